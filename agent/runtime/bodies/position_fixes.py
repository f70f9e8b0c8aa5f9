"""Observations from what a receiver says bit by bit: place, time, accuracy, heading and velocity.

The time of an observation is that of its place. The clock of the receiver differs from ours by a
constant, which is the shortest difference seen between arrival and time: what arrives later was late.
"""

from collections import deque
from collections.abc import Callable
from math import cos, inf, radians, remainder, sin, tau
from typing import Final

from agent.interface.config import S
from agent.interface.observation import Observation

DAY_US: Final = 86_400 * S
# Standard deviation of a place without GST, metres, by the kind of fix: 4 is RTK fixed, 5 RTK float.
ACCURACY_M: Final = {1: 3.0, 2: 1.0, 4: 0.02, 5: 0.4}
# What a fix of this kind is at best, whatever its receiver says of it.
BEST_M: Final = {1: 1.0, 2: 0.3, 4: 0.0, 5: 0.05}
HEADING_ACCURACY_RAD: Final = radians(1.0)  # of two antennas a metre apart
HEADING_AGE_MAX_US: Final = S // 10  # an older heading is no heading
VELOCITY_AGE_MAX_US: Final = S // 2
# A velocity that is computed is that over this time, and late by half of it. Noise of a centimetre in two
# places at 20 Hz would be 0.3 m/s, and the farewell of a robot that seems to drive is not believed.
VELOCITY_OVER_US: Final = 400_000
ACCURACY_AGE_MAX_US: Final = 2 * S  # GST is often sent once a second
OFFSET_FOR_US: Final = 60 * S  # two clocks of 50 ppm differ by 3 ms more in this time
STEP_FOR_US: Final = 2 * S  # a step of the receiver's time is believed after this time
STEADY_US: Final = S // 20  # as much later or earlier do places arrive on a line that is sound
GAP_MAX_US: Final = S // 2  # after a longer silence, places may be late


class ReceiverClock:
    """The time of a receiver on our clock.

    A receiver sets its time back by whole seconds when it learns of leap seconds, and repeats or leaves
    out one at a leap second. Places then look late. A place cannot become later by more than the time
    since the one before, so a larger step is one of the time. At midnight a leap second looks like a
    silence of 1 s. Such a step is the new difference when arrivals have been steady for `STEP_FOR_US`.
    """

    def __init__(self, latency_us: int) -> None:
        """`latency_us`: from the time of a place to its arrival, at the shortest."""
        self.latency_us = latency_us
        self._least_for_us = self._before_for_us = DAY_US  # of this period, and of the one before
        self._period_ends_at_us = -DAY_US
        self._last: tuple[int, int] | None = None  # difference and arrival of the newest place
        self._step: tuple[int, int] | None = None  # the least since a step, and when that began

    def sensed_at_us(self, utc_at_us: int, arrived_at_us: int) -> int:
        """The time at which a place was true. `utc_at_us`: since midnight."""
        differ_for_us = (arrived_at_us - utc_at_us) % DAY_US
        if arrived_at_us >= self._period_ends_at_us:
            self._before_for_us, self._least_for_us = self._least_for_us, differ_for_us
            self._period_ends_at_us = arrived_at_us + OFFSET_FOR_US
        if _later(self._least_for_us, differ_for_us):
            self._least_for_us = differ_for_us
        self._follow_steps(differ_for_us, utc_at_us, arrived_at_us)
        least_for_us = self._least_for_us
        if self._before_for_us < DAY_US and _later(least_for_us, self._before_for_us):
            least_for_us = self._before_for_us
        late_for_us = (differ_for_us - least_for_us) % DAY_US
        return arrived_at_us - late_for_us - self.latency_us

    def _follow_steps(self, differ_for_us: int, utc_at_us: int, arrived_at_us: int) -> None:
        last, self._last = self._last, (differ_for_us, arrived_at_us)
        if last is None:
            return
        gap_for_us = arrived_at_us - last[1]
        grown_for_us = round(remainder(differ_for_us - last[0], DAY_US))
        whole_for_us = round(grown_for_us / S) * S
        whole = whole_for_us > 0 and abs(grown_for_us - whole_for_us) <= STEADY_US
        if whole and (grown_for_us > gap_for_us + STEADY_US or utc_at_us < S):
            self._step = differ_for_us, arrived_at_us
        elif self._step is not None:
            stepped_for_us, begun_at_us = self._step
            off_for_us = abs(remainder(differ_for_us - stepped_for_us, DAY_US))
            if _later(stepped_for_us, differ_for_us):
                stepped_for_us = differ_for_us
            self._step = stepped_for_us, begun_at_us
            if gap_for_us > GAP_MAX_US or off_for_us > STEADY_US:
                self._step = None
            elif arrived_at_us - begun_at_us > STEP_FOR_US:
                self._least_for_us, self._before_for_us = stepped_for_us, DAY_US
                self._step = None


