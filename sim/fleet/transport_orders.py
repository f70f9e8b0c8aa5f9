"""An operator's device that orders transports and repeats each order until robots have confirmed
it.

A robot that knows a task may die before it has sent it to another, so two robots must confirm it,
or all robots if there are fewer. If another device used the same number at the same time, the
greater order keeps it; robots apply the same rule.
"""

from collections.abc import Sequence

from agent.delivery.task_registry import TransportTask
from protocol.frames.delivery_frames import BUCKET_TASKS, TASK_NUMBERS, TaskBookDigest, TaskOrder
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.name import TOOL_FUNCTION, Name

ENOUGH = 2


class NumbersSpentError(Exception):
    """Every number that a transport can have belongs to one. One line for the person."""

    def __init__(self) -> None:
        super().__init__(
            f"all {TASK_NUMBERS} numbers of transports are used: robots keep each one for ever, so start "
            "a fleet with new state folders"
        )


class TransportClient:
    """Gives each order a task number, says it until enough robots know it, and takes another number
    where two devices used one."""

    def __init__(self, known: int = 0) -> None:
        """`known`: all robots know tasks below this number from the start."""
        # Task number -> index of our order, and the order.
        self.wanted: dict[int, tuple[int, TransportTask]] = {}
        self._number: dict[int, int] = {}  # index of our order -> its task number
        self.robots: set[int] = set()  # source addresses that have reported what they know
        self._known = self._first_free = known
        self._used: set[int] = set()  # numbers that were heard of
        self._tools: set[int] = set()  # source addresses of tools, which confirm nothing
        self._sure: dict[int, set[int]] = {}  # task -> robots that know it
        self._count = 0

    def order(self, orders: Sequence[TransportTask]) -> list[int]:
        """Order transports, each under the next number that is free. The results are their indexes,
        by which `number_of` names them also after a conflict. Raises NumbersSpentError."""
        return [self.recall(self._free(), order) for order in orders]

    def recall(self, number: int, order: TransportTask) -> int:
        """Order a transport under the number that it had before a restart. The result is its index."""
        self.wanted[number] = (self._count, order)
        self._number[self._count] = number
        self._count += 1
        return self._count - 1

    def forget(self, number: int) -> None:
        """Order it no more: no robot has heard of it."""
        self.wanted.pop(number, None)

    def finish(self, number: int) -> None:
        """Order it no more: it is delivered, and its number stays its own.

        A greater order under that number would else give ours a new one, and it would be carried again.
        """
        if self.wanted.pop(number, None) is not None and number < TASK_NUMBERS:
            self._use(number)

    def number_of(self, index: int) -> int:
        """The task number of one of our orders."""
        return self._number[index]

    def withdraw(self, number: int) -> None:
        """Take one of our orders back; it is said until a robot repeats that."""
        index, order = self.wanted[number]
        self.wanted[number] = (index, order.taken_back)
        self._sure.pop(number, None)

    def hear(self, source: int, message: Message) -> None:
        """Learn from the bus which robots know which tasks, and which numbers other devices have
        used."""
        if isinstance(message, AddressClaimed):
            if Name.unpack(message.name).function == TOOL_FUNCTION:
                self._tools.add(source)
            else:
                self._tools.discard(source)
        elif isinstance(message, TaskBookDigest) and source not in self._tools:
            self.robots.add(source)
            for k in range(BUCKET_TASKS):
                if message.bits >> k & 1:
                    self._know(message.bucket * BUCKET_TASKS + k, source)
        elif isinstance(message, TaskOrder) and message.task < TASK_NUMBERS:
            self._use(message.task)
            mine = self.wanted.get(message.task)
            other = TransportTask(message.pickup, message.dropoff)
            if mine is not None and other == mine[1] and other.withdrawn and source in self.robots:
                self._sure.setdefault(message.task, set()).add(source)
            if mine is not None and mine[1].taken_back == other:
                self.wanted[message.task] = (
                    mine[0],
                    other,
                )  # another device took it back, or we did
                return
            if mine is not None and other > mine[1]:  # the number belongs to another device's order
                del self.wanted[message.task]
                try:
                    number = self._free()
                except NumbersSpentError:  # it stays unconfirmed
                    number = TASK_NUMBERS + mine[0]
                self.wanted[number] = mine
                self._number[mine[0]] = number

    def _know(self, task: int, source: int) -> None:
        mine = self.wanted.get(task)
        if mine is not None and mine[1].withdrawn:
            return  # that a robot knows the task does not say that it knows this
        self._sure.setdefault(task, set()).add(source)
        if task not in self.wanted and task < TASK_NUMBERS:
            self._use(task)

    def _use(self, task: int) -> None:
        self._used.add(task)
        self._first_free = max(self._first_free, task + 1)

    def _free(self) -> int:
        """Above all that are used. Where somebody has used the last one, the lowest that is not."""
        above = max(self._first_free, *(number + 1 for number in self.wanted), 0)
        if above < TASK_NUMBERS:
            return above
        used = self._used | self.wanted.keys()
        gap = next((task for task in range(self._known, TASK_NUMBERS) if task not in used), None)
        if gap is None:
            raise NumbersSpentError
        return gap

    def confirmed(self, number: int) -> bool:
        """Whether two robots, or all there are, know the task with this number."""
        mine = self.wanted.get(number)
        # Of robots that hear of a withdrawal one repeats it, and the others have heard that.
        enough = 1 if mine is not None and mine[1].withdrawn else min(ENOUGH, len(self.robots))
        return bool(enough) and len(self._sure.get(number, ())) >= enough

    def due(self) -> list[TaskOrder]:
        """The orders to send again."""
        return [
            TaskOrder(number, *order)
            for number, (_, order) in self.wanted.items()
            if number < TASK_NUMBERS and not self.confirmed(number)
        ]

    @property
    def numbers(self) -> list[int]:
        """The task numbers of our orders, in their order."""
        return sorted(self.wanted, key=lambda number: self.wanted[number][0])
