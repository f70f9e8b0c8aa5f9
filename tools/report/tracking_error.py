"""Planned against executed: how far each robot was from the line that it intended to follow.

A robot reports the rest of its path five times a second. Its line is what it reported when it started.
As long as the rest lies on that line, the robot still follows it. Its error is the distance from its
place to the piece it is on and all later pieces. Where a new path begins there is no error yet. A robot
that stands is not counted, because it would count for as long as it stands.
"""

from collections.abc import Iterable
from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]  # (n, 2)

SAME_M = 0.05  # intents are rounded to a centimetre, and paths with bends are thinned to a metre
MOVES_M_S = 0.05
SKIP_M = 0.5  # between two intents a robot drives at most this: 0.2 s at 2.5 m/s
NONE: Points = np.empty((0, 2))
STALE_US = 1_000_000  # after a longer silence the line that it followed is unknown


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


def followed(intents: Iterable[tuple[int, dict[str, Any]]], zero_at_us: int) -> list[Following]:
    """From a recording's intents; what makes no sense in them is passed over."""
    robots: dict[int, Following] = {}
    # When it was sent, and the line from the piece it is on.
    now: dict[int, tuple[int, Points]] = {}
    for t_us, intent in intents:
        told = _told(intent)
        if told is None:
            continue
        slot, here, speed_m_s, path, tool = told
        robot = robots.setdefault(slot, Following(slot, [], []))
        at_us, line = now.pop(slot, (t_us, NONE))
        if not len(path):
            continue
        rest, more = _rest(line, path) if t_us - at_us <= STALE_US else (NONE, path)
        if not len(rest) or _skips(here, line, rest):
            rest = np.vstack([here, path])
            robot.lines.append(rest)
        else:
            robot.lines[-1] = np.vstack([robot.lines[-1], more])
            if speed_m_s >= MOVES_M_S:
                off_m = float(_distances(here[None, :], rest).min())
                robot.samples.append(
                    Sample((t_us - zero_at_us) / 1e6, float(here[0]), float(here[1]), off_m, tool)
                )
        now[slot] = (t_us, rest)
    return [robots[slot] for slot in sorted(robots)]


def _told(intent: dict[str, Any]) -> tuple[int, Points, float, Points, bool] | None:
    try:
        here = np.array([intent["x"], intent["y"]], dtype=float)
        path = np.array(intent["path"], dtype=float).reshape(-1, 2)
        speed_m_s = hypot(intent["vx"], intent["vy"])
        slot = int(intent["slot"])
    except (ValueError, KeyError, TypeError):
        return None
    if not (np.isfinite(here).all() and np.isfinite(path).all()):
        return None
    return slot, here, speed_m_s, path, bool(intent.get("tool", False))


def _rest(line: Points, path: Points) -> tuple[Points, Points]:
    """The piece that is being driven with what is left, and by what it has grown; none: another way.

    The end of a long way is not told at first (`sim.record.robot_intent.POINTS_MAX`), so it may grow.
    """
    if len(line) < 2:
        return NONE, path
    keep = len(line) - len(path)
    if keep >= 1 and np.array_equal(line[keep:], path):
        return line[keep - 1 :], NONE
    to_end = _distances(line[-1:], np.vstack([path, path[-1:]]))[0]
    known = int(to_end.argmin()) + 1  # points of the path up to where the line ends
    distances = _distances(path[:known], line)
    if to_end.min() > SAME_M or distances.min(axis=1).max() > SAME_M:
        return NONE, path
    return np.vstack([line[int(distances[0].argmin())], path]), path[known:]


def _skips(here: Points, line: Points, rest: Points) -> bool:
    """A short cut of a new plan rejoins the old line: the robot is on what the rest leaves out."""
    off_line, off_rest = (_distances(here[None, :], each).min() for each in (line, rest))
    return bool(off_rest - off_line > SKIP_M)


def _distances(points: Points, line: Points) -> Points:
    """(points, segments), metres."""
    a, b = line[:-1], line[1:]
    along = b - a
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    from_a = points[:, None, :] - a[None, :, :]
    t = np.clip((from_a * along[None, :, :]).sum(axis=2) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(from_a - t[:, :, None] * along[None, :, :], axis=2))
