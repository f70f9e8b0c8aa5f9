"""Fences from range sensors, for ORCA where the walls are not known beforehand.

Echoes of neighbouring rays that are near each other are sides of one thing and are joined. A lone
echo is a point. Echoes of robots are left out, because ORCA has the robots from their poses.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from agent.interface.observation import Observation
from agent.motion.unexplained_echoes import echoes

JOINED_M = 0.5  # echoes further apart may have a door between them
OTHER_M = 0.15  # beyond a robot's radius: poses are rounded to 0.05 m and are a beat old
NEAR_M = 1.5  # a robot this small and slow cannot meet further echoes before the next scan


def fences_of(
    here: Observation, others: Iterable[tuple[float, float, float]]
) -> NDArray[np.float64]:
    """The walls near a robot as segments (n, 4) of ax, ay, bx, by in metres; a point has both ends
    equal.

    `here`: the observation with its rays. `others`: x, y and radius of known robots, metres.
    """
    found = echoes(here, NEAR_M, [(x, y, r + OTHER_M) for x, y, r in others])
    rows = np.empty((len(found), 4))
    rows[:, :2] = found
    rows[:-1, 2:], rows[-1:, 2:] = found[1:], found[:1]
    gap_m = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])
    alone = ~(gap_m < JOINED_M)  # no echo is no less than anything
    rows[alone, 2:] = rows[alone, :2]
    return rows[~np.isnan(rows[:, 0])]
