"""S24: whole units that robots work once more, by their tracks."""

import pytest

from agent.field.field_map import Section
from agent.interface.config import S
from sim.world.ground_truth import Track
from sim.world.repeated_work import RepeatedWorkChecker

# Two rows and a ring with two corners, in units of 5 m.
ROWS = Section(4, (((0.0, 0.0), (20.0, 0.0)), ((20.0, 4.0), (0.0, 4.0))), (4, 4))
RING = Section(7, (((0.0, 10.0), (10.0, 10.0), (10.0, 20.0), (0.0, 20.0)),), (6,))
SPEED_M_S = 1.0


def driven(*points: tuple[float, float, bool], from_s: float = 0.0) -> Track:
    """The track of a robot that drives from point to point, x and y in metres, at 1 m/s; each with
    whether the implement is down on the way there."""
    track, t_s = Track(), from_s
    x_m, y_m, down = points[0]
    track.add(round(t_s * S), x_m, y_m, down)
    for to_x_m, to_y_m, down in points[1:]:
        steps = max(1, round(max(abs(to_x_m - x_m), abs(to_y_m - y_m)) / 0.1))
        for k in range(1, steps + 1):
            t_s += 0.1 / SPEED_M_S
            at = x_m + (to_x_m - x_m) * k / steps, y_m + (to_y_m - y_m) * k / steps
            track.add(round(t_s * S), *at, down)
        x_m, y_m = to_x_m, to_y_m
    return track


@pytest.fixture
def checker() -> RepeatedWorkChecker:
    """Of the rows and the ring."""
    return RepeatedWorkChecker([ROWS, RING], 0.2)


def test_units_are_numbered_as_progress_counts_them(checker: RepeatedWorkChecker) -> None:
    row = checker.passes(0, driven((-1.0, 0.0, True), (11.0, 0.0, True)))
    assert [each.unit for each in row] == [(4, 0), (4, 1)]
    other = checker.passes(0, driven((21.0, 4.0, True), (9.0, 4.0, True)))
    assert sorted(each.unit for each in other) == [(4, 4), (4, 5)]
    ring = checker.passes(0, driven((-1.0, 10.0, True), (10.0, 10.0, True), (10.0, 21.0, True)))
    assert sorted(each.unit for each in ring) == [(7, 0), (7, 1), (7, 2), (7, 3)]


def test_s24_a_unit_that_was_told_is_not_worked_once_more(checker: RepeatedWorkChecker) -> None:
    tracks = {
        0: driven((-1.0, 0.0, True), (21.0, 0.0, True)),
        1: driven((-1.0, 0.0, True), (6.0, 0.0, True), from_s=60.0),
    }
    found = checker.repeated(tracks, {(4, 0): 30 * S, (4, 1): 30 * S})
    assert [(each.unit, each.slot) for each in found] == [((4, 0), 1)]
    assert checker.repeated(tracks, {}) == [], "what was not told may be worked again"
    assert checker.repeated(tracks, {(4, 0): 61 * S}) == [], "nor what is told meanwhile"


@pytest.mark.parametrize(
    "points",
    [
        ((-1.0, 0.0, False), (21.0, 0.0, False)),  # the implement is up
        ((1.0, 0.0, True), (4.9, 0.0, True)),  # not all of the unit
        ((-1.0, 0.4, True), (21.0, 0.4, True)),  # beside it
        ((2.5, -5.0, True), (2.5, 5.0, True)),  # across it
        ((-1.0, 0.0, True), (2.0, 0.0, True), (2.2, 0.0, False), (6.0, 0.0, True)),  # up within it
    ],
)
def test_other_ways_are_no_work(
    checker: RepeatedWorkChecker, points: tuple[tuple[float, float, bool], ...]
) -> None:
    told_at_us = {(4, unit): 1 for unit in range(8)}
    tracks = {1: driven(*points, from_s=60.0)}
    assert [each for each in checker.repeated(tracks, told_at_us) if each.unit == (4, 0)] == []


def test_a_unit_beside_another_line_is_not_judged() -> None:
    """A robot on the ring worked a short row in the tip of a field, by its track."""
    beside = Section(5, (((2.0, 10.1), (6.0, 10.3)), ((2.0, 13.8), (6.0, 13.9))), (1, 1))
    checker = RepeatedWorkChecker([RING, beside], 0.2)
    tracks = {1: driven((-1.0, 10.1, True), (8.0, 10.1, True), from_s=60.0)}
    assert checker.repeated(tracks, {(5, 0): 0, (7, 9): 0}) == []
    other = {1: driven((1.0, 13.8, True), (7.0, 13.9, True), from_s=60.0)}
    assert [each.unit for each in checker.repeated(other, {(5, 1): 0})] == [(5, 1)]
