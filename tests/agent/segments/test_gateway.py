"""What one gateway makes of frames on its bus; fleets of gateways are in test_segments_rig.py."""

from agent.interface.config import MS, S
from agent.segments.gateway import Gateway
from agent.segments.segment_area import Area
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.segment_frames import GATEWAY_ADDRESS
from protocol.frames.work_frames import TaskClaim
from protocol.name import GATEWAY_FUNCTION, Name

ROBOT = 0x80  # bus address
OLD = TaskClaim(3, epoch=1, phase=Phase.CLAIMED, bid=3, lamport=5, owner=1)
NEW = TaskClaim(3, epoch=2, phase=Phase.CLAIMED, bid=3, lamport=9, owner=1)


def test_an_old_claim_from_a_gateway_with_our_number_raises_nothing() -> None:
    """A gateway that listens takes the lowest number only if no other one has it."""
    name = Name(5, function=GATEWAY_FUNCTION, arbitrary_address=0)
    gateway = Gateway(Area(2, 10), name, 5, 0)
    for claim, source, now_us in ((NEW, ROBOT, MS), (OLD, GATEWAY_ADDRESS, S // 2)):
        gateway.on_frame(encode(claim, source, GLOBAL_ADDRESS), now_us)
    assert gateway.border.allocation.entry(3).epoch == NEW.epoch
