"""Visits of bodies become paths in whole units of time, or are found to be no plan."""

import pytest

from sim.files.mapf_paths import PathError, timed, tracks, without_broken_moves


def test_who_follows_closely_is_in_the_next_cell_when_the_first_has_gone() -> None:
    visits = [
        (0.0, 0, 1),
        (0.0, 1, 0),
        (1.4, 1, 1),
        (1.6, 0, 2),
    ]  # 1 came before 0 was in the middle
    assert tracks(timed(visits, 2)) == [[1, 1, 2], [0, 0, 1]]


def test_a_ring_that_turns_is_a_plan() -> None:
    visits = [(0.0, k, k) for k in range(4)] + [(1.0, k, (k + 1) % 4) for k in range(4)]
    assert tracks(timed(visits, 4)) == [[k, (k + 1) % 4] for k in range(4)]


def test_a_cell_where_another_stayed_is_a_conflict() -> None:
    with pytest.raises(PathError, match="robot 1 came to cell 2, where robot 0 stayed"):
        timed([(0.0, 0, 2), (0.0, 1, 1), (1.0, 1, 2)], 2)


def test_a_move_that_was_taken_back_is_left_out_and_a_real_conflict_is_not() -> None:
    starts = [(0.0, 0, 2), (0.0, 1, 1)]
    back = [*starts, (1.0, 1, 2), (5.0, 1, 1), (6.0, 0, 3)]
    assert without_broken_moves(back) == [*starts, (5.0, 1, 1), (6.0, 0, 3)]
    assert tracks(timed(without_broken_moves(back), 2))[1] == [1] * 7
    gone = [*starts, (1.0, 0, 3), (1.0, 1, 2), (5.0, 1, 1)]
    assert without_broken_moves(gone) == gone, "the cell was free"
    for stays in ([(1.0, 1, 2)], [(1.0, 1, 2), (2.0, 1, 4)]):
        assert without_broken_moves([*starts, *stays]) == [*starts, *stays]
        with pytest.raises(PathError):
            timed(without_broken_moves([*starts, *stays]), 2)


def test_nothing_happens_earlier_than_it_did() -> None:
    visits = [(0.0, 0, 0), (0.0, 1, 5), (3.0, 0, 1), (4.1, 0, 2), (5.0, 1, 1)]
    for row, own in zip(timed(visits, 2), ([0, 3, 4], [0, 5]), strict=True):
        assert [at for at, _ in row] == own


def test_a_robot_that_goes_to_and_fro_behind_a_wreck_is_where_it_stayed_longest() -> None:
    """Robot 0 cannot come to the middle of cell 1 because of a wreck. While others turn through cell
    0, it goes back and forth over the border. Seen with `room-64-64-8`, two crashes, instance 12.
    """
    pokes = [(4.19, 0, 0), (4.56, 0, 1), (5.37, 0, 0), (5.69, 0, 1), (6.5, 0, 0), (6.81, 0, 1)]
    visits = sorted([
        (0.0, 0, 0), (0.7, 0, 1), *pokes, (8.81, 0, 0),
        (0.0, 1, 5), (4.22, 1, 0), (5.47, 1, 2), (6.47, 1, 3), (7.47, 1, 9),
        (0.0, 2, 7), (4.0, 2, 5), (5.38, 2, 0), (6.59, 2, 2), (7.59, 2, 3),
        (0.0, 3, 3), (5.0, 3, 4), (6.5, 3, 0), (7.72, 3, 5),
        (0.0, 4, 2), (4.91, 4, 3), (6.37, 4, 4),
    ])  # fmt: skip
    kept = without_broken_moves(visits)
    assert [each for each in visits if each not in kept] == [
        (4.19, 0, 0),
        (5.37, 0, 0),
        (6.5, 0, 0),
    ]
    for at_once in zip(*tracks(timed(kept, 5)), strict=True):
        assert len(set(at_once)) == 5


def test_a_move_to_the_middle_and_back_is_a_move() -> None:
    visits = [(0.0, 0, 2), (0.0, 1, 1), (1.0, 0, 3), (1.0, 1, 2), (2.0, 1, 1)]
    assert without_broken_moves(visits) == visits
