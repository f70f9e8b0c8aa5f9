"""One robot's mission by itself: the wait / proceed rule, and itineraries as people read them."""

import pytest

from agent.delivery.cost_matrix import FULL, Carrier
from agent.delivery.delivery_mission import DeliveryMission
from agent.delivery.itinerary_broadcast import ItineraryBroadcast
from agent.delivery.plan_negotiation import ProblemSnapshot
from agent.delivery.task_registry import TASKS_MAX, TransportTask, stop_names
from agent.delivery.warehouse import SECTIONS_END, CarrierState, Warehouse
from agent.interface.config import LEASE_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation, VisibleParcel
from agent.mapping.building import Floor
from crdt import FieldAllocationCRDT, Progress
from crdt.claim_register import EPOCH_MAX
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.fleet_frames import Pose

WIDE = 60
FLOOR = Floor.drawn("." * WIDE, 1.0, 0.3)
NEAR, FAR = 0, 1  # a task of 20 s, and one of 90 s


def house(carrier: Carrier, bays: list[tuple[float, float]]) -> Warehouse:
    orders = {NEAR: TransportTask(5, 20), FAR: TransportTask(45, 0)}  # cells of the one row
    return Warehouse(FLOOR, carrier, bays, orders)


def view(now_us: int, battery: float = 1.0) -> FleetView:
    here = Observation(0.5, 0.5, 0.0, 0.0, 0.0, (4.0,) * 8, battery=battery)
    live = frozenset({0})
    return FleetView(0, now_us, here, FieldAllocationCRDT(), Progress({}), live, {}, {})


@pytest.mark.parametrize(("task", "proceeds"), [(NEAR, False), (FAR, True)])
def test_a_short_task_waits_for_the_new_plan_and_a_long_one_goes_on(
    task: int, proceeds: bool
) -> None:
    """The mission's numbers: T_replan is 45 s, T_next 20 s or 90 s."""
    home = house(Carrier(1.0, 0.0), [])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    now_us = 10 * S
    here = [CarrierState(0, (0.5, 0.5), 0, FULL)]
    mission.dispatch.round.call(ProblemSnapshot((0,), (), home.work([], here)), 45 * S, now_us)
    mission.dispatch.itinerary = [task]
    choice = mission.choose(view(now_us))
    assert (choice is not None) is proceeds
    assert (mission.waited_for_us > 0) is not proceeds
    after = mission.choose(view(now_us + 60 * S))
    # a robot that waits, waits for the plan
    assert after is not None or mission.dispatch.round.active


