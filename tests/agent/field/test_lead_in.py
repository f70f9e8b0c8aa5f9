"""Lead-ins: both ends of the bar begin the first unit in time, however the robot arrives."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from shapely.geometry import box

from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.motion.implement_clearance import LEAD_M
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress
from sim.world.coverage_truth import coverage, sample_points
from sim.world.ground_truth import Track

WIDTH_M, OVERLAP_M = 4.0, 0.2
BEGIN, END = (10.0, 10.0), (40.0, 10.0)
ACCELERATION_M_S2, PERIOD_S = 1.5, CONTROL_PERIOD_US / S


def _left_m2(course_rad: float, speed_m_s: float, aside_m: float) -> float:
    """The area that is left of the first unit by a robot that arrives at the lead-in with a
    velocity, and to the left of the line."""
    section = Section(0, ((BEGIN, END),), (2,))
    fences = ((0.0, 0.0), (50.0, 0.0), (50.0, 20.0), (0.0, 20.0))
    field = Field("line", fences, (), (0.0, 0.0), BEGIN, WIDTH_M, OVERLAP_M, 15.0, (section,))
    route = Route(np.zeros((120, 240), dtype=np.bool_), -1.0, -1.0, 0.25)
    work = FieldMission(field, route, 0.8, 2.5, ACCELERATION_M_S2)
    progress, track, now_us = Progress(work.section_units), Track(), 0
    x_m, y_m = BEGIN[0] - LEAD_M, BEGIN[1] + aside_m
    vx_m_s, vy_m_s = speed_m_s * cos(course_rad), speed_m_s * sin(course_rad)
    while 0 not in work.worked:
        assert now_us < 120 * S, "the robot waits for ever"
        here = Observation(x_m, y_m, 0.0, vx_m_s, vy_m_s)
        view = FleetView(0, now_us, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
        if work.section is None:
            work.begin(0, view)
        wish = work.work(view)
        if not wish.tool_on:
            work.on_implement_raised()
        track.add(now_us, x_m, y_m, wish.tool_on)
        dvx_m_s, dvy_m_s = wish.vx_m_s - vx_m_s, wish.vy_m_s - vy_m_s
        share = min(1.0, ACCELERATION_M_S2 * PERIOD_S / max(hypot(dvx_m_s, dvy_m_s), 1e-9))
        vx_m_s, vy_m_s = vx_m_s + share * dvx_m_s, vy_m_s + share * dvy_m_s
        x_m, y_m = x_m + vx_m_s * PERIOD_S, y_m + vy_m_s * PERIOD_S
        now_us += CONTROL_PERIOD_US
    raster = sample_points(box(0.0, 0.0, 50.0, 20.0), WIDTH_M, OVERLAP_M, 0.05)
    cells = coverage(raster, {0: track}, WIDTH_M).uncovered
    beyond_m, off_m = cells[:, 0] - BEGIN[0], np.abs(cells[:, 1] - BEGIN[1])
    inside = (beyond_m > 0.0) & (beyond_m < 2.0) & (off_m < (WIDTH_M - OVERLAP_M) / 2)
    return float(np.count_nonzero(inside)) * raster.cell_m**2


@pytest.mark.parametrize("aside_m", [-0.15, -0.06, 0.0, 0.06, 0.15])
@pytest.mark.parametrize("course_rad", [k * pi / 4 for k in range(8)])
@pytest.mark.parametrize("speed_m_s", [0.1, 0.5, 1.0])
def test_l5_a_robot_that_drifts_sideways_begins_its_first_unit_with_both_ends(
    course_rad: float, speed_m_s: float, aside_m: float
) -> None:
    """Found by `headland chaos`, profiles stop 940029, bus 960027 and body 960024: two robots began
    sections at one boundary, both still drifting, and 0.13 m2 between them were left."""
    left_m2 = _left_m2(course_rad, speed_m_s, aside_m)
    assert left_m2 < 0.04, (course_rad, speed_m_s, aside_m)
