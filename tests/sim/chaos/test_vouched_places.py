"""The simulated person starts robots that cannot know whether their place is right."""

import pytest

from sim.chaos.fault_profiles import SPANS, vouch
from sim.scenarios import scenario as kinds

SPAN = SPANS["field"]


@pytest.mark.parametrize(("for_s", "starts"), [(4.0, [0]), (0.1, [])])
def test_a_place_that_jumps_while_it_drifts_far_is_vouched_for(
    for_s: float, starts: list[int]
) -> None:
    """Beyond 0.15 m of inaccuracy no robot compares places, so it takes the wrong one for right."""
    drift = kinds.Drifting(
        at_s=18.0, kind="drifting", robot=0, vx_m_s=-0.2, vy_m_s=1.0, for_s=for_s
    )
    jump = kinds.Jumped(
        at_s=18.0, kind="jumped", robot=0, dx_m=-0.8, dy_m=0.6, turn_rad=0.0, for_s=2.0
    )
    orders = [each for each in vouch([drift, jump], SPAN) if isinstance(each, kinds.Order)]
    assert [each.robot for each in orders] == starts
