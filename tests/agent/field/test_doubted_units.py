"""A unit that was passed while a push may have begun counts when it is clear that there was none."""

from collections.abc import Callable

import numpy as np
import pytest

from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress

FROM_M, UNIT_M, UNITS, PERIOD_S = 10.0, 15.0, 3, CONTROL_PERIOD_US / S
END_M = FROM_M + UNITS * UNIT_M
ACCELERATION_M_S2 = 1.5


class Row:
    """A robot on a row from west to east, whose body follows each request as fast as it can."""

    def __init__(self) -> None:
        ends = ((FROM_M, 10.0), (END_M, 10.0)), ((FROM_M, 20.0), (END_M, 20.0))
        sections = Section(0, ends[:1], (UNITS,)), Section(1, ends[1:], (UNITS,))
        fences = ((0.0, 0.0), (65.0, 0.0), (65.0, 30.0), (0.0, 30.0))
        field = Field("row", fences, (), (0.0, 0.0), (FROM_M, 10.0), 4.0, 0.2, UNIT_M, sections)
        route = Route(np.zeros((160, 300), dtype=np.bool_), -1.0, -1.0, 0.25)
        self.work = FieldMission(field, route, 0.8, 2.5, ACCELERATION_M_S2)
        self.progress = Progress(self.work.section_units)
        self.x_m, self.y_m, self.vx_m_s, self.vy_m_s, self.now_us = FROM_M - 2.0, 10.0, 0.0, 0.0, 0
        self.counted: list[tuple[int, float, int]] = []  # unit, place east, time
        self.farthest_m = self.back_m = 0.0
        self.finished = False
        self.told_share = 1.0  # of its velocity that it senses

    @property
    def view(self) -> FleetView:
        vx_m_s, vy_m_s = self.told_share * self.vx_m_s, self.told_share * self.vy_m_s
        here = Observation(self.x_m, self.y_m, 0.0, vx_m_s, vy_m_s, sensed_at_us=self.now_us)
        crdt, live = FieldAllocationCRDT(), frozenset({0})
        return FleetView(0, self.now_us, here, crdt, self.progress, live, {}, {})

    def period(self, push_m_s: float = 0.0) -> None:
        """The push moves the body on, beyond what it senses."""
        if self.work.section is None:
            self.work.begin(0, self.view)
        wish = self.work.work(self.view)
        if not wish.tool_on:
            self.work.on_implement_raised()
        self.counted += [(unit, self.x_m, self.now_us) for unit in wish.covered]
        step_m_s = ACCELERATION_M_S2 * PERIOD_S
        self.vx_m_s += max(-step_m_s, min(wish.vx_m_s - self.vx_m_s, step_m_s))
        self.vy_m_s += max(-step_m_s, min(wish.vy_m_s - self.vy_m_s, step_m_s))
        self.x_m += (self.vx_m_s + push_m_s) * PERIOD_S
        self.y_m += self.vy_m_s * PERIOD_S
        self.now_us += CONTROL_PERIOD_US
        self.farthest_m = max(self.farthest_m, self.x_m)
        self.back_m = max(self.back_m, self.farthest_m - self.x_m)
        self.finished = wish.finished

    def until(self, there: Callable[[], bool], push_m_s: float = 0.0) -> None:
        """Drive until then, or until the section is finished."""
        while not self.finished and not there():
            assert self.now_us < 200 * S, self.counted
            self.period(push_m_s)

    @property
    def units(self) -> list[int]:
        return [unit for unit, _, _ in self.counted]


def test_a_robot_that_nobody_pushes_waits_for_nothing() -> None:
    row = Row()
    row.until(lambda: False)
    assert row.units == [0, 1, 2] and row.back_m < 0.01 and not row.work.doubted
    for unit, at_m, _ in row.counted:
        assert at_m - (FROM_M + (unit + 1) * UNIT_M) < 0.15


@pytest.mark.parametrize("end_m", [FROM_M + UNIT_M, END_M])
def test_a_unit_that_was_doubted_in_vain_counts_soon_and_is_not_worked_again(end_m: float) -> None:
    row = Row()
    row.until(lambda: row.x_m > end_m - 0.2)
    before = row.units
    row.until(lambda: row.x_m > end_m, push_m_s=1.4)
    row.until(lambda: bool(row.work.doubted))
    doubted, doubted_at_us = row.work.doubted[0], row.now_us
    assert before == list(range(doubted)) == row.units
    section, view = row.work.field.sections[0], row.view
    left = [unit for leg in row.work._stretches(section, view, last=False) for unit in leg.units]
    assert doubted not in left, "not again while it may count"
    row.until(lambda: doubted in row.units)
    assert row.now_us - doubted_at_us < 1 * S
    row.until(lambda: False)
    assert row.units == [0, 1, 2] and row.back_m < 0.5


def test_l5_a_unit_whose_end_was_passed_by_a_push_is_worked_again_at_once() -> None:
    """Found by `headland chaos`, profile steered, seed 106000090."""
    row = Row()
    end_m = FROM_M + UNIT_M
    row.until(lambda: row.x_m > end_m - 0.3)
    row.until(lambda: row.x_m > end_m + 1.5, push_m_s=1.5)
    assert row.units == []
    row.until(lambda: False)
    assert sorted(row.units) == [0, 1, 2] and row.back_m > UNIT_M - 1.0
    assert row.units.index(0) < row.units.index(2), "before the robot drives on"


def test_a_velocity_that_is_always_too_low_holds_no_units_back() -> None:
    """By 8 %: a wheel that is larger than the driver says."""
    row = Row()
    row.told_share = 0.92
    row.until(lambda: False)
    assert row.units == [0, 1, 2]
    for unit, at_m, _ in row.counted:
        assert at_m - (FROM_M + (unit + 1) * UNIT_M) < 3.0


def test_a_unit_that_was_doubted_counts_for_its_own_section_only() -> None:
    row = Row()
    row.until(lambda: row.x_m > FROM_M + UNIT_M - 0.2)
    row.until(lambda: bool(row.work.doubted), push_m_s=1.4)
    row.work.abandon()
    row.work.begin(1, row.view)
    row.until(lambda: row.now_us > 10 * S)
    assert row.units == []
