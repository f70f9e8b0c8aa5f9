"""The tasks that exist: a map from number to pickup and dropoff that only grows, joined by maximum.

A robot that knows a task missing in another robot's digest repeats its order, unless another robot
has just done so. A robot that misses a task of another robot's digest answers with its own digest of
those tasks, because it would not come to them by itself. A device that means to order transports asks for
the highest number with an empty digest of the last bucket, because a round of all digests takes minutes.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from struct import Struct
from typing import NamedTuple
from zlib import crc32

from agent.interface.config import MS, S
from crdt.digest import mix
from protocol.frames.delivery_frames import (
    BUCKET_TASKS,
    CHECK_BITS,
    ORDER_SALTS,
    TASK_NUMBERS,
    TaskBookDigest,
    TaskOrder,
)

TASKS_MAX = 0x6000  # sections from here on are visits of charger bays
assert TASK_NUMBERS <= TASKS_MAX
DIGEST_US = 1 * S  # between two digests of one peer, each of one bucket of tasks
AGAIN_US = 400 * MS  # an order received within this time is not repeated
KEY, LAYOUT = "order/", Struct("<HH")  # of a durable record: pickup, dropoff
# The pickup of an order that was taken back. No floor has this cell, and the greatest wins the join.
WITHDRAWN = 0xFFFF
LAST_BUCKET = TASK_NUMBERS // BUCKET_TASKS - 1
HIGHEST_ASKED = TaskBookDigest(LAST_BUCKET, 0, 0, 0)  # robots answer with their highest bucket
NO_TASKS: Mapping[int, "TransportTask"] = {}
ORDERS_A_BEAT = 2  # so that a late joiner of 500 tasks does not fill the bus


class TransportTask(NamedTuple):
    """A task: cells of the floor, counted as `Warehouse.place` says."""

    pickup: int
    dropoff: int

    @property
    def withdrawn(self) -> bool:
        """Whether the order was taken back. A parcel that is aboard by then is delivered anyway."""
        return self.pickup == WITHDRAWN

    @property
    def taken_back(self) -> "TransportTask":
        """What an operator sends to take it back."""
        return self._replace(pickup=WITHDRAWN)


def recalled_orders(recalled: Mapping[str, bytes]) -> dict[int, TransportTask]:
    """Tasks received while running, from durable memory, by number. Records that do not parse are
    skipped.
    """
    found = {}
    for key, raw in sorted(recalled.items()):
        number = key.removeprefix(KEY)
        if key.startswith(KEY) and number.isdecimal() and len(raw) == LAYOUT.size:
            found[int(number)] = TransportTask(*LAYOUT.unpack(raw))
    return found


def record(task: int, order: TransportTask) -> tuple[str, bytes]:
    """Key and value of the durable record of a task."""
    return f"{KEY}{task}", LAYOUT.pack(*order)


def stop_names(begun: Iterable[int], ahead: Iterable[int], load: int) -> list[str]:
    """An itinerary as people read it: P5 picks task 5 up, D5 delivers it, C1 is charger bay 1.

    `begun`: stops under way, `ahead`: the later ones; each is a task, or `TASKS_MAX` plus a bay.
    `load`: the task whose parcel is aboard, which need not be picked up; -1: none.
    """
    found = []
    for stop in (*begun, *ahead):
        if stop >= TASKS_MAX:
            found.append(f"C{stop - TASKS_MAX}")
        else:
            found += [f"P{stop}"] * (stop != load) + [f"D{stop}"]
    return found


class TaskRegistry:
    """The replica of one peer, and what it still has to send to make others equal."""

    def __init__(
        self,
        slot: int,
        tasks: Mapping[int, TransportTask],
        now_us: int,
        on_floor: Callable[[TransportTask], bool] = lambda order: True,
        recalled: Mapping[int, TransportTask] = NO_TASKS,
    ) -> None:
        """`slot`: ours. `tasks`: those that every robot was given before the start, by number.
        `on_floor`: whether both cells of an order are places of the building, which is the same for all
        robots; other orders, and numbers without a bucket, are counted in `refused`. `recalled`: tasks
        received before a restart; one that is refused does not hide the task that was given.
        """
        self._on_floor = on_floor
        self.refused = (
            0  # orders with cells that are no places, or with a number that has no bucket
        )
        self.tasks: dict[int, TransportTask] = {}
        for task, order in (*tasks.items(), *recalled.items()):
            if task < TASK_NUMBERS and self._is_sound(order):
                self.tasks[task] = order
            else:
                self.refused += 1
        # When we last told that we lack some of a bucket.
        self._asked_at_us: dict[int, int] = {}
        self._lacking: dict[int, None] = {}  # buckets to tell, because others know more
        self.added = 0  # change counter, so that cached results can detect changes
        self._due: dict[int, int] = {}  # task to send again, and from when
        self._heard_at_us: dict[int, int] = {}
        self._slot, self._turn = slot, slot
        self._salt = slot % ORDER_SALTS  # another one in each round of the buckets
        # So that robots do not send in the same beat.
        self._digest_at_us = now_us + DIGEST_US + slot * 37 * MS

    def __contains__(self, task: int) -> bool:
        return task in self.tasks

    def _is_sound(self, order: TransportTask) -> bool:
        """Whether its cells are places. An order that was taken back has no pickup any more."""
        return self._on_floor(order._replace(pickup=order.dropoff) if order.withdrawn else order)

    def on_message(
        self, message: TaskOrder | TaskBookDigest, now_us: int
    ) -> tuple[tuple[str, bytes], ...]:
        """Take in an order or a digest of another peer.

        The returned records must be durable before any frame reveals that we know the task. An
        order with a known number and other cells: the greater pair of cells wins at all peers.
        """
        if isinstance(message, TaskOrder):
            return self._order(message, now_us)
        self._compare(message, now_us)
        return ()

    def _order(self, message: TaskOrder, now_us: int) -> tuple[tuple[str, bytes], ...]:
        if message.task >= TASK_NUMBERS:
            self.refused += 1
            return ()
        self._heard_at_us[message.task] = now_us
        self._due.pop(message.task, None)
        order, known = TransportTask(message.pickup, message.dropoff), self.tasks.get(message.task)
        if not self._is_sound(order):
            self.refused += 1
            return ()
        if known is None or order > known:
            self.tasks[message.task] = order
            self.added += 1
            self._due[message.task] = now_us + AGAIN_US  # repeat it once for robots that missed it
            return (record(message.task, order),)
        if order < known:
            self._due[message.task] = now_us
        return ()

    def _compare(self, message: TaskBookDigest, now_us: int) -> None:
        bits, check = self._digest(message.bucket, message.salt)
        fresh = now_us - self._asked_at_us.get(message.bucket, -AGAIN_US) >= AGAIN_US
        if message.bits & ~bits and fresh:
            self._asked_at_us[message.bucket] = now_us
            self._lacking[message.bucket] = None
        elif message.bucket == LAST_BUCKET and not message.bits | bits and self.tasks and fresh:
            self._asked_at_us[message.bucket] = now_us
            self._lacking[max(self.tasks) // BUCKET_TASKS] = None
        lacking = bits & ~message.bits
        if not lacking and bits == message.bits and check != message.check:
            lacking = bits  # one number, two tasks: send ours, so that all take the greater one
        for k in range(BUCKET_TASKS):
            task = message.bucket * BUCKET_TASKS + k
            if lacking >> k & 1 and now_us - self._heard_at_us.get(task, -AGAIN_US) >= AGAIN_US:
                self._due.setdefault(task, now_us + self._slot % 8 * 50 * MS)

    def _digest(self, bucket: int, salt: int) -> tuple[int, int]:
        """Which tasks of a bucket we know, and the check of their orders. A CRC alone would not do: two
        lists that have one CRC with a salt before them have one with every salt."""
        bits, found = 0, []
        for k in range(BUCKET_TASKS):
            order = self.tasks.get(bucket * BUCKET_TASKS + k)
            if order is not None:
                bits |= 1 << k
                found.append((k, *order))
        return bits, mix(salt << 32 | crc32(repr(found).encode())) >> 64 - CHECK_BITS

    def _told(self, bucket: int) -> TaskBookDigest:
        bits, check = self._digest(bucket, self._salt)
        return TaskBookDigest(bucket, self._salt, check, bits)

    def outgoing(self, now_us: int) -> Iterator[TaskOrder | TaskBookDigest]:
        """The frames that are due with our beat: repeated orders, and a digest."""
        told = [task for task, due_at_us in self._due.items() if due_at_us <= now_us][
            :ORDERS_A_BEAT
        ]
        for task in told:
            del self._due[task]
            self._heard_at_us[task] = now_us
            yield TaskOrder(task, *self.tasks[task])
        if self._lacking:  # a digest that shows what we lack makes others repeat it
            bucket = next(iter(self._lacking))
            del self._lacking[bucket]
            yield self._told(bucket)
        if now_us >= self._digest_at_us:
            self._digest_at_us = now_us + DIGEST_US
            # Empty buckets are left out. One order with a high number would delay all others.
            buckets = sorted({task // BUCKET_TASKS for task in self.tasks}) or [0]
            self._turn = (self._turn + 1) % len(buckets)
            if self._turn == 0:
                self._salt = (self._salt + 1) % ORDER_SALTS
            yield self._told(buckets[self._turn])
