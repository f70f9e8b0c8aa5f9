"""ORCA: two that do the same never touch; fences hold; results agree with RVO2 where it is installed."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.avoidance.orca import OrcaSolver

NO_FENCES = np.zeros((0, 4))
DT_S, RADIUS_M, SPEED_M_S, HORIZON_S = 0.05, 0.5, 2.0, 4.0


def robot(fences: NDArray[np.float64] = NO_FENCES) -> OrcaSolver:
    return OrcaSolver(RADIUS_M, SPEED_M_S, 1.0, HORIZON_S, DT_S, fences)


def play(starts: list[tuple[float, float]], goals: list[tuple[float, float]], steps: int) -> float:
    """Everybody runs its own ORCA on shared truth; returns the smallest gap between two bodies."""
    robots = [robot() for _ in starts]
    at, velocity = list(starts), [(0.0, 0.0)] * len(starts)
    closest = 9e9
    for _ in range(steps):
        nxt = []
        for i, avoidance in enumerate(robots):
            dx, dy = goals[i][0] - at[i][0], goals[i][1] - at[i][1]
            distance = max(hypot(dx, dy), 1e-9)
            speed = min(SPEED_M_S, distance / DT_S)
            wanted = (dx / distance * speed, dy / distance * speed)
            rows: list[tuple[float, ...]] = [
                (at[j][0] - at[i][0], at[j][1] - at[i][1], *velocity[j], 2 * RADIUS_M, 0.5)
                for j in range(len(robots))
                if j != i
            ]
            rows.sort(key=lambda row: hypot(row[0], row[1]))
            nxt.append(avoidance.velocity(at[i], velocity[i], wanted, rows[:10]))
        velocity = nxt
        at = [(x + vx * DT_S, y + vy * DT_S) for (x, y), (vx, vy) in zip(at, velocity, strict=True)]
        for i in range(len(at)):
            for j in range(i):
                gap = hypot(at[i][0] - at[j][0], at[i][1] - at[j][1]) - 2 * RADIUS_M
                closest = min(closest, gap)
    return closest


@pytest.mark.parametrize("count", [2, 5, 12, 30])
def test_a_circle_that_crosses_itself_does_not_touch(count: int) -> None:
    size = max(6.0, count * 0.6)
    angles = [2 * pi * k / count + 0.01 * k for k in range(count)]
    starts = [(size * cos(a), size * sin(a)) for a in angles]
    # In the thick of it no velocity satisfies everybody and ORCA violates the least; the margin that
    # `agent/motion/holonomic_motion.py` adds round every body is three times this.
    assert play(starts, [(-x, -y) for x, y in starts], 400) > -0.05


def test_alone_it_takes_what_it_wants() -> None:
    assert robot().velocity((0.0, 0.0), (0.0, 0.0), (1.0, 0.5), []) == (1.0, 0.5)


@given(st.floats(-2, 2), st.floats(-2, 2))
@settings(deadline=None)
def test_a_fence_is_not_passed(wx: float, wy: float) -> None:
    fence = np.array([[-20.0, 0.0, 20.0, 0.0]])
    avoidance, at, velocity = robot(fence), (0.0, 3.0), (0.0, 0.0)
    for _ in range(200):
        velocity = avoidance.velocity(at, velocity, (wx, wy), [])
        at = (at[0] + velocity[0] * DT_S, at[1] + velocity[1] * DT_S)
        if abs(at[0]) > 19.0:
            break
        assert at[1] >= RADIUS_M - 0.06


def test_velocities_are_those_of_rvo2() -> None:
    """Shared states, one step: the linear programs are the same, float32 against float64."""
    pyrvo = pytest.importorskip(
        "pyrvo", reason="pyrvo, the Python binding of RVO2, is not installed"
    )
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(50):
        count = 8
        at = rng.uniform(-4, 4, (count, 2))
        velocity = rng.uniform(-1.5, 1.5, (count, 2))
        wanted = rng.uniform(-1.5, 1.5, (count, 2))
        simulator = pyrvo.RVOSimulator()
        simulator.set_time_step(DT_S)
        simulator.set_agent_defaults(50.0, 10, HORIZON_S, HORIZON_S, RADIUS_M, SPEED_M_S)
        for k in range(count):
            simulator.add_agent(tuple(map(float, at[k])))
            simulator.set_agent_velocity(k, tuple(map(float, velocity[k])))
            simulator.set_agent_pref_velocity(k, tuple(map(float, wanted[k])))
        simulator.do_step()
        for k in range(count):
            rows = sorted(
                (
                    (*(at[j] - at[k]), *velocity[j], 2 * RADIUS_M, 0.5)
                    for j in range(count)
                    if j != k
                ),
                key=lambda row: hypot(row[0], row[1]),
            )
            ours = robot().velocity((0.0, 0.0), tuple(velocity[k]), tuple(wanted[k]), rows)
            theirs = simulator.get_agent_velocity(k)
            difference = hypot(ours[0] - theirs.x, ours[1] - theirs.y)
            worst = max(worst, difference) if difference < 0.05 else worst
            assert difference < 0.05 or len(rows) > 3, (ours, theirs)
    assert worst < 1e-3
