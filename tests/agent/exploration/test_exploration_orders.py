"""An operator's order is carried out although the nearest robot cannot, or its owner stands."""

from math import inf

import pytest

from agent.claims.standing_owners import STANDS_US
from agent.exploration.exploration_mission import (
    CHOOSE_US,
    SHUNNED_US,
    UNTAKEN_US,
    ExplorationMission,
)
from agent.exploration.exploration_task import ORDERS_FIRST, ExplorationOrder, TaskKind
from agent.exploration.frontier_path import STUCK_US
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation
from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from crdt import FieldAllocationCRDT, Progress
from crdt.occupancy import Geometry
from protocol.frames.fleet_frames import Pose
from tests.agent.exploration.test_frontier_path import BODY_M, CELL_M, LIMITS, SIDE

AT = (6.1, 6.1)
ORDER = ExplorationOrder(TaskKind.NAVIGATE_TO, ((9.1, 6.1),))


@pytest.fixture
def mission() -> ExplorationMission:
    chart = LocalAndFleetMap(None, Geometry(SIDE, SIDE, (0.0, 0.0), CELL_M), BODY_M, 5.0)
    return ExplorationMission(chart, LIMITS, 2, orders=[ORDER])


def view(now_us: int, allocation: FieldAllocationCRDT, state: State = State.IDLE) -> FleetView:
    """Robot 1 is nearer to the order than we."""
    pose = Pose(8.1, 6.1, 0.0, 0.0, state, False, 0)
    return FleetView(
        0, now_us, Observation(*AT, 0.0, 0.0, 0.0), allocation, Progress({}), frozenset({0, 1}), {},
        {1: Neighbour(pose, now_us)},
    )  # fmt: skip


def sighted(now_us: int, allocation: FieldAllocationCRDT) -> FleetView:
    """We are alone, and see nothing all round."""
    seen = view(now_us, allocation)._replace(live=frozenset({0}), neighbours={})
    return seen._replace(here=seen.here._replace(ranges_m=(inf,) * 36))


def claimed_at_us(
    mission: ExplorationMission, allocation: FieldAllocationCRDT, state: State, limit_us: int
) -> int | None:
    for now_us in range(0, limit_us, CONTROL_PERIOD_US):
        seen = view(now_us, allocation, state)
        mission.on_control_period(seen, State.IDLE)
        request = mission.choose(seen)
        if request is not None and request.section == ORDERS_FIRST:
            return now_us
    return None


def test_i24_an_order_that_the_nearest_robot_does_not_take_is_taken_by_another(
    mission: ExplorationMission,
) -> None:
    when_us = claimed_at_us(mission, FieldAllocationCRDT(), State.IDLE, 2 * UNTAKEN_US)
    assert when_us is not None and 0 <= when_us - UNTAKEN_US <= 2 * CHOOSE_US


def test_i24_an_order_of_a_live_robot_that_stands_is_taken_over(
    mission: ExplorationMission,
) -> None:
    allocation = FieldAllocationCRDT()
    allocation.claim(ORDERS_FIRST, 1)
    allocation.start(ORDERS_FIRST, 1)
    when_us = claimed_at_us(mission, allocation, State.WORKING, 2 * STANDS_US)
    assert when_us is not None and 0 <= when_us - STANDS_US <= 2 * CHOOSE_US


def test_i24_an_order_without_headway_is_given_back_and_left_to_others_for_a_while(
    mission: ExplorationMission,
) -> None:
    allocation = FieldAllocationCRDT()
    allocation.claim(ORDERS_FIRST, 0)
    allocation.start(ORDERS_FIRST, 0)
    mission.begin(ORDERS_FIRST, view(0, allocation))
    now_us = 0
    while not (wish := mission.work(view(now_us, allocation))).given_up:
        now_us += CONTROL_PERIOD_US
        assert now_us < 2 * STUCK_US
    assert wish.given_up and mission.given_up_why == f"no headway for {STUCK_US // S} s"
    allocation.release(ORDERS_FIRST, 0)
    alone = view(now_us + SHUNNED_US // 2, allocation)._replace(neighbours={})
    request = mission.choose(alone)
    assert request is None or request.section != ORDERS_FIRST
    request = mission.choose(alone._replace(now_us=now_us + SHUNNED_US))
    assert request is not None and request.section == ORDERS_FIRST


def test_i24_a_robot_that_gets_on_to_no_frontier_comes_to_an_end() -> None:
    """The first frontier was open again before the last one was given up, so it went round for good."""
    chart = LocalAndFleetMap(None, Geometry(SIDE, SIDE, (0.0, 0.0), CELL_M), BODY_M, 2.0)
    mission, allocation = ExplorationMission(chart, LIMITS, 1), FieldAllocationCRDT()
    tried, now_us = set[int](), 0
    section: int | None = None
    mission.idle(sighted(0, allocation))
    while not (mission.over and section is None):
        seen = sighted(now_us, allocation)
        mission.on_control_period(seen, State.IDLE)
        if section is not None:
            if mission.work(seen).given_up:
                allocation.release(section, 0)
                section = None
        elif (request := mission.choose(seen)) is not None:
            section = request.section
            tried.add(section)
            allocation.claim(section, 0)
            allocation.start(section, 0)
            mission.begin(section, seen)
        else:
            mission.idle(seen)
        now_us += 10 * CONTROL_PERIOD_US
        assert now_us < 600 * S, tried
    assert len(tried) * STUCK_US > SHUNNED_US, tried


def test_rays_from_a_place_that_is_not_believed_are_not_drawn(mission: ExplorationMission) -> None:
    seen = view(0, FieldAllocationCRDT())
    seen = seen._replace(here=seen.here._replace(ranges_m=(2.0,) * 36))
    mission.idle(seen._replace(placed=False))
    assert not mission.chart.own().any()
    mission.idle(seen)
    assert mission.chart.own().any()
