"""Nobody is ever where it cannot stop before another that halts, whatever beats were lost."""

from math import cos, hypot, pi, sin
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.avoidance.orca import OrcaSolver
from agent.avoidance.orca_kernel import TOLD
from agent.avoidance.stopping_constraint import (
    HARDEST_M_S2,
    REACTION_S,
    SLACK_M,
    before_agent,
    within_grip,
)
from agent.interface.geometry import Point

NO_FENCES = np.zeros((0, 4))
RADIUS_M, SPEED_M_S, BRAKING_M_S2, DT_S, STEP_S = 0.35, 1.0, 2.0, 0.05, 0.01
MARGIN_M = 0.15  # as `agent/motion/holonomic_motion.py` has it
ROUNDED_M = 0.05  # POSE: the place


class Robot:
    """A point with a body; its velocity follows what is wanted as the wheels can."""

    def __init__(self, x_m: float, y_m: float, vx_m_s: float, stops: bool) -> None:
        self.at, self.v, self.wanted = (x_m, y_m), (vx_m_s, 0.0), (vx_m_s, 0.0)
        self.hard_m_s2 = BRAKING_M_S2
        self.heard: dict[int, tuple[Point, Point, float]] = {}
        self.avoidance = OrcaSolver(
            RADIUS_M, SPEED_M_S, 1.0, 1.0, DT_S, NO_FENCES, keep_right_rad=0.05,
            stopping_m_s2=BRAKING_M_S2 if stops else 0.0,
        )  # fmt: skip

    def choose(self, goal: Point, now_s: float) -> None:
        dx, dy = goal[0] - self.at[0], goal[1] - self.at[1]
        far = max(hypot(dx, dy), 1e-9)
        speed = min(SPEED_M_S, far)
        rows: list[tuple[float, ...]] = []
        for (x, y), (vx, vy), heard_s in self.heard.values():
            age_s = now_s - heard_s
            share = 0.5 if hypot(vx, vy) > 0.05 else 1.0
            rows.append((x + vx * age_s - self.at[0], y + vy * age_s - self.at[1], vx, vy,
                         2 * RADIUS_M + MARGIN_M, share, age_s))  # fmt: skip
        self.wanted = self.avoidance.velocity(
            self.at, self.v, (dx / far * speed, dy / far * speed), rows
        )

    def halt(self, rng: Random) -> None:
        self.wanted, self.hard_m_s2 = (0.0, 0.0), rng.uniform(BRAKING_M_S2, HARDEST_M_S2)

    def step(self) -> None:
        cx, cy = self.wanted[0] - self.v[0], self.wanted[1] - self.v[1]
        most, asked = self.hard_m_s2 * STEP_S, hypot(cx, cy)
        part = min(1.0, most / asked) if asked > 0 else 1.0
        self.v = self.v[0] + cx * part, self.v[1] + cy * part
        self.at = self.at[0] + self.v[0] * STEP_S, self.at[1] + self.v[1] * STEP_S


def play(rng: Random, robots: list[Robot], goals: list[Point], loss: float, halt: float) -> float:
    """Everybody halts now and then for a second; returns the smallest gap between two bodies."""
    until_s = [0.0] * len(robots)
    closest_m = 9e9
    for tick in range(300):
        now_s = tick * DT_S
        for me, robot in enumerate(robots):
            for other, peer in enumerate(robots):
                if other != me and (tick == 0 or rng.random() >= loss):
                    x, y = (round(c / ROUNDED_M) * ROUNDED_M for c in peer.at)
                    robot.heard[other] = (x, y), peer.v, now_s
        for me, robot in enumerate(robots):
            if now_s >= until_s[me] and rng.random() < halt:
                until_s[me] = now_s + 1.0
                robot.halt(rng)
            elif now_s >= until_s[me]:
                robot.hard_m_s2 = BRAKING_M_S2
                robot.choose(goals[me], now_s)
        for _ in range(round(DT_S / STEP_S)):
            for robot in robots:
                robot.step()
            for me, a in enumerate(robots):
                for b in robots[:me]:
                    gap_m = hypot(a.at[0] - b.at[0], a.at[1] - b.at[1]) - 2 * RADIUS_M
                    closest_m = min(closest_m, gap_m)
    return closest_m


def train(stops: bool) -> list[Robot]:
    return [Robot(1.0 * k, 0.0, 0.0, stops) for k in range(4)]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), loss=st.sampled_from((0.0, 0.3, 0.6)))
def test_a_train_whose_robots_halt_does_not_touch(seed: int, loss: float) -> None:
    goals = [(40.0 + k, 0.0) for k in range(4)]
    assert play(Random(seed), train(True), goals, loss, 0.02) > 0.0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), loss=st.sampled_from((0.0, 0.3)))
