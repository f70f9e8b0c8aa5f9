"""Lines that were passed along with the implement down, and those that were only crossed."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.world.ground_truth import Track
from sim.world.swath_truth import NEVER_US, LineTruth, Polyline


def track(*ways: tuple[float, float, float, float, bool]) -> Track:
    """Straight ways, 2.5 m/s: from x, y, to x, y, implement."""
    result, t_us = Track(), 0
    for ax, ay, bx, by, tool in ways:
        steps = max(1, round(max(abs(bx - ax), abs(by - ay)) / 0.25))
        for k in range(steps + 1):
            result.add(t_us, ax + (bx - ax) * k / steps, ay + (by - ay) * k / steps, tool)
            t_us += 100_000
    return result


def units_worked(
    lines: Sequence[Polyline], tracks: Mapping[int, Track], tolerance_m: float
) -> NDArray[np.float64]:
    """The share of each line that was worked by anybody."""
    truth = LineTruth(lines, tolerance_m)
    worked = np.zeros(len(truth.line_of), dtype=np.bool_)
    for track in tracks.values():
        worked |= truth.worked_at_us(track) != NEVER_US
    hits = np.bincount(truth.line_of, weights=worked, minlength=len(lines))
    return hits / np.maximum(np.bincount(truth.line_of, minlength=len(lines)), 1)


UNITS = [
    *([(x, 0.0), (x + 5.0, 0.0)] for x in (0.0, 5.0, 10.0, 15.0)),
    [(2.0, 3.0), (7.0, 3.0)],  # beside the way
    [(12.0, -4.0), (12.0, 4.0)],  # across it
]


@pytest.mark.parametrize("backwards", [False, True])
def test_units_passed_along(backwards: bool) -> None:
    way = [(0.0, 0.05, 12.5, 0.05, True), (12.5, 0.05, 20.0, 0.05, False)]
    if backwards:
        way = [(c, d, a, b, tool) for a, b, c, d, tool in way[::-1]]
    shares = units_worked(UNITS, {0: track(*way)}, 0.1)
    assert shares == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0, 0.0], abs=0.06)
    assert units_worked(UNITS, {0: track(*way)}, 0.04).max() == 0.0


def test_several_robots_share_a_line() -> None:
    tracks = {
        1: track((-1.0, 0.0, 8.0, 0.0, True)),
        4: track((21.0, 0.0, 7.0, 0.0, True)),
    }
    assert units_worked(UNITS, tracks, 0.1)[:4] == pytest.approx(1.0)


def test_when_a_line_was_worked() -> None:
    truth = LineTruth([[(0.0, 0.0), (10.0, 0.0)]], 0.1)
    at_us = truth.worked_at_us(track((0.0, 0.0, 10.0, 0.0, True), (10.0, 0.0, 0.0, 0.0, True)))
    assert 0 < at_us.min() <= 200_000 and 3_900_000 <= at_us.max() <= 4_100_000


def test_no_lines_and_no_tracks() -> None:
    assert units_worked([], {}, 0.1).size == 0
    assert units_worked(UNITS, {}, 0.1).max() == 0.0
    assert units_worked([[(1.0, 1.0), (1.0, 1.0)]], {0: Track()}, 0.1).tolist() == [0.0]
