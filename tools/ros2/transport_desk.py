"""Transports that ROS 2 clients send as an action with two poses, as orders of an operator.

They are what `headland task add` orders, so they need the operator's key. Nobody assigns a robot: a
client is told of the one that took the task, and how far it is, by the registers of the fleet.
"""

import asyncio
from typing import Final

from agent.delivery.task_outcome import TaskPhase, outcome_of
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.interface.ports import Bus
from protocol.frames.codec import Malformed, decode
from protocol.frames.frame import Frame
from sim.fleet.transport_orders import NumbersSpentError, TransportClient
from tools.common.event_lines import EventLines
from tools.inspect.inspector import Inspector
from tools.operate.operator_device import Operator
from tools.operate.task_numbers import LISTEN_S, learn_numbers
from tools.operate.tool_address import DeviceAddress
from tools.ros2.action_tasks import TELL_S, ActionTasks, in_field, tell
from tools.ros2.graph import ActionGoal, Ended, GoalPlace, Graph

CARRY: Final = "NavigateThroughPoses"
NAME: Final = "transport"
SAY_S: Final = 0.5  # between repetitions of an order that two robots have not confirmed
ASK_S: Final = 5.0  # between questions for the fleet's registers, while transports are open


class TransportDesk:
    """Offers the action of a fleet that delivers, and orders what clients ask."""

    def __init__(
        self,
        bus: Bus,
        device: DeviceAddress,
        house: Warehouse,
        inspector: Inspector,
        graph: Graph,
        lines: EventLines,
    ) -> None:
        """`device`: whose address it speaks from, with the proofs of transports."""
        self.bus, self.device, self.house = bus, device, house
        self.inspector, self.graph = inspector, graph
        self.client = TransportClient()
        self._loop = asyncio.get_running_loop()
        self._heard_at_s = self._loop.time()
        self._tasks = ActionTasks(lines)

    def hear(self, now_s: float, frame: Frame) -> None:
        """Take one frame of the bus."""
        source, message = decode(frame)
        if not isinstance(message, Malformed):
            self.client.hear(source, message)

    async def run(self) -> None:
        """Offer the action, until it is cancelled."""
        self.graph.act(NAME, CARRY, self._may_carry, self._tasks.taken(self._carry))
        try:
            await learn_numbers(self.device)
            await self._loop.create_future()
        finally:
            self._tasks.cancel()

    def _may_carry(self, places: list[GoalPlace]) -> bool:
        """In the thread of the graph: from the first place to the second, where robots can stand."""
        return self.device.proofs is not None and self._task(places) is not None

    def _task(self, places: list[GoalPlace]) -> TransportTask | None:
        if len(places) != 2 or not all(map(in_field, places)):
            return None
        pickup, dropoff = (self.house.cell((place.x_m, place.y_m)) for place in places)
        return None if pickup is None or dropoff is None else TransportTask(pickup, dropoff)

    async def _carry(self, goal: ActionGoal) -> None:
        task = self._task(goal.places)
        assert task is not None, "it was accepted"
        # Before that the numbers of other tasks may be unknown.
        await asyncio.sleep(max(0.0, self._heard_at_s + LISTEN_S - self._loop.time()))
        client = self.client
        try:
            index = client.order([task])[0]
        except NumbersSpentError as spent:
            self._tasks.abort(goal, str(spent))
            return
        said_at_s = asked_at_s = 0.0
        while True:
            number, now_s = client.number_of(index), self._loop.time()
            if goal.cancelled and not client.wanted[number][1].withdrawn:
                client.withdraw(number)
            if now_s - said_at_s >= SAY_S:
                said_at_s = now_s
                for due in client.due():
                    if due.task == number:
                        self.device.send(due)
            if now_s - asked_at_s >= ASK_S:
                asked_at_s = now_s
                Operator(self.bus, None, self.device).ask_work()
            order, fleet = client.wanted[number][1], self.inspector
            outcome = outcome_of(number, order, fleet.allocation, fleet.progress)
            if outcome.phase is TaskPhase.DELIVERED:
                client.finish(number)
                goal.end(Ended.SUCCEEDED, "")
                return
            if outcome.phase is TaskPhase.WITHDRAWN and client.confirmed(number):
                client.finish(number)
                goal.end(Ended.CANCELLED, "")
                return
            aboard = outcome.phase is TaskPhase.ABOARD
            if outcome.carrier is not None and outcome.carrier in fleet.robots:
                left = 1 if aboard else 2
                tell(goal, fleet, outcome.carrier, goal.places[2 - left], left)
            await asyncio.sleep(TELL_S)
