"""Fields in parts: bodies fit through no passage between them, so robots work the part they are in."""

from pathlib import Path

import pytest
from shapely.geometry import LineString, Polygon, box

from agent.field.field_plan import FieldPlan, FieldValues, divided
from agent.field.section_choice import SectionChooser
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.interface.vehicle import Vehicle
from crdt import FieldAllocationCRDT, Progress
from sim.runs.field_run import FieldRun
from sim.runs.work_plan import plan_work
from sim.scenarios.field_setup import FieldSetup
from tests.sim.drawn_fields import scenario

BODY = Vehicle(radius_m=0.8)


def dumbbell(passage_m: float) -> Polygon:
    """Two fields and a passage of 12 m between them."""
    passage = box(29.0, 3.0, 41.0, 3.0 + passage_m)
    return box(0.0, 0.0, 30.0, 20.0) | passage | box(40.0, 0.0, 60.0, 20.0)


def ring(polygon: Polygon) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in polygon.exterior.coords[:-1]]


@pytest.mark.parametrize("drive", ["mecanum", pytest.param("ackermann", marks=pytest.mark.slow)])
def test_a_run_ends_when_all_is_worked_that_robots_can_reach(drive: str, tmp_path: Path) -> None:
    """Robots claimed the sections beyond the passage in turn, and stood at the fence until the limit."""
    made = scenario(tmp_path, ring(dumbbell(1.5)), 2, 1, time_limit_s=400.0, drive=drive)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.finished and outcome.reached > 0.999 and outcome.simulated_s < 350.0, outcome
    assert any("passages" in part.why for part in outcome.unreached)


def test_a_plan_leaves_out_what_no_robot_can_reach(tmp_path: Path) -> None:
    setup = FieldSetup(scenario(tmp_path, ring(dumbbell(1.5)), 2, 1))
    planned = plan_work(setup)
    rows = [section.section for robot in planned.robots for section in robot.sections]
    everything = {section.id for section in setup.field.sections}
    assert setup.unreachable and planned.apart == len(setup.unreachable)
    assert sorted(rows) == sorted(everything - setup.unreachable)


def test_robots_on_both_sides_are_planned_for_their_own_one(tmp_path: Path) -> None:
    outline = box(0.0, 0.0, 8.0, 40.0) | box(7.0, 0.0, 10.0, 1.5) | box(9.0, 0.0, 17.0, 40.0)
    setup = FieldSetup(scenario(tmp_path, ring(outline), 12, 1))
    assert not setup.unreachable, "what the test is about"
    for robot in plan_work(setup).robots:
        apart = setup.plan.parts.apart_from(setup.starts[robot.robot])
        assert not apart & {section.section for section in robot.sections}


def test_a_robot_does_not_want_a_section_that_it_cannot_reach() -> None:
    outline = dumbbell(1.5)
    field = divided("dumbbell", outline, (51.0, 0.0), FieldValues(), BODY)
    plan = FieldPlan(field, BODY)
    for place in ((15.0, 10.0), (50.0, 10.0)):
        progress = Progress({section.id: section.units for section in field.sections})
        allocation = FieldAllocationCRDT()
        choosing = SectionChooser(field, 2.5, plan.travel, plan.parts)
        here = Observation(*place, 0.0, 0.0, 0.0)
        wanted = set()
        for k in range(len(field.sections)):
            view = FleetView(0, 30_000_000 * k, here, allocation, progress, frozenset((0,)), {}, {})
            choice = choosing.choose(view, place)
            if choice is not None:
                wanted.add(choice.section)
                allocation.done(choice.section, 0)
        side = box(0.0, 0.0, 30.0, 20.0) if place[0] < 30.0 else box(40.0, 0.0, 60.0, 20.0)
        near = {s.id for s in field.sections if side.covers(LineString(s.swaths[0]))}
        assert wanted == near and near


def test_a_field_without_such_passages_is_one_part() -> None:
    for passage_m in (2.1, 6.0):
        field = divided("dumbbell", dumbbell(passage_m), (51.0, 0.0), FieldValues(), BODY)
        assert not FieldPlan(field, BODY).parts.apart_from((15.0, 10.0))
