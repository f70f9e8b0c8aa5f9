"""Frames of other devices, and members that are gone, that once ended a robot or misled it."""

import pytest

from agent.peer.inputs import Received
from agent.peer.member_discovery import MemberDiscovery
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.name import tool_name
from protocol.rekeying import Rekeying
from sim.rigs.keyed_rig import KeyedRig

ELSEWHERE, GONE = 200, 2
CLAIM_PGN = 0xEE00
PAGES = (1 << 24, 1 << 25, 3 << 24)  # data page, extended data page, both


def test_the_screen_of_a_terminal_has_no_line_for_a_revoked_robot() -> None:
    """The leader looked up the standing of every robot of the fleet, and ended with a KeyError."""
    rig = KeyedRig(1)
    peer = rig.peers[0]
    rig.forge(AddressClaimed(tool_name(ELSEWHERE).pack()), ELSEWHERE)
    new = Rekeying(1, bytes(range(16)), GONE)
    peer.named.keys._next = new
    rig.tell(0, Received(encode(new.switch(), ELSEWHERE)))
    assert GONE not in peer.membership.standing
    rows = peer.named.terminal._screen(peer.context(rig.now_us)).rows
    assert [row.split()[0] for row in rows] == ["0", "1"]


def test_a_request_is_a_request_only_on_its_own_data_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame of another group with the same PDU format counted as a request for names."""
    rig, heard = KeyedRig(1), list[int]()
    monkeypatch.setattr(MemberDiscovery, "overheard", lambda _, to, now_us: heard.append(to))
    real = encode(Request(CLAIM_PGN), ELSEWHERE, 60)
    for page in PAGES:
        rig.tell(0, Received(Frame(real.identifier | page, real.data)))
    assert heard == []
    rig.tell(0, Received(real))
    assert heard == [60]
