"""A body that cannot take a velocity at once brakes before fences first."""

from math import cos, hypot, pi, sin
from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.avoidance.fence_braking import braking_first

RADIUS_M, ACCELERATION_M_S2, PERIOD_S = 0.9, 1.5, 0.05


def told(
    x_m: float, course: tuple[float, float], wanted: tuple[float, float],
    fences: NDArray[np.float64], wheels: tuple[float, float] | None = None,
) -> tuple[float, float]:  # fmt: skip
    """The command of a body at (`x_m`, 0) that moves with `course`. `wheels`: the velocity of its wheels,
    if they slip."""
    return braking_first(
        x_m, 0.0, *course, *wanted, *(wheels or course), fences, RADIUS_M, ACCELERATION_M_S2
    )


def nearest_m(course: tuple[float, float], wanted: tuple[float, float], first: bool) -> float:
    """The least gap between a body at (0, 0) and the fence x = 2.2, while it takes the wanted
    velocity. `first`: braking comes first."""
    fences = np.array([(2.2, -50.0, 2.2, 50.0)])
    x = y = 0.0
    vx, vy = course
    least_m = 2.2
    for _ in range(60):
        wx, wy = wanted
        if first:
            wx, wy = braking_first(
                x, y, vx, vy, wx, wy, vx, vy, fences, RADIUS_M, ACCELERATION_M_S2
            )
        dvx, dvy = wx - vx, wy - vy
        share = min(1.0, ACCELERATION_M_S2 * PERIOD_S / max(hypot(dvx, dvy), 1e-9))
        vx, vy = vx + share * dvx, vy + share * dvy
        x, y = x + vx * PERIOD_S, y + vy * PERIOD_S
        least_m = min(least_m, 2.2 - x)
    return least_m


def test_m26_a_large_change_along_a_fence_leaves_enough_for_braking() -> None:
    """Found in a field of 8 x 8 m with two robots, seed 1: told to drive along the fence with 2.4
    m/s, a robot closed in on it for a second, and touched it."""
    assert nearest_m((1.5, 0.0), (0.0, -2.4), first=False) < RADIUS_M
    assert nearest_m((1.5, 0.0), (0.0, -2.4), first=True) >= RADIUS_M - 0.01


@pytest.mark.parametrize("seed", range(50))
def test_what_can_be_braked_is_braked(seed: int) -> None:
    draw = Random(seed)
    # Half of the acceleration would be enough, as ORCA assumes.
    closing_m_s = draw.uniform(0.0, (2 * 0.5 * ACCELERATION_M_S2 * (2.2 - RADIUS_M)) ** 0.5)
    course = closing_m_s, draw.uniform(-2.0, 2.0)
    wanted = draw.uniform(-1.0, 0.0), draw.uniform(-2.5, 2.5)
    assert nearest_m(course, wanted, first=True) >= RADIUS_M - 0.02, (seed, course, wanted)


def test_what_does_not_concern_a_fence_stays() -> None:
    fences = np.array([(2.2, -50.0, 2.2, 50.0)])
    away = told(0.0, (-1.0, 0.5), (0.3, 2.0), fences)
    assert away == (0.3, 2.0)
    far = told(-50.0, (1.0, 0.0), (-1.0, 0.5), fences)
    assert far == (-1.0, 0.5)


@pytest.mark.parametrize("count", [24, 180, 720])
def test_short_edges_of_a_round_outline_do_not_undo_the_braking(count: int) -> None:
    """Robots touched the fence of a circle of 720 points: each edge cut what braked before the others."""
    middle_m, ring = 20.0, np.linspace(0.0, 2 * pi, count + 1)
    x, y = middle_m * np.cos(ring), middle_m * np.sin(ring)
    fences = np.column_stack((x[:-1], y[:-1], x[1:], y[1:]))
    for course_rad in np.linspace(-1.2, 1.2, 13):
        at_m, vx, vy = 17.6, 1.4 * cos(course_rad), 1.4 * sin(course_rad)
        for wx, wy in ((-1.5, 1.5), (0.5, -1.4), (0.0, 2.0)):
            cx, _ = told(at_m, (vx, vy), (wx, wy), fences)
            assert cx <= max(wx, vx) + 1e-9
            assert vx - cx >= min(vx - wx, 0.5 * (vx - wx)) - 1e-9, "it brakes nearly as was chosen"


def test_m27_a_command_does_not_follow_what_slip_adds_along_a_fence() -> None:
    """Found by `senses` 115900022: each command was the speed at which slip moved the body, so a robot
    whose limit is 2.5 m/s was told to drive 4.0 m/s beside a fence, and leaned on it for 0.3 s."""
    fences = np.array([(2.2, -50.0, 2.2, 50.0)])
    speed_m_s = 2.3
    for _ in range(40):
        slipping = 0.9, 1.15 * speed_m_s
        _, along_m_s = told(1.1, slipping, (-0.2, 2.3), fences, (0.1, speed_m_s))
        assert along_m_s <= 2.3 + 1e-9
        speed_m_s = along_m_s
    # Also where it moves the other way along the fence.
    _, back_m_s = told(1.1, (0.9, -3.0), (-0.2, 1.0), fences, (0.1, -2.4))
    assert back_m_s >= -2.4 - 1e-9


def test_m27_a_body_that_slips_towards_a_fence_is_told_to_make_up_for_it() -> None:
    fences = np.array([(2.2, -50.0, 2.2, 50.0)])
    away_m_s, _ = told(1.2, (0.9, 0.0), (-0.2, 0.0), fences, (-0.1, 0.0))
    assert away_m_s == pytest.approx(-0.2 - 1.0)
    # Far enough away half of the acceleration stops it, and it is told what was chosen.
    assert told(-2.0, (0.9, 0.0), (-0.2, 0.0), fences, (-0.1, 0.0)) == (-0.2, 0.0)
