"""What it means to be moved by somebody."""

from math import cos, pi, sin
from random import Random

import pytest

from agent.field.displacement_detector import FOLLOWED_FOR_US, DisplacementDetector
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.observation import Observation

SPEED_M_S, STEP_M = 2.5, 0.125
ACCELERATION_M_S2 = 1.5
PERIOD_S = CONTROL_PERIOD_US / S


def detector() -> DisplacementDetector:
    return DisplacementDetector(SPEED_M_S, ACCELERATION_M_S2)


def at(x_m: float, now_us: int, vx_m_s: float = 0.0, y_m: float = 0.0) -> Observation:
    return Observation(x_m, y_m, 0.0, vx_m_s, 0.0, sensed_at_us=now_us)


@pytest.mark.parametrize(
    ("dx_m", "pushed"), [(STEP_M, False), (0.28, False), (0.3, True), (3.5, True)]
)
def test_a_push_is_told_from_driving(dx_m: float, pushed: bool) -> None:
    """Found by `headland chaos`, profile body, seeds 6008 and 6095: a robot that was pushed 3.5 m along
    its row counted what lay between as worked."""
    shove = detector()
    assert not shove.observe(at(0.0, 0), 0)
    later_us = CONTROL_PERIOD_US
    assert shove.observe(at(dx_m, later_us), later_us) is pushed
    assert not shove.observe(at(dx_m + STEP_M, 2 * later_us), 2 * later_us)


def test_who_was_late_may_have_driven_further() -> None:
    shove = detector()
    shove.observe(at(0.0, 0), 0)
    assert not shove.observe(at(2.5, S), S)
    assert not shove.observe(at(2.6, 0), 0), "a clock that was set back"


class Drive:
    """A robot on its row that drives at `speed_m_s`, as its senses tell it."""

    def __init__(self, told_share: float = 1.0, late: int = 0, noise_m: float = 0.0) -> None:
        """`told_share`: of its velocity that it senses. `late`: control periods by which it senses its
        velocity late. `noise_m`: standard deviation of its place, which it also says."""
        self.shove, self.told_share, self.noise_m = detector(), told_share, noise_m
        self.x_m, self.v_m_s, self.now_us = 0.0, 0.0, 0
        self.told_m_s = [0.0] * (late + 1)
        self.rng = Random(1)

    def on(self, for_s: float, speed_m_s: float, push_m_s: float = 0.0) -> list[int]:
        """The control periods in which a displacement is seen."""
        seen = []
        for period in range(round(for_s / PERIOD_S)):
            change_m_s = max(-0.075, min(speed_m_s - self.v_m_s, 0.075))
            self.x_m += (self.v_m_s + change_m_s / 2 + push_m_s) * PERIOD_S
            self.v_m_s += change_m_s
            self.now_us += CONTROL_PERIOD_US
            self.told_m_s = [*self.told_m_s[1:], self.told_share * self.v_m_s]
            place_m = self.x_m + self.rng.gauss(0.0, self.noise_m)
            here = at(place_m, self.now_us, self.told_m_s[0], self.rng.gauss(0.0, self.noise_m))
            here = here._replace(position_accuracy_m=self.noise_m)
            if self.shove.observe(here, self.now_us):
                seen.append(period)
        return seen


@pytest.mark.parametrize("speed_m_s", [0.4, 1.5, 2.5])
def test_l5_a_push_at_walking_speed_is_no_driving(speed_m_s: float) -> None:
    """Found by `headland chaos`, profile body, seed 1008: a robot that was pushed 1.76 m along its row,
    at 1 m/s, counted the ground as worked: no step was longer than what its wheels can do."""
    drive = Drive()
    assert drive.on(5.0, speed_m_s) == []
    seen = drive.on(1.76, speed_m_s, 1.0)
    last = round(1.76 / PERIOD_S) - 1
    assert seen[0] * PERIOD_S < 0.4 and seen[-1] == last
    drive.on(0.5, speed_m_s)
    assert drive.on(5.0, speed_m_s) == []


