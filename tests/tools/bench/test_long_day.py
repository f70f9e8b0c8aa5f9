"""A day of a fleet: what robots hold does not grow with the time that they work."""

import gc
from collections import Counter
from pathlib import Path

import pytest

from tools.bench.long_day import SAMPLES, DaySample, samples

FLAT = 1.15  # of what ten robots hold after their caches are full


@pytest.mark.slow
def test_ten_robots_hold_no_more_after_fifteen_minutes_than_after_ten(tmp_path: Path) -> None:
    """Each robot kept four places a second for good: half a gigabyte in half a day."""
    held: list[Counter[str]] = []

    def look(_: DaySample) -> None:
        held.append(Counter(type(each).__name__ for each in gc.get_objects()))

    found = samples(tmp_path, 900.0, seed=1, tell=look)
    assert len(found) == len(held) == SAMPLES and found[-1].done > 0
    warm, last = held[2 * SAMPLES // 3 - 1], held[-1]
    grown = (last - warm).most_common(5)
    assert last.total() <= FLAT * warm.total(), f"{warm.total()} to {last.total()}: {grown}"
