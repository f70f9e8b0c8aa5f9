"""Observations from NMEA 0183 sentences: place, accuracy, heading and velocity of a machine.

| sentence | gives |
|---|---|
| GGA | place and its time, kind of fix |
| GST | accuracy of the place |
| HDT, THS | heading |
| VTG, RMC | velocity |

An observation needs a GGA with a new time and a heading. Without GST the kind of fix says the accuracy,
`ACCURACY_M`. Without VTG and RMC the velocity is that between the last two places.

The time of an observation is that of its GGA. The clock of the receiver differs from ours by a constant,
which is the shortest difference seen between arrival and time: what arrives later was late on its way.
"""

from collections import Counter
from collections.abc import Callable
from datetime import time as Clock
from math import cos, inf, radians, remainder, sin
from typing import Any, Final

try:
    from pynmeagps import NMEAReader
except ImportError:
    raise ImportError("NMEA needs an extra: pip install 'headland[nmea]'") from None

from agent.interface.config import S
from agent.interface.observation import Observation

DAY_US: Final = 86_400 * S
# Standard deviation of a place without GST, metres, by the kind of fix: 4 is RTK fixed, 5 RTK float.
ACCURACY_M: Final = {1: 3.0, 2: 1.0, 4: 0.02, 5: 0.4}
HEADING_ACCURACY_RAD: Final = radians(1.0)  # of two antennas a metre apart
HEADING_AGE_MAX_US: Final = S // 10  # an older heading is no heading
VELOCITY_AGE_MAX_US: Final = S // 2
ACCURACY_AGE_MAX_US: Final = 2 * S  # GST is often sent once a second
OFFSET_FOR_US: Final = 60 * S  # two clocks of 50 ppm differ by 3 ms more in this time
KNOT_M_S: Final = 1852 / 3600
KMH_M_S: Final = 1 / 3.6
QUARTER: Final = 90.0  # degrees from north, clockwise, to degrees from east, counter-clockwise


class ReceiverClock:
    """The time of a receiver on our clock."""

    def __init__(self, latency_us: int) -> None:
        """`latency_us`: from the time of a place to its arrival, at the shortest."""
        self.latency_us = latency_us
        self._least_for_us = self._before_for_us = DAY_US  # of this period, and of the one before
        self._period_ends_at_us = -DAY_US

    def sensed_at_us(self, utc_at_us: int, arrived_at_us: int) -> int:
        """The time at which a place was true. `utc_at_us`: since midnight."""
        differ_for_us = (arrived_at_us - utc_at_us) % DAY_US
        if arrived_at_us >= self._period_ends_at_us:
            self._before_for_us, self._least_for_us = self._least_for_us, differ_for_us
            self._period_ends_at_us = arrived_at_us + OFFSET_FOR_US
        if _later(self._least_for_us, differ_for_us):
            self._least_for_us = differ_for_us
        least_for_us = self._least_for_us
        if self._before_for_us < DAY_US and _later(least_for_us, self._before_for_us):
            least_for_us = self._before_for_us
        late_for_us = (differ_for_us - least_for_us) % DAY_US
        return arrived_at_us - late_for_us - self.latency_us


def _later(one_for_us: int, other_for_us: int) -> bool:
    """Whether the first of two differences on a circle of a day is the longer one."""
    return remainder(one_for_us - other_for_us, DAY_US) > 0


