"""Where ground was left, and who stands there."""

import numpy as np

from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
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
    told = told_missed(missed, CELL_M, 4.0, {0: away, 2: wreck}, {0: [], 2: []})
    assert told == (
        "17.0 m2 are left in 2 places, the largest of 16.0 m2 at 2.0,22.0, "
        "where robot 2 stands since 0.0 s"
    )
    wreck[1] = (40_000_000, -0.9, 22.0, True)
    late: list[TrackPoint] = [(0, 9.0, 9.0, False), (88_000_000, 9.0, 22.0, False),
                              (99_000_000, 4.5, 22.0, False)]  # fmt: skip
    told = told_missed(missed, CELL_M, 4.0, {0: late, 2: wreck}, {0: [], 2: []})
    assert told.endswith("where robot 2 stands since 40.0 s")
    assert (
        told_missed(missed[:64], CELL_M, 4.0, {0: away}, {0: []}) == "16.0 m2 are left at 2.0,22.0"
    )
    assert told_missed(missed[:0], CELL_M, 4.0, {0: away}, {0: []}) == ""


def test_a_robot_that_works_when_a_run_ends_does_not_stand_there() -> None:
    """A run that its limit ended said "where robot 0 stands since 59.8 s", of a robot in its work."""
    missed = np.array(square(0.0, 20.0, 8))
    working: list[TrackPoint] = [(k * 100_000, -60.0 + k * 0.1, 22.0, True) for k in range(600)]
    told = told_missed(missed, CELL_M, 4.0, {0: working}, {0: []})
    assert told == "16.0 m2 are left at 2.0,22.0"
    dead = {0: working[:580], 1: [(60_000_000, 50.0, 50.0, False)]}  # its track ends where it fell
    told = told_missed(missed, CELL_M, 4.0, dead, {1: []})
    assert told == "16.0 m2 are left at 2.0,22.0"
    dead[1] = [(90_000_000, 50.0, 50.0, False)]
    told = told_missed(missed, CELL_M, 4.0, dead, {1: []})
    assert told.endswith("where robot 0 stands since 57.8 s, switched off")


def test_the_place_of_ground_round_an_island_is_on_that_ground() -> None:
    """A field that nobody had worked was left at the middle of its island."""
    whole = np.array(square(-10.0, -10.0, 40))
    ring = whole[np.abs(whole).max(axis=1) > 3.0]
    told = told_missed(ring, CELL_M, 4.0, {}, {})
    x_m, y_m = map(float, told.split(" at ")[1].split(","))
    assert 3.0 < max(abs(x_m), abs(y_m)) < 4.0, told


def test_a_robot_that_is_off_is_said_to_be_and_one_that_waits_is_named_with_its_causes() -> None:
    """A dead robot was named as what is in the way, while a live one waited for a person."""
    missed = np.array(square(0.0, 20.0, 8))
    wreck: list[TrackPoint] = [(0, -9.0, 22.0, True), (40_000_000, -0.5, 22.0, False)]
    told = told_missed(missed, CELL_M, 4.0, {0: wreck}, {1: [], 2: ["BOOT_UNCONFIRMED"]})
    assert told.endswith(
        "where robot 0 stands since 0.0 s, switched off; held: robot 2 (BOOT_UNCONFIRMED)"
    )


def test_a_run_names_the_robot_that_waits_for_a_person() -> None:
    faults = [
        {"kind": "crash", "at_s": 5.0, "robot": 0},
        {"kind": "crash", "at_s": 6.0, "robot": 1},
        {"kind": "restart", "at_s": 9.0, "robot": 1, "disk": "lost"},
    ]
    outcome = FieldRun(
        FieldSetup(load("small").changed(2, 1, faults=faults, time_limit_s=20.0))
    ).run()
    assert outcome.missed.endswith("held: robot 1 (BOOT_UNCONFIRMED, NOT_STARTED)")
