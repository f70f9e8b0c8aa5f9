"""What the registers of a task mean, in one word."""

import pytest

from agent.delivery.task_outcome import TaskOutcome, TaskPhase, outcome_of
from agent.delivery.task_registry import TransportTask
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack

ORDER = TransportTask(1, 2)


@pytest.mark.parametrize(
    ("phase", "bits", "order", "outcome"),
    [
        (Phase.FREE, 0, ORDER, TaskOutcome(TaskPhase.OPEN, None)),
        (Phase.FREE, 0, None, TaskOutcome(TaskPhase.OPEN, None)),
        (Phase.CLAIMED, 0, ORDER, TaskOutcome(TaskPhase.OPEN, 4)),
        (Phase.STARTED, 0, ORDER, TaskOutcome(TaskPhase.FETCHING, 4)),
        (Phase.STARTED, 1, ORDER, TaskOutcome(TaskPhase.ABOARD, 4)),
        (Phase.FREE, 1, ORDER, TaskOutcome(TaskPhase.ABOARD, None)),
        (Phase.DONE, 3, ORDER, TaskOutcome(TaskPhase.DELIVERED, 4)),
        (Phase.DONE, 0, None, TaskOutcome(TaskPhase.DELIVERED, 4)),
        (Phase.FREE, 0, ORDER.taken_back, TaskOutcome(TaskPhase.WITHDRAWN, None)),
        (Phase.STARTED, 1, ORDER.taken_back, TaskOutcome(TaskPhase.ABOARD, 4)),
        (Phase.DONE, 3, ORDER.taken_back, TaskOutcome(TaskPhase.DELIVERED, 4)),
    ],
)
def test_an_outcome_is_read_without_progress_bits(
    phase: Phase, bits: int, order: TransportTask | None, outcome: TaskOutcome
) -> None:
    allocation, progress = FieldAllocationCRDT(), Progress({})
    if phase is not Phase.FREE:
        allocation.apply(5, pack(0, phase, 3, 7, 4))
    if bits:
        progress.apply(5, 0, bits)
    assert outcome_of(5, order, allocation, progress) == outcome
    assert outcome.final is (outcome.phase in ("delivered", "withdrawn"))
