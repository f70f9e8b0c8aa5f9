"""Frames of a mission that are not passed to it."""

from agent.interface.config import S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.mapping.building import Floor
from agent.navigation.navigation_mission import NavigationMission
from agent.peer.mission_messages import MissionMessages
from agent.peer.part import Header, StepContext
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.agreement_frames import SilentPosition
from protocol.frames.identifier import GLOBAL_ADDRESS
from sim.scenarios.building_generator import CORRIDOR

HERE = Observation(7.5, 2.5, 0.0, 0.0, 0.0)


def test_a_silent_robot_that_the_fleet_does_not_have_is_no_body() -> None:
    """One frame put a body into a doorway that every robot told on, and that never went away."""
    errands = NavigationMission(0, {0: [(13.5, 0.5)]}, Floor.drawn(CORRIDOR, 1.0, 0.35), 1.0, 1.0)
    part = MissionMessages(errands, frozenset({0, 1, 2}))
    live = frozenset({0, 1})
    ctx = StepContext(0, S, State.IDLE, True, HERE, live, True)
    for slot in (9, 2):
        told = SilentPosition(7.5, 0.5, slot, 5)
        part.handles[SilentPosition](ctx, Header(129, 1, GLOBAL_ADDRESS), told)
    view = FleetView(0, 2 * S, HERE, FieldAllocationCRDT(0), Progress({}), live, {}, {})
    errands.on_control_period(view, State.IDLE)
    assert errands.bodies.dead.keys() == {2} and part.refused == 1
    said = [m for m in errands.outgoing(60 * S) if isinstance(m, SilentPosition)]
    assert [m.slot for m in said] == [2], "it is not told on"
