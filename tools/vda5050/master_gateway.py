"""A fleet on a bus, and its robots as vehicles at a broker.

It takes part in nothing: it orders transports as `headland task add` does, listens to what the robots
say, and tells the master. The fleet carries on without it, without the broker and without the master.
"""

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from agent.delivery.task_outcome import TaskPhase, outcome_of
from agent.delivery.task_registry import HIGHEST_ASKED, TASKS_MAX
from agent.delivery.warehouse import Warehouse
from agent.interface.ports import Bus
from agent.interface.vehicle import Vehicle
from agent.runtime.files.printable_text import printable
from agent.runtime.vda5050.broker_link import Broker, BrokerLink, VehicleAddress
from agent.runtime.vda5050.messages import (
    Action,
    ActionStatus,
    InstantActions,
    MasterOrder,
    MessageHeader,
    Topic,
    VehicleState,
)
from crdt import Phase
from protocol.frames.codec import Malformed, decode
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import Command, Reason
from sim.fleet.transport_orders import NumbersSpentError, TransportClient
from tools.common.bus_address import AttachError
from tools.common.event_lines import EventLines
from tools.inspect.inspector import SILENT_S, Inspector, Seen
from tools.inspect.proven_work import ProvenWork
from tools.operate.estop import press
from tools.operate.operator_device import LIVE_S, Operator
from tools.operate.order_proofs import proofs_of
from tools.operate.reset import operator_keyring
from tools.vda5050.factsheet import factsheet_of
from tools.vda5050.fleet_vehicle import (
    INSTANT_ERROR,
    NO_ORDER,
    UNHEARD,
    FleetVehicle,
    HeardRobot,
)
from tools.vda5050.order_book import BookedOrder, BookError, OrderBook
from tools.vda5050.transport_rules import OrderRefused, transport_of

TICK_S: Final = 0.05
STATE_S: Final = 1.0  # between states in which nothing has changed; the standard demands 30 s
VISUALIZATION_S: Final = 0.5
SAY_S: Final = 0.5  # between repetitions of an order that is not confirmed
ASK_S: Final = 5.0  # between questions to the fleet for its registers, while orders are open
AGAIN_S: Final = 2.0  # after a connection has failed for a reason that nobody expected
OBEY_S: Final = 5.0  # for a robot to obey
CHANGES: Final = {"agv_position", "velocity", "battery_state", "driving"}  # no reason for a state


class FleetNames(NamedTuple):
    """What a master knows these vehicles by."""

    interface: str  # the first level of all topics
    manufacturer: str
    map_id: str
    vehicle: Vehicle
    version: str  # of the standard, as each header says


