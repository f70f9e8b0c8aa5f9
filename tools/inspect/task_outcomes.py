"""`headland task list`, `status` and `withdraw`: what has become of the transports of a fleet."""

import asyncio
import sys
from collections import Counter
from typing import Any, NamedTuple

from agent.delivery.task_outcome import TaskOutcome, TaskPhase, outcome_of
from agent.delivery.task_registry import HIGHEST_ASKED, TransportTask
from agent.delivery.warehouse import Warehouse
from protocol.frames.codec import Malformed, decode
from protocol.frames.delivery_frames import BUCKET_TASKS, TaskBookDigest, TaskOrder
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from protocol.name import TOOL_FUNCTION, Name
from sim.files.strict_json import dumps
from tools.common.bus_address import Attached, AttachError
from tools.common.bus_attach import attach
from tools.common.exit_codes import wrong
from tools.common.told_wait import told_wait
from tools.inspect.inspector import Inspector
from tools.operate.operator_device import Operator
from tools.operate.task_numbers import LISTEN_S

ASK_S = 0.5  # between questions for orders; robots answer two a beat
LEARN_S = 60.0  # for all orders: 500 of them take 13 s
BUCKETS_ASKED = 16  # at once, of those that nobody has told: a share of 2 % of a slow bus
ASKED_MAX = 2  # a bucket about which nobody says a word has no tasks; one question may be lost
DUMB_S = (
    3.0  # without a further order: nobody answers, and a list without places is better than none
)
LOOK_S = 0.2
UNFINISHED = f"headland: more tasks than robots tell in {LEARN_S:.0f} s: the list may lack some"
AGAIN_S = 2.0  # between questions for registers while waiting
NOT_DELIVERED = 1


class ListedTask(NamedTuple):
    """One task, as the fleet tells it."""

    number: int
    order: TransportTask | None  # None: no robot has said it
    outcome: TaskOutcome

    def to_dict(self, house: Warehouse | None) -> dict[str, Any]:
        """Plain values; places are in metres where the floor is known."""
        found: dict[str, Any] = {
            "task": self.number, "outcome": str(self.outcome.phase), "final": self.outcome.final,
            "carrier": self.outcome.carrier,
        }  # fmt: skip
        if house is not None and self.order is not None:
            pickup = None if self.order.withdrawn else house.place(self.order.pickup)
            found |= {"pickup": pickup, "dropoff": house.place(self.order.dropoff)}
        return found


