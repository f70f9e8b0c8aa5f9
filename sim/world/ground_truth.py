"""What the world records for its checkers: positions of all robots, and contacts."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import asin, atan2, hypot, inf, pi

import numpy as np
from numpy.typing import NDArray

STRAIGHT_US = 20_000_000  # a straight piece of a track has a point at least this often
# Along the track; drives are uneven, and the track of a launch is not judged to the instant.
EVEN_M = 0.25
TrackPoint = tuple[int, float, float, bool]  # microseconds, x, y, implement down from here on


@dataclass
class Contact:
    """One touch, from its first step to its last."""

    t_us: int
    first: int  # slot
    second: int | None  # slot; None: not a robot
    depth_m: float  # the deepest so far
    against: str  # "robot 3", "fence", "box 7", "outside"
    x_m: float  # position of the first robot at the start
    y_m: float
    last_at_us: int = 0


class _Line:
    """The even drives from one point that pass every point so far: a cone of directions and a range
    of speeds. Microseconds, and metres from the first point."""

    def __init__(self) -> None:
        self._base: float | None = None  # radians, direction of the first point that is far enough
        self._left, self._right = pi, -pi  # of the cone, relative to that direction
        self._slowest, self._fastest = 0.0, inf  # metres a microsecond
        self._far_m = 0.0

    def pass_by(self, dt_us: float, dx_m: float, dy_m: float, near_m: float) -> None:
        far_m = hypot(dx_m, dy_m)
        self._far_m = max(self._far_m, far_m)
        if dt_us > 0:
            self._slowest = max(self._slowest, (far_m - EVEN_M) / dt_us)
            self._fastest = min(self._fastest, (far_m + EVEN_M) / dt_us)
        if far_m > near_m:
            if self._base is None:
                self._base = atan2(dy_m, dx_m)
            turn, room = self._turn(dx_m, dy_m), asin(near_m / far_m)
            self._left, self._right = min(self._left, turn + room), max(self._right, turn - room)

    def leads_to(self, dt_us: float, dx_m: float, dy_m: float, near_m: float) -> bool:
        far_m = hypot(dx_m, dy_m)
        return (
            0 < dt_us <= STRAIGHT_US
            and far_m >= self._far_m - near_m
            and self._slowest <= far_m / dt_us <= self._fastest
            and (self._base is None or self._right <= self._turn(dx_m, dy_m) <= self._left)
        )

    def _turn(self, dx_m: float, dy_m: float) -> float:
        """Angle from the first direction, -pi to pi."""
        assert self._base is not None
        turn = atan2(dy_m, dx_m) - self._base
        return turn - 2 * pi if turn > pi else turn + 2 * pi if turn < -pi else turn


class Track:
    """A robot's track: ten points a second, and one for each switch of the implement; 32 bytes
    each.

    An implement that is down at a point stays down until the next point. A track with `straight_m`
    leaves out points that lie within this distance of the line between their neighbours, and within
    `EVEN_M` of the position of an even drive at their time. So a launch of days stores a point for
    each turn, not ten a second.
    """

    def __init__(self, straight_m: float | None = None) -> None:
        self.straight_m = straight_m
        self._line: _Line | None = None  # from the last point but one to the last
        self._flat = array("d")
        self.driven_m = 0.0

    def add(self, t_us: int, x_m: float, y_m: float, tool_on: bool, carried: bool = False) -> None:
        """`carried`: a person moved the robot here; it did not drive."""
        flat = self._flat
        if flat:
            if carried:
                flat[-1] = 0.0  # on the way here the implement did no work
            else:
                self.driven_m += hypot(x_m - flat[-3], y_m - flat[-2])
        if self.straight_m is not None and len(flat) >= 8:
            self._leave_out(t_us, x_m, y_m, tool_on and not carried, self.straight_m)
        flat.extend((t_us, x_m, y_m, tool_on))

    def _leave_out(self, t_us: int, x_m: float, y_m: float, tool_on: bool, near_m: float) -> None:
        """Drop the last point if the drive to the new one passes all points left out before it."""
        flat = self._flat
        was_at_us, was_x, was_y, was_on, last_at_us, last_x, last_y, last_on = flat[-8:]
        line = self._line or _Line()
        line.pass_by(last_at_us - was_at_us, last_x - was_x, last_y - was_y, near_m)
        if was_on == last_on == tool_on and line.leads_to(
            t_us - was_at_us, x_m - was_x, y_m - was_y, near_m
        ):
            self._line = line
            del flat[-4:]
        else:
            self._line = None

    def __len__(self) -> int:
        return len(self._flat) // 4

    def settled_from(self, point: int) -> list[float]:
        """Four numbers for each point from there on, except the last: see `to_array`. These points
        do not change any more."""
        return self._flat[4 * point : -4].tolist()

    @property
    def newest(self) -> list[float]:
        """The last point, four numbers, which the next point may replace. Empty if there is
        none."""
        return self._flat[-4:].tolist()

    def recall(self, flat: Sequence[float]) -> None:
        """Begin with the points of an earlier run of the world, the implement up."""
        self._flat = array("d", flat)
        self.driven_m = sum(
            hypot(flat[k] - flat[k - 4], flat[k + 1] - flat[k - 3]) for k in range(5, len(flat), 4)
        )
        if flat:
            self._flat[-1] = 0.0
        self._line = None

    def __iter__(self) -> Iterator[TrackPoint]:
        flat = self._flat
        for k in range(0, len(flat), 4):
            yield int(flat[k]), flat[k + 1], flat[k + 2], flat[k + 3] != 0.0

    @property
    def points(self) -> list[TrackPoint]:
        """All points recorded so far, the oldest first."""
        return list(self)

    def to_array(self) -> NDArray[np.float64]:
        """(n, 4): microseconds, x, y, 1.0 if the implement is down from there on."""
        return np.array(self._flat).reshape(-1, 4)
