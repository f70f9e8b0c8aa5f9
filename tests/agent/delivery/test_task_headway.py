"""A carrier that makes no headway gives its task back, says why, and holds back for a while."""

from math import inf

from agent.claims.standing_owners import LOOK_US, STANDS_US, StandingOwners
from agent.delivery.task_headway import AGAIN_US, HEADWAY_US, STANDSTILL_US, TaskHeadway
from agent.interface.config import CONTROL_PERIOD_US, LEASE_US, S
from tests.agent.peer.test_stall_watchdog import view

GOAL = (50.0, 0.0)
PLACE = (1.0, 2.0)


def lost_at_us(headway: TaskHeadway, speed_m_s: float, left_m: float, limit_us: int) -> int | None:
    """When a carrier that moves to and fro at this speed, with so much left, has lost its headway."""
    for now_us in range(0, limit_us, CONTROL_PERIOD_US):
        along_m = speed_m_s * now_us / S
        at = PLACE[0] + abs((along_m + 5.0) % 20.0 - 10.0), PLACE[1]
        headway.observe(at, GOAL, left_m, now_us)
        if headway.lost:
            return now_us
    return None


def test_i24_a_carrier_that_stands_gives_its_task_back() -> None:
    headway = TaskHeadway()
    when_us = lost_at_us(headway, 0.0, 40.0, 2 * STANDSTILL_US)
    assert when_us is not None and abs(when_us - STANDSTILL_US) <= 3 * CONTROL_PERIOD_US
    assert "stands for 30 s" in headway.lost


def test_i24_a_carrier_that_drives_to_and_fro_gives_its_task_back() -> None:
    for left_m in (40.0, inf):  # on a path, and in round after round
        headway = TaskHeadway()
        when_us = lost_at_us(headway, 0.5, left_m, 2 * HEADWAY_US)
        assert when_us is not None and abs(when_us - HEADWAY_US) <= 3 * CONTROL_PERIOD_US
        assert "no nearer for 120 s" in headway.lost


def test_time_in_which_it_may_not_drive_or_handles_a_parcel_does_not_count() -> None:
    headway = TaskHeadway()
    for number in range(1_000):  # each time after a stop of a minute
        headway.observe(PLACE, GOAL, 40.0, number * 60 * S)
    for number in range(2_000):
        headway.observe(PLACE, GOAL, 40.0, number * CONTROL_PERIOD_US)
        if number % 100 == 0:
            headway.handles()
        assert not headway.lost


def test_a_carrier_that_gave_a_task_back_holds_back_until_it_moves_or_for_longer_each_time() -> (
    None
):
    headway = TaskHeadway()
    assert not headway.holds_back(PLACE, 0)
    now_us = 0
    for times in range(3):
        headway.gave_back(PLACE, now_us)
        assert headway.holds_back(PLACE, now_us + (AGAIN_US << times) - 1)
        assert not headway.holds_back((PLACE[0] + 2.0, PLACE[1]), now_us)
        now_us += AGAIN_US << times
        assert not headway.holds_back(PLACE, now_us)


def test_i24_an_owner_that_stands_is_known_after_three_leases() -> None:
    assert STANDS_US == 3 * LEASE_US > STANDSTILL_US, "first it may give back by itself"
    owners = StandingOwners(1.0)
    for now_us in range(0, STANDS_US, CONTROL_PERIOD_US):
        owners.observe(view(now_us, (0.0, 0.0), 5.0), lambda sections: 0)
        assert not owners.stands(1)
    owners.observe(view(STANDS_US, (0.0, 0.0), 5.0), lambda sections: 0)
    assert list(owners.standing()) == [1]
    owners.observe(view(STANDS_US + LOOK_US, (0.0, 0.0), 7.0), lambda sections: 0)
    assert not owners.stands(1), "it moved"
