"""What a gateway sends again of the sections that it shares; fleets are in test_segments_rig.py."""

from agent.segments.segment_area import Area
from agent.segments.work_relay import REPAIRS_APART_MAX, WorkRelay
from crdt import Phase
from protocol.frames.work_frames import TaskClaim

NEIGHBOUR = 3


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
