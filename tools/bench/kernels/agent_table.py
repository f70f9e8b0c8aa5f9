"""The table of all robots of a simulation for kernels: one row a robot, float32, metres and seconds."""

import numpy as np
from numpy.typing import NDArray

Agents = NDArray[np.float32]  # (robots, AGENT_COLUMNS)
X, Y, VX, VY, WANT_X, WANT_Y, NEW_VX, NEW_VY = range(8)
RADIUS, SPEED_MAX, RANGE, NEIGHBOURS, HORIZON, WALL_HORIZON, AGENT_COLUMNS = range(8, 15)
