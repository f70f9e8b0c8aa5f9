"""The bound of what splitting last sections gains, on tracks whose splits are known."""

import pytest

from agent.interface.config import S
from sim.world.ground_truth import TrackPoint
from tools.bench.last_sections import BEGIN_S, ideal_split


def works(begin_s: int, end_s: int, y_m: float) -> list[TrackPoint]:
    """A robot that works eastwards at 2 m/s from 0 m on."""
    return [(t * S, 2.0 * (t - begin_s), y_m, True) for t in range(begin_s, end_s + 1)]


def test_a_robot_that_ends_early_takes_half_of_what_is_left() -> None:
    # Robot 0 ends at 20 m after 10 s, robot 1 at 200 m after 100 s: a way of 72 s at 2.5 m/s.
    found = ideal_split({0: works(0, 10, 0.0), 1: works(0, 100, 0.0)}, 2.5)
    assert (found.end_s, found.mean_end_s, found.splits) == (100.0, 55.0, 1)
    assert found.split_end_s == pytest.approx((10 + 100 + BEGIN_S + 72) / 2)


def test_a_fleet_that_ends_together_gains_nothing() -> None:
    found = ideal_split({k: works(0, 30, 4.0 * k) for k in range(3)}, 2.5)
    assert found.split_end_s == found.end_s == 30.0 and found.splits == 0


def test_a_robot_that_is_too_far_away_stays() -> None:
    found = ideal_split({0: works(0, 10, 0.0), 1: works(0, 40, 200.0)}, 2.5)
    assert found.split_end_s == 40.0 and found.splits == 0


def test_robots_that_never_worked_are_left_out() -> None:
    stands = [(0, 0.0, 0.0, False), (40 * S, 0.0, 0.0, False)]
    assert ideal_split({0: stands}, 2.5).end_s == 0.0
    assert ideal_split({0: stands, 1: works(0, 40, 0.0)}, 2.5).mean_end_s == 40.0
