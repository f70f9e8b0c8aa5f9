"""Contacts of implements with implements or bodies, from true tracks.

An implement that is down is a bar of the working width and `DEPTH_M` along the course. It lies
through the middle of its robot, at right angles to its course. One that is up is folded and no
wider than the body. A contact means that a bar that is down enters another bar that is down, or
another body. Edges of neighbouring swaths overlap by plan, and each robot may be off its line by
half of that, so a bar is judged without `overlap_m` at each end. Two that touch are one contact
until they have been apart for a second.
"""

from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.world.contact_free_steps import TRACK_US
from sim.world.ground_truth import Track, TrackPoint

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

APART_STEPS: Final = 1_000_000 // TRACK_US
MOVED_M: Final = 0.02  # in a step; a robot that moves less keeps its course
# Along the course; two robots that pass at 5 m/s are detected in at least one check.
DEPTH_M: Final = 0.5


class Met(NamedTuple):
    """The beginning of a contact of a bar."""

    t_us: int
    first: int
    second: int
    body: bool  # a bar and a body; else two bars
    x_m: float  # of the first robot
    y_m: float


class _Way(NamedTuple):
    """(steps, 2) and (steps,): the middle, the course as a unit vector, whether the bar is down."""

    at: Floats
    course: Floats
    down: Bools

    def during(self, steps: NDArray[np.intp]) -> "_Way":
        return _Way(self.at[steps], self.course[steps], self.down[steps])


def implement_contacts(
    tracks: Mapping[int, Iterable[TrackPoint]], width_m: float, overlap_m: float, radius_m: float
) -> list[Met]:
    """Contacts of all pairs, by time. Tracks are points (microseconds, x, y, implement down),
    metres."""
    points = {slot: _points(track) for slot, track in sorted(tracks.items())}
    steps = 1 + max(
        (int(rows[-1, 0]) // TRACK_US for rows in points.values() if len(rows)), default=0
    )
    ways = {slot: _way(rows, steps) for slot, rows in points.items() if len(rows)}
    half_m, found = width_m / 2 - overlap_m, list[Met]()
    for a, b in combinations(ways, 2):
        one, two = ways[a], ways[b]
        near = np.hypot(*(two.at - one.at).T) < 2 * half_m + DEPTH_M + radius_m
        index = np.flatnonzero(near & (one.down | two.down))
        if not index.size:
            continue
        one, two = one.during(index), two.during(index)
        body = one.down & _reaches(one, two.at, half_m, radius_m)
        body |= two.down & _reaches(two, one.at, half_m, radius_m)
        met = body | (one.down & two.down & _cross(one, two, half_m))
        when = index[met]
        begins = np.flatnonzero(np.diff(when, prepend=-2 * APART_STEPS) > APART_STEPS)
        for k in begins.tolist():
            at = ways[a].at[when[k]]
            found.append(
                Met(int(when[k]) * TRACK_US, a, b, bool(body[met][k]), float(at[0]), float(at[1]))
            )
    return sorted(found)


def _points(track: Iterable[TrackPoint]) -> Floats:
    if isinstance(track, Track):
        return track.to_array()
    return np.array([point[:4] for point in track], dtype=np.float64).reshape(-1, 4)


def _way(rows: Floats, steps: int) -> _Way:
    """The position at each step, on straight lines between points; without motion the course is
    kept."""
    at_us = np.arange(steps) * TRACK_US
    at = np.column_stack([np.interp(at_us, rows[:, 0], rows[:, k]) for k in (1, 2)])
    down = rows[np.maximum(np.searchsorted(rows[:, 0], at_us, side="right") - 1, 0), 3] != 0.0
    moves = np.diff(at, axis=0, prepend=at[:1])
    length_m = np.hypot(moves[:, 0], moves[:, 1])
    moved = length_m > MOVED_M
    latest = np.maximum.accumulate(np.where(moved, np.arange(steps), 0))
    course = moves[latest] / np.maximum(length_m[latest], MOVED_M)[:, None]
    known = np.hypot(course[:, 0], course[:, 1]) > 0.5
    return _Way(at, course, down & known)


def _reaches(way: _Way, at: Floats, half_m: float, radius_m: float) -> Bools:
    """Whether the bar enters a body at that position."""
    apart = at - way.at
    ahead = np.abs((apart * way.course).sum(axis=1)) - DEPTH_M / 2
    aside = np.abs(apart[:, 0] * way.course[:, 1] - apart[:, 1] * way.course[:, 0]) - half_m
    return np.asarray(np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0)) < radius_m)


def _cross(one: _Way, two: _Way, half_m: float) -> Bools:
    """Whether two bars overlap: no line along one of their sides separates them."""
    apart = two.at - one.at
    overlap = np.ones(len(apart), dtype=np.bool_)
    sides = [(way.course, way.course[:, ::-1] * (1.0, -1.0)) for way in (one, two)]
    for axis in (side for pair in sides for side in pair):
        reach = sum(
            np.abs((axis * along).sum(axis=1)) * DEPTH_M / 2
            + np.abs((axis * across).sum(axis=1)) * half_m
            for along, across in sides
        )
        overlap &= np.abs((apart * axis).sum(axis=1)) < reach
    return overlap
