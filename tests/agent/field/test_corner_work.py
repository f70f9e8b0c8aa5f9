"""Corners: the bar swings round them with the implement down, or what begins there is worked again."""

from math import hypot

import numpy as np
from shapely.geometry import box

from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.interface.config import CONTROL_PERIOD_US
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.motion.implement_clearance import LEAD_M
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress
from sim.world.coverage_truth import coverage, sample_points
from sim.world.ground_truth import Track

CORNER = (26.0, 2.0)  # where the second unit ends and the third begins
WIDTH_M, OVERLAP_M = 4.0, 0.2
NEAR_M = 0.1  # a control period at full speed is 0.125 m, but corners are turned slowly
SWATH = ((2.0, 2.0), CORNER, (26.0, 26.0))


def _field() -> Field:
    section = Section(0, (SWATH,), (4,))
    fences = ((0.0, 0.0), (28.0, 0.0), (28.0, 28.0), (0.0, 28.0))
    return Field("corner", fences, (), (0.0, 0.0), (2.0, 2.0), WIDTH_M, OVERLAP_M, 12.0, (section,))


def _worked(lifted_at: tuple[float, float] | None) -> tuple[list[int], float]:
    """Units in the order in which they were covered, and the area left out about the corner, in m2.

    `lifted_at`: on reaching this place for the first time the robot stands for half a second,
    implement up.
    """
    field = _field()
    route = Route(np.zeros((120, 120), dtype=np.bool_), -1.0, -1.0, 0.25)
    work = FieldMission(field, route, 0.8, 2.5, 1.5)
    progress, track = Progress(work.section_units), Track()
    x_m, y_m, now_us, stands = 2.0, 2.0, 0, 0
    covered: list[int] = []
    while len(covered) < 4 and now_us < 120_000_000:
        here = Observation(x_m, y_m, 0.0, 0.0, 0.0)
        alone = frozenset({0})
        view = FleetView(0, now_us, here, FieldAllocationCRDT(), progress, alone, {}, {})
        if work.section is None:
            work.begin(0, view)
        wish = work.work(view)
        for unit in wish.covered:
            progress.cover(0, unit)
        if lifted_at is not None and hypot(x_m - lifted_at[0], y_m - lifted_at[1]) < NEAR_M:
            lifted_at, stands = None, 10
        covered += [unit for unit in wish.covered if unit not in covered]
        tool_on = wish.tool_on and not stands
        if not tool_on:
            work.on_implement_raised()
        track.add(now_us, x_m, y_m, tool_on)
        if stands:
            stands -= 1
        else:
            x_m += wish.vx_m_s * CONTROL_PERIOD_US / 1e6
            y_m += wish.vy_m_s * CONTROL_PERIOD_US / 1e6
        now_us += CONTROL_PERIOD_US
    raster = sample_points(box(0.0, 0.0, 28.0, 28.0), WIDTH_M, OVERLAP_M, 0.1)
    left = coverage(raster, {0: track}, WIDTH_M).uncovered
    missed = [at for at in left if hypot(at[0] - CORNER[0], at[1] - CORNER[1]) < WIDTH_M / 2]
    return covered, len(missed) * 0.1**2


def test_a_corner_is_worked_in_passing() -> None:
    covered, missed_m2 = _worked(None)
    assert covered == [0, 1, 2, 3] and missed_m2 < 0.05


def test_who_lifts_at_a_corner_between_two_units_swings_round_it_again() -> None:
    """Chaos, profile all, seed 1: both units counted, and what lies beyond the corner was left out."""
    covered, missed_m2 = _worked(CORNER)
    assert covered == [0, 1, 2, 3], "what ends at the corner is worked once more, at once"
    assert missed_m2 < 0.05


def test_who_lifts_elsewhere_works_the_unit_under_way_again() -> None:
    covered, missed_m2 = _worked((20.05, 2.0))
    assert covered == [0, 1, 2, 3] and missed_m2 < 0.05


def test_a_stretch_follows_the_swath_round_a_corner_at_its_end() -> None:
    section = _field().section(0)
    before, after = section.leads(2, 3, LEAD_M)
    assert np.allclose(before, ((CORNER[0] - LEAD_M, CORNER[1]), CORNER)) and after == ()
    before, after = section.leads(0, 1, LEAD_M)
    assert before == () and np.allclose(after, (CORNER, (CORNER[0], CORNER[1] + LEAD_M)))