def test_an_itinerary_names_the_charger_that_it_will_need() -> None:
    """105 m of a battery's 130 m leave too little for the way from there to the bay: first the bay."""
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    mission.dispatch.itinerary = [NEAR, FAR]
    mission.dispatch.telling.changed(0)
    for k in range(10):
        mission.on_control_period(view(k * S // 10), State.IDLE)
    assert mission.stops == ["P0", "D0", "C0", "P1", "D1"]
    told, heard = [], ItineraryBroadcast(0)
    for frame in mission.outgoing(S):
        told.append(frame)
        if type(frame).__name__ == "Itinerary":
            heard.on_message(0, frame)  # type: ignore[arg-type]
    assert heard.told[0].whole == (NEAR, TASKS_MAX, FAR)


def test_a_robot_with_a_parcel_whose_order_it_forgot_takes_no_other_task() -> None:
    """Its memory was lost. It claimed the next task, drove to the pickup and could not load."""
    mission = DeliveryMission(0, house(Carrier(1.0, 0.0), []), (0.5, 0.5), 1.0, 1.6, 0, 1)
    forgotten = 7
    for k in range(100):
        seen = view(k * S // 10)
        seen = seen._replace(here=seen.here._replace(load=forgotten))
        mission.dispatch.itinerary = [NEAR] if k == 0 else mission.dispatch.itinerary
        mission.on_control_period(seen, State.IDLE)
        assert mission.choose(seen) is None
    assert not mission.dispatch.itinerary, "others carry what it had planned"
    mission.on_message(1, TaskOrder(forgotten, 5, 20), 10 * S)
    choice = mission.choose(seen)
    assert choice is not None and choice.section == forgotten


def test_a_robot_with_a_parcel_whose_order_it_forgot_charges_when_it_is_low() -> None:
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    for battery, charges in ((0.9, False), (0.45, True)):
        seen = view(S, battery)
        seen = seen._replace(here=seen.here._replace(load=7))
        mission.on_control_period(seen, State.IDLE)
        choice = mission.choose(seen)
        assert (choice is not None and choice.section >= TASKS_MAX) is charges


def test_a_bay_that_a_robot_claimed_before_it_fell_silent_is_free_after_its_lease() -> None:
    """Its battery was empty on the way to the only bay. The others never charged again."""
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    allocation = FieldAllocationCRDT()
    allocation.claim(TASKS_MAX, 1)
    allocation.start(TASKS_MAX, 1)
    silent_at_us = 10 * S
    for live, now_us, charges in (
        (frozenset({0, 1}), 3600 * S, False),
        (frozenset({0}), silent_at_us + LEASE_US - S, False),
        (frozenset({0}), silent_at_us + LEASE_US, True),
    ):
        seen = view(now_us, 0.4)._replace(
            allocation=allocation, live=live, fell_silent_at_us={1: silent_at_us}
        )
        mission.on_control_period(seen, State.IDLE)
        choice = mission.choose(seen)
        assert (choice is not None) is charges
    assert choice is not None and choice.section == TASKS_MAX
    assert allocation.takeover(choice.section, 0, choice.bid) is not None and choice.takeover


def test_a_robot_charges_also_after_years() -> None:
    """After 8,192 visits of the fleet no robot found a bay any more."""
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    allocation, visits = FieldAllocationCRDT(), range(TASKS_MAX, SECTIONS_END)
    for section in visits[:-4]:
        allocation.done(section, 1)
    for _ in range(3 * EPOCH_MAX):
        choice = mission.charging.visit((0.5, 0.5), None, allocation, (), lambda owner: False)
        assert choice is not None and allocation.claim(choice.section, 0) is not None
        allocation.start(choice.section, 0)
        left = mission._at_bay(choice.section, view(S)._replace(allocation=allocation))
        told = allocation.done if left.finished else allocation.release
        assert (left.finished or left.given_up) and told(choice.section, 0) is not None


def test_a_bay_that_a_robot_has_given_up_is_left_alone_whatever_visit_it_was() -> None:
    """Something stood in the nearest bay. The robot took the next visit of it, again and again."""
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(10.5, 0.5), (50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    allocation = FieldAllocationCRDT()
    for section in range(TASKS_MAX, TASKS_MAX + 6):
        allocation.done(section, 1)
    seen = view(S, 0.4)._replace(allocation=allocation)
    mission.on_control_period(seen, State.IDLE)
    choice = mission.choose(seen)
    assert choice is not None and home.bay_of(choice.section) == 0
    mission.begin(choice.section, seen)
    assert mission._given_up(choice.section, seen, "no headway").given_up
    choice = mission.choose(seen)
    assert choice is not None and home.bay_of(choice.section) == 1


def test_a_bay_in_which_a_silent_robot_may_stand_is_the_last_choice() -> None:
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(10.5, 0.5), (50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    allocation = FieldAllocationCRDT()
    allocation.claim(TASKS_MAX, 1)
    for free in (True, False):
        choice = mission.charging.visit((0.5, 0.5), None, allocation, (), lambda owner: True)
        assert choice is not None and choice.takeover is not free
        assert home.bay_of(choice.section) == int(free)
        allocation.claim(TASKS_MAX + 1, 2)


def test_a_bay_in_which_a_robot_stands_until_a_person_comes_is_not_chosen() -> None:
    """It was the nearest. A robot waited beside it for 30 s, and its battery was empty on the way on."""
    home = house(Carrier(1.0, 0.0, battery_m=130.0, reserve=0.0), [(10.5, 0.5), (50.5, 0.5)])
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    for state, bay in ((State.EMERGENCY_STOP, 1), (State.IDLE, 0)):
        other = Neighbour(Pose(10.4, 0.5, 0.0, 0.0, state, False, 0, False), S)
        seen = view(S, 0.4)._replace(live=frozenset({0, 1}), neighbours={1: other})
        choice = mission.choose(seen)
        assert choice is not None and home.bay_of(choice.section) == bay


def test_what_is_aboard_need_not_be_picked_up() -> None:
    assert stop_names([7], [TASKS_MAX + 1, 5], 7) == ["D7", "C1", "P5", "D5"]
    assert stop_names([], [5, 11, TASKS_MAX + 1], -1) == ["P5", "D5", "P11", "D11", "C1"]


@pytest.mark.parametrize("ordered_first", [True, False])
def test_a_transport_across_a_wall_of_the_plan_is_never_begun(ordered_first: bool) -> None:
    """Found: for 15 s it counted as within reach. A lone robot fetched the parcel and stood with it for
    ever, and the orders after it waited."""
    across = TransportTask(2, 7)  # a wall is between them
    floor = Floor.drawn("....#....", 1.0, 0.3)
    home = Warehouse(floor, Carrier(1.0, 0.0), [], {0: across} if ordered_first else {})
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    for k in range(120):
        seen = view(k * S // 20)
        if k == 80 and not ordered_first:
            mission.on_message(None, TaskOrder(0, *across), seen.now_us)
        mission.on_control_period(seen, State.IDLE)
        assert mission.choose(seen) is None
    assert 0 in mission.cut_off.sections, "people are told that it cannot be done"
    mission.on_message(None, TaskOrder(1, 2, 3), 6 * S)
    for k in range(120, 140):
        mission.on_control_period(view(k * S // 20), State.IDLE)
    choice = mission.choose(view(7 * S))
    assert choice is not None and choice.section == 1


def test_the_search_for_a_parcel_goes_on_after_a_place_that_cannot_be_reached() -> None:
    """Found: the robot stood for ever, and noted the same place again twenty times a second."""
    floor = Floor.drawn("....#....", 1.0, 0.3)
    home = Warehouse(floor, Carrier(1.0, 0.0), [], {0: TransportTask(1, 3)})
    mission = DeliveryMission(0, home, (0.5, 0.5), 1.0, 1.6, 0, 1)
    allocation = FieldAllocationCRDT()
    allocation.claim(0, 0)
    allocation.start(0, 0)
    mission.begin(0, view(0))
    at = (0.5, 0.5)
    for k in range(60 * 20):
        seen = view(k * S // 20)._replace(allocation=allocation)
        seen = seen._replace(here=seen.here._replace(x_m=at[0], y_m=at[1]))
        mission.on_control_period(seen, State.WORKING)
        if mission.work(seen).given_up:
            break
        if mission.goal is not None and mission.goal[0] < 4.0:  # it drives there, up to the wall
            at = mission.goal
    else:
        pytest.fail(f"it stands at {at} and wants to go to {mission.goal}")
    assert not mission.whereabouts.searching(0), "it has looked everywhere"


def test_a_transport_between_neighbouring_cells_that_was_taken_back_is_not_delivered() -> None:
    """Found by drawn orders: the parcel at its pickup lies within reach of its dropoff, and the robot on
    its way said that it was delivered."""
    beside = TransportTask(1, 2)
    mission = DeliveryMission(
        0, Warehouse(FLOOR, Carrier(1.0, 0.0), [], {0: beside}), (0.5, 0.5), 1.0, 1.6, 0, 1
    )
    allocation = FieldAllocationCRDT()
    allocation.claim(0, 0)
    allocation.start(0, 0)
    seen = view(0)._replace(allocation=allocation)
    seen = seen._replace(here=seen.here._replace(parcels={0: VisibleParcel(1.5, 0.5, False)}))
    mission.begin(0, seen)
    mission.on_control_period(seen, State.WORKING)
    assert not mission.work(seen).finished
    mission.on_message(None, TaskOrder(0, *beside.taken_back), 0)
    request = mission.work(seen)
    assert request.given_up and not request.finished
