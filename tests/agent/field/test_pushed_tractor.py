"""What a tractor counts as worked when it is pushed along its row, and after its implement was up."""

from collections.abc import Callable
from math import copysign, cos, hypot, sin

import numpy as np
import pytest

from agent.field.field_map import Field, Section
from agent.field.tractor_mission import TractorMission
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.motion.tractor_tracker import SteeringLimits
from agent.paths.route import Route
from agent.paths.tractor_route import TurnRoute
from crdt import FieldAllocationCRDT, Progress

WIDTH_M, OVERLAP_M, UNIT_M, PERIOD_S = 4.0, 0.2, 5.0, CONTROL_PERIOD_US / S
ROWS = ((20.0, 20.0), (50.0, 20.0)), ((50.0, 40.0), (20.0, 40.0))
UNITS = 6  # of each row
FENCES = ((0.0, 0.0), (70.0, 0.0), (70.0, 60.0), (0.0, 60.0))
ENDS_AT_US = 300 * S
STEP_M = 2.5 * PERIOD_S
ASIDE_M = 0.09  # a row counts up to 0.1 m beside it
Happens = Callable[[float, float, int], bool]  # at a place, x and y in metres, and a time


def never(x_m: float, y_m: float, now_us: int) -> bool:
    """Nothing happens."""
    return False


def worked(pushed: Happens = never, raised: Happens = never, turned_rad: float = 0.0) -> list[int]:
    """The units of two rows in the order in which a tractor alone counts them.

    Its body follows each request exactly. While `pushed`, people push it on at 1 m/s along its course.
    While `raised`, its implement is up. `turned_rad`: by which it is turned there in the end, a little
    beside the row, towards which it then drives.
    """
    section = Section(0, ROWS, (UNITS, UNITS))
    field = Field(
        "rows", FENCES, (), (0.0, 0.0), ROWS[0][0], WIDTH_M, OVERLAP_M, UNIT_M, (section,)
    )
    free = np.zeros((320, 320), dtype=np.bool_)
    route, turns = Route(free, -5.0, -5.0, 0.25), TurnRoute(free, -5.0, -5.0, 0.25, 2.0)
    work = TractorMission(field, route, turns, 0.8, SteeringLimits(2.5, 1.5, 0.67))
    progress, order, now_us = Progress(work.section_units), list[int](), 0
    x_m, y_m, heading_rad, vx_m_s, vy_m_s = 17.0, 20.0, 0.0, 0.0, 0.0
    while True:
        assert now_us < ENDS_AT_US, order
        here = Observation(x_m, y_m, heading_rad, vx_m_s, vy_m_s, sensed_at_us=now_us)
        view = FleetView(0, now_us, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
        if work.section is None:
            work.begin(0, view)
        if raised(x_m, y_m, now_us):
            work.on_implement_raised()
            if turned_rad and not raised(x_m + STEP_M, y_m, now_us):
                y_m, heading_rad, turned_rad = y_m - copysign(ASIDE_M, turned_rad), turned_rad, 0.0
                continue
        wish = work.work(view)
        order += wish.covered
        if wish.finished:
            return order
        vx_m_s, vy_m_s = wish.vx_m_s, wish.vy_m_s
        push_m = PERIOD_S if pushed(x_m, y_m, now_us) and hypot(vx_m_s, vy_m_s) > 0.0 else 0.0
        x_m += vx_m_s * PERIOD_S + push_m * cos(heading_rad)
        y_m += vy_m_s * PERIOD_S + push_m * sin(heading_rad)
        heading_rad += wish.turn_rad_s * PERIOD_S
        now_us += CONTROL_PERIOD_US


def test_a_tractor_alone_works_its_rows_one_after_the_other() -> None:
    assert worked() == [*range(UNITS), *range(UNITS, 2 * UNITS)]


@pytest.mark.parametrize("from_m", [26.0, 29.6, 31.5, 34.8, 37.0])
def test_l5_a_tractor_that_is_pushed_along_its_row_works_that_ground_again(from_m: float) -> None:
    """Three tractors in `small` that were pushed 34 times, slower than their wheels drive, left 50 m2."""

    def pushed(x_m: float, y_m: float, now_us: int) -> bool:
        return now_us < 20 * S and from_m <= x_m < from_m + 2.5

    order = worked(pushed)
    unit = int((from_m - ROWS[0][0][0]) // UNIT_M)
    assert order.index(unit) > order.index(2 * UNITS - 1), "not before the other row"
    assert sorted(order) == list(range(2 * UNITS))


def test_units_of_the_next_row_count_after_the_implement_was_up_in_this_one() -> None:
    """A tractor kept the place up to which its implement was up. So in its next row, nothing counted up
    to there, and it was worked twice."""

    def raised(x_m: float, y_m: float, now_us: int) -> bool:
        return now_us < 20 * S and 41.0 <= x_m < 42.0

    order = worked(raised=raised)
    assert order == [0, 1, 2, 3, 5, *range(UNITS, 2 * UNITS), 4]


@pytest.mark.parametrize("turned_rad", [0.2, -0.2])
def test_l5_a_bar_that_comes_down_aslant_has_not_worked_the_beginning_of_its_unit(
    turned_rad: float,
) -> None:
    """Found by `steered` 115900003: the implement came down on the first centimetre of a unit, 0.4 m of
    that were left beside one end of the bar, and the unit counted."""

    def raised(x_m: float, y_m: float, now_us: int) -> bool:
        return now_us < 20 * S and 33.0 <= x_m < 34.9

    order = worked(raised=raised, turned_rad=turned_rad)
    assert order.index(3) > order.index(2 * UNITS - 1), order
    assert sorted(order) == list(range(2 * UNITS))


def test_the_units_of_a_steered_body_begin_where_those_of_its_section_do() -> None:
    """They were taken to begin up to 0.3 m further on, as on ways with a lead-in, which it has not."""

    def raised(x_m: float, y_m: float, now_us: int) -> bool:
        return now_us < 20 * S and 24.0 <= x_m < 25.05

    order = worked(raised=raised)
    assert order.index(1) > order.index(2 * UNITS - 1), order