def _later(one_for_us: int, other_for_us: int) -> bool:
    """Whether the first of two differences on a circle of a day is the longer one."""
    return remainder(one_for_us - other_for_us, DAY_US) > 0


class PositionFixes:
    """Puts together observations: each has a place and a heading that came after the one before."""

    def __init__(
        self,
        to_metres: Callable[[float, float], tuple[float, float]],
        antenna_m: tuple[float, float],
        accuracy_m: float = inf,
    ) -> None:
        """`to_metres`: from longitude and latitude to metres east and north in the field.
        `antenna_m`: where the antenna is, ahead and left of the middle of the body. `accuracy_m`: of
        places whose receiver says none.
        """
        self.to_metres, self.antenna_m, self.accuracy_m = to_metres, antenna_m, accuracy_m
        self._place: tuple[float, float, int] | None = None  # longitude, latitude, time
        self._heading: tuple[float, int] | None = None  # radians, arrival
        self._velocity: tuple[float, float, int] | None = None  # east, north, arrival
        self._accuracy: tuple[float, int] | None = None  # metres, arrival
        self._kind: tuple[int, int] | None = None  # of fix, arrival
        # East, north, heading, and time of the middle of the body during `VELOCITY_OVER_US`.
        self._recent: deque[tuple[float, float, float, int]] = deque()

    def take_place(self, longitude: float, latitude: float, at_us: int) -> None:
        """A place in degrees, and the time at which it was true, microseconds."""
        self._place = longitude, latitude, at_us

    def take_kind(self, kind: int, arrived_at_us: int) -> None:
        """The kind of fix, numbered as in GGA; another than those of `ACCURACY_M` is no fix."""
        if self._kind is not None and self._kind[0] != kind:
            self._accuracy = None  # it was of the fixes before: without RTK they are metres off
        self._kind = kind, arrived_at_us

    def take_heading(self, heading_rad: float, arrived_at_us: int) -> None:
        """Radians, counter-clockwise from east."""
        self._heading = heading_rad, arrived_at_us

    def take_velocity(self, vx_m_s: float, vy_m_s: float, arrived_at_us: int) -> None:
        """Of the antenna, metres a second, east and north."""
        self._velocity = vx_m_s, vy_m_s, arrived_at_us

    def take_speed(self, speed_m_s: float, course_rad: float, arrived_at_us: int) -> None:
        """Metres a second over ground; the course is counter-clockwise from east."""
        self.take_velocity(speed_m_s * cos(course_rad), speed_m_s * sin(course_rad), arrived_at_us)

    def take_accuracy(self, accuracy_m: float, arrived_at_us: int) -> None:
        """Standard deviation of the place, metres."""
        self._accuracy = accuracy_m, arrived_at_us

    @property
    def heading_rad(self) -> float:
        """The newest heading, radians; 0.0 without one."""
        return 0.0 if self._heading is None else self._heading[0]

    def knows_velocity(self, now_us: int) -> bool:
        """Whether the receiver has told a velocity within `VELOCITY_AGE_MAX_US`."""
        velocity = self._velocity
        return velocity is not None and now_us - velocity[2] <= VELOCITY_AGE_MAX_US

    def whole(self, now_us: int) -> Observation | None:
        """The observation that is complete now; None if there is none."""
        place, heading = self._place, self._heading
        if place is None or heading is None or now_us - heading[1] > HEADING_AGE_MAX_US:
            return None
        self._place = self._heading = None
        longitude, latitude, at_us = place
        heading_rad = heading[0]
        ahead_m, left_m = self.antenna_m
        arm_x_m = cos(heading_rad) * ahead_m - sin(heading_rad) * left_m
        arm_y_m = sin(heading_rad) * ahead_m + cos(heading_rad) * left_m
        x_m, y_m = self.to_metres(longitude, latitude)
        x_m, y_m = x_m - arm_x_m, y_m - arm_y_m
        accuracy_m = self._accuracy_m(now_us)
        self._remember(x_m, y_m, heading_rad, at_us)
        if self.knows_velocity(now_us):
            assert self._velocity is not None
            turn_rad_s = self._turn_rad_s()
            vx_m_s = self._velocity[0] + turn_rad_s * arm_y_m
            vy_m_s = self._velocity[1] - turn_rad_s * arm_x_m
        else:
            vx_m_s, vy_m_s = self._passed_m_s()
        return Observation(
            x_m, y_m, heading_rad, vx_m_s, vy_m_s, sensed_at_us=at_us,
            position_accuracy_m=accuracy_m, heading_accuracy_rad=HEADING_ACCURACY_RAD,
        )  # fmt: skip

    def _accuracy_m(self, now_us: int) -> float:
        kind = None
        if self._kind is not None and now_us - self._kind[1] <= ACCURACY_AGE_MAX_US:
            kind = self._kind[0]
        if self._accuracy is not None and now_us - self._accuracy[1] <= ACCURACY_AGE_MAX_US:
            return max(self._accuracy[0], 0.0 if kind is None else BEST_M.get(kind, inf))
        return self.accuracy_m if kind is None else ACCURACY_M.get(kind, inf)

    def _remember(self, x_m: float, y_m: float, heading_rad: float, at_us: int) -> None:
        recent = self._recent
        if recent and at_us <= recent[-1][3]:  # the time went back
            recent.clear()
        recent.append((x_m, y_m, heading_rad, at_us))
        while len(recent) > 2 and at_us - recent[0][3] > VELOCITY_OVER_US:
            recent.popleft()

    def _passed_for_s(self) -> float:
        """Time from the oldest of the recent places to the newest; 0.0 if that is too long ago."""
        passed_for_us = self._recent[-1][3] - self._recent[0][3]
        return passed_for_us / S if passed_for_us <= VELOCITY_AGE_MAX_US else 0.0

    def _passed_m_s(self) -> tuple[float, float]:
        """Velocity of the body by its recent places, metres a second, east and north."""
        passed_for_s, first, last = self._passed_for_s(), self._recent[0], self._recent[-1]
        if not passed_for_s:
            return 0.0, 0.0
        return (last[0] - first[0]) / passed_for_s, (last[1] - first[1]) / passed_for_s

    def _turn_rad_s(self) -> float:
        """How fast the body turns, counter-clockwise. The antenna moves by that around its middle."""
        passed_for_s = self._passed_for_s()
        if not passed_for_s:
            return 0.0
        return remainder(self._recent[-1][2] - self._recent[0][2], tau) / passed_for_s


QUARTER_DEG: Final = 90.0  # from north to east


def course_rad(degrees: float) -> float:
    """From degrees clockwise from north to radians counter-clockwise from east."""
    return radians(remainder(QUARTER_DEG - degrees, 360.0))
