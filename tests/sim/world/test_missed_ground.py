"""Where ground was left, and who stands there."""

import numpy as np

from sim.world.ground_truth import TrackPoint
from sim.world.missed_ground import told_missed

CELL_M = 0.5


def square(west_m: float, south_m: float, cells: int) -> list[tuple[float, float]]:
    return [
        (west_m + (i + 0.5) * CELL_M, south_m + (j + 0.5) * CELL_M)
        for i in range(cells) for j in range(cells)
    ]  # fmt: skip


def test_the_largest_piece_is_told_with_its_place_and_the_robot_that_stands_there() -> None:
    """A report said that ground under a wreck was beside fences."""
    missed = np.array(square(0.0, 20.0, 8) + square(-30.0, -20.0, 2))
    away: list[TrackPoint] = [(0, 0.0, 0.0, True), (90_000_000, 9.0, 0.0, False)]
    wreck: list[TrackPoint] = [
        (0, -9.0, 22.0, True), (40_000_000, -0.5, 22.0, True), (99_000_000, -0.45, 22.0, False),
    ]  # fmt: skip
    told = told_missed(missed, CELL_M, 4.0, {0: away, 2: wreck})
    assert told == (
        "17.0 m2 are left in 2 places, the largest of 16.0 m2 at 2.0,22.0, "
        "where robot 2 stands since 0.0 s"
    )
    wreck[1] = (40_000_000, -0.9, 22.0, True)
    late: list[TrackPoint] = [(0, 9.0, 9.0, False), (88_000_000, 9.0, 22.0, False),
                              (99_000_000, 4.5, 22.0, False)]  # fmt: skip
    told = told_missed(missed, CELL_M, 4.0, {0: late, 2: wreck})
    assert told.endswith("where robot 2 stands since 40.0 s")
    assert told_missed(missed[:64], CELL_M, 4.0, {0: away}) == "16.0 m2 are left at 2.0,22.0"
    assert told_missed(missed[:0], CELL_M, 4.0, {0: away}) == ""
