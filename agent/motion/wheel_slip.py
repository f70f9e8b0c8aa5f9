"""How much the wheels of a body slip, by its velocity and its commands, and how fast it may drive then.

A body that slips does not go where its wheels push it. What it goes aside in the time of a decision is
more than the margin to a fence or to another body, unless it drives slower. Slip grows with speed, so a
slower body is moved aside by less.
"""

from math import exp, hypot
from typing import Final

from agent.interface.config import S
from agent.interface.geometry import Point

# The velocity of a body that does not slip is between what slow and what fast wheels would have made of
# its commands, with an error of 0.15 m/s in 99 of 100 periods. With this one a body drives half of the
# margin between two bodies in 0.25 s.
ALLOWED_M_S: Final = 0.3
SLOWEST_SHARE: Final = 0.2  # of the full speed: a body that slips gets on
FORGOTTEN_S: Final = 3.0  # the error of a grip that wanders is seen again within that
LEAST_M_S: Final = 1.0  # an error at less speed says little of one at full speed


class WheelSlip:
    """The slip of one body that may move to any side."""

    def __init__(self, fastest_m_s: float) -> None:
        self.fastest_m_s = fastest_m_s
        self._error_m_s = 0.0  # greatest error of late, at full speed
        self._seen_at_us = 0

    def observe(self, moves: Point, slow: Point, told: Point, now_us: int) -> None:
        """Each control period: the velocity, what it would be with wheels that are slow to follow, and
        what they were told, (x, y) metres a second."""
        passed_for_s, self._seen_at_us = (now_us - self._seen_at_us) / S, now_us
        if self._error_m_s > 0.0:
            self._error_m_s *= exp(-max(passed_for_s, 0.0) / FORGOTTEN_S)
            if self._error_m_s < ALLOWED_M_S:
                self._error_m_s = 0.0
        error_m_s = _off_m_s(moves, slow, told)
        if error_m_s > ALLOWED_M_S:
            speed_m_s = max(hypot(*told), hypot(*slow), LEAST_M_S)
            error_m_s *= self.fastest_m_s / min(speed_m_s, self.fastest_m_s)
            self._error_m_s = max(self._error_m_s, error_m_s)

    @property
    def limit_m_s(self) -> float:
        """As fast as the body may drive."""
        if self._error_m_s == 0.0:
            return self.fastest_m_s
        return self.fastest_m_s * max(ALLOWED_M_S / self._error_m_s, SLOWEST_SHARE)


def _off_m_s(moves: Point, slow: Point, told: Point) -> float:
    """The distance of a velocity from all those between two others."""
    dx, dy = told[0] - slow[0], told[1] - slow[1]
    x, y = moves[0] - slow[0], moves[1] - slow[1]
    length_2 = dx * dx + dy * dy
    share = 0.0 if length_2 == 0.0 else min(max((x * dx + y * dy) / length_2, 0.0), 1.0)
    return hypot(x - share * dx, y - share * dy)
