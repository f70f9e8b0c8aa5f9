"""What it means to be moved by somebody."""

import pytest

from agent.field.displacement_detector import DisplacementDetector
from agent.interface.config import CONTROL_PERIOD_US

SPEED_M_S, STEP_M = 2.5, 0.125


@pytest.mark.parametrize(
    ("dx_m", "pushed"), [(STEP_M, False), (0.28, False), (0.3, True), (3.5, True)]
)
def test_a_push_is_told_from_driving(dx_m: float, pushed: bool) -> None:
    """Found by `headland chaos`, profile body, seeds 6008 and 6095: a robot that was pushed 3.5 m along
    its row counted what lay between as worked."""
    shove = DisplacementDetector()
    assert not shove.observe((0.0, 0.0), 0, SPEED_M_S)
    assert shove.observe((dx_m, 0.0), CONTROL_PERIOD_US, SPEED_M_S) is pushed
    assert not shove.observe((dx_m + STEP_M, 0.0), 2 * CONTROL_PERIOD_US, SPEED_M_S)


def test_who_was_late_may_have_driven_further() -> None:
    shove = DisplacementDetector()
    shove.observe((0.0, 0.0), 0, SPEED_M_S)
    assert not shove.observe((2.5, 0.0), 1_000_000, SPEED_M_S)
    assert not shove.observe((2.6, 0.0), 0, SPEED_M_S), "a clock that was set back"
