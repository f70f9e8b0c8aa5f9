"""How far a body can have driven, as its wheels were told and can speed up."""

from random import Random

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import Drive
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.peer.place_jumps import FASTER
from agent.peer.place_progress import KEPT_MAX, PlaceProgress

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


@pytest.mark.parametrize("says", [True, False])
@pytest.mark.parametrize("hangs", [True, False])
def test_a_place_that_falls_back_before_a_goal_leads_nowhere(hangs: bool, says: bool) -> None:
    """Between two fixes the place passed the goal, and the robot told its body to turn. Each time it
    forgot what it had seen, and drove 3.4 m at 2 m/s beside its place (fixes 115400116).

    `says`: whether the body says its velocity."""
    progress, told, x_m = PlaceProgress(), "", 0.0
    for period in range(80):
        since_fix = period % 4
        x_m = 2.0 * PERIOD_S * (since_fix if hangs else period)
        v_m_s = 2.0 if says else 0.0
        here = Observation(x_m, 0.0, 0.0, v_m_s, 0.0, sensed_at_us=period * CONTROL_PERIOD_US)
        drive = Drive(-0.4 if since_fix == 3 else 2.3, 0.0)
        told = told or progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US)
    assert bool(told) is hangs, told


@pytest.mark.parametrize("periods", [3, 8, 20, 45])
@pytest.mark.parametrize("slow", [0.5, 1.0, 2.0])
def test_a_body_that_is_sent_to_and_fro_and_follows_leads_on(periods: int, slow: float) -> None:
    """`slow`: its acceleration, in those of its limits."""
    progress, x_m, v_m_s = PlaceProgress(), 0.0, 0.0
    for period in range(400):
        told_m_s = 2.0 if period // periods % 2 else -2.0
        gained_m_s = slow * ACCELERATION_M_S2 * PERIOD_S
        v_m_s += max(-gained_m_s, min(gained_m_s, told_m_s - v_m_s))
        x_m += v_m_s * PERIOD_S
        here = Observation(x_m, 0.0, 0.0, v_m_s, 0.0, sensed_at_us=period * CONTROL_PERIOD_US)
        found = progress.look(
            here, Drive(told_m_s, 0.0), LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US
        )
        assert not found, (period, found)


def test_a_place_that_led_nowhere_and_jumps_away_is_not_back() -> None:
    """It was taken for one that leads on, jumped back to where it had hung, and the robot drove another
    1.2 m by it (fixes 115400127). One that moves in time, as a person pushes the body, is back."""
    for step_m, back in ((90.0, False), (0.05, True)):
        progress = PlaceProgress()
        for period in range(40):
            at_us = period * CONTROL_PERIOD_US
            here = Observation(0.1 * (period % 4), 0.0, 0.0, 2.0, 0.0, sensed_at_us=at_us)
            drive = Drive(2.0, 0.0)
            if progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US):
                break
        assert progress.hangs
        x_m, at_us, was_back = here.x_m, here.sensed_at_us, False
        for period in range(60):
            at_us += CONTROL_PERIOD_US
            x_m += step_m if period == 0 or step_m < 1.0 else 0.0
            seen = Observation(x_m, 0.0, 0.0, 0.0, 0.0, sensed_at_us=at_us)
            was_back = was_back or progress.is_back(seen, 1.5)
        assert was_back is back, step_m


@pytest.mark.parametrize("hangs", [True, False])
def test_a_place_that_falls_back_while_the_body_brakes_leads_nowhere(hangs: bool) -> None:
    """The robot was told 0.3 m/s before its goal, so that hardly a way was expected of it while it drove
    2 m from its place (fixes 115600014)."""
    progress, told, x_m, gone_m, periods = PlaceProgress(), "", 0.0, 0.0, 0
    for period in range(40):
        v_m_s = max(2.3 - 1.5 * PERIOD_S * period, 0.0)
        gone_m += v_m_s * PERIOD_S
        x_m += v_m_s * PERIOD_S
        if hangs and period % 4 == 0:
            x_m = 0.0
        here = Observation(x_m, 0.0, 0.0, v_m_s, 0.0, sensed_at_us=period * CONTROL_PERIOD_US)
        drive = Drive(0.3, -0.2)
        told = told or progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US)
        if not told:
            periods += 1
    assert bool(told) is hangs and (periods < 12) is hangs, (told, periods)


def test_a_velocity_that_stays_after_a_halt_is_no_place_that_leads_nowhere() -> None:
    """Receivers tell it for half a second more, and the noise of a place is a centimetre."""
    progress, rng = PlaceProgress(), Random(1)
    for period in range(60):
        x_m = min(2.0 * PERIOD_S * period, 2.0) + rng.gauss(0.0, 0.01)
        v_m_s = 2.0 if period < 31 else 0.0
        here = Observation(x_m, 0.0, 0.0, v_m_s, 0.0, sensed_at_us=period * CONTROL_PERIOD_US)
        drive = Drive(2.0 if period < 20 else 0.0, 0.0)
        assert not progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US)


def test_a_body_that_moves_to_and_fro_for_hours_keeps_no_more_places() -> None:
    """Ten robots of drills kept 40 places more each second, a gigabyte a day; and the way on which a jump
    could not be told from the body's own motion became longer and longer."""
    progress, ways_m = PlaceProgress(), []
    for period in range(40_000):
        forth = period // 4 % 2 == 0
        speed_m_s, x_m = (0.5 if forth else -0.5), 0.5 * PERIOD_S * (period % 4)
        here = Observation(
            x_m if forth else 2 * PERIOD_S - x_m, 0.0, 0.0, speed_m_s, 0.0,
            sensed_at_us=period * CONTROL_PERIOD_US,
        )  # fmt: skip
        drive = Drive(speed_m_s, 0.0, 0.0, False)
        assert not progress.look(here, drive, LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US)
        assert max(len(progress._kept), len(progress._said)) <= KEPT_MAX
        ways_m.append(progress.unseen(0.0).way_m)
    assert max(ways_m[20_000:]) <= 1.1 * max(ways_m[:1_000])


@pytest.mark.parametrize("starts", [False, True])
def test_a_robot_that_is_started_while_it_drives_may_turn_back(starts: bool) -> None:
    """After a start its body was taken for one that stands. So one that was told to turn back at full
    speed, and went on by 1.2 m while it braked, was found with a frozen place. It stood until a person
    started it again, and its section was never finished (stop 116420111)."""
    progress, x_m, v_m_s, draw = PlaceProgress(), 0.0, -2.4, Random(2)
    for period in range(120):
        if starts and period == 60:
            progress.forget(drives_on=True)
        turns_for_s = max(period - 67, 0) * PERIOD_S
        told_m_s = -2.4 if turns_for_s == 0.0 else min(-0.2 + 1.8 * turns_for_s, SPEED_M_S)
        v_m_s = min(max(told_m_s, v_m_s - 2.1 * PERIOD_S), v_m_s + 2.1 * PERIOD_S)
        x_m += v_m_s * PERIOD_S
        here = Observation(
            x_m + draw.gauss(0.0, 0.008), 0.0, 0.0, v_m_s, 0.0,
            sensed_at_us=period * CONTROL_PERIOD_US,
        )  # fmt: skip
        found = progress.look(
            here, Drive(told_m_s, 0.0), LIMITS, ACCELERATION_M_S2 / 2, CONTROL_PERIOD_US
        )
        assert not found, (period, found)
