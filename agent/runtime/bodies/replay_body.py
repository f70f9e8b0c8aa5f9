"""A recorded drive: the NMEA sentences of a file, in the time in which they were sent.

    [body]
    plugin = "replay"
    options = { log = "field-day.nmea" }

The robot sees the places and drives nothing: to look at its decisions again, or to try a receiver's log.
"""

from bisect import bisect_right
from math import remainder
from pathlib import Path

from agent.interface.effects import GatedDrive
from agent.interface.observation import Observation
from agent.runtime.bodies.nmea_body import in_field
from agent.runtime.bodies.nmea_fixes import NmeaFixes
from agent.runtime.bodies.position_fixes import DAY_US
from agent.runtime.option_values import antenna, origin_or_none, text
from agent.runtime.robot_body import DeclaredMachine, RobotBody

LOG_BYTES_MAX = 1 << 28  # a day at 20 Hz


class _LogClock:
    """The time of a log, which goes on at midnight. Where a log goes back, its time stands."""

    def __init__(self) -> None:
        self.at_us = 0  # of the newest place, since the first
        self._utc_at_us: int | None = None

    def at(self, utc_at_us: int) -> int:
        """The time of a place; `utc_at_us`: of it since midnight."""
        if self._utc_at_us is not None:
            passed_for_us = round(remainder(utc_at_us - self._utc_at_us, DAY_US))
            self.at_us += max(passed_for_us, 0)
        self._utc_at_us = utc_at_us
        return self.at_us


class ReplayBody(RobotBody):
    """A body that was where a log says."""

    def __init__(
        self,
        slot: int,
        log: str,
        antenna_ahead_m: float = 0.0,
        antenna_left_m: float = 0.0,
        origin: tuple[float, float] | None = None,
    ) -> None:
        """`log`: a file of sentences. The other options are those of `NmeaBody`. Raises ValueError."""
        self.log = Path(text("log", log, "the name of a file of NMEA sentences"))
        self.origin = origin_or_none(origin)
        self.antenna_m = antenna(antenna_ahead_m, antenna_left_m)
        self.seen: list[Observation] = []  # times since the first
        self._begins_at_us: int | None = None

    def declare(self, machine: DeclaredMachine) -> None:
        """Raises ValueError if neither the field nor the options say where (0, 0) is."""
        self.origin = self.origin or machine.origin
        if self.origin is None:
            raise ValueError(
                "without a field, options.origin says latitude and longitude of (0, 0)"
            )
        self.log = machine.folder / self.log

    async def open(self) -> None:
        """Read the log. Raises ValueError if it cannot be read or has no place in it: it does not come by
        itself, as a device may."""
        assert self.origin is not None, "`declare` comes before `open`"
        try:
            if self.log.stat().st_size > LOG_BYTES_MAX:
                raise ValueError(f"options.log: {self.log}: more than {LOG_BYTES_MAX >> 20} MB")
            lines = self.log.read_bytes().splitlines()
        except OSError as problem:
            raise ValueError(f"options.log: {self.log}: {problem.strerror}") from None
        clock = _LogClock()
        fixes = NmeaFixes(
            in_field(self.origin),
            self.antenna_m,
            lambda utc_at_us, arrived_at_us: clock.at(utc_at_us),
        )
        taken = (fixes.take(line, clock.at_us) for line in lines)
        places = [each for each in taken if each is not None]
        if not places:
            raise ValueError(f"options.log: {self.log}: no place and heading in it")
        begins_at_us = places[0].sensed_at_us
        self.seen = [
            each._replace(sensed_at_us=each.sensed_at_us - begins_at_us) for each in places
        ]
        self._begins_at_us = None

    def sense(self, now_us: int) -> Observation | None:
        """The place of this time; after the last one it stays, and grows old."""
        if self._begins_at_us is None:
            self._begins_at_us = now_us
        since_for_us = now_us - self._begins_at_us
        index = bisect_right(self.seen, since_for_us, key=lambda each: each.sensed_at_us) - 1
        seen = self.seen[index]
        return seen._replace(sensed_at_us=seen.sensed_at_us + self._begins_at_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """A log cannot be driven."""
