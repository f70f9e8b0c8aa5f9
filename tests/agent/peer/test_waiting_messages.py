"""A long message that waits for another one to the same address is sent when that has ended."""

from agent.interface.config import MS, S
from agent.peer.diagnostics import COMPONENT_PGN
from agent.peer.pgn_responder import LOG_PGN
from protocol.frames.codec import decode
from protocol.frames.network_frames import (
    AddressClaimed,
    Request,
    TransportData,
    TransportManagement,
)
from protocol.name import tool_name
from protocol.transport import Transport
from sim.rigs.keyed_rig import KeyedRig

TOOL = 150


def test_two_long_answers_to_one_tool_arrive_one_after_the_other() -> None:
    """Found by a review: the second one was never sent."""
    rig = KeyedRig(1, robots=2, keyed=False)
    rig.forge(AddressClaimed(tool_name(5).pack()), TOOL)
    tool, got, robot = Transport(), list[int](), rig.address_of(0)
    rig.recorded.clear()
    for pgn in (COMPONENT_PGN, LOG_PGN):
        rig.forge(Request(pgn), TOOL, robot)
    ends_at_us = rig.now_us + 5 * S
    while rig.now_us < ends_at_us and len(got) < 2:
        rig.run_for(10 * MS)
        heard = list(rig.recorded)
        rig.recorded.clear()
        for frame in heard:
            source, message = decode(frame)
            to = frame.identifier >> 8 & 0xFF
            if to == TOOL and isinstance(message, TransportManagement | TransportData):
                out, whole = tool.on_message(source, to, message, rig.now_us)
                got += [] if whole is None else [whole.pgn]
                for said in out:
                    rig.forge(said.message, TOOL, said.destination)
    assert got == [COMPONENT_PGN, LOG_PGN]
    assert not rig.peers[0].named.letters._waiting
