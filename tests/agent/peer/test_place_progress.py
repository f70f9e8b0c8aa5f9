"""How far a body can have driven, as its wheels were told and can speed up."""

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import Drive
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.peer.place_jumps import FASTER
from agent.peer.place_progress import PlaceProgress

SPEED_M_S, ACCELERATION_M_S2, PERIOD_S = 2.5, 1.5, CONTROL_PERIOD_US / S
LIMITS = BodyLimits(0.8, SPEED_M_S, ACCELERATION_M_S2)


def way_m(periods: int, told_m_s: float, sensed_m_s: float) -> float:
    """Of a body whose place stands still."""
    progress = PlaceProgress()
    for period in range(periods):
        here = Observation(0.0, 0.0, 0.0, sensed_m_s, 0.0, sensed_at_us=period * CONTROL_PERIOD_US)
        drive = Drive(told_m_s, 0.0, 0.0, False)
        progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US)
    return progress.way_m


def test_wheels_that_stand_need_time_to_drive() -> None:
    assert way_m(1, SPEED_M_S, 0.0) <= 2 * ACCELERATION_M_S2 * PERIOD_S**2 + 1e-9
    assert way_m(10, SPEED_M_S, 0.0) < FASTER * SPEED_M_S * 10 * PERIOD_S / 2
    assert way_m(20, 0.0, 0.0) == 0.0


@pytest.mark.parametrize("periods", [1, 5, 20, 60])
def test_a_body_that_speeds_up_with_twice_its_acceleration_drives_no_further(periods: int) -> None:
    v_m_s = driven_m = 0.0
    for _ in range(periods):
        v_m_s = min(v_m_s + 2 * ACCELERATION_M_S2 * PERIOD_S, SPEED_M_S)
        driven_m += v_m_s * PERIOD_S
    assert way_m(periods, SPEED_M_S, 0.0) >= driven_m - 1e-9


def test_a_body_that_drives_already_drives_on_at_once() -> None:
    assert way_m(1, SPEED_M_S, SPEED_M_S) >= SPEED_M_S * PERIOD_S


@pytest.mark.parametrize("periods", [2, 5])
@pytest.mark.parametrize("hangs", [True, False])
def test_a_place_that_falls_back_at_a_corner_leads_nowhere(hangs: bool, periods: int) -> None:
    """Each fall took the place before the corner again, so that the command turned across the motion
    (fixes 110000064). The robot drove 4.1 m. `periods`: between two fixes."""
    progress, step_m = PlaceProgress(), 1.8 * PERIOD_S
    told = ""
    for period in range(40):
        since_fix = period % periods
        x_m = -step_m * (since_fix if hangs else period)
        here = Observation(x_m, 0.0, 0.0, -1.8, 0.1, sensed_at_us=period * CONTROL_PERIOD_US)
        drive = Drive(-2.0, 0.2, 0.0, False) if since_fix else Drive(0.0, -0.5, 0.0, False)
        told = told or progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US)
    assert bool(told) is hangs, told