class MasterGateway:
    """All vehicles of one fleet, its bus, and the book of orders."""

    def __init__(
        self, bus: Bus, house: Warehouse, book: OrderBook, broker: Broker, named: FleetNames,
        keys: Path | None, lines: EventLines, proven: ProvenWork | None = None,
    ) -> None:  # fmt: skip
        """`keys`: the operator's key file, in a fleet with keys. `lines`: say what happens. `proven`:
        what counts of what robots say of work; None: all."""
        self.house, self.book, self.broker = house, book, broker
        self.lines = lines
        self.named, self.keys = named, keys
        self.operator = Operator(bus, None)
        self.operator.device.proofs = proofs_of(keys, lines.note)
        self.inspector, self.desk = Inspector(), TransportClient(max(book.tasks, default=-1) + 1)
        self.inspector.proven = proven
        self.courses: dict[int, float] = {}  # of each robot, radians
        self.ports: dict[int, _Port] = {}
        self.working: set[asyncio.Task[Any]] = set()

    def hear(self, frame: Frame) -> None:
        """Take one frame of the bus."""
        now_s = asyncio.get_running_loop().time()
        self.operator.hear(now_s, frame)
        self.inspector.hear(now_s, frame)
        source, message = decode(frame)
        if isinstance(message, Malformed):
            return
        self.desk.hear(source, message)
        slot = self.inspector.slot_of.get(source)
        if isinstance(message, Pose) and slot is not None:
            self.courses[slot] = message.course_rad

    def serial(self, slot: int) -> str:
        """The serial number of a robot."""
        return f"robot{slot}"

    async def run(self, end: asyncio.Event) -> None:
        """Serve until `end` is set. Raises BookError where the book is of another building."""
        loop = asyncio.get_running_loop()
        for number, task in self.book.tasks.items():
            self.desk.recall(number, task)
        said_s = asked_s = 0.0
        try:
            while not end.is_set():
                now_s = loop.time()
                self.operator.now_s = self.inspector.now_s = now_s
                # A robot that died while the gateway was away still has an order to be told of.
                known = self.inspector.robots.keys() | self.book.orders.keys()
                for slot in sorted(known - self.ports.keys()):
                    self._add(slot)
                if self.inspector.proven is not None:
                    for question in self.inspector.proven.questions(round(now_s * 1e6)):
                        self.operator.send(question)
                for port in self.ports.values():
                    self._observe(port)
                if now_s - said_s >= SAY_S:
                    said_s = now_s
                    self._finish_delivered()
                    self._book_again()
                    for order in self.due():
                        self.operator.send(order)
                if now_s - asked_s >= ASK_S:
                    asked_s = now_s
                    if not self.inspector.robots or any(
                        p.vehicle.busy for p in self.ports.values()
                    ):
                        self.operator.ask_who()
                        self.operator.ask_work()
                        self.operator.send(HIGHEST_ASKED)  # orders get numbers above all others
                for port in self.ports.values():
                    port.tell(now_s, self)
                await asyncio.sleep(TICK_S)
        finally:
            for port in self.ports.values():
                port.running.cancel()
            for task_ in self.working:
                task_.cancel()
            running = [port.running for port in self.ports.values()]
            await asyncio.gather(*running, *self.working, return_exceptions=True)

    def _add(self, slot: int) -> None:
        booked = self.book.orders.get(slot)
        transport = None
        if booked is not None and not (booked.cancelled and booked.number is None):
            try:
                transport = transport_of(booked.order, self.house, self.named.map_id)
            except OrderRefused as refused:
                raise BookError(printable(
                    f"--book {self.book.path}: its order {booked.order.order_id} is of another building: "
                    f"{refused}; name another book, or the --scenario of this one"
                )) from None  # fmt: skip
        self.ports[slot] = _Port(self, FleetVehicle(slot, booked, transport))
        serial = self.serial(slot)
        self.lines.say(
            "vehicle", f"{serial}: a vehicle at {self.broker}", robot=slot, serial=serial
        )

    # ---------------------------------------------------------------- what the bus says

    def _observe(self, port: "_Port") -> None:
        vehicle = port.vehicle
        seen = self.inspector.robots.get(vehicle.slot)
        vehicle.robot = UNHEARD if seen is None else self._heard(seen)
        booked = vehicle.booked
        if booked is None or booked.number is None:
            return
        if port.index is not None:
            number = self.desk.number_of(port.index)
            if number != booked.number:  # another device has used it as well
                booked = vehicle.booked = booked._replace(number=number)
                self._book_number(port, booked)
        assert booked.number is not None
        order = self.desk.wanted.get(booked.number)
        task = booked.task if order is None else order[1]
        outcome = outcome_of(
            booked.number, task, self.inspector.allocation, self.inspector.progress
        )
        if outcome.phase is TaskPhase.WITHDRAWN and not self.desk.confirmed(booked.number):
            outcome = outcome._replace(phase=TaskPhase.OPEN)  # no robot has said that it knows
        if outcome.phase is TaskPhase.DELIVERED:
            self.desk.finish(booked.number)
        vehicle.outcome = outcome

    def _book_number(self, port: "_Port", booked: BookedOrder) -> None:
        """The new number of an order. Where the disk takes no record, robots hear of it later."""
        try:
            self.book.write(booked)
        except OSError as problem:
            if not port.unbooked:
                why, order_id = problem.strerror or str(problem), booked.order.order_id
                self.lines.say(
                    "order-not-booked",
                    f"{self.serial(booked.slot)}: order {order_id} is task {booked.number} now, and "
                    f"waits until that can be booked: {why}",
                    robot=booked.slot, order=order_id, task=booked.number, why=why,
                )  # fmt: skip
            port.unbooked = True
        else:
            port.unbooked = False

    def _book_again(self) -> None:
        for port in self.ports.values():
            booked = port.vehicle.booked
            if port.unbooked and booked is not None:
                self._book_number(port, booked)

    def due(self) -> list[TaskOrder]:
        """Orders to say again: those whose number is booked."""
        unbooked = {
            port.vehicle.booked.number
            for port in self.ports.values()
            if port.unbooked and port.vehicle.booked is not None
        }
        return [order for order in self.desk.due() if order.task not in unbooked]

    def _finish_delivered(self) -> None:
        """Also those of earlier orders, which the book has recalled."""
        for number in list(self.desk.wanted):
            if self.inspector.allocation.phase_of(number) is Phase.DONE:
                self.desk.finish(number)

    def _heard(self, seen: Seen) -> HeardRobot:
        inspector, now_s = self.inspector, self.inspector.now_s
        loads = [
            task for task in inspector.allocation.assigned_sections(seen.slot)
            if task < TASKS_MAX and inspector.progress.bits(task, 0) & 1
            and inspector.allocation.phase_of(task) is not Phase.DONE
        ]  # fmt: skip
        return HeardRobot(
            not seen.left and now_s - seen.last_s <= SILENT_S,
            seen.placed and seen.has_place, seen.x_m, seen.y_m,
            self.courses.get(seen.slot, 0.0), seen.speed_m_s, seen.battery, seen.stopped,
            seen.started, seen.causes.sentences(round(now_s * 1e6)), loads,
        )  # fmt: skip

    # ---------------------------------------------------------------- what the master says

    def order(self, port: "_Port", order: MasterOrder) -> None:
        """Take an order, or report why not."""
        vehicle = port.vehicle
        try:
            whole = vehicle.takes(order)
            if whole is None:
                return
            transport = transport_of(whole, self.house, self.named.map_id)
        except OrderRefused as refused:
            vehicle.refuse(refused.error(order))
            self._refused(vehicle.slot, order, str(refused))
            return
        number, index = None, None
        if transport is not None:
            try:
                index = self.desk.order([transport.task])[0]
            except NumbersSpentError as spent:
                vehicle.refuse(OrderRefused("orderError", str(spent)).error(order))
                self._refused(vehicle.slot, order, str(spent))
                return
            number = self.desk.number_of(index)
        task = None if transport is None else transport.task
        booked = BookedOrder(vehicle.slot, whole, number, task)
        try:
            self.book.write(booked)  # before the first frame
        except OSError as problem:
            if number is not None:
                self.desk.forget(number)
            why = f"it cannot be booked: {problem.strerror or problem}"
            vehicle.refuse(OrderRefused("orderError", why).error(order))
            self._refused(vehicle.slot, order, why)
            return
        vehicle.accept(booked, transport)
        port.index = index
        if number is not None:
            self.lines.say(
                "order", f"{self.serial(vehicle.slot)}: order {order.order_id} is task {number}",
                robot=vehicle.slot, order=order.order_id, task=number,
            )  # fmt: skip

    def _refused(self, slot: int, order: MasterOrder, why: str) -> None:
        self.lines.say(
            "order-refused", f"{self.serial(slot)}: order {order.order_id} refused: {why}",
            robot=slot, order=order.order_id, why=why,
        )  # fmt: skip

    def act(self, port: "_Port", actions: InstantActions) -> None:
        """Begin the instant actions that are new."""
        for action in actions.actions:
            if port.vehicle.begin(action):
                task = asyncio.create_task(self._act(port, action))
                self.working.add(task)
                task.add_done_callback(self.working.discard)

    async def _act(self, port: "_Port", action: Action) -> None:
        vehicle = port.vehicle
        acts: dict[str, Callable[[], Awaitable[str | None]]] = {
            "startPause": partial(self._pause, port, True),
            "stopPause": partial(self._pause, port, False),
            "stop": self._stop,
            "cancelOrder": partial(self._cancel, port),
            "stateRequest": self._nothing,
            "factsheetRequest": partial(self._factsheet, port),
        }
        act = acts.get(action.action_type)
        if act is None:
            vehicle.report(action, ActionStatus.FAILED, f"{action.action_type} is not supported")
            return
        vehicle.report(action, ActionStatus.RUNNING)
        try:
            why = await act()
        except AttachError as problem:  # the key has ended, or its file is gone
            why = str(problem)
        except OSError as problem:
            why = f"it cannot be booked: {problem.strerror or problem}"
        status = ActionStatus.FINISHED if why is None else ActionStatus.FAILED
        none = why is not None and why.startswith(NO_ORDER)
        vehicle.report(action, status, why, NO_ORDER if none else INSTANT_ERROR)
        port.told_s = 0.0

    async def _nothing(self) -> str | None:
        return None

    async def _factsheet(self, port: "_Port") -> str | None:
        port.link.publish(factsheet_of(self.named.vehicle))
        return None

    async def _pause(self, port: "_Port", paused: bool) -> str | None:
        """One after the other: the robot has not yet said what the one before has made of it."""
        command, vehicle = Command.HOLD if paused else Command.START, port.vehicle
        async with port.pausing:
            self._take_key()
            end_s = asyncio.get_running_loop().time() + OBEY_S
            while asyncio.get_running_loop().time() < end_s:
                if vehicle.robot.heard and vehicle.robot.started is not paused:
                    return None
                self.operator.command(command, vehicle.slot)
                await asyncio.sleep(SAY_S / 2)
        return "the robot has not confirmed it; a fleet with keys needs --keys"

    async def _stop(self) -> str | None:
        unsigned = ""
        try:
            self._take_key()
        except AttachError as problem:  # robots brake for a stop without a tag, too
            self.operator.keyring, unsigned = None, f"{problem}; the stop is said unsigned; "
        begun_s = asyncio.get_running_loop().time()
        late = await press(self.operator, Reason.OPERATOR_INTERVENTION, OBEY_S)
        names = [self.serial(robot.slot) for robot in late]
        # A gateway that runs for days has heard addresses that are long gone.
        names += [f"address {each}" for each in self.operator.unnamed(begun_s - LIVE_S)]
        if names:
            return f"{unsigned}not confirmed by {', '.join(names)}"
        if not self.operator.live:
            return f"{unsigned}no robot is heard"
        return f"{unsigned}robots only brake while it is said" if unsigned else None

    async def _cancel(self, port: "_Port") -> str | None:
        self._observe(port)  # another device may have used its number
        vehicle, booked = port.vehicle, port.vehicle.booked
        if booked is None or not vehicle.busy:
            return f"{NO_ORDER}: there is no order"
        if booked.number is None or booked.task is None:
            self._book(vehicle, booked._replace(cancelled=True))
            return None
        if vehicle.outcome is not None and vehicle.outcome.phase is TaskPhase.ABOARD:
            return "the parcel is aboard, and will be delivered"
        if port.cancelling is None or port.cancelling.done():
            self._book(vehicle, booked._replace(cancelled=True, task=booked.task.taken_back))
            self.desk.withdraw(booked.number)
            port.cancelling = asyncio.create_task(self._taken_back(vehicle, booked.order.order_id))
            self.working.add(port.cancelling)
            port.cancelling.add_done_callback(self.working.discard)
        return await asyncio.shield(port.cancelling)

    async def _taken_back(self, vehicle: FleetVehicle, order_id: str) -> str | None:
        """When the fleet has said what becomes of an order: one wait for all that cancel it."""
        while (outcome := vehicle.outcome) is None or not outcome.final:
            await asyncio.sleep(TICK_S)
            if vehicle.booked is None or vehicle.booked.order.order_id != order_id:
                return None  # it was over, and the master has ordered the next
        if outcome.phase is TaskPhase.WITHDRAWN:
            return None
        return "the parcel was aboard, and is delivered"

    def _book(self, vehicle: FleetVehicle, booked: BookedOrder) -> None:
        self.book.write(booked)
        vehicle.booked = booked

    def _take_key(self) -> None:
        if self.keys is not None:
            self.operator.keyring = operator_keyring(self.keys, OBEY_S)
            assert self.operator.keyring is not None
            self.operator.slot = self.operator.keyring.sender


