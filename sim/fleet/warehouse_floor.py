"""The true state of a warehouse floor: its parcels, new orders for them, and events.

A simulation keeps it in its fleet, a launch in the process of the world; robots have no access to
it.
"""

from collections.abc import Callable, Mapping
from functools import partial

from agent.delivery.cost_matrix import Trip
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.interface.config import S
from protocol.frames.codec import Malformed, decode_once
from protocol.frames.delivery_frames import TASK_NUMBERS, TaskOrder
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from sim.fleet.scheduler import Script
from sim.fleet.transport_orders import TransportClient
from sim.scenarios.delivery_scenario import TaskRow
from sim.scenarios.delivery_setup import DeliverySetup
from sim.world.world import World

DESK_US = 500_000  # between two repeats of an unconfirmed order
BOX_CLEAR_M = 2.0  # a box never falls on a robot, nor right before one


class WarehouseFloor:
    """Where parcels, boxes and bays are, what the operator orders, and what fails when."""

    def __init__(
        self, setting: DeliverySetup, world: World, now_us: Callable[[], int],
        is_up: Callable[[int], bool], say: Callable[[Message], None],
    ) -> None:  # fmt: skip
        """`say`: sends on the bus, as the device that orders transports."""
        self.setting, self.world, self.now_us, self.say = setting, world, now_us, say
        self.truth = setting.parcels()
        self.truth.is_up = is_up
        self.truth.place_of = lambda slot: world.body(slot).position
        self.desk = TransportClient(len(setting.house.tasks))
        self.begin_at_us = 0  # events before this instant are past: an earlier launch had them

    def hear(self, t_us: int, frame: Frame) -> None:
        """Handle every frame. A device that orders a transport also puts the parcel there."""
        source, message = decode_once(frame)
        if not isinstance(message, Malformed):
            self.desk.hear(source, message)
        if isinstance(message, TaskOrder):
            order = TransportTask(message.pickup, message.dropoff)
            house = self.setting.house
            if message.task < TASK_NUMBERS and house.known(order):
                trip = house.trip(order)
                self.truth.appear(message.task, trip.pickup, trip.dropoff, t_us)

    def recall(self, now_us: int) -> None:
        """Continue at that instant: the parcels that appeared in an earlier launch are known."""
        self.begin_at_us = now_us
        self.desk = TransportClient(
            max([len(self.setting.house.tasks) - 1, *self.truth.dropoff]) + 1
        )

    def order(self, row: TaskRow) -> None:
        """Order one more transport."""
        self.desk.order([self.setting.order(self.setting.house, row)])

    @property
    def delivered(self) -> bool:
        """Whether every parcel lies at its dropoff and all expected parcels have appeared."""
        tasks = self.truth.dropoff
        return (
            len(tasks) >= len(self.setting.rows)
            and self.truth.delivered_at_us.keys() == tasks.keys()
        )

    # ---------------------------------------------------------------- timed events

    def calls(self) -> Script[None]:
        """Repeat orders until they are confirmed; never ends."""
        while True:
            for order in self.desk.due():
                self.say(order)
            yield self.now_us() + DESK_US

    def events(self) -> list[Script[None]]:
        """The scripts of the scenario's events; each ends."""
        return [self._boxes(), self._arrivals(), self._outages()]

    def _boxes(self) -> Script[None]:
        """Random obstacles; a box never falls on a robot."""
        world = self.world
        for box in self.setting.boxes():
            if box.at_s * S < self.begin_at_us:
                continue
            yield round(box.at_s * S)
            world.advance(self.now_us())
            near = min(
                (abs(b.position[0] - box.x_m) + abs(b.position[1] - box.y_m))
                for b in world.robots.values()
            )
            if near > BOX_CLEAR_M:
                number = world.add_box(box.x_m, box.y_m, box.size_m)
                end_at_us = self.now_us() + round(box.for_s * S)
                world.at(end_at_us, partial(world.remove_box, number))

    def _arrivals(self) -> Script[None]:
        for row in sorted(self.setting.rows, key=lambda row: row.at_s):
            if row.at_s and row.at_s * S >= self.begin_at_us:
                yield round(row.at_s * S)
                self.order(row)

    def _outages(self) -> Script[None]:
        for outage in sorted(self.setting.scenario.warehouse.outage, key=lambda o: o.at_s):
            yield round(outage.at_s * S)
            if outage.bay < len(self.truth.bays):
                self.truth.bays[outage.bay].works = False


def beyond_battery(house: Warehouse, trips: Mapping[int, Trip]) -> frozenset[int]:
    """Of tasks by number those that a battery that is full at any bay does not last for: from there to
    both places, and to a bay again."""
    if not (house.carrier.runs_dry and house.bays):
        return frozenset()
    return frozenset(task for task, trip in trips.items() if not house.lasts(trip))
