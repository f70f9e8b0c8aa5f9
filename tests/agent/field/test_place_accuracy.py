"""A unit counts only if it was worked even where the place was wrong by its accuracy."""

import numpy as np
import pytest

from agent.field.field_map import Field, Section
from agent.field.field_mission import ACCURACY_SHARE, FieldMission
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.motion.implement_clearance import LEAD_M
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress

WIDTH_M, OVERLAP_M, ASIDE_M = 4.0, 0.2, 0.04
BEGIN, END = (10.0, 10.0), (40.0, 10.0)


def counted(accuracy_m: float) -> set[int]:
    """The units that count for a robot that drives straight on, `ASIDE_M` beside its line."""
    section = Section(0, ((BEGIN, END),), (2,))
    fences = ((0.0, 0.0), (50.0, 0.0), (50.0, 20.0), (0.0, 20.0))
    field = Field("line", fences, (), (0.0, 0.0), BEGIN, WIDTH_M, OVERLAP_M, 15.0, (section,))
    route = Route(np.zeros((120, 240), dtype=np.bool_), -1.0, -1.0, 0.25)
    work, units = FieldMission(field, route, 0.8, 2.5, 1.5), set[int]()
    assert work.position_accuracy_max_m == ACCURACY_SHARE * OVERLAP_M / 2
    progress = Progress(work.section_units)
    for period in range(40 * S // CONTROL_PERIOD_US):
        x_m = BEGIN[0] - LEAD_M + period * 0.05
        here = Observation(x_m, BEGIN[1] + ASIDE_M, 0.0, 1.0, 0.0, position_accuracy_m=accuracy_m)
        now_us = period * CONTROL_PERIOD_US
        view = FleetView(0, now_us, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
        if work.section is None:
            work.begin(0, view)
        units.update(work.work(view).covered)
        if x_m > END[0] + LEAD_M:
            break
    return units


@pytest.mark.parametrize(("accuracy_m", "units"), [(0.0, {0, 1}), (0.05, {0, 1}), (0.07, set())])
def test_a_unit_counts_where_the_accuracy_allows(accuracy_m: float, units: set[int]) -> None:
    assert counted(accuracy_m) == units
