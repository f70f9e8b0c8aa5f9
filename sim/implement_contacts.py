"""How often implements met, from true tracks: a figure of its own, because bodies alone are avoided.

The implement is a bar of the working width through the middle of its robot, at right angles to its
course, raised or down. Two bars that cross, or a bar that passes through another body, are one contact
until they have been apart for a second.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.gliding import TRACK_US
from sim.truth import TrackPoint

Floats = NDArray[np.float64]

APART_STEPS: Final = 1_000_000 // TRACK_US
MOVED_M: Final = 0.02  # in a step; who moves less keeps its course


def implement_contacts(
    tracks: Mapping[int, Sequence[TrackPoint]], width_m: float, radius_m: float
) -> int:
    """Of all pairs. Tracks are points (microseconds, x, y, implement down), metres."""
    steps = 1 + max(
        (int(track[-1][0]) // TRACK_US for track in tracks.values() if track), default=0
    )
    places = {slot: _places(track, steps) for slot, track in sorted(tracks.items()) if track}
    bars = {slot: _half_bars(at, width_m) for slot, at in places.items()}
    found = 0
    for a, b in combinations(places, 2):
        apart = places[b] - places[a]
        met = _crossing(apart, bars[a], bars[b])
        met |= _reaches(apart, bars[a], radius_m) | _reaches(apart, bars[b], radius_m)
        when = np.flatnonzero(met)
        found += int(when.size > 0) + int(np.count_nonzero(np.diff(when) > APART_STEPS))
    return found


def _places(track: Sequence[TrackPoint], steps: int) -> Floats:
    """(steps, 2): where it was at each step; what is not told is as before."""
    rows = np.array([point[:3] for point in track], dtype=np.float64)
    index = np.searchsorted(rows[:, 0], np.arange(steps) * TRACK_US, side="right") - 1
    found: Floats = rows[np.maximum(index, 0), 1:]
    return found


def _half_bars(places: Floats, width_m: float) -> Floats:
    """(steps, 2): from the middle to the bar's left end; nothing before the first course."""
    moves = np.diff(places, axis=0, prepend=places[:1])
    length_m = np.hypot(moves[:, 0], moves[:, 1])
    known = np.where(length_m > MOVED_M, np.arange(len(places)), 0)
    latest = np.maximum.accumulate(known)
    ux, uy = (moves[latest] / np.maximum(length_m[latest], MOVED_M)[:, None]).T
    return np.column_stack((-uy, ux)) * (width_m / 2)


def _crossing(apart: Floats, bar: Floats, other: Floats) -> NDArray[np.bool_]:
    cross = bar[:, 0] * other[:, 1] - bar[:, 1] * other[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (apart[:, 0] * other[:, 1] - apart[:, 1] * other[:, 0]) / cross
        across = (apart[:, 0] * bar[:, 1] - apart[:, 1] * bar[:, 0]) / cross
        return np.asarray((np.abs(along) <= 1.0) & (np.abs(across) <= 1.0))


def _reaches(apart: Floats, bar: Floats, radius_m: float) -> NDArray[np.bool_]:
    """Whether the bar at one place comes into a body at the other; the sign of `apart` is all one."""
    square = np.maximum((bar**2).sum(axis=1), 1e-12)
    share = np.clip((apart * bar).sum(axis=1) / square, -1.0, 1.0)
    gap = apart - share[:, None] * bar
    has = (bar**2).sum(axis=1) > 0.0
    return np.asarray(has & (np.hypot(gap[:, 0], gap[:, 1]) < radius_m))
