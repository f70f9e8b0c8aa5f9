"""Observations from NMEA 0183 sentences: place, accuracy, heading and velocity of a machine.

| sentence | gives |
|---|---|
| GGA | place and its time, kind of fix |
| GST | accuracy of the place |
| HDT, THS | heading |
| VTG, RMC | velocity |

An observation needs a GGA with a new time and a heading. Without GST the kind of fix says the accuracy,
`ACCURACY_M`. Without VTG and RMC the velocity is that of the places of the last 0.4 s.

The time of an observation is that of its GGA. The clock of the receiver differs from ours by a constant,
which is the shortest difference seen between arrival and time: what arrives later was late on its way.
"""

from collections import Counter
from collections.abc import Callable
from datetime import time as Clock
from math import inf, isfinite
from typing import Any, Final

try:
    from pynmeagps import NMEAReader
except ImportError:
    raise ImportError("NMEA needs an extra: pip install 'headland[nmea]'") from None

from agent.interface.config import S
from agent.interface.observation import Observation
from agent.runtime.bodies.position_fixes import ACCURACY_M, PositionFixes, course_rad

KNOT_M_S: Final = 1852 / 3600
KMH_M_S: Final = 1 / 3.6
TURN_DEG: Final = 360.0


class NmeaFixes:
    """Takes the sentences of one receiver."""

    def __init__(
        self,
        to_metres: Callable[[float, float], tuple[float, float]],
        antenna_m: tuple[float, float],
        sensed_at_us: Callable[[int, int], int],
        accuracy_m: float = inf,
    ) -> None:
        """`to_metres`: from longitude and latitude to metres east and north in the field.
        `antenna_m`: where the antenna is, ahead and left of the middle of the body.
        `sensed_at_us`: our time of a place, from its time since midnight and its arrival.
        `accuracy_m`: of a receiver that says neither GST nor the kind of its fix.
        """
        self.fixes = PositionFixes(to_metres, antenna_m, accuracy_m)
        self.counts: Counter[str] = Counter()  # sentences by kind, and "malformed", "repeated"
        self.sensed_at_us = sensed_at_us
        self.utc_at_us = 0  # time of the newest place, since midnight
        self._utc: Clock | None = None

    def take(self, line: bytes, arrived_at_us: int) -> Observation | None:
        """The observation that this sentence completes; None if it completes none.

        What is before its last dollar sign is binary: receivers send that between sentences."""
        line = line[max(line.rfind(b"$"), 0) :]
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
            elif _says_invalid(sentence):
                self.counts["invalid"] += 1
            elif kind in ("HDT", "THS"):
                bearing = sentence.headingT if kind == "HDT" else sentence.headt
                self.fixes.take_heading(course_rad(_bearing(bearing)), arrived_at_us)
            elif kind == "GST":
                sizes_m = _number(sentence.stdLat), _number(sentence.stdLong)
                # Receivers say by -1 or 0.0 that they do not know it.
                if min(sizes_m) < 0.0 or max(sizes_m) == 0.0:
                    self.counts["invalid"] += 1
                else:
                    self.fixes.take_accuracy(max(sizes_m), arrived_at_us)
            elif kind in ("VTG", "RMC"):
                self._take_velocity(sentence, arrived_at_us)
        except (TypeError, ValueError, AttributeError):  # an empty field, or "nan"
            self.counts["malformed"] += 1
            return None
        return self.fixes.whole(arrived_at_us)

    def _take_place(self, gga: Any, arrived_at_us: int) -> None:
        if gga.time == self._utc:
            self.counts["repeated"] += 1
            return
        utc: Clock = gga.time
        self.utc_at_us = (utc.hour * 3600 + utc.minute * 60 + utc.second) * S + utc.microsecond
        self._utc = utc
        if gga.quality in ACCURACY_M:
            if gga.NS not in ("N", "S") or gga.EW not in ("E", "W"):
                raise ValueError("a place without its hemisphere")
            at_us = self.sensed_at_us(self.utc_at_us, arrived_at_us)
            self.fixes.take_place(_number(gga.lon), _number(gga.lat), at_us)
            self.fixes.take_kind(gga.quality, arrived_at_us)

    def _take_velocity(self, sentence: Any, arrived_at_us: int) -> None:
        rmc = sentence.msgID == "RMC"
        speed_m_s = _number(sentence.spd) * KNOT_M_S if rmc else _number(sentence.sogk) * KMH_M_S
        course = sentence.cog if rmc else sentence.cogt
        if course in ("", None):  # receivers leave it out below a walking pace
            to_rad = self.fixes.heading_rad
        else:
            to_rad = course_rad(_bearing(course))
        self.fixes.take_speed(speed_m_s, to_rad, arrived_at_us)


def _number(field: Any) -> float:
    """The value of a field. Raises TypeError or ValueError if it is no finite number."""
    value = float(field)
    if not isfinite(value):
        raise ValueError(f"{field!r} is no finite number")
    return value


def _bearing(field: Any) -> float:
    """A bearing in degrees. Some receivers say by 999.9 that they know none. Raises TypeError or
    ValueError."""
    bearing = _number(field)
    if not 0.0 <= bearing <= TURN_DEG:
        raise ValueError(f"{field!r} is no bearing")
    return bearing


def _says_invalid(sentence: Any) -> bool:
    """Whether a sentence says of itself that its heading or velocity is not to be used."""
    if sentence.msgID == "THS":
        return bool(sentence.mi != "A")  # estimated, manual, simulated or not valid
    if sentence.msgID == "RMC":
        return bool(sentence.status != "A")
    return bool(sentence.msgID == "VTG" and getattr(sentence, "posMode", "") == "N")
