"""What a revoked member said is taken out of a replica, and nothing that others said."""

from hypothesis import given
from hypothesis import strategies as st

from crdt import FieldAllocationCRDT, Phase, Progress
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.sync.replica import Replica
from protocol.sync.vouchers import Vouchers

THIEF = 3
DONE, CLAIMED, STARTED = int(Phase.DONE), int(Phase.CLAIMED), int(Phase.STARTED)


def replica(units: int = 40) -> Replica:
    made = Replica(FieldAllocationCRDT(), Progress(dict.fromkeys(range(4), units)))
    made.vouchers = Vouchers()
    return made


def test_a_forged_end_is_taken_out_and_the_honest_claim_before_it_returns() -> None:
    ours = replica()
    ours.on_message(TaskClaim(0, 0, STARTED, 0, 5, 1), 1, 10)
    digest = ours.digest
    ours.on_message(StateSyncResponse(0, 0, DONE, 0, 9, 1), THIEF, 20)  # in the name of robot 1
    assert ours.allocation.done_count() == 1
    assert ours.void(THIEF, None) == ([0], [])
    assert ours.allocation.owner_of(0) == 1 and ours.allocation.phase_of(0) is Phase.STARTED
    assert ours.digest == digest and ours.allocation.done_count() == 0


def test_what_it_said_before_the_stated_point_remains() -> None:
    ours = replica()
    ours.on_message(TaskClaim(0, 0, DONE, 0, 5, THIEF), THIEF, 10)
    ours.on_message(WorkProgress(2, 0, 0b1), THIEF, 10)
    ours.on_message(TaskClaim(1, 0, DONE, 0, 6, THIEF), THIEF, 30)
    ours.on_message(WorkProgress(2, 0, 0b11), THIEF, 30)
    assert ours.void(THIEF, 20) == ([1], [2 << 8])
    assert ours.allocation.phase_of(0) is Phase.DONE and ours.allocation.key(1) is None
    assert ours.progress.bits(2, 0) == 0b1


def test_a_claim_of_the_revoked_member_goes_whoever_relayed_it() -> None:
    ours = replica()
    ours.on_message(StateSyncResponse(2, 0, DONE, 0, 5, THIEF), 1, 10)
    assert ours.void(THIEF, None) == ([2], []) and len(ours.allocation) == 0


def test_a_section_that_was_ended_because_of_void_units_is_free_again() -> None:
    ours = replica(2)
    ours.on_message(WorkProgress(0, 0, 0b10), THIEF, 10)
    ours.on_message(WorkProgress(0, 0, 0b01), 1, 11)
    ours.on_message(TaskClaim(0, 0, DONE, 0, 5, 1), 1, 12)
    assert ours.void(THIEF, None) == ([0], [0])
    assert ours.allocation.phase_of(0) is Phase.FREE and ours.progress.bits(0, 0) == 0b01


CLAIMS = st.builds(
    TaskClaim, st.integers(0, 3), st.integers(0, 2), st.sampled_from([CLAIMED, STARTED, DONE]),
    st.integers(0, 3), st.integers(0, 20), st.integers(0, 2),
)  # fmt: skip
UNITS = st.builds(WorkProgress, st.integers(0, 3), st.just(0), st.integers(1, (1 << 40) - 1))


@given(st.lists(st.tuples(CLAIMS | UNITS, st.booleans()), max_size=30))
def test_after_it_the_replica_never_has_more_than_without_the_thief(
    said: list[tuple[TaskClaim | WorkProgress, bool]],
) -> None:
    """And its sums are those of its entries: digests of equal replicas stay equal."""
    ours, without = replica(), replica()
    for now_us, (message, forged) in enumerate(said):
        ours.on_message(message, THIEF if forged else message[0] % 3, now_us)
        if not forged:
            without.on_message(message, message[0] % 3, now_us)
    ours.void(THIEF, None)
    for section in ours.allocation.sections():
        assert (ours.allocation.key(section) or 0) <= (without.allocation.key(section) or 0)
        assert without.progress.bits(section, 0) | ours.progress.bits(section, 0) == (
            without.progress.bits(section, 0)
        )
    again = Replica(FieldAllocationCRDT(), Progress(dict.fromkeys(range(4), 40)))
    for section, key in ours.allocation.entries().items():
        again.allocation.apply(section, key)
    for section, block, bits in ours.progress.entries():
        again.progress.apply(section, block, bits)
    assert again.digest == ours.digest
    assert again.allocation.done_count() == ours.allocation.done_count()
