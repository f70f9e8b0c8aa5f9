"""Contacts of implements with implements or bodies, from true tracks.

An implement that is down is a bar of the working width and `DEPTH_M` along the course. It lies
through the middle of its robot, at right angles to its course. One that is up is folded and no
wider than the body. A contact means that a bar that is down enters another bar that is down, or
another body. Edges of neighbouring swaths overlap by plan, and each robot may be off its line by
half of that, so a bar is judged without `overlap_m` at each end. Two that touch are one contact
until they have been apart for a second.

People, vehicles and boxes are under a bar that is down and moves if its whole width enters them. One
that stood where it is a second before was there to be seen; one that moves may have come by itself. Each
that stands is a contact of its own, and all that move are one.
"""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from math import hypot
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.world.contact_free_steps import TRACK_US
from sim.world.ground_truth import Track, TrackPoint
from sim.world.walls import AT_X, AT_Y, BOX, COS, HALF_X, HALF_Y, SHAPE, SIN

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Things = Sequence[tuple[int, Sequence[Sequence[float]]]]  # see `things_under_bars`

APART_STEPS: Final = 1_000_000 // TRACK_US
MOVED_M: Final = 0.02  # of a way; a robot keeps its course until it has moved further
STILL_M: Final = 1e-6  # in a step; a robot that moves less stands
# Along the course; two robots that pass at 5 m/s are detected in at least one check.
DEPTH_M: Final = 0.5
STOOD_M: Final = 0.1  # a thing that has moved less than this in a second stands
TOUCH_M: Final = 0.02  # less deep is no contact, as for bodies


class Met(NamedTuple):
    """The beginning of a contact of a bar."""

    t_us: int
    first: int
    second: int
    body: bool  # a bar and a body; else two bars
    x_m: float  # of the first robot
    y_m: float


class Over(NamedTuple):
    """The beginning of a contact of a bar with a person, a vehicle or a box."""

    t_us: int
    slot: int
    stood: bool  # the thing had been there for a second
    thing: tuple[float, ...]  # a row of `sim.world.walls`


class _Way(NamedTuple):
    """(steps, 2) and (steps,): the middle, the course as a unit vector, whether the bar is down, and
    whether the robot moves."""

    at: Floats
    course: Floats
    down: Bools
    moves: Bools  # whether it has moved so far that its course is known again

    def during(self, steps: NDArray[np.intp]) -> "_Way":
        return _Way(self.at[steps], self.course[steps], self.down[steps], self.moves[steps])


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


def things_under_bars(
    tracks: Mapping[int, Iterable[TrackPoint]],
    things: Things,
    width_m: float,
) -> list[Over]:
    """Contacts of lowered bars with what stands or moves in a world, by time.

    `things`: as `World` keeps them, rows from each time on. `width_m`: of the bar."""
    if not any(rows for _, rows in things):
        return []
    found = list[Over]()
    for slot, track in sorted(tracks.items()):
        points = _points(track)
        if not len(points):
            continue
        way = _way(points, 1 + int(points[-1, 0]) // TRACK_US)
        newest = dict[tuple[float, ...], int]()  # thing that stands: when the bar was last over it
        moving = -2 * APART_STEPS  # the same of all that do not stand
        for k in np.flatnonzero(way.down & way.moves).tolist():
            under = [
                row for row in _there(things, k * TRACK_US) if _is_over(way, k, row, width_m / 2)
            ]
            for row in under:
                thing, stood = tuple(row), was_there(things, row, k * TRACK_US - 1_000_000)
                last = newest.get(thing, -2 * APART_STEPS) if stood else moving
                if k - last > APART_STEPS:
                    found.append(Over(k * TRACK_US, slot, stood, thing))
                if stood:
                    newest[thing] = k
                else:
                    moving = k
    return sorted(found)


def _there(things: Things, t_us: int) -> Sequence[Sequence[float]]:
    """The rows at a time."""
    index = bisect_right(things, t_us, key=itemgetter(0)) - 1
    return things[index][1] if index >= 0 else ()


def was_there(things: Things, thing: Sequence[float], t_us: int) -> bool:
    """Whether a thing stood where it is at an earlier time, microseconds; `things` as in
    `things_under_bars`."""
    return any(_is_same(thing, was) for was in _there(things, t_us))


def _is_same(row: Sequence[float], was: Sequence[float]) -> bool:
    """Whether a thing is where one of this size was."""
    away_m = hypot(row[AT_X] - was[AT_X], row[AT_Y] - was[AT_Y])
    return away_m < STOOD_M and row[HALF_X] == was[HALF_X] and row[HALF_Y] == was[HALF_Y]


def _is_over(way: _Way, step: int, row: Sequence[float], half_m: float) -> bool:
    """Whether the bar is over a thing: no line along one of their sides separates them."""
    (x_m, y_m), (ux, uy) = way.at[step].tolist(), way.course[step].tolist()
    dx_m: float = row[AT_X] - x_m
    dy_m: float = row[AT_Y] - y_m
    ahead_m, aside_m = dx_m * ux + dy_m * uy, dy_m * ux - dx_m * uy
    if row[SHAPE] != BOX:
        before_m = max(abs(ahead_m) - DEPTH_M / 2, 0.0)
        beside_m = max(abs(aside_m) - half_m, 0.0)
        return bool(hypot(before_m, beside_m) < row[HALF_X] - TOUCH_M)
    c, s, half_x_m, half_y_m = row[COS], row[SIN], row[HALF_X], row[HALF_Y]
    along, across = abs(c * ux + s * uy), abs(s * ux - c * uy)  # of the two first sides
    depth_m = DEPTH_M / 2
    return bool(
        abs(ahead_m) < depth_m + half_x_m * along + half_y_m * across - TOUCH_M
        and abs(aside_m) < half_m + half_x_m * across + half_y_m * along - TOUCH_M
        and abs(dx_m * c + dy_m * s) < half_x_m + depth_m * along + half_m * across - TOUCH_M
        and abs(dy_m * c - dx_m * s) < half_y_m + depth_m * across + half_m * along - TOUCH_M
    )


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
    moved = np.hypot(moves[:, 0], moves[:, 1]) > MOVED_M
    _creeps(at, moves, moved)
    latest = np.maximum.accumulate(np.where(moved, np.arange(steps), 0))
    course = moves[latest] / np.maximum(np.hypot(*moves[latest].T), MOVED_M)[:, None]
    known = np.hypot(course[:, 0], course[:, 1]) > 0.5
    return _Way(at, course, down & known, moved)


def _creeps(at: Floats, moves: Floats, moved: Bools) -> None:
    """Add to the steps that moved those by which a slow robot has come further than `MOVED_M` since it
    last moved so far, with this way as the move."""
    fast = np.maximum.accumulate(np.where(moved, np.arange(len(at)), 0))
    slow = np.flatnonzero(~moved & (np.hypot(moves[:, 0], moves[:, 1]) > STILL_M))
    last = 0
    for k in slow.tolist():
        last = max(last, int(fast[k]))
        way = at[k] - at[last]
        if hypot(*way.tolist()) > MOVED_M:
            moves[k], moved[k], last = way, True, k


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
