"""Whether the range sensors of a robot work: scans that are absent or do not change stop it.

A robot that drives on without them does not see a person. A driver gives no scan when its newest one
is old, and a scan that arrives with every observation counts as new. A driver that hangs repeats one
scan. This shows when the robot moves: no two scans from different places are equal, except beside
straight walls along which it drives.

A robot that has never had a scan has no range sensors, and is not held. It remembers its first scan for
good: a restart does not make a dead sensor one that never was.
"""

from collections.abc import Mapping
from math import cos, hypot, isfinite, pi, remainder, sin
from typing import Any, Final

from agent.interface.config import SCAN_AGE_MAX_US, S
from agent.interface.effects import Persist
from agent.interface.observation import Observation
from agent.peer import notices
from agent.peer.part import NOTHING, DirectListener, Outputs, Part
from agent.peer.sense_freshness import Senses
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController

STEADY_US: Final = 1 * S  # scans must arrive and change for this long before it drives on
# How far it drives, or turns, with equal scans. Until then it does not know that they are old, and what
# came into its way meanwhile is not seen: this and its way to standstill.
MOVED_M: Final = 0.3
TURNED_RAD: Final = 0.2
# Sine of the angle between two echoes beside each other and the way that was driven: less is a wall
# along that way, of which every scan is the same.
ALONG: Final = 0.1
SCANS_KEY, SCANNED = "scans", b"\1"  # durable: it has had a scan


class RangeSensing(Part):
    """Watches one robot's scans in each control period, after its place."""

    def __init__(
        self, safety: StopController, senses: Senses, recalled: Mapping[str, bytes]
    ) -> None:
        """`recalled`: durable memory as it was before the start; the key is `SCANS_KEY`."""
        self.safety, self.senses = safety, senses
        self._has_scanned = recalled.get(SCANS_KEY) == SCANNED
        self._scan: tuple[float, ...] | None = None  # the newest; None: there never was one
        self._first: Observation | None = None  # the first observation with that scan
        self._wrong_at_us = 0  # when scans were last absent or stuck

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {notices.ControlDue: self._period}

    def _period(self, notice: notices.ControlDue, now_us: int) -> Outputs:
        here = self.senses.here
        if here is None or not self.senses.current:
            self._first = None
            return NOTHING  # without a place the robot stands, and it cannot compare scans
        if not here.ranges_m and not self._has_scanned:
            return NOTHING
        first = () if self._has_scanned else (Persist(SCANS_KEY, SCANNED),)
        self._has_scanned = True
        why = self._wrong(here)
        if why:
            self._wrong_at_us = now_us
        elif not self.safety.holds(StopCause.SCAN_LOST):
            return first
        there = bool(why) or now_us - self._wrong_at_us < STEADY_US
        return [*first, *self.safety.hold_while(StopCause.SCAN_LOST, there, why, now_us)]

    def _wrong(self, here: Observation) -> str:
        """Why the scan is not what is around the robot now; empty if nothing speaks against it."""
        if not here.ranges_m:
            self._first = None
            return "no scan arrives"
        first = self._first
        if first is None or here.ranges_m != self._scan:
            self._scan, self._first = here.ranges_m, here
            return ""
        if here.sensed_at_us - first.sensed_at_us <= SCAN_AGE_MAX_US:
            return ""
        if not any(map(isfinite, here.ranges_m)):
            return ""  # open ground looks the same everywhere
        turned_rad = abs(remainder(here.heading_rad - first.heading_rad, 2 * pi))
        dx_m, dy_m = here.x_m - first.x_m, here.y_m - first.y_m
        moved_m = hypot(dx_m, dy_m)
        if turned_rad <= TURNED_RAD and (
            moved_m <= MOVED_M or _along(first, dx_m / moved_m, dy_m / moved_m)
        ):
            return ""
        return f"the same scan for {moved_m:.2f} m and {turned_rad:.2f} rad"


def _along(seen: Observation, east: float, north: float) -> bool:
    """Whether every echo may be of a wall along this direction (a unit vector), so that a robot that
    drives there always sees the same."""
    ranges_m = seen.ranges_m
    count = len(ranges_m)
    ends = [
        (range_m * cos(angle), range_m * sin(angle)) if isfinite(range_m) else None
        for range_m, angle in (
            (each, seen.heading_rad + 2 * pi * k / count) for k, each in enumerate(ranges_m)
        )
    ]
    for k, end in enumerate(ends):
        beside = [b for b in (ends[k - 1], ends[(k + 1) % count]) if b is not None]
        if end is not None and beside and not any(_parallel(end, b, east, north) for b in beside):
            return False
    return True


def _parallel(a: tuple[float, float], b: tuple[float, float], east: float, north: float) -> bool:
    dx_m, dy_m = b[0] - a[0], b[1] - a[1]
    return abs(dx_m * north - dy_m * east) <= ALONG * hypot(dx_m, dy_m)
