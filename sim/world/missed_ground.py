"""What a run has left unworked, in one sentence: how much, where most of it is, which robot is there,
and which robots wait for a person."""

from collections.abc import Mapping, Sequence
from math import dist

import numpy as np
import scipy
from numpy.typing import NDArray

from agent.interface.config import S
from sim.world.ground_truth import TrackPoint

MOVED_M = 0.1  # less is standing: bodies are pushed a little
STANDS_FOR_US = 5 * S  # one that stands for a shorter time may have given way, or works
Floats = NDArray[np.float64]


def told_missed(
    missed: Floats,
    cell_m: float,
    width_m: float,
    tracks: Mapping[int, Sequence[TrackPoint]],
    waits: Mapping[int, Sequence[str]],
) -> str:
    """Empty if nothing is left. `missed`: (n, 2), centres of the cells that can be reached and were never
    worked, metres. `width_m`: of the implement; a robot that stands nearer than that is named.
    `waits`: of each robot that runs, by slot, why it may not move; empty if it may."""
    if not len(missed):
        return ""
    patch, count = _largest(missed, cell_m)
    x_m, y_m = _middle(patch, cell_m)
    told = f"{len(missed) * cell_m**2:.1f} m2 are left"
    if count > 1:
        told += f" in {count} places, the largest of {len(patch) * cell_m**2:.1f} m2"
    told += f" at {x_m:.1f},{y_m:.1f}"
    beside = []
    ended_at_us = max((track[-1][0] for track in tracks.values() if track), default=0)
    for slot, track in sorted(tracks.items()):
        if not track:
            continue
        _, x_of, y_of, _ = track[-1]
        gap_m = np.hypot(patch[:, 0] - x_of, patch[:, 1] - y_of).min()
        at_us = _standing_at_us(track)
        if gap_m <= width_m and ended_at_us - at_us >= STANDS_FOR_US:
            beside.append((at_us, slot))
    if beside:
        at_us, slot = min(beside)  # there longest, not one that has come by at the end
        told += f", where robot {slot} stands since {at_us / S:.1f} s"
        told += "" if slot in waits else ", switched off"
    held = [f"robot {slot} ({', '.join(why)})" for slot, why in sorted(waits.items()) if why]
    return f"{told}; held: {', '.join(held)}" if held else told


def _largest(missed: Floats, cell_m: float) -> tuple[Floats, int]:
    """The cells of the largest piece, and how many pieces there are."""
    cells = np.rint((missed - missed.min(axis=0)) / cell_m).astype(np.int64)
    flags = np.zeros(cells.max(axis=0) + 1, dtype=np.bool_)
    flags[cells[:, 0], cells[:, 1]] = True
    pieces, count = scipy.ndimage.label(flags, structure=np.ones((3, 3)))
    of_cell = pieces[cells[:, 0], cells[:, 1]]
    return missed[of_cell == np.bincount(of_cell).argmax()], int(count)


def _middle(patch: Floats, cell_m: float) -> tuple[float, float]:
    """Of a piece, metres; where that is not on it, as inside a ring, its nearest cell."""
    middle = patch.mean(axis=0)
    away_m = np.hypot(*(patch - middle).T)
    x_m, y_m = middle if away_m.min() <= cell_m else patch[away_m.argmin()]
    return float(x_m), float(y_m)


def _standing_at_us(track: Sequence[TrackPoint]) -> int:
    """Since when it is where it is at the end."""
    _, *end, _ = track[-1]
    for t_us, *at, _ in reversed(track):
        if dist(at, end) > MOVED_M:
            return t_us
    return track[0][0]
