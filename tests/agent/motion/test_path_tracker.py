"""Following a polyline: a point mass under the wanted velocity must stay on the line and arrive."""

from math import cos, hypot, radians, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.motion.path_tracker import PathTracker

DT_S = 0.05
coordinate = st.floats(-50, 50)


def drive(
    tracker: PathTracker, x_m: float, y_m: float, seconds: float
) -> tuple[float, float, float]:
    """Simulate an ideal holonomic body; returns the end and the largest distance from the line."""
    worst_m = 0.0
    for _ in range(round(seconds / DT_S)):
        tracker.locate(x_m, y_m)
        if tracker.arrived:
            break
        vx_m_s, vy_m_s = tracker.velocity(x_m, y_m)
        assert hypot(vx_m_s, vy_m_s) <= tracker.speed_m_s + 1e-9
        x_m, y_m = x_m + vx_m_s * DT_S, y_m + vy_m_s * DT_S
        worst_m = max(worst_m, abs(tracker.off_m))
    return x_m, y_m, worst_m


def test_a_straight_line_is_driven_straight() -> None:
    tracker = PathTracker([(0.0, 0.0), (40.0, 0.0)], 2.0, 1.0)
    x_m, y_m, worst_m = drive(tracker, 0.0, 0.0, 30.0)
    assert tracker.arrived and hypot(x_m - 40.0, y_m) < 0.3 and worst_m < 1e-6


def test_an_offset_is_closed() -> None:
    tracker = PathTracker([(0.0, 0.0), (40.0, 0.0)], 2.0, 1.0)
    drive(tracker, 0.0, 0.8, 3.0)
    assert abs(tracker.off_m) < 0.05


@given(st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=6), coordinate, coordinate)
@settings(deadline=None)
def test_it_arrives_from_anywhere(
    points: list[tuple[float, float]], x_m: float, y_m: float
) -> None:
    tracker = PathTracker(points, 2.0, 1.0)
    x_m, y_m, _ = drive(tracker, x_m, y_m, 900.0)
    assert tracker.arrived, f"stands at {x_m:.2f}, {y_m:.2f} of {points}"
    assert hypot(x_m - points[-1][0], y_m - points[-1][1]) < 0.5


@pytest.mark.parametrize("angle", [0.5, 1.0, 1.57, 3.0])
def test_it_slows_down_for_corners(angle: float) -> None:
    corner = [(0.0, 0.0), (20.0, 0.0), (20.0 + 20.0 * cos(angle), 20.0 * sin(angle))]
    tracker = PathTracker(corner, 3.0, 1.0)
    _, _, worst_m = drive(tracker, 0.0, 0.0, 120.0)
    assert tracker.arrived and worst_m < 0.6


def test_before_its_beginning_and_after_its_end_a_line_is_as_far_as_its_ends() -> None:
    """An implement was lowered 3.6 m before its robot's section, in another's (found by chaos)."""
    tracker = PathTracker([(0.0, 0.0), (10.0, 0.0)], 2.5, 1.0)
    for x_m, y_m, gap_m in ((-3.0, 0.4, 3.026), (5.0, 0.4, 0.4), (12.0, 0.0, 2.0)):
        tracker.locate(x_m, y_m)
        assert abs(tracker.gap_m - gap_m) < 0.001
        assert abs(tracker.off_m) <= 0.4


@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 90.0, 120.0, 150.0])
@pytest.mark.parametrize("gain_m_s2", [1.5, 2.0, 3.0])
def test_a_body_with_inertia_stays_near_the_line_behind_a_corner(
    angle_deg: float, gain_m_s2: float
) -> None:
    """It gained speed along the line before its motion across had ended, and passed over the line
    by more than half the overlap: the unit behind the corner had to be worked again.
    """
    angle_rad = radians(angle_deg)
    points = [(0.0, 0.0), (20.0, 0.0), (20.0 + 20.0 * cos(angle_rad), 20.0 * sin(angle_rad))]
    tracker = PathTracker(points, 3.0, 1.4)
    x_m, y_m, vx_m_s, vy_m_s, worst_m = 0.0, 0.0, 0.0, 0.0, 0.0
    step_m_s = gain_m_s2 * DT_S
    for _ in range(round(60.0 / DT_S)):
        tracker.locate(x_m, y_m)
        if tracker.arrived:
            break
        ax, ay = tracker.velocity(x_m, y_m, (vx_m_s, vy_m_s))
        dx, dy = ax - vx_m_s, ay - vy_m_s
        share = min(1.0, step_m_s / max(hypot(dx, dy), 1e-9))
        vx_m_s, vy_m_s = vx_m_s + share * dx, vy_m_s + share * dy
        x_m, y_m = x_m + vx_m_s * DT_S, y_m + vy_m_s * DT_S
        worst_m = max(worst_m, abs(tracker.off_m))
    assert tracker.arrived and worst_m < 0.1


@pytest.mark.parametrize("angle", [0.3, 1.0, 1.57, 2.0, 2.8])
def test_a_body_just_before_a_corner_is_not_beside_its_line(angle: float) -> None:
    """Found by chaos in a drawn field, mecanum, overlap 0.1 m: at a tip the segment behind the corner
    counted from 6 cm before it, so units there were 0.05 to 0.06 m beside their line, and were worked for
    good."""
    tracker = PathTracker([(0.0, 0.0), (20.0, 0.0), (20.0 + cos(angle), sin(angle))], 1.0, 1.0)
    for k in range(2001):
        tracker.locate(k / 100.0, 0.0)
        assert tracker.aside_m < 1e-9, f"{k} cm from the beginning"
    tracker.locate(20.0 - 0.03 * sin(angle / 2), 0.03 * cos(angle / 2))
    assert tracker.aside_m == pytest.approx(0.03 * cos(angle / 2)), "inside of the corner"