class _Port:
    """One vehicle at the broker, and what it has told last."""

    def __init__(self, gateway: MasterGateway, vehicle: FleetVehicle) -> None:
        self.vehicle, self.gateway = vehicle, gateway
        self.pausing = asyncio.Lock()
        self.cancelling: asyncio.Task[str | None] | None = None  # the wait for its order's end
        self.index: int | None = None  # of its order at the desk
        self.unbooked = False  # its order has a number that the book does not have yet
        booked = vehicle.booked
        if booked is not None and booked.number is not None:
            wanted = gateway.desk.wanted.get(booked.number)
            self.index = None if wanted is None else wanted[0]  # None: it is delivered
        self.told: VehicleState | None = None
        self.told_s = self.shown_s = 0.0
        named = gateway.named
        identity = VehicleAddress(
            named.interface, named.manufacturer, gateway.serial(vehicle.slot), named.version
        )
        self.link = BrokerLink(gateway.broker, identity, self._heard, self._up)
        self.link.invalid = self._invalid
        self.link.failed = self._failed
        self.running = self._begun()

    def _begun(self) -> asyncio.Task[None]:
        running = asyncio.create_task(self.link.run([Topic.ORDER, Topic.INSTANT_ACTIONS]))
        running.add_done_callback(self._is_over)
        return running

    def _is_over(self, running: asyncio.Task[None]) -> None:
        """A connection comes back by itself. One that has failed is begun again, and told to people."""
        problem = None if running.cancelled() else running.exception()
        if problem is None:
            return
        self._failed(repr(problem))
        self.running = asyncio.create_task(self._again())

    def _failed(self, why: str) -> None:
        serial = self.gateway.serial(self.vehicle.slot)
        self.gateway.lines.say(
            "connection-failed", f"{serial}: its connection has failed and is begun again: {why}",
            robot=self.vehicle.slot, serial=serial, why=why,
        )  # fmt: skip

    async def _again(self) -> None:
        await asyncio.sleep(AGAIN_S)
        self.running = self._begun()

    def _up(self) -> None:
        self.told_s = 0.0

    def _invalid(self, topic: str, why: ValueError) -> None:
        self.vehicle.invalid(topic, str(why).splitlines()[0])

    def _heard(self, message: MessageHeader) -> None:
        if isinstance(message, MasterOrder):
            self.gateway.order(self, message)
        elif isinstance(message, InstantActions):
            self.gateway.act(self, message)

    def tell(self, now_s: float, gateway: MasterGateway) -> None:
        """Publish what is due."""
        vehicle = self.vehicle
        if vehicle.robot.heard is not self.link.present:
            self.link.say(vehicle.robot.heard)
        state = vehicle.state(gateway.named.map_id, gateway.serial)
        changed = self.told is None or state.model_dump(exclude=CHANGES) != self.told.model_dump(
            exclude=CHANGES
        )
        if (changed or now_s - self.told_s >= STATE_S) and self.link.publish(state):
            self.told, self.told_s = state, now_s
        if now_s - self.shown_s >= VISUALIZATION_S:
            self.shown_s = now_s
            self.link.publish(vehicle.visualization(gateway.named.map_id))
