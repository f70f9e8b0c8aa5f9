"""What gateways make of the sections that they share; whole fleets are in test_segments_rig.py."""

from agent.segments.segment_area import Area, SegmentPlace
from agent.segments.work_relay import REPAIRS_APART_MAX, UNKNOWN_OWNER, WorkRelay
from crdt import Phase
from crdt.claim_register import LAMPORT_MAX, pack
from protocol.backbone_messages import Entry
from protocol.frames.work_frames import TASK_CLAIM, TaskClaim

NEIGHBOUR, HOME, BORROWED = 3, 1, 10


def test_an_entry_lost_after_days_of_a_difference_that_cannot_be_repaired_is_sent_again() -> None:
    relay = WorkRelay(Area(2, 10, lent={4: frozenset({NEIGHBOUR})}))
    never = relay.digest(NEIGHBOUR) + 1  # the neighbour has another plan of the border
    for _ in range(40 * REPAIRS_APART_MAX):
        relay.on_digest(NEIGHBOUR, never)
    claim = TaskClaim(4, epoch=0, phase=Phase.CLAIMED, bid=3, lamport=5, owner=1)
    relay.allocation.claim(4, 1)
    relay.on_message(claim, from_gateway=False)
    assert [len(entries) for _, entries in relay.outgoing()] == [1], "and it is lost"
    for _ in range(REPAIRS_APART_MAX):
        relay.on_digest(NEIGHBOUR, never)
    assert [len(entries) for _, entries in relay.outgoing()] == [1]


def decided(relay: WorkRelay, phase: Phase, epoch: int) -> list[tuple[int, int | None]]:
    """The sections that change when their home says that a robot of ours has one."""
    claim = TaskClaim(0, epoch=epoch, phase=phase, bid=0, lamport=9, owner=0)
    told = Entry(1, HOME, 0, relay.area.segment, UNKNOWN_OWNER, TASK_CLAIM.pack(claim))
    return list(relay.on_entries(HOME, [told]))


def test_what_the_home_decides_about_a_claim_of_ours_is_not_lost() -> None:
    """The home raises the epoch of one of two claims that differ only in their owners. The robot had
    given its section back meanwhile, and so the home said for good that it has it."""
    relay = WorkRelay(Area(2, 10, borrowed={BORROWED: SegmentPlace(HOME, 0)}))
    relay.allocation.claim(BORROWED, 5)
    assert decided(relay, Phase.CLAIMED, 1) == [(BORROWED, None)]
    assert relay.allocation.entry(BORROWED).owner == 5
    relay.allocation.release(BORROWED, 5)
    assert relay.allocation.entry(BORROWED)[:2] == (2, Phase.FREE)
    assert decided(relay, Phase.STARTED, 2) == [(BORROWED, None)]
    assert relay.allocation.owner_of(BORROWED) == 5, "it gives back what it holds unknowingly"


def test_a_segment_without_memory_learns_from_the_home_what_it_had() -> None:
    relay = WorkRelay(Area(2, 10, borrowed={BORROWED: SegmentPlace(HOME, 0)}))
    assert decided(relay, Phase.FREE, 3) == [(BORROWED, None)]
    assert relay.allocation.entry(BORROWED)[:2] == (3, Phase.FREE)
    assert decided(relay, Phase.CLAIMED, 3) == [(BORROWED, None)]


def test_the_home_decides_between_two_equal_claims_when_the_clock_has_stopped() -> None:
    """One wrong frame carries the clock to its end. Then two segments worked each section that both had
    claimed, because all their claims have the same time."""
    home = WorkRelay(Area(2, 10, lent={4: frozenset({NEIGHBOUR})}))
    home.allocation.apply(9, pack(0, Phase.FREE, 0, LAMPORT_MAX, 0))
    home.allocation.claim(4, 5, bid=3)
    theirs = TaskClaim(4, epoch=0, phase=Phase.CLAIMED, bid=3, lamport=LAMPORT_MAX, owner=1)
    told = Entry(1, 2, 4, NEIGHBOUR, 1, TASK_CLAIM.pack(theirs))
    assert list(home.on_entries(NEIGHBOUR, [told])) == [(4, None)]
    assert home.allocation.entry(4) == (1, Phase.CLAIMED, 3, LAMPORT_MAX, 5)
    ((_, (answer,)),) = home.outgoing()
    assert TASK_CLAIM.unpack(answer.data).epoch == 1, "the neighbour is told"
