"""A robot beside a task controller whose bytes were recorded: one session, and the values of its work."""

import pytest

from sim.rigs.task_session_rig import SessionRecord, task_session


def _right(found: SessionRecord) -> None:
    assert found.log_ins == 1 and found.log_in_for_s <= 3.0, found
    assert found.area_error <= 1e-3 and found.distance_error <= 1e-3, found
    assert found.time_error_for_s <= 1.0 and found.states_missed == 0, found


@pytest.mark.parametrize("version", [3, 4])
def test_a_quarter_of_an_hour(version: int) -> None:
    _right(task_session(version, 0.25))


@pytest.mark.slow
@pytest.mark.parametrize("version", [3, 4])
def test_eight_hours(version: int) -> None:
    _right(task_session(version, 8.0, seed=3))
