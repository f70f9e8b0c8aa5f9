"""A19: what a robot says about the standard heartbeat, which it sends only when it is asked."""

from random import Random

from agent.interface.effects import Send
from agent.interface.identity import Identity
from agent.peer.inputs import Received, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from protocol.frames.fleet_frames import HEARTBEAT, Heartbeat
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import Acknowledgment, AcknowledgmentControl
from protocol.name import fleet_name

ASKS_PGN = 0xCC00  # request for repetition rate, ISO 11783-3
HEARTBEAT_PGN = 61_668  # of ISO 11783-7
STRANGER = 200  # an address


def _joined() -> tuple[Peer, int, int]:
    """A robot on the bus, its address and the time."""
    peer = make_peer(Identity(0, frozenset({0}), fleet_name("a19", 0), 1), Random(19), 0, {})
    now_us = 0
    while not peer.joining.joined:
        now_us = max(now_us, peer.due_at_us)
        peer.step(Timer(), now_us)
        assert now_us < 10_000_000
    assert peer.joining.address is not None
    return peer, peer.joining.address, now_us


def _refusals(destination: int, peer: Peer, now_us: int) -> list[Acknowledgment]:
    identifier = 6 << 26 | ASKS_PGN << 8 | destination << 8 | STRANGER
    data = HEARTBEAT_PGN.to_bytes(3, "little") + (20).to_bytes(2, "little") + b"\xff" * 3
    effects = peer.step(Received(Frame(identifier, data)), now_us)
    said = [effect.message for effect in effects if isinstance(effect, Send)]
    return [message for message in said if isinstance(message, Acknowledgment)]


def test_a19_a_request_for_another_rate_of_the_standard_heartbeat_is_refused() -> None:
    """On commit 24747e2 there was neither a frame nor a refusal."""
    peer, address, now_us = _joined()
    refusal = Acknowledgment(AcknowledgmentControl.NACK, 0xFF, STRANGER, HEARTBEAT_PGN)
    assert _refusals(address, peer, now_us) == [refusal]


def test_a19_a_request_to_all_or_to_another_is_not_refused() -> None:
    peer, address, now_us = _joined()
    assert _refusals(0xFF, peer, now_us) == []
    assert _refusals((address + 1) % 250, peer, now_us) == []


def test_a19_our_heartbeat_is_not_described_as_the_standard_one() -> None:
    assert GROUP_OF[Heartbeat].pgn != HEARTBEAT_PGN
    said = " ".join((Heartbeat.__doc__ or "").split())
    assert "proprietary" in said and "PGN 61668" in said
    meanings = " ".join(field.meaning for field in HEARTBEAT.fields)
    assert meanings and "SPN" not in meanings, "no field claims to be the standard's"