def test_a_crowd_whose_robots_halt_does_not_touch(seed: int, loss: float) -> None:
    rng = Random(seed)
    places = [(1.6 * (k % 3), 1.6 * (k // 3)) for k in range(6)]
    robots = [Robot(x + rng.uniform(-0.2, 0.2), y, 0.0, True) for x, y in places]
    goals = [(rng.uniform(-1, 5), rng.uniform(-1, 4)) for _ in places]
    assert play(rng, robots, goals, loss, 0.02) > 0.0


@given(
    far_m=st.floats(2.0, 12.0), bearing_rad=st.floats(0.0, 2 * pi), own_m_s=st.floats(0.1, 2.5),
    peer_m_s=st.floats(0.0, 2.5), aslant_rad=st.floats(-pi / 2, pi / 2),
)  # fmt: skip
def test_two_that_brake_straight_on_any_courses_have_room_for_it(
    far_m: float, bearing_rad: float, own_m_s: float, peer_m_s: float, aslant_rad: float
) -> None:
    """One of two robots that came aslant towards each other lost its place and braked. The other one had
    reckoned with the part of that robot's speed towards it, and touched it at 0.2 m/s."""
    radius_m, braking_m_s2 = 1.75, 1.5
    px, py = far_m * cos(bearing_rad), far_m * sin(bearing_rad)
    course_rad = bearing_rad + pi + aslant_rad
    ux, uy = peer_m_s * cos(course_rad), peer_m_s * sin(course_rad)
    lines = np.zeros((1, 4), dtype=np.float32)
    limited = before_agent(px, py, ux, uy, radius_m, 0.0, braking_m_s2, own_m_s, own_m_s, lines, 0)
    towards_m_s = float(hypot(*lines[0, :2])) if limited else own_m_s
    coming_m_s = peer_m_s * cos(aslant_rad)
    own_m = towards_m_s * (REACTION_S + own_m_s / (2 * braking_m_s2))
    peer_m = coming_m_s * (REACTION_S + peer_m_s / (2 * braking_m_s2))
    if towards_m_s > 0.0:
        assert own_m + peer_m <= far_m - radius_m + SLACK_M + 1e-5


def test_a_train_without_it_does() -> None:
    """Plain ORCA relies on the one ahead, and on beats."""
    goals = [(40.0 + k, 0.0) for k in range(4)]
    assert min(play(Random(seed), train(False), goals, 0.6, 0.02) for seed in range(20)) < 0.0


@pytest.mark.parametrize("gap_m", [0.2, 1.0, 3.0])
def test_it_stops_no_further_away_than_it_must(gap_m: float) -> None:
    robots = [Robot(0.0, 0.0, 0.0, True), Robot(2 * RADIUS_M + gap_m, 0.0, 0.0, True)]
    closest_m = play(Random(1), robots, [(9.0, 0.0), robots[1].at], 0.0, 0.0)
    assert 0.0 < closest_m < MARGIN_M + 0.05


@pytest.mark.parametrize("drift_m_s", [0.05, 0.15, 0.25])
def test_a_robot_that_brakes_before_another_one_does_not_drift_into_a_fence(
    drift_m_s: float,
) -> None:
    """In `curitiba` a robot braked before a working one for two seconds, straight along its velocity.
    That led aslant into the fence beside it, which it touched by a millimetre."""
    braking_m_s2, fence_m = 1.5, 0.2  # to the fence: what the avoidance keeps beside the body
    change_m_s = braking_m_s2 * DT_S
    fence = (0.0, 0.0, 1.0, 0.0)  # no motion to the south: (-py, px) for p = (0, -1)
    stop = (0.0, 0.0, 0.0, 1.0)  # no motion to the east
    lines = np.array([fence, stop], dtype=np.float32)
    x_m, y_m, vx, vy = 0.0, 0.0, np.float32(2.4), np.float32(-drift_m_s)
    while vx > change_m_s:
        before = vx
        vx, vy = within_grip(
            np.float32(-1.0), np.float32(2.0), vx, vy, vx, np.float32(change_m_s), lines, 1, 2
        )
        assert before - vx > 0.93 * change_m_s, "braking comes first"
        x_m, y_m = x_m + float(vx) * DT_S, y_m + float(vy) * DT_S
    assert y_m > -fence_m / 2
    assert x_m < 1.05 * 2.4**2 / (2 * braking_m_s2)


@pytest.mark.parametrize("slip", [1.1, 1.3, 2.0])
def test_a_robot_whose_wheels_slip_brakes_from_what_it_was_told(slip: float) -> None:
    """In `senses` 40500055 wheels moved a robot 1.3 times as fast as told. Each command was the speed
    that it sensed, less what grip allows in one period, so braking made it faster."""
    change_m_s = 1.5 * DT_S
    lines = np.array([(0.0, 0.0, 0.0, 1.0)], dtype=np.float32)  # no motion to the east
    told = 2.0
    for _ in range(2 * int(2.0 / change_m_s) + 2):
        before, vx, still = told, np.float32(told * slip), np.float32(0.0)
        told, across = map(float, within_grip(
            np.float32(-1.0), still, vx, still, np.float32(told), np.float32(change_m_s), lines, 0, 1
        ))  # fmt: skip
        assert across == 0.0 and told <= max(before - change_m_s / 2, 0.0) + 1e-6
        if told <= 0.0:
            return
    raise AssertionError("it stands by then")


def test_the_solver_keeps_the_speed_that_wheels_without_slip_have() -> None:
    """It falls by what braking allows in one period, also where less is told."""
    robot, change_m_s, kept_m_s = Robot(0.0, 0.0, 0.0, True), BRAKING_M_S2 * DT_S, 0.0
    for goal in [(9.0, 0.0)] * 3 + [(0.0, 0.0)] * 5:
        robot.choose(goal, 0.0)
        kept_m_s = max(hypot(*robot.wanted), kept_m_s - change_m_s)
        assert robot.avoidance._work[TOLD] == pytest.approx(kept_m_s, abs=1e-6)
    assert 0.0 < kept_m_s < SPEED_M_S