def test_a_person_who_pushes_the_robot_that_stands_is_noticed() -> None:
    drive = Drive()
    drive.on(3.0, 2.5)
    drive.on(3.0, 0.0)
    assert drive.on(2.0, 0.0, 1.0)


@pytest.mark.parametrize("speed_m_s", [0.4, 1.5, 2.5])
def test_l5_a_push_is_doubted_before_it_is_seen(speed_m_s: float) -> None:
    """Found by `headland chaos`, profile steered, seed 106000090: a robot was pushed across the end of a
    unit, which it counted before it had noticed the push. 0.4 m of it were left."""
    drive = Drive()
    drive.on(5.0, speed_m_s)
    assert not drive.shove.doubtful
    drive.on(2 * PERIOD_S, speed_m_s, 1.5)
    assert drive.shove.doubtful
    assert drive.on(1.0, speed_m_s) == [] and not drive.shove.doubtful


def test_driving_with_a_receiver_of_2_cm_is_not_doubted() -> None:
    drive = Drive(noise_m=0.02)
    for speed_m_s in (2.5, 0.0, 0.5, 2.5, 1.0):
        drive.on(4.0, speed_m_s)
        doubted = 0
        for _ in range(100):
            drive.on(PERIOD_S, speed_m_s)
            doubted += drive.shove.doubtful
        assert doubted < 20, "of 100 periods"


@pytest.mark.parametrize("late", [0, 2, 4])
@pytest.mark.parametrize("noise_m", [0.0, 0.02])
def test_driving_is_no_push_whatever_the_receiver(late: int, noise_m: float) -> None:
    """Noise of a place of 2 cm, as with real-time corrections, and velocities of 0.2 s ago."""
    drive = Drive(late=late, noise_m=noise_m)
    for speed_m_s in (2.5, 0.0, 0.5, 2.5, 1.0, 2.5, 0.0):
        assert drive.on(10.0, speed_m_s) == []


@pytest.mark.parametrize("told_share", [0.0, 0.2])
def test_a_body_that_senses_no_velocity_shows_leaps_only(told_share: float) -> None:
    drive = Drive(told_share)
    assert drive.on(20.0, 2.5) == []
    drive.x_m += 1.0
    assert drive.on(0.2, 2.5) == [0]


def test_a_velocity_that_fails_is_not_taken_for_a_push_for_ever() -> None:
    drive = Drive()
    drive.on(20.0, 1.5)
    drive.told_share = 0.0
    assert drive.on(5.0, 1.5)
    drive.on(FOLLOWED_FOR_US / S, 1.5)
    assert drive.on(5.0, 1.5) == []


def test_places_that_come_each_other_period_are_compared_over_their_time() -> None:
    shove, seen = detector(), []
    for period in range(100):
        now_us = period * CONTROL_PERIOD_US
        sensed_at_us = now_us - now_us % (2 * CONTROL_PERIOD_US)
        here = at(SPEED_M_S * sensed_at_us / S, sensed_at_us, SPEED_M_S)
        seen.append(shove.observe(here, now_us))
    assert not any(seen)


def test_an_antenna_on_a_boom_moves_while_the_body_turns() -> None:
    """Its velocity is not that of the middle of the body, whose place does not change."""
    shove, seen = detector(), []
    for period in range(400):
        now_us = period * CONTROL_PERIOD_US
        turn_rad_s = 1.0 if period % 100 > 50 else 0.0
        heading_rad = turn_rad_s * (period % 100 - 50) * PERIOD_S
        speed_m_s = 1.0 if not turn_rad_s else 0.0
        vx_m_s = speed_m_s - turn_rad_s * sin(heading_rad)
        vy_m_s = turn_rad_s * cos(heading_rad)
        x_m = (period // 100 * 51 + min(period % 100, 51)) * PERIOD_S
        here = Observation(x_m, 0.0, heading_rad % (2 * pi), vx_m_s, vy_m_s, sensed_at_us=now_us)
        seen.append(shove.observe(here, now_us))
    assert not any(seen)
