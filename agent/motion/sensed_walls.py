"""Fences from range sensors, for ORCA where the walls are not known beforehand.

Echoes of neighbouring rays that are near each other are sides of one thing and joined; a lone echo is
a point. Echoes of robots are left out, ORCA has those from their poses.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from agent.interface.ports import Observation
from agent.motion.unexplained_echoes import echoes

JOINED_M = 0.5  # echoes further apart may have a door between them
OTHER_M = 0.15  # beyond a robot's radius: poses are rounded to 0.05 m and are a beat old
NEAR_M = 1.5  # further echoes cannot be met before the next scan by anything this small and slow


def fences_of(
    here: Observation, others: Iterable[tuple[float, float, float]]
) -> NDArray[np.float64]:
    """Segments (n, 4) in metres: ax, ay, bx, by. `others`: x, y and radius of robots."""
    found = echoes(here, NEAR_M, [(x, y, r + OTHER_M) for x, y, r in others])
    rows = np.empty((len(found), 4))
    rows[:, :2] = found
    rows[:-1, 2:], rows[-1:, 2:] = found[1:], found[:1]
    gap_m = np.hypot(rows[:, 2] - rows[:, 0], rows[:, 3] - rows[:, 1])
    alone = ~(gap_m < JOINED_M)  # no echo is no less than anything
    rows[alone, 2:] = rows[alone, :2]
    return rows[~np.isnan(rows[:, 0])]
