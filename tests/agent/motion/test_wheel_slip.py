"""How fast a body drives whose wheels slip."""

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.motion.wheel_slip import FORGOTTEN_S, SLOWEST_SHARE, WheelSlip

FASTEST_M_S = 2.5


@pytest.mark.parametrize(
    ("aside_m_s", "least_m_s", "most_m_s"),
    [(0.1, FASTEST_M_S, FASTEST_M_S), (0.5, 0.5, 2.0), (2.0, 0.0, 0.6)],
)
def test_a_body_that_goes_aside_drives_slower(
    aside_m_s: float, least_m_s: float, most_m_s: float
) -> None:
    """A body at 2.5 m/s with 0.3 of slip went aside by 1.3 m/s, and leaned on a fence (shapes 116420092);
    another one touched a robot that stood (rays 116420087)."""
    slip = WheelSlip(FASTEST_M_S)
    slip.observe((2.0, aside_m_s), (2.0, 0.0), (2.1, 0.0), CONTROL_PERIOD_US)
    assert least_m_s <= slip.limit_m_s <= most_m_s
    assert slip.limit_m_s >= SLOWEST_SHARE * FASTEST_M_S


def test_a_body_that_is_faster_than_expected_does_not_slip() -> None:
    """Wheels that follow a command at once, and wheels that follow slowly."""
    slip = WheelSlip(FASTEST_M_S)
    for k, moves_m_s in enumerate((-2.4, 0.0, 2.4)):
        slip.observe((moves_m_s, 0.0), (-2.4, 0.0), (2.5, 0.0), k * CONTROL_PERIOD_US)
    assert slip.limit_m_s == FASTEST_M_S


def test_slip_is_forgotten() -> None:
    slip = WheelSlip(FASTEST_M_S)
    slip.observe((2.0, 2.0), (2.0, 0.0), (2.0, 0.0), 1)
    slow_m_s = slip.limit_m_s
    slip.observe((1.0, 0.0), (1.0, 0.0), (1.0, 0.0), round(FORGOTTEN_S * S))
    assert slow_m_s <= slip.limit_m_s < FASTEST_M_S
    slip.observe((1.0, 0.0), (1.0, 0.0), (1.0, 0.0), round(5 * FORGOTTEN_S * S))
    assert slip.limit_m_s == FASTEST_M_S
