"""Which lines an implement really passed along, when, and of which robot; from true tracks alone.

Lines are sampled every quarter of a metre. A sample was worked when a robot's centre passed it
within tolerance and within 30 degrees of the line's direction, either way, with the implement down.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, hypot

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.world.coverage_truth import Floats, cells_near, strokes_of
from sim.world.ground_truth import Track, TrackPoint

Polyline = Sequence[tuple[float, float]]

SAMPLE_M = 0.25
COLUMNS = 6  # of a sample
ALONG_COS = 0.866  # 30 degrees: along the line, not across it
NEVER_US = np.iinfo(np.int64).max


class LineTruth:
    """Judges which of the given lines an implement passed along, within a tolerance, by samples of
    each line."""

    def __init__(self, lines: Sequence[Polyline], tolerance_m: float) -> None:
        self.tolerance_m = tolerance_m
        pieces = [_samples(number, line) for number, line in enumerate(lines)]
        table = np.vstack([np.empty((0, COLUMNS)), *pieces])
        low = table[:, :2].min(axis=0, initial=np.inf)
        side_m = max(1.0, 2 * tolerance_m)
        cells = ((table[:, :2] - low) / side_m).astype(np.int64)
        self._shape = (int(cells[:, 1].max(initial=0)) + 1, int(cells[:, 0].max(initial=0)) + 1)
        bucket = cells @ np.array([1, self._shape[1]])
        order = np.argsort(bucket, kind="stable")
        self._table = table[order]  # x, y, course, line, share
        buckets = self._shape[0] * self._shape[1]
        self._begins = np.searchsorted(bucket[order], np.arange(buckets + 1))
        self._place = np.array([*low, side_m])
        self.line_of: NDArray[np.int64] = self._table[:, 4].astype(np.int64)
        self.share_of: Floats = self._table[
            :, 5
        ]  # of its line that lies before each sample, 0 to 1

    @property
    def samples(self) -> Floats:
        """(samples, 4): x, y in metres, and the unit vector along the line."""
        return self._table[:, :4]

    def worked_at_us(self, track: Track | Sequence[TrackPoint] | Floats) -> NDArray[np.int64]:
        """When each sample was first worked by the robot of this track, (samples,); `NEVER_US`:
        never.

        `track` as an array is (points, 4), see `coverage_truth.strokes_of`.
        """
        at_us = np.full(len(self._table), NEVER_US)
        if len(self._table):
            _pass(strokes_of(track), self.tolerance_m, self._place, self._shape, self._table,
                  self._begins, at_us)  # fmt: skip
        return at_us


def _samples(number: int, line: Polyline) -> Floats:
    """(n, 6): x, y, unit vector along the line, number of the line, share of it before the sample."""
    rows, before_m = [np.empty((0, COLUMNS))], 0.0
    total_m = sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(line))
    for a, b in pairwise(line):
        dx, dy = b[0] - a[0], b[1] - a[1]
        length_m = hypot(dx, dy)
        if length_m == 0.0:
            continue
        count = ceil(length_m / SAMPLE_M)
        part = (np.arange(count) + 0.5) / count
        piece = np.empty((count, COLUMNS))
        piece[:, 0], piece[:, 1] = a[0] + part * dx, a[1] + part * dy
        piece[:, 2:5] = dx / length_m, dy / length_m, number
        piece[:, 5] = (before_m + part * length_m) / total_m
        before_m += length_m
        rows.append(piece)
    return np.vstack(rows)


@njit(cache=True, error_model="numpy")
def _pass(strokes, tolerance, place, shape, samples, begins, at_us):  # type: ignore[no-untyped-def]
    """Note when a stroke (from, to, when, ...) first passes along each sample."""
    west, south, side = place
    for k in range(strokes.shape[0]):
        ax, ay, bx, by = strokes[k, 0], strokes[k, 1], strokes[k, 2], strokes[k, 3]
        length = np.hypot(bx - ax, by - ay)
        if length == 0.0:
            continue
        cx, cy = (bx - ax) / length, (by - ay) / length
        for r in range(*cells_near(ay, by, tolerance, south, side, shape[0])):
            for c in range(*cells_near(ax, bx, tolerance, west, side, shape[1])):
                bucket = r * shape[1] + c
                for n in range(begins[bucket], begins[bucket + 1]):
                    rx, ry = samples[n, 0] - ax, samples[n, 1] - ay
                    along, across = rx * cx + ry * cy, abs(rx * cy - ry * cx)
                    if -1e-9 <= along <= length + 1e-9 and across <= tolerance:
                        straight = abs(cx * samples[n, 2] + cy * samples[n, 3])
                        if straight >= ALONG_COS:
                            at_us[n] = min(at_us[n], np.int64(strokes[k, 4]))
