"""The last resort of a body on a grid: it does not drive nearer to a body that it sees near.

Plans keep robots a cell apart, and 0.71 of a cell if one follows another round a corner. A robot that
comes nearer than `GUARD` is not where our plan expects it: it is late, or not part of our plan.
"""

from collections.abc import Mapping
from math import hypot

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import HALT, Drive
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import MotionController
from agent.interface.observation import Neighbour, Observation

GUARD = 0.6  # of a cell, between centres
PERIOD_S = CONTROL_PERIOD_US / S


class GridGuard(MotionController):
    """The motion controller of a robot on a grid: its requests are safe by the plan if all robots
    keep to it."""

    def __init__(self, cell_m: float, radius_m: float, speed_m_s: float) -> None:
        assert self.fits(cell_m, radius_m, speed_m_s), "bodies are too large for their cells"
        self.guard_m, self.speed_m_s = GUARD * cell_m, speed_m_s

    @staticmethod
    def fits(cell_m: float, radius_m: float, speed_m_s: float) -> bool:
        """Whether bodies of this size can keep apart by the guard on cells of this size."""
        closing_m = 2 * speed_m_s * PERIOD_S  # two that have not yet seen each other move
        return GUARD * cell_m - closing_m >= 2 * radius_m

    def drive(
        self,
        here: Observation,
        wish: MotionRequest,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Drive:
        vx, vy = wish.vx_m_s, wish.vy_m_s
        for x_m, y_m in here.bodies:
            after_m = hypot(x_m - vx * PERIOD_S, y_m - vy * PERIOD_S)
            if after_m < self.guard_m and after_m < hypot(x_m, y_m):
                return HALT
        return Drive(vx, vy, 0.0, wish.tool_on)
