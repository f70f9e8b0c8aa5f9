"""What the world remembers for its checkers: where everybody was, and who touched what."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

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

    An implement that is down at a point stays down until the next point.
    """

    def __init__(self) -> None:
        self._flat = array("d")
        self.driven_m = 0.0

    def add(self, t_us: int, x_m: float, y_m: float, tool_on: bool, carried: bool = False) -> None:
        """`carried`: somebody moved the robot here, it did not drive."""
        flat = self._flat
        if flat:
            if carried:
                flat[-1] = 0.0  # on the way here the implement worked nothing
            else:
                self.driven_m += hypot(x_m - flat[-3], y_m - flat[-2])
        flat.extend((t_us, x_m, y_m, tool_on))

    def __len__(self) -> int:
        return len(self._flat) // 4

    def flat_from(self, point: int) -> list[float]:
        """Four numbers for each point from there on: see `to_array`."""
        return self._flat[4 * point :].tolist()

    def recall(self, flat: Sequence[float]) -> None:
        """Begin with what `flat_from` told of an earlier life of the world, the implement up."""
        self._flat = array("d", flat)
        self.driven_m = sum(
            hypot(flat[k] - flat[k - 4], flat[k + 1] - flat[k - 3]) for k in range(5, len(flat), 4)
        )
        if flat:
            self._flat[-1] = 0.0

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
