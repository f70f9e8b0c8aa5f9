"""What people leave a machine that they push towards a fence, and what it can do there."""

import numpy as np
import pytest

from agent.avoidance.fence_distance import gap_m
from agent.motion.tractor_motion import TractorMotion
from agent.runtime.mission_parts import field_parts
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Pushed, load


@pytest.mark.parametrize(("drive", "has_room"), [("ackermann", True), ("differential", False)])
def test_people_leave_a_tractor_room_to_a_fence(drive: str, has_room: bool) -> None:
    """A tractor that was pushed aslant into a corner could not get out (chaos with bodies that steer)."""
    push = Pushed(at_s=3.0, kind="pushed", robot=0, dx_m=-30.0, dy_m=0.0)
    yard = load("yard").changed(1, 1)
    scenario = yard.model_copy(
        update={
            "fault": [push],
            "fleet": yard.fleet.model_copy(update={"drive": drive}),
            "run": yard.run.model_copy(update={"time_limit_s": 20.0}),
        }
    )
    setup = FieldSetup(scenario)
    run = FieldRun(setup)
    run.run()
    assert run.cluster is not None
    track = run.cluster.world.robots[0].track.to_array()
    gaps_m = np.array([gap_m(x, y, setup.plan.fences) for x, y in track[:, 1:3]])
    nearest_m = gaps_m.min() - scenario.fleet.radius_m
    # As it drives off it may come nearer again.
    assert bool(nearest_m > 0.2) is has_room


@pytest.mark.parametrize(("drive", "turns"), [("ackermann", False), ("differential", True)])
def test_bodies_of_differential_drive_turn_on_the_spot(drive: str, turns: bool) -> None:
    yard = load("yard")
    fleet = yard.fleet.model_copy(update={"drive": drive})
    motion = field_parts(0, FieldSetup(yard.model_copy(update={"fleet": fleet})).plan).motion
    assert isinstance(motion, TractorMotion) and (motion.rotation is not None) is turns
