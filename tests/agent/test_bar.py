"""The bar of an implement: since where all of it is down, and what it means to be moved by somebody."""

from math import cos, sin

import pytest

from agent.bar import Bar
from agent.config import CONTROL_PERIOD_US

WIDTH_M, SPEED_M_S, STEP_M = 4.0, 2.5, 0.125
EAST = (1.0, 0.0)


def drive(bar: Bar, x_m: float, y_m: float, course_rad: float, steps: int) -> tuple[float, float]:
    for _ in range(steps):
        x_m, y_m = x_m + STEP_M * cos(course_rad), y_m + STEP_M * sin(course_rad)
        bar.draw((x_m, y_m), x_m, EAST)
    return x_m, y_m


def test_who_drives_along_the_line_works_from_where_the_bar_came_down() -> None:
    bar = Bar(WIDTH_M)
    bar.lower((1.0, 0.0))
    drive(bar, 1.0, 0.0, 0.0, 10)
    assert bar.down_from_m == pytest.approx(1.0) and bar.slant_m == pytest.approx(0.0)


@pytest.mark.parametrize("course_rad", [0.1, -0.3, 0.7])
def test_who_comes_from_the_side_leaves_a_corner_of_the_ground(course_rad: float) -> None:
    """Found by `headland chaos`, profile all, seeds 6005 and 6010: a bit at a seam of two sections."""
    bar = Bar(WIDTH_M)
    bar.lower((1.0, 0.0))
    x_m, y_m = drive(bar, 1.0, 0.0, course_rad, 4)
    ahead_m = WIDTH_M / 2 * abs(sin(course_rad))
    assert bar.slant_m == pytest.approx(ahead_m)
    assert bar.down_from_m == pytest.approx(1.0 + ahead_m)
    drive(bar, x_m, y_m, 0.0, 1)
    assert bar.down_from_m == pytest.approx(min(1.0 + ahead_m, x_m)), (
        "straight: from here on at least"
    )
    assert bar.slant_m == pytest.approx(0.0)


def test_nothing_is_worked_before_it_has_moved() -> None:
    bar = Bar(WIDTH_M)
    bar.lower((1.0, 0.0))
    bar.draw((1.01, 0.0), 1.01, EAST)
    assert bar.down_from_m > 1e9 and bar.slant_m == WIDTH_M / 2


@pytest.mark.parametrize(
    ("dx_m", "pushed"), [(STEP_M, False), (0.28, False), (0.3, True), (3.5, True)]
)
def test_a_push_is_told_from_driving(dx_m: float, pushed: bool) -> None:
    """Found by `headland chaos`, profile body, seeds 6008 and 6095: a robot that was pushed 3.5 m along
    its row counted what lay between as worked."""
    bar = Bar(WIDTH_M)
    assert not bar.leaps((0.0, 0.0), 0, SPEED_M_S)
    assert bar.leaps((dx_m, 0.0), CONTROL_PERIOD_US, SPEED_M_S) is pushed
    assert not bar.leaps((dx_m + STEP_M, 0.0), 2 * CONTROL_PERIOD_US, SPEED_M_S)


def test_who_was_late_may_have_driven_further() -> None:
    bar = Bar(WIDTH_M)
    bar.leaps((0.0, 0.0), 0, SPEED_M_S)
    assert not bar.leaps((2.5, 0.0), 1_000_000, SPEED_M_S)
    assert not bar.leaps((2.6, 0.0), 0, SPEED_M_S), "a clock that was set back"
