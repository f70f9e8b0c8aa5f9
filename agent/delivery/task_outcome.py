"""What has become of a transport task, for people and programs that ordered it.

Robots tell it in registers and bits of progress. This is the one place that says what those mean.
"""

from enum import StrEnum
from typing import NamedTuple

from agent.delivery.task_registry import TransportTask
from crdt import FieldAllocationCRDT, Phase, Progress

PICKED_UP = 1 << 0  # the units of a task, as bits of its progress


class TaskPhase(StrEnum):
    """How far a task is. DELIVERED and WITHDRAWN are final."""

    OPEN = "open"  # no robot has begun it
    FETCHING = "fetching"  # a robot drives to the parcel
    ABOARD = "aboard"  # a robot carries the parcel, or has stopped with it
    DELIVERED = "delivered"
    WITHDRAWN = "withdrawn"  # its order was taken back before the parcel was picked up


class TaskOutcome(NamedTuple):
    """How far a task is, and which robot holds it."""

    phase: TaskPhase
    carrier: int | None  # slot; None: nobody

    @property
    def final(self) -> bool:
        """Whether it can change no more."""
        return self.phase in (TaskPhase.DELIVERED, TaskPhase.WITHDRAWN)


def outcome_of(
    task: int, order: TransportTask | None, allocation: FieldAllocationCRDT, progress: Progress
) -> TaskOutcome:
    """The outcome of a task by one replica. `order`: None if its order was not heard."""
    phase, carrier = allocation.phase_of(task), allocation.owner_of(task)
    if phase is Phase.DONE:
        return TaskOutcome(TaskPhase.DELIVERED, carrier)
    if progress.bits(task, 0) & PICKED_UP:
        return TaskOutcome(TaskPhase.ABOARD, carrier)
    if order is not None and order.withdrawn:
        return TaskOutcome(TaskPhase.WITHDRAWN, None)
    if phase is Phase.STARTED:
        return TaskOutcome(TaskPhase.FETCHING, carrier)
    return TaskOutcome(TaskPhase.OPEN, carrier)
