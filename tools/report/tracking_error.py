"""Planned against executed: how far each robot was from the line that it intended to follow.

A robot reports the rest of its path five times a second. Its line is what it reported when it started.
As long as the rest lies on that line, the robot still follows it. Its error is the distance from its
place to the piece it is on and all later pieces. Where a new path begins there is no error yet. A robot
that stands is not counted, because it would count for as long as it stands.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import hypot, inf, isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Point

Points = NDArray[np.float64]  # (n, 2)
# While it is followed, a line is a list: of five points, numpy takes ten times as long.
Line = list[Point]

SAME_M = 0.05  # intents are rounded to a centimetre, and paths with bends are thinned to a metre
MOVES_M_S = 0.05
SKIP_M = 0.5  # between two intents a robot drives at most this: 0.2 s at 2.5 m/s
STALE_US = 1_000_000  # after a longer silence the line that it followed is unknown
SHORT_M2 = 1e-12  # a shorter piece of a line is a point


class Sample(NamedTuple):
    """How far a robot was from its planned line at one instant."""

    t_s: float
    x_m: float
    y_m: float
    off_m: float
    tool: bool  # the implement was to be down


class Following(NamedTuple):
    """One robot: the lines it planned, and how it kept to them."""

    slot: int
    lines: list[Points]
    samples: list[Sample]

    def rmse_m(self, tool: bool | None = None) -> float:
        """nan where nothing was driven. `tool`: only with the implement down, or only with it up."""
        squares = [s.off_m**2 for s in self.samples if tool is None or s.tool is tool]
        return sqrt(sum(squares) / len(squares)) if squares else float("nan")

    @property
    def worst_m(self) -> float:
        """The largest distance to the line; not a number without samples."""
        return max((sample.off_m for sample in self.samples), default=float("nan"))


class _Robot(NamedTuple):
    lines: list[Line]
    samples: list[Sample]


def followed(intents: Iterable[tuple[int, dict[str, Any]]], zero_at_us: int) -> list[Following]:
    """From a recording's intents; what makes no sense in them is passed over."""
    robots: dict[int, _Robot] = {}
    # When it was sent, and the line from the piece it is on.
    now: dict[int, tuple[int, Line]] = {}
    for t_us, intent in intents:
        told = _told(intent)
        if told is None:
            continue
        slot, here, speed_m_s, path, tool = told
        robot = robots.get(slot)
        if robot is None:
            robot = robots[slot] = _Robot([], [])
        at_us, line = now.pop(slot, (t_us, []))
        if not path:
            continue
        gone, rest, more = _rest(line, path) if t_us - at_us <= STALE_US else ([], [], path)
        off_m = _off_m(here, rest)
        if not rest or off_m - min(_off_m(here, gone), off_m) > SKIP_M:
            # A short cut of a new plan rejoins the old line: the robot is on what the rest leaves out.
            rest = [here, *path]
            robot.lines.append(rest)
        else:
            if more:
                robot.lines[-1] = [*robot.lines[-1], *more]
            if speed_m_s >= MOVES_M_S:
                robot.samples.append(Sample((t_us - zero_at_us) / 1e6, *here, off_m, tool))
        now[slot] = (t_us, rest)
    return [
        Following(slot, [np.array(line) for line in robot.lines], robot.samples)
        for slot, robot in sorted(robots.items())
    ]


def _told(intent: dict[str, Any]) -> tuple[int, Point, float, Line, bool] | None:
    try:
        here = (float(intent["x"]), float(intent["y"]))
        path = _line(intent["path"])
        speed_m_s = hypot(intent["vx"], intent["vy"])
        slot = int(intent["slot"])
    except (ValueError, KeyError, TypeError, OverflowError):
        return None
    if not all(isfinite(x) and isfinite(y) for x, y in (here, *path)):
        return None
    return slot, here, speed_m_s, path, bool(intent.get("tool", False))


def _line(path: Any) -> Line:
    try:
        return [(x * 1.0, y * 1.0) for x, y in path]
    except (ValueError, TypeError):  # no list of pairs of numbers; numpy may still make sense of it
        return [(x, y) for x, y in np.array(path, dtype=float).reshape(-1, 2).tolist()]


def _rest(line: Line, path: Line) -> tuple[Line, Line, Line]:
    """What is left out of the line; the piece that is being driven with what is left; and by what it has
    grown. Without a rest: another way.

    The end of a long way is not told at first (`sim.record.robot_intent.POINTS_MAX`), so it may grow.
    """
    if len(line) < 2:
        return [], [], path
    keep = len(line) - len(path)
    if keep >= 1 and line[keep:] == path:
        return line[:keep], line[keep - 1 :], []
    to_end = _distances(line[-1:], [*path, path[-1]])[0]
    known = int(to_end.argmin()) + 1  # points of the path up to where the line ends
    if to_end.min() > SAME_M:
        return [], [], path
    distances = _distances(path[:known], line)
    if distances.min(axis=1).max() > SAME_M:
        return [], [], path
    return line, [line[int(distances[0].argmin())], *path], path[known:]


def _off_m(here: Point, line: Line) -> float:
    """From a place to a line; infinite where the line has no piece."""
    (x, y), least_m2 = here, inf
    for (ax, ay), (bx, by) in pairwise(line):
        along_x, along_y, from_x, from_y = bx - ax, by - ay, x - ax, y - ay
        square = along_x * along_x + along_y * along_y
        t = (from_x * along_x + from_y * along_y) / (square if square > SHORT_M2 else SHORT_M2)
        t = 0.0 if t < 0.0 else 1.0 if t > 1.0 else t
        off_x, off_y = from_x - t * along_x, from_y - t * along_y
        least_m2 = min(least_m2, off_x * off_x + off_y * off_y)
    return sqrt(least_m2)


def _distances(points: Sequence[Point], line: Line) -> Points:
    """(points, segments), metres."""
    of, corners = np.array(points), np.array(line)
    a, b = corners[:-1], corners[1:]
    along = b - a
    square = np.maximum((along**2).sum(axis=1), SHORT_M2)
    from_a = of[:, None, :] - a[None, :, :]
    t = np.clip((from_a * along[None, :, :]).sum(axis=2) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(from_a - t[:, :, None] * along[None, :, :], axis=2))
