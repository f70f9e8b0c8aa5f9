"""A robot beside a task controller whose bytes were recorded: one session, and the values of its work."""

import pytest

from agent.safety.stop_cause import StopCause
from sim.rigs.task_session_rig import BITS_A_SECOND, SessionRecord, standing_load, task_session


def _right(found: SessionRecord) -> None:
    assert found.log_ins == 1 and found.log_in_for_s <= 3.0, found
    assert found.area_error <= 1e-3 and found.distance_error <= 1e-3, found
    assert found.time_error_for_s <= 1.0 and found.states_missed == 0, found


@pytest.mark.sampled(1)
@pytest.mark.parametrize("version", [3, 4])
def test_a_quarter_of_an_hour(version: int) -> None:
    _right(task_session(version, 0.25))


@pytest.mark.slow
@pytest.mark.parametrize("version", [3, 4])
def test_eight_hours(version: int) -> None:
    _right(task_session(version, 8.0, seed=3))


def test_a_standing_robot_takes_little_of_the_bus() -> None:
    """Twenty of them stay below 4 %. Two faults of a robot take three frames in each second, by SAE
    J1939-21 and -73; `test_faults_rig.py` has a fleet in which the leader alone does."""
    one, two = standing_load(()), standing_load((StopCause.IMPLEMENTS_STOP,))
    assert (one.told, two.told) == (1, 2)
    assert 20 * (one.session + one.faults) <= 0.03, one
    assert two.faults * BITS_A_SECOND >= 3 * 131, "three frames without a stuffed bit"
    assert one.session == two.session
