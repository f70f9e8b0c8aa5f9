"""What it takes one peer to decide about one new task, with 50 robots and 500 tasks in its state.

The clock is this process's CPU time, and runs from the frame of the order at the peer to the frame of its
bid: reading the order, one control period of its mission with all that falls into it, and its beat. Each
peer has a cost matrix of its own, as in a process of its own; nothing is known of the new places before.
"""

import time
from collections.abc import Iterator
from itertools import pairwise
from random import Random
from typing import NamedTuple

from agent.delivery.cost_matrix import FULL, Carrier, CostMatrix, Trip
from agent.delivery.delivery_mission import DeliveryMission
from agent.delivery.itinerary_broadcast import ItineraryBroadcast
from agent.delivery.task_registry import TransportTask
from agent.delivery.tour_auction import RoutingPlanner
from agent.delivery.warehouse import CarrierState, Warehouse
from agent.interface.config import MS
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation
from agent.mapping.building import Floor
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack
from protocol.frames.codec import decode, encode
from protocol.frames.delivery_frames import TaskBid, TaskOrder
from protocol.frames.fleet_frames import Pose
from tools.bench.figure import Figure

ROBOTS, TASKS = 50, 500
TICK_US = 50 * MS
RAYS = 180
SENDER = 249  # of the order
KNOWN_US = 6_000 * MS  # the fleet has been together for this time


class KnownFleet(NamedTuple):
    """What all peers know alike: where each robot is, what it is at, what it means to do."""

    house: Warehouse
    plan: list[list[int]]
    starts: list[tuple[float, float]]
    allocation: FieldAllocationCRDT


def fleet(floor: Floor, costs: CostMatrix, seed: int) -> KnownFleet:
    """50 robots, each at the first of its tasks."""
    rng = Random(f"{seed}/decision")
    house = Warehouse(floor, Carrier(1.0, 5.0))
    house.costs = costs
    cells = [cell for cell in range(floor.cells) if house.cell(house.place(cell)) == cell]
    house.tasks = {k: TransportTask(*rng.sample(cells, 2)) for k in range(TASKS)}
    starts = [house.place(cell) for cell in rng.sample(cells, ROBOTS)]
    trips = [house.trip(order) for order in house.tasks.values()]
    robots = [CarrierState(slot, at, 0, FULL) for slot, at in enumerate(starts)]
    plan = RoutingPlanner(house.work(trips, robots)).auctioned()
    allocation = FieldAllocationCRDT()
    for slot, own in enumerate(plan):
        if own:
            allocation.apply(own[0], pack(0, Phase.STARTED, 0, 1, slot))
    return KnownFleet(house, plan, starts, allocation)


class OnePeer:
    """The mission of one of them, as its peer would use it."""

    def __init__(self, of: KnownFleet, slot: int) -> None:
        self.fleet, self.slot, self.now_us = of, slot, 0
        self.mission = DeliveryMission(slot, of.house.twin(), of.starts[slot], 1.0, 1.6, 0, slot)
        self.mission.section = of.plan[slot][0] if of.plan[slot] else None
        self.mission.dispatch.itinerary = of.plan[slot][1:]
        for other, own in enumerate(of.plan):
            if other != slot:
                telling = ItineraryBroadcast(0)
                telling.stops = own[1:]
                telling.changed(0)
                for _ in range(len(own)):
                    for frame in telling.outgoing(0, FULL):
                        self.mission.on_message(other, frame, 0)
        self.now_us = KNOWN_US
        for _ in range(3):
            self.period()

    def view(self) -> FleetView:
        """What its peer knows at present: all others at their places, and the shared state."""
        x_m, y_m = self.fleet.starts[self.slot]
        here = Observation(x_m, y_m, 0.0, 0.0, 0.0, (4.0,) * RAYS)
        neighbours = {
            slot: Neighbour(Pose(*at, 0.0, 0.0, State.WORKING, False, 255), self.now_us)
            for slot, at in enumerate(self.fleet.starts)
            if slot != self.slot
        }
        live = frozenset(range(ROBOTS))
        return FleetView(
            self.slot, self.now_us, here, self.fleet.allocation, Progress({}), live, {}, neighbours
        )

    def period(self) -> list[TaskBid]:
        """One control period later: the bids that the mission sends."""
        self.now_us += TICK_US
        view = self.view()
        self.mission.on_control_period(view, State.WORKING)
        return [m for m in self.mission.outgoing(self.now_us) if isinstance(m, TaskBid)]

    def decides(self, task: int, trip: Trip) -> tuple[float, bool]:
        """CPU milliseconds, and whether its bid is out."""
        house = self.fleet.house
        cells = house.cell(trip.pickup), house.cell(trip.dropoff)
        assert cells[0] is not None and cells[1] is not None
        frame = encode(TaskOrder(task, cells[0], cells[1]), SENDER)
        began_s = time.process_time()
        _, message = decode(frame)
        assert isinstance(message, TaskOrder)
        self.mission.on_message(None, message, self.now_us)
        bids = self.period()
        took_ms = (time.process_time() - began_s) * 1000
        while self.mission.dispatch.deciding is not None:  # the auction closes: nobody else bids
            self.period()
        return took_ms, [bid.task for bid in bids] == [task]


def decisions(
    floor: Floor, costs: CostMatrix, peers: range, tasks: int, seed: int
) -> Iterator[Figure]:
    """`tasks`: decisions of each of those peers, and one more."""
    of, rng = fleet(floor, costs, seed), Random(f"{seed}/new tasks")
    cells = [cell for cell in range(floor.cells) if of.house.cell(of.house.place(cell)) == cell]
    took_ms, silent = [], 0
    for slot in peers:
        peer = OnePeer(of, slot)
        places = [of.house.place(cell) for cell in rng.sample(cells, 2 * (tasks + 1))]
        trips = [Trip(a, b) for a, b in pairwise(places)][::2]
        for k, trip in enumerate(trips):
            ms, bid = peer.decides(TASKS + k, trip)
            silent += not bid
            if slot or k:  # the first one of all is compiled
                took_ms.append(ms)
    took_ms.sort()
    where = (
        f"CPU of one peer from the order's frame to its bid's; {len(took_ms)} decisions of {len(peers)} "
        f"peers, {silent} without a bid; each with its own matrix of {2 * TASKS} places"
    )
    middle, worst = took_ms[len(took_ms) // 2], took_ms[-1]
    name = "decision of a peer for one new task, 50 robots, 500 tasks"
    yield Figure(name, middle, "ms", "<= 50", middle <= 50, "-", f"median; {where}")
    yield Figure(f"{name}, worst", worst, "ms", "<= 50", worst <= 50, "-", where)
