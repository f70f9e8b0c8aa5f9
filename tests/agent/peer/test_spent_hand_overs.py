"""After 255 hand-overs a section stays with its owner: the owner works it, and others leave it alone."""

from agent.claims.standing_owners import STANDS_US
from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_task import ORDERS_FIRST, ExplorationOrder, TaskKind
from agent.field.section_choice import SectionChooser
from agent.interface.config import CONTROL_PERIOD_US, LEASE_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import ClaimRequest, FleetView, MotionRequest
from agent.interface.observation import Observation
from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import EPOCH_MAX
from crdt.occupancy import Geometry
from tests.agent.exploration.test_frontier_path import BODY_M, CELL_M, LIMITS, SIDE
from tests.agent.field.test_section_choice import FIELD
from tests.agent.lone_peer import Eager, pass_time, peer_in

SECTION = 0


def handed_over(allocation: FieldAllocationCRDT, section: int, owner: int) -> FieldAllocationCRDT:
    for _ in range(EPOCH_MAX):
        allocation.claim(section, owner)
        allocation.release(section, owner)
    assert not allocation.stays(section)
    allocation.claim(section, owner)
    allocation.start(section, owner)
    assert allocation.stays(section) and allocation.entry(section).epoch == EPOCH_MAX
    return allocation


class Wants(Eager):
    """A mission that wants its section again, and finishes it on its tenth turn."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.turns = 0

    def choose(self, view: FleetView) -> ClaimRequest | None:
        ours = view.allocation.assigned_sections(view.slot)
        return ClaimRequest(ours[0], 0) if ours else None

    def begin(self, section: int, view: FleetView) -> None:
        self.begun.append(section)

    def work(self, view: FleetView) -> MotionRequest:
        self.turns += 1
        return MotionRequest(0.0, 0.0, finished=self.turns == 10)


def test_its_owner_takes_it_up_again_and_finishes_it() -> None:
    mission = Wants()
    peer = peer_in(State.DISCONNECTED, None, mission=mission)
    handed_over(peer.allocation, SECTION, 0)
    pass_time(peer, 20 * S)
    assert mission.begun == [SECTION] and mission.turns == 10
    assert peer.allocation.phase_of(SECTION) is Phase.DONE and peer.state is State.IDLE


def test_a_robot_that_explores_does_not_ask_for_what_stays_with_another() -> None:
    order = ExplorationOrder(TaskKind.NAVIGATE_TO, ((9.1, 6.1),))
    chart = LocalAndFleetMap(None, Geometry(SIDE, SIDE, (0.0, 0.0), CELL_M), BODY_M, 5.0)
    mission = ExplorationMission(chart, LIMITS, 2, orders=[order])
    allocation = handed_over(FieldAllocationCRDT(), ORDERS_FIRST, 1)
    for now_us in range(0, 2 * LEASE_US, CONTROL_PERIOD_US):
        seen = FleetView(
            0, now_us, Observation(6.1, 6.1, 0.0, 0.0, 0.0), allocation, Progress({}),
            frozenset({0}), {1: 0}, {},
        )  # fmt: skip
        request = mission.choose(seen)
        assert request is None or request.section != ORDERS_FIRST


def test_in_a_field_the_owner_wants_it_last_and_no_other_robot_wants_it() -> None:
    allocation = FieldAllocationCRDT()
    first, *others = [section.id for section in FIELD.sections]
    for section in others:
        allocation.done(section, 1)
    handed_over(allocation, first, 0)
    progress = Progress({section.id: section.units for section in FIELD.sections})
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
    ours = FleetView(0, STANDS_US, here, allocation, progress, frozenset({0}), {}, {})
    wanted = SectionChooser(FIELD, 2.5).choose(ours, (0.0, 0.0))
    assert wanted is not None and wanted.section == first and not wanted.takeover
    theirs = ours._replace(
        slot=1, now_us=2 * LEASE_US, live=frozenset({1}), fell_silent_at_us={0: 0}
    )
    assert SectionChooser(FIELD, 2.5).choose(theirs, (0.0, 0.0)) is None
