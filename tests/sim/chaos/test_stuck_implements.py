"""S22: how far a robot drives with an implement down that was told to rise."""

from pathlib import Path

import pytest

from sim.chaos.fault_profiles import with_faults
from sim.chaos.planted_bugs import planted
from sim.chaos.verdict import judge
from sim.scenarios.scenario import load

STORY = Path(__file__).parents[2] / "chaos/stories/stuck_implement.toml"


@pytest.mark.parametrize("overlapping", [1, 3])
def test_a_way_counts_once_however_many_faults_hold_the_implement(overlapping: int) -> None:
    """`headland chaos`, profile implement, seed 20800572: three faults at a time, and three times
    the way."""
    scenario = load(str(STORY))
    scenario = with_faults(scenario, list(scenario.fault) * overlapping)
    assert judge(scenario).ok
    with planted("implement-not-watched"):
        broken = judge(scenario).broken
    mine = [each.rule for each in broken if each.what.startswith("robot 0 drives")]
    assert mine == ["S22"]
