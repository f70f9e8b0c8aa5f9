"""What the world remembers for its checkers: where everybody was, and who touched what."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

STRAIGHT_US = 20_000_000  # a straight piece of a track has a point at least this often
TrackPoint = tuple[int, float, float, bool]  # microseconds, x, y, implement down from here on


@dataclass
class Contact:
    """One touch, from its first step to its last."""

    t_us: int
    first: int  # slot
    second: int | None  # slot; None: something that is no robot
    depth_m: float  # the deepest so far
    against: str  # "robot 3", "fence", "box 7", "outside"
    x_m: float  # of the first robot, when it began
    y_m: float
    until_us: int = 0


class Track:
    """A robot's way: ten points a second, and one for each switch of the implement; 32 bytes each.

    An implement that is down at a point stays down until the next point. A track with `straight_m` leaves
    out points that lie that near to the line between their neighbours, and as near in time: a launch of
    days keeps a point for each turn and for each `STRAIGHT_US`, not ten a second.
    """

    def __init__(self, straight_m: float | None = None) -> None:
        self.straight_m = straight_m
        self._between: list[tuple[float, float, float]] = []  # left out since the last but one
        self._flat = array("d")
        self._told = 0  # points that are kept elsewhere, too
        self.driven_m = 0.0

    def add(self, t_us: int, x_m: float, y_m: float, tool_on: bool, carried: bool = False) -> None:
        """`carried`: somebody moved the robot here, it did not drive."""
        flat = self._flat
        if flat:
            if carried:
                flat[-1] = 0.0  # on the way here the implement worked nothing
            else:
                self.driven_m += hypot(x_m - flat[-3], y_m - flat[-2])
        if self.straight_m is not None and len(flat) >= 8 and not carried:
            self._leave_out(t_us, x_m, y_m, tool_on, self.straight_m)
        flat.extend((t_us, x_m, y_m, tool_on))

    def _leave_out(self, t_us: int, x_m: float, y_m: float, tool_on: bool, near_m: float) -> None:
        """The last point, where a straight and even drive to the new one passes all that were between."""
        flat, between = self._flat, self._between
        was_us, was_x, was_y, was_on, last_us, last_x, last_y, last_on = flat[-8:]
        between.append((last_us, last_x, last_y))
        if (
            len(flat) // 4 > self._told
            and was_on == last_on == tool_on
            and 0 < t_us - was_us <= STRAIGHT_US
            and all(
                hypot(
                    was_x + (x_m - was_x) * (at_us - was_us) / (t_us - was_us) - at_x,
                    was_y + (y_m - was_y) * (at_us - was_us) / (t_us - was_us) - at_y,
                )
                <= near_m
                for at_us, at_x, at_y in between
            )
        ):
            del flat[-4:]
        else:
            between.clear()

    def __len__(self) -> int:
        return len(self._flat) // 4

    def flat_from(self, point: int) -> list[float]:
        """Four numbers for each point from there on: see `to_array`. They stay as they are told."""
        self._told = len(self)
        return self._flat[4 * point :].tolist()

    def recall(self, flat: Sequence[float]) -> None:
        """Begin with what `flat_from` told of an earlier life of the world, the implement up."""
        self._flat = array("d", flat)
        self.driven_m = sum(
            hypot(flat[k] - flat[k - 4], flat[k + 1] - flat[k - 3]) for k in range(5, len(flat), 4)
        )
        if flat:
            self._flat[-1] = 0.0
        self._told = len(self)

    def __iter__(self) -> Iterator[TrackPoint]:
        flat = self._flat
        for k in range(0, len(flat), 4):
            yield int(flat[k]), flat[k + 1], flat[k + 2], flat[k + 3] != 0.0

    @property
    def points(self) -> list[TrackPoint]:
        return list(self)

    def to_array(self) -> NDArray[np.float64]:
        """(n, 4): microseconds, x, y, 1.0 where the implement is down from there on."""
        return np.array(self._flat).reshape(-1, 4)
