"""Echoes that no map explains, beside robots that are received."""

from math import cos, dist, inf, pi

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.config import NEIGHBOURS_MAX
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.motion.unexplained_echoes import THIN_MAX_M, thinned

RAYS = 720
PLACE = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


def before_a_wall(at_m: float, half_rad: float) -> tuple[float, ...]:
    """The ranges of a robot that looks east at a box with a straight side."""
    turns = [(k * 2 * pi / RAYS + pi) % (2 * pi) - pi for k in range(RAYS)]
    return tuple(at_m / cos(turn) if abs(turn) < half_rad else inf for turn in turns)


def test_a_box_in_many_rays_hides_no_robot() -> None:
    """A sensor of 720 rays saw a box as a hundred echoes, and ORCA took the ten nearest of them alone."""
    motion = HolonomicMotion(0, BodyLimits(0.35, 0.8, 1.0), np.empty((0, 4)), looks=True)
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, before_a_wall(0.6, 0.6), sensed_at_us=0)
    behind = (-1.9, 0.0, 0.5, 0.0, 0.8, 0.5, 0.0)
    rows = motion._look(here, [behind])
    assert len(motion.strange) > 100 and len(rows) <= NEIGHBOURS_MAX
    assert behind in rows
    sides_m = [row[1] for row in rows if row is not behind]
    assert min(sides_m) < -0.2 and max(sides_m) > 0.2, "both ends of the box count"


@given(st.lists(PLACE, max_size=60), st.integers(1, 10))
def test_each_echo_that_is_left_out_is_near_one_that_counts(
    points: list[tuple[float, float]], most: int
) -> None:
    kept = thinned(points, most)
    assert kept == points if len(points) <= most else set(kept) <= set(points)
    for point in points:
        assert min(dist(point, each) for each in kept) <= THIN_MAX_M
