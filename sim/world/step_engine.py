"""Which code moves bodies.

`pymunk` makes every step of a world by the physics engine: runs, launches and explorations.
`contact_free` calls the engine only where something is near, and moves bodies by
`sim.world.contact_free_steps` elsewhere. Both have the same result. The second costs less, so
campaigns and trials choose it.
"""

from typing import Literal

Engine = Literal["pymunk", "contact_free"]
