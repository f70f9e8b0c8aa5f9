"""A body that cannot take a velocity at once brakes before fences first."""

from math import cos, hypot, pi, sin
from random import Random

import numpy as np
import pytest

from agent.avoidance.fence_braking import braking_first

RADIUS_M, ACCELERATION_M_S2, PERIOD_S = 0.9, 1.5, 0.05


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
            wx, wy = braking_first(x, y, vx, vy, wx, wy, fences, RADIUS_M, ACCELERATION_M_S2)
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
    away = braking_first(0.0, 0.0, -1.0, 0.5, 0.3, 2.0, fences, RADIUS_M, ACCELERATION_M_S2)
    assert away == (0.3, 2.0)
    far = braking_first(-50.0, 0.0, 1.0, 0.0, -1.0, 0.5, fences, RADIUS_M, ACCELERATION_M_S2)
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
            cx, _ = braking_first(at_m, 0.0, vx, vy, wx, wy, fences, RADIUS_M, ACCELERATION_M_S2)
            assert cx <= max(wx, vx) + 1e-9
            assert vx - cx >= min(vx - wx, 0.5 * (vx - wx)) - 1e-9, "it brakes nearly as was chosen"
