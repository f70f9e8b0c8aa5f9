"""The choice of the code that moves bodies.

`pymunk` makes every step of a world with the physics engine: runs, launches and explorations.
`contact_free` calls the engine only if something is near, and otherwise moves bodies with
`sim.world.contact_free_steps`. Both have the same result. The second costs less, so campaigns and
trials use it.
"""

from typing import Literal

Engine = Literal["pymunk", "contact_free"]