class NmeaFixes:
    """Takes the sentences of one receiver."""

    def __init__(
        self,
        to_metres: Callable[[float, float], tuple[float, float]],
        antenna_m: tuple[float, float],
        sensed_at_us: Callable[[int, int], int],
    ) -> None:
        """`to_metres`: from longitude and latitude to metres east and north in the field.
        `antenna_m`: where the antenna is, ahead and left of the middle of the body.
        `sensed_at_us`: our time of a place, from its time since midnight and its arrival.
        """
        self.to_metres, self.antenna_m = to_metres, antenna_m
        self.counts: Counter[str] = Counter()  # sentences by kind, and "malformed", "repeated"
        self.sensed_at_us = sensed_at_us
        self.utc_at_us = 0  # time of the newest place, since midnight
        self._utc: Clock | None = None
        self._place: tuple[float, float, int, int] | None = None  # longitude, latitude, kind, time
        self._heading: tuple[float, int] | None = None  # radians, arrival
        self._velocity: tuple[float, float, int] | None = None  # east, north, arrival
        self._accuracy: tuple[float, int] | None = None  # metres, arrival
        self._last: Observation | None = None

    def take(self, line: bytes, arrived_at_us: int) -> Observation | None:
        """The observation that this sentence completes; None if it completes none."""
        try:
            sentence: Any = NMEAReader.parse(line + b"\r\n")
        except Exception:  # of many kinds, for bytes of any kind
            sentence = None
        if sentence is None:
            self.counts["malformed"] += 1
            return None
        kind = sentence.msgID
        self.counts[kind] += 1
        try:
            if kind == "GGA":
                self._take_place(sentence, arrived_at_us)
            elif kind in ("HDT", "THS"):
                degrees = sentence.headingT if kind == "HDT" else sentence.headt
                self._heading = _course_rad(float(degrees)), arrived_at_us
            elif kind == "GST":
                self._accuracy = max(float(sentence.stdLat), float(sentence.stdLong)), arrived_at_us
            elif kind in ("VTG", "RMC"):
                self._take_velocity(sentence, arrived_at_us)
        except (TypeError, ValueError, AttributeError):  # an empty field
            self.counts["malformed"] += 1
            return None
        return self._whole(arrived_at_us)

    def _take_place(self, gga: Any, arrived_at_us: int) -> None:
        if gga.time == self._utc:
            self.counts["repeated"] += 1
            return
        utc: Clock = gga.time
        self.utc_at_us = (utc.hour * 3600 + utc.minute * 60 + utc.second) * S + utc.microsecond
        self._utc = utc
        if gga.quality in ACCURACY_M:
            at_us = self.sensed_at_us(self.utc_at_us, arrived_at_us)
            self._place = float(gga.lon), float(gga.lat), gga.quality, at_us

    def _take_velocity(self, sentence: Any, arrived_at_us: int) -> None:
        rmc = sentence.msgID == "RMC"
        speed_m_s = float(sentence.spd) * KNOT_M_S if rmc else float(sentence.sogk) * KMH_M_S
        course = sentence.cog if rmc else sentence.cogt
        if course in ("", None):  # receivers leave it out below a walking pace
            heading = self._heading
            course_rad = 0.0 if heading is None else heading[0]
        else:
            course_rad = _course_rad(float(course))
        self._velocity = speed_m_s * cos(course_rad), speed_m_s * sin(course_rad), arrived_at_us

    def _whole(self, now_us: int) -> Observation | None:
        place, heading = self._place, self._heading
        if place is None or heading is None or now_us - heading[1] > HEADING_AGE_MAX_US:
            return None
        self._place = self._heading = None
        longitude, latitude, kind, at_us = place
        heading_rad = heading[0]
        ahead_m, left_m = self.antenna_m
        x_m, y_m = self.to_metres(longitude, latitude)
        x_m -= cos(heading_rad) * ahead_m - sin(heading_rad) * left_m
        y_m -= sin(heading_rad) * ahead_m + cos(heading_rad) * left_m
        accuracy_m = ACCURACY_M.get(kind, inf)
        if self._accuracy is not None and now_us - self._accuracy[1] <= ACCURACY_AGE_MAX_US:
            accuracy_m = self._accuracy[0]
        vx_m_s, vy_m_s = self._velocity_m_s(x_m, y_m, at_us, now_us)
        self._last = Observation(
            x_m, y_m, heading_rad, vx_m_s, vy_m_s, sensed_at_us=at_us,
            position_accuracy_m=accuracy_m, heading_accuracy_rad=HEADING_ACCURACY_RAD,
        )  # fmt: skip
        return self._last

    def _velocity_m_s(self, x_m: float, y_m: float, at_us: int, now_us: int) -> tuple[float, float]:
        velocity, last = self._velocity, self._last
        if velocity is not None and now_us - velocity[2] <= VELOCITY_AGE_MAX_US:
            return velocity[:2]
        if last is None or not 0 < at_us - last.sensed_at_us <= VELOCITY_AGE_MAX_US:
            return 0.0, 0.0
        passed_for_s = (at_us - last.sensed_at_us) / S
        return (x_m - last.x_m) / passed_for_s, (y_m - last.y_m) / passed_for_s


def _course_rad(degrees: float) -> float:
    """From degrees clockwise from north to radians counter-clockwise from east."""
    return radians(remainder(QUARTER - degrees, 360.0))