class TaskListener:
    """Everything that a bus says about tasks, and questions to the fleet about the rest."""

    def __init__(self, bus: CanBus) -> None:
        """It begins to listen, on the running loop."""
        self.operator, self.inspector = Operator(bus, None), Inspector()
        self.known: set[int] = set()  # numbers that robots have told
        self.orders: dict[int, TransportTask] = {}
        self._told: set[int] = set()  # buckets of which a robot has told which tasks it knows
        self._loop = asyncio.get_running_loop()
        bus.subscribe(self.hear)

    def hear(self, frame: Frame) -> None:
        """Take one frame."""
        now_s = self._loop.time()
        self.operator.hear(now_s, frame)
        self.inspector.hear(now_s, frame)
        source, message = decode(frame)
        if isinstance(message, Malformed):
            return
        if isinstance(message, TaskBookDigest):
            bits = (k for k in range(BUCKET_TASKS) if message.bits >> k & 1)
            self.known.update(message.bucket * BUCKET_TASKS + k for k in bits)
            if Name.unpack(self.operator.names.get(source, 0)).function != TOOL_FUNCTION:
                self._told.add(message.bucket)  # a tool's question tells only what it has heard
        elif isinstance(message, TaskOrder):
            order = TransportTask(message.pickup, message.dropoff)
            self.orders[message.task] = max(order, self.orders.get(message.task, order))
            self.known.add(message.task)

    async def learn(self, only: int | None = None) -> bool:
        """Ask until every task is known, with its order; `only`: until this one is. False if the time was
        too short. Raises AttachError without a fleet."""
        listening = asyncio.ensure_future(self.operator.listen(LISTEN_S))
        while not listening.done():
            self.operator.send(HIGHEST_ASKED)  # a round of all digests takes a second a bucket
            await asyncio.wait([listening], timeout=ASK_S)
        listening.result()
        if not self.known and not self.inspector.robots:
            raise AttachError("no delivering fleet is heard on this bus: headland launch warehouse")
        self.operator.ask_work()
        asked = Counter[int]()
        learned, last_s, end_s = len(self.orders), self._loop.time(), self._loop.time() + LEARN_S
        while self._unsure(only) and self._loop.time() < min(last_s + DUMB_S, end_s):
            lacking = {task // BUCKET_TASKS for task in self.known - self.orders.keys()}
            unasked = [b for b in self._unsure(only) if b not in lacking and asked[b] < ASKED_MAX]
            if len(self.orders) > learned or unasked:
                learned, last_s = len(self.orders), self._loop.time()
            for bucket in lacking & set(self._unsure(only)) | set(unasked[:BUCKETS_ASKED]):
                mine = {t % BUCKET_TASKS for t in self.orders if t // BUCKET_TASKS == bucket}
                self.operator.send(TaskBookDigest(bucket, 0, 0, sum(1 << k for k in mine)))
                asked[bucket] += 1
            await asyncio.sleep(ASK_S)
        await asyncio.sleep(ASK_S)  # the answers about registers may be under way
        return self._loop.time() < end_s

    def _unsure(self, only: int | None) -> list[int]:
        """The buckets that may have more tasks than we know, or whose orders were not all heard; `only`:
        as in `learn`."""
        highest = max(self.known, default=0) // BUCKET_TASKS
        wanted = range(highest + 1) if only is None else (only // BUCKET_TASKS,)
        lacking = {task // BUCKET_TASKS for task in self.known - self.orders.keys()}
        sure = self._told - lacking if only not in self.orders else set(wanted)
        return [bucket for bucket in wanted if bucket not in sure]

    def task(self, number: int) -> ListedTask:
        """One task by what is known now."""
        order, inspector = self.orders.get(number), self.inspector
        outcome = outcome_of(number, order, inspector.allocation, inspector.progress)
        return ListedTask(number, order, outcome)


def list_tasks(house: Warehouse | None, where: Attached, as_json: bool) -> int:
    """The exit code of `headland task list`: 0, or 2 without a fleet."""

    async def story() -> list[ListedTask]:
        bus = attach(*where)
        try:
            listener = TaskListener(bus)
            if not await listener.learn():
                print(UNFINISHED, file=sys.stderr)
            return [listener.task(number) for number in sorted(listener.known)]
        finally:
            bus.close()

    try:
        with told_wait("robots tell their tasks", LISTEN_S + LEARN_S):
            found = asyncio.run(story())
    except AttachError as problem:
        return wrong(problem)
    if as_json:
        print(dumps([each.to_dict(house) for each in found]))
    else:
        for each in found:
            print(_line(each))
    return 0


def status(
    number: int, wait_s: float, house: Warehouse | None, where: Attached, as_json: bool
) -> int:
    """The exit code of `headland task status`: 0 if it is delivered, 1 if not, 2 if nobody knows it.

    `wait_s`: how long to wait for a final outcome."""

    async def story() -> ListedTask | None:
        bus = attach(*where)
        try:
            listener = TaskListener(bus)
            await listener.learn(number)
            if number not in listener.known:
                return None
            loop = asyncio.get_running_loop()
            end_s, asked_s = loop.time() + wait_s, loop.time()
            while not listener.task(number).outcome.final and loop.time() < end_s:
                if loop.time() - asked_s > AGAIN_S:
                    listener.operator.ask_work()
                    asked_s = loop.time()
                await asyncio.sleep(LOOK_S)
            return listener.task(number)
        finally:
            bus.close()

    try:
        with told_wait(f"task {number}", LISTEN_S + LEARN_S + wait_s):
            found = asyncio.run(story())
    except AttachError as problem:
        return wrong(problem)
    if found is None:
        return wrong(f"no robot knows task {number}: headland task list")
    print(dumps(found.to_dict(house)) if as_json else _line(found))
    return 0 if found.outcome.phase is TaskPhase.DELIVERED else NOT_DELIVERED


def _line(task: ListedTask) -> str:
    carrier = task.outcome.carrier
    by = "" if carrier is None else f" by robot {carrier}"
    return f"task {task.number}: {task.outcome.phase}{by}"
