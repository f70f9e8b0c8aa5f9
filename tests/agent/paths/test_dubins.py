"""Dubins words end where they should, and the shortest is as short as it can be."""

from math import hypot, pi, remainder

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.paths.dubins import WORDS, shortest_m, soonest_for_s, step, words

pose = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-pi, pi))


@settings(deadline=None)  # the first call compiles
@given(pose, pose, st.floats(0.5, 6.0))
def test_every_word_ends_at_the_goal(
    start: tuple[float, float, float], goal: tuple[float, float, float], radius_m: float
) -> None:
    lengths, curvatures = np.empty((WORDS, 3)), np.empty((WORDS, 3))
    words(*start, *goal, radius_m, lengths, curvatures)
    found = 0
    for word in range(WORDS):
        if not np.isfinite(lengths[word]).all():
            continue
        found += 1
        x, y, heading = start
        for length, curvature in zip(lengths[word], curvatures[word], strict=True):
            assert length >= 0.0
            x, y, heading = step(x, y, heading, curvature, length)
        assert hypot(x - goal[0], y - goal[1]) < 1e-4, word
        assert abs(remainder(heading - goal[2], 2 * pi)) < 1e-4, word
    assert found >= 2
    assert shortest_m(start, goal, radius_m) >= hypot(goal[0] - start[0], goal[1] - start[1]) - 1e-6


@settings(deadline=None)
@given(pose, st.floats(0.5, 6.0), st.sampled_from(["L", "R", "LR", "RL", "LS", "SR"]), st.data())
def test_a_goal_at_the_end_of_an_arc_is_no_circle_further(
    start: tuple[float, float, float], radius_m: float, pieces: str, data: st.DataObject
) -> None:
    """A straight piece of no length had a direction of rounding noise, and an arc became a circle."""
    goal, way_m = start, 0.0
    for piece in pieces:
        length_m = radius_m * data.draw(st.floats(0.01, 3.0 if len(pieces) > 1 else 6.0))
        curvature = {"L": 1.0, "S": 0.0, "R": -1.0}[piece] / radius_m
        goal = step(*goal, curvature, length_m)
        way_m += length_m
    assert shortest_m(start, goal, radius_m) <= way_m + 1e-4


@pytest.mark.slow
def test_known_ways() -> None:
    assert shortest_m((0, 0, 0), (10, 0, 0), 2.0) == pytest.approx(10.0)
    u_turn = shortest_m((0, 0, 0), (0, 4, pi), 2.0)
    assert u_turn == pytest.approx(2 * pi), "a half circle"
    bulb = shortest_m((0, 0, 0), (0, 1, pi), 2.0)
    assert bulb > 3 * pi, "rows nearer than two radii need a bulb"


@settings(deadline=None, max_examples=30)
@given(pose, pose, st.floats(0.5, 6.0))
def test_the_soonest_word_at_one_speed_is_the_shortest(
    start: tuple[float, float, float], goal: tuple[float, float, float], radius_m: float
) -> None:
    for_s = soonest_for_s(np.array([start]), np.array([goal]), radius_m, 2.0, 2.0, 0.0)
    assert for_s.shape == (1, 1)
    assert for_s[0, 0] == pytest.approx(shortest_m(start, goal, radius_m) / 2.0)


def test_a_half_circle_takes_its_length_and_the_turning_of_the_wheels() -> None:
    starts, goals = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 4.0, pi], [10.0, 0.0, 0.0]])
    for_s = soonest_for_s(starts, goals, 2.0, 2.5, 1.0, 0.7)
    assert for_s[0, 0] == pytest.approx(2 * pi + 0.7), "one arc"
    assert for_s[0, 1] == pytest.approx(4.0), "straight on"
