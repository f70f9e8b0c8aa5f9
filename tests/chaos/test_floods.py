"""A device that outranks every stop: nobody moves on after a press, and all is well when it has gone."""

import pytest

from sim.chaos.flood_trial import Flood, Trial, draw
from sim.chaos.planted_bugs import planted

LOWEST = 0x4D


@pytest.mark.parametrize("policy", ["stop", "slow", "continue"])
def test_item_2_nobody_drives_on_through_a_flood_under_any_policy(policy: str) -> None:
    result = Trial(Flood(1, 3, policy, LOWEST, 8, 8.0, 1.0, ((4.0, 0),))).run()
    assert not result.late, result
    assert result.wire_for_s < 1.0 and result.fleet_for_s < 5.0, result


def test_item_2_a_fleet_goes_on_by_itself_after_a_flood() -> None:
    result = Trial(Flood(2, 3, "continue", 0, 8, 12.0, 1.0, ())).run()
    assert not result.broken, result
    assert result.moved_m < 2.5, "a silence and its braking distance"


def test_item_2_the_fault_is_seen_when_robots_go_on_unheard() -> None:
    with planted("alone-unheard"):
        result = Trial(Flood(1, 3, "continue", LOWEST, 8, 8.0, 1.0, ((4.0, 0),))).run()
    assert result.late


@pytest.mark.parametrize("seed", range(6))
def test_item_2_drawn_floods(seed: int) -> None:
    result = Trial(draw(seed, 3, longest_for_s=15.0)).run()
    assert not result.broken, result


@pytest.mark.slow
def test_a_fleet_that_finishes_its_work_in_a_flood_has_recovered() -> None:
    """Nothing was left to drive for, and the trial waited for a robot that drives."""
    result = Trial(draw(102904, longest_for_s=120.0)).run()
    assert not result.broken and result.moved_m > 50.0, result
