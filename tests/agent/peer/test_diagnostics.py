"""A13: what a diagnostic tool of another maker asks a robot first, and what it gets."""

from itertools import pairwise
from random import Random
from typing import Any

import pytest

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send
from agent.interface.identity import Identity
from agent.interface.lifecycle import State
from agent.peer.diagnostic_broadcasts import DiagnosticBroadcasts
from agent.peer.diagnostics import FaultMemory, fault_of, root_causes, texts
from agent.peer.inputs import Received, Timer
from agent.peer.part import StepContext
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from agent.safety.stop_cause import StopCause
from protocol.frames.codec import encode, packed
from protocol.frames.diagnostic_frames import (
    ActiveFaults,
    BroadcastControl,
    ClearFault,
    StandardHeartbeat,
)
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.messages import GROUPS, Message
from protocol.frames.network_frames import (
    Acknowledgment,
    AcknowledgmentControl,
    AddressClaimed,
    RepetitionRateRequest,
    Request2,
    TransportData,
    TransportManagement,
)
from protocol.name import fleet_name
from protocol.transport import TransportControl

TOOL = 249  # an address
IDENTITY = Identity(0, frozenset({0}), fleet_name("a13", 0), 1, started=True, release="1.2.3",
                    first_boot=True)  # fmt: skip
SERIAL = f"{IDENTITY.name.identity:07d}"
FRAMES = {
    65226: "ffff 00000000 ffff",  # DM1
    65227: "ffff 00000000 ffff",  # DM2
    64818: "01 ffffffffffffff",  # diagnostic protocols: SAE J1939-73
    64654: "ff 01 00 01 01 00 ffff",  # functionalities: minimum control function
}
TEXTS = {
    64965: f"peer*{SERIAL}*robot 0*peer*Headland**",  # ECU
    65242: "\x01Headland 1.2.3*",  # software
    64653: "peer*Headland*robot*",  # product
    65259: f"Headland*peer*{SERIAL}*robot 0*",  # component
}


def joined(cyclic: bool = False) -> tuple[Peer, int]:
    """A robot on the bus that may move, and the time."""
    peer, now_us = make_peer(IDENTITY._replace(diagnostics=cyclic), Random(13), 0, {}), 0
    while not peer.joining.joined:
        now_us = max(now_us, peer.due_at_us)
        peer.step(Timer(), now_us)
        assert now_us < 10_000_000
    assert peer.safety.free
    return peer, now_us


def asked(peer: Peer, pgn: int, now_us: int, destination: int | None = None) -> list[Effect]:
    """What it does on the request of a tool."""
    address = peer.address if destination is None else destination
    assert address is not None
    data = pgn.to_bytes(3, "little")
    identifier = 6 << 26 | 0xEA00 << 8 | address << 8 | TOOL
    return list(peer.step(Received(Frame(identifier, data)), now_us))


def acknowledged(control: AcknowledgmentControl, pgn: int) -> Send:
    return Send(Acknowledgment(control, 0xFF, TOOL, pgn))


@pytest.mark.parametrize("destination", [None, GLOBAL_ADDRESS])
@pytest.mark.parametrize("pgn", FRAMES)
def test_a13_faults_and_functions_are_told_in_one_frame(pgn: int, destination: int | None) -> None:
    """On commit 24747e2 each of them was refused."""
    peer, now_us = joined()
    (said,) = asked(peer, pgn, now_us, destination)
    assert isinstance(said, Send)
    assert packed(said.message) == bytes.fromhex(FRAMES[pgn])
    assert encode(said.message, 128).identifier >> 8 & 0x3FFFF == pgn


@pytest.mark.parametrize("pgn", TEXTS)
def test_a13_identification_goes_by_the_transport_protocol(pgn: int) -> None:
    peer, now_us = joined()
    (announced,) = asked(peer, pgn, now_us, GLOBAL_ADDRESS)
    assert isinstance(announced, Send) and isinstance(announced.message, TransportManagement)
    assert announced.message.pgn == pgn
    size = int.from_bytes(announced.message.body[:2], "little")
    data = b""
    while len(data) < size:
        now_us += 10 * MS
        sent = [e.message for e in peer.step(Timer(), now_us) if isinstance(e, Send)]
        data += b"".join(m.body for m in sent if isinstance(m, TransportData))
    assert data[:size].decode("latin-1") == TEXTS[pgn]


def test_a_request_that_is_filled_up_to_eight_bytes_is_answered() -> None:
    """Many tools send all frames with eight bytes; robots did not answer such requests."""
    peer, now_us = joined()
    for pgn, kind in ((65226, ActiveFaults), (0xEE00, AddressClaimed)):
        data = pgn.to_bytes(3, "little") + b"\xff" * 5
        identifier = 6 << 26 | 0xEA00 << 8 | (peer.address or 0) << 8 | TOOL
        (said,) = (
            e for e in peer.step(Received(Frame(identifier, data)), now_us) if isinstance(e, Send)
        )
        assert isinstance(said.message, kind)
    assert list(peer.step(Received(Frame(identifier, data[:2])), now_us)) == []


def test_a_device_without_an_address_gets_a_long_answer_as_all_do() -> None:
    """A connection to the null address was opened, which nobody can grant."""
    peer, now_us = joined()
    identifier = 6 << 26 | 0xEA00 << 8 | (peer.address or 0) << 8 | NULL_ADDRESS
    frame = Frame(identifier, (64965).to_bytes(3, "little"))
    (said,) = (e for e in peer.step(Received(frame), now_us) if isinstance(e, Send))
    assert (
        isinstance(said.message, TransportManagement)
        and said.message.control == TransportControl.BAM
    )
    assert said.destination == GLOBAL_ADDRESS


def test_a_long_message_to_a_robot_is_refused_at_once() -> None:
    """A sender of 1,786 bytes and more waited in vain for 1.25 s; a terminal's was taken in."""
    peer, now_us = joined()
    for source in (TOOL, 38):
        identifier = 7 << 26 | 0xC800 << 8 | (peer.address or 0) << 8 | source
        announced = Frame(identifier, bytes.fromhex("14 A00F0000 00EF00"))
        (said,) = (e for e in peer.step(Received(announced), now_us) if isinstance(e, Send))
        assert said.destination == source
        assert packed(said.message) == bytes.fromhex("FF 02 FFFFFF 00EF00")


def test_a_long_message_to_all_is_answered_by_nobody() -> None:
    """ISO 11783-3 has none. Each robot refused it, so one frame made as many as there are robots."""
    peer, now_us = joined()
    announced = Frame(7 << 26 | 0xC8FF << 8 | TOOL, bytes.fromhex("14 A00F0000 00EF00"))
    assert not [e for e in peer.step(Received(announced), now_us) if isinstance(e, Send)]


def test_a13_software_without_a_release_has_a_name() -> None:
    assert texts(IDENTITY._replace(release=""))[65242] == "\x01Headland*"


def test_a13_each_cause_of_standing_is_a_fault() -> None:
    peer, now_us = joined()
    peer.safety.raise_cause(StopCause.SENSES_OLD, now_us, "")
    (said,) = asked(peer, 65226, now_us)
    assert isinstance(said, Send)
    spn = 516_096 + StopCause.SENSES_OLD.number
    assert packed(said.message) == bytes.fromhex("ffff 14e0e901 ffff")
    assert said.message.spn == spn  # type: ignore[union-attr]
    peer.safety.raise_cause(StopCause.CONFIG_MISMATCH, now_us, "")
    (opened,) = asked(peer, 65226, now_us)
    assert isinstance(opened, Send) and isinstance(opened.message, TransportManagement)
    assert opened.message.pgn == 65226 and opened.destination == TOOL
    data = peer.letters.faults.active_faults(root_causes(peer.safety.causes))
    assert isinstance(data, bytes) and len(data) == 2 + 2 * 4
    found = {int.from_bytes(data[k : k + 2], "little") | data[k + 2] >> 5 << 16 for k in (2, 6)}
    assert found == {spn, 516_096 + StopCause.CONFIG_MISMATCH.number}
    assert {data[k + 2] & 31 for k in (2, 6)} == {9, 13}


def test_a_latched_robot_that_was_not_started_has_one_fault() -> None:
    """A reset takes the start away, so the missing start only follows from the latch."""
    peer, now_us = joined()
    peer.safety.raise_cause(StopCause.NOT_STARTED, now_us, "")
    (said,) = asked(peer, 65226, now_us)
    assert isinstance(said, Send)
    assert said.message.spn == fault_of(StopCause.NOT_STARTED)[0]  # type: ignore[union-attr]
    for latch in (StopCause.STOP_DOT, StopCause.BOOT_UNCONFIRMED, StopCause.DISK_ERROR):
        peer.safety.raise_cause(latch, now_us, "")
        (said,) = asked(peer, 65226, now_us)
        assert isinstance(said, Send) and isinstance(said.message, ActiveFaults)
        assert said.message.spn == fault_of(latch)[0]
        peer.safety.clear_cause(latch, now_us)


def test_causes_that_do_not_follow_from_each_other_are_all_faults() -> None:
    peer, now_us = joined()
    for cause in StopCause:
        peer.safety.raise_cause(cause, now_us, "")
    told = root_causes(peer.safety.causes)
    assert set(StopCause) - set(told) == {StopCause.NOT_STARTED}


def test_a13_earlier_faults_can_be_cleared_because_there_are_none() -> None:
    peer, now_us = joined()
    assert asked(peer, 65228, now_us) == [acknowledged(AcknowledgmentControl.ACK, 65228)]
    assert asked(peer, 65228, now_us, GLOBAL_ADDRESS) == []


def test_earlier_faults_are_told_counted_and_forgotten_on_request() -> None:
    """DM2, DM3 and DM22, as bytes. A robot kept no earlier faults."""
    peer, now_us = joined()

    def answered(pgn: int) -> bytes:
        (said,) = asked(peer, pgn, now_us)
        assert isinstance(said, Send)
        return packed(said.message)

    for times in (1, 2):
        peer.safety.raise_cause(StopCause.SENSES_OLD, now_us, "")
        assert answered(65226) == bytes.fromhex(f"ffff 14e0e90{times} ffff")
        assert answered(65227) == bytes.fromhex("ffff 00000000 ffff"), "it is active"
        peer.safety.clear_cause(StopCause.SENSES_OLD, now_us)
        assert answered(65226) == bytes.fromhex("ffff 00000000 ffff")
        assert answered(65227) == bytes.fromhex(f"ffff 14e0e90{times} ffff")
    assert asked(peer, 65228, now_us) == [acknowledged(AcknowledgmentControl.ACK, 65228)]
    assert answered(65227) == bytes.fromhex("ffff 00000000 ffff")
    peer.safety.raise_cause(StopCause.SENSES_OLD, now_us, "")
    answered(65226)
    peer.safety.clear_cause(StopCause.SENSES_OLD, now_us)
    spn, mode = fault_of(StopCause.SENSES_OLD)
    clear = ClearFault(1, 255, spn & 0xFFFF, mode, spn >> 16)
    (said,) = received(peer, clear, now_us)
    assert said.destination == TOOL and said.message == clear._replace(control=2)
    (said,) = received(peer, clear, now_us)
    assert said.message == clear._replace(control=3, refusal=3), "it is forgotten"


def test_occurrences_end_at_126() -> None:
    memory = FaultMemory()
    for _ in range(300):
        memory.see((StopCause.BUS_OFF,))
        memory.see(())
    frame = memory.previous_faults()
    assert not isinstance(frame, bytes) and frame.occurrences == 126
    memory.see((StopCause.BUS_OFF, StopCause.DISK_ERROR))
    memory.forget()
    assert memory.earlier == () and memory.active_faults((StopCause.BUS_OFF,))[3] == 126


def test_a13_active_faults_are_not_cleared_by_a_tool() -> None:
    """DM11: what holds a robot ends by its own condition."""
    peer, now_us = joined()
    assert asked(peer, 65235, now_us) == [acknowledged(AcknowledgmentControl.NACK, 65235)]


def told(peer: Peer, until_us: int, kinds: type | tuple[type, ...]) -> list[tuple[int, Any]]:
    """What it sends of these kinds until then, and when."""
    said, now_us = [], 0
    while (now_us := max(now_us, peer.due_at_us)) <= until_us:
        for effect in peer.step(Timer(), now_us):
            if isinstance(effect, Send) and isinstance(effect.message, kinds):
                said.append((now_us, effect.message))
    return said


def broadcasts(peer: Peer, until_us: int) -> list[Any]:
    """What the part sends, asked each 10 ms, and when; a cause may change meanwhile."""
    safety, named = peer.safety, peer.named
    part, said = DiagnosticBroadcasts(safety, peer.letters, named.votes, named.reports, True), []
    for now_us in range(0, until_us, 10 * MS):
        here = StepContext(0, now_us, State.IDLE, True, None, frozenset(), True)
        CHANGES.get(now_us, lambda _, __: None)(safety, now_us)
        said += [(now_us, output.message) for output in part.on_timer(here)]
    return said


CHANGES: dict[int, Any] = {
    2000 * MS: lambda safety, now_us: safety.raise_cause(StopCause.OBSTACLE_AHEAD, now_us, ""),
    5500 * MS: lambda safety, now_us: safety.clear_cause(StopCause.OBSTACLE_AHEAD, now_us),
    **{
        10 * S + k * 10 * MS: lambda safety, now_us, k=k: (
            safety.clear_cause(StopCause.OBSTACLE_AHEAD, now_us)
            if k % 2
            else safety.raise_cause(StopCause.OBSTACLE_AHEAD, now_us, "")
        )
        for k in range(200)
    },
}


def test_a13_dm1_is_told_each_second_and_when_causes_change() -> None:
    """A cause that flickers does not fill the bus."""
    peer, _ = joined()
    said = broadcasts(peer, 14 * S)
    assert [(at_us // MS, m.spn) for at_us, m in said if at_us < 10 * S] == [
        *((ms, 516_096 + StopCause.OBSTACLE_AHEAD.number) for ms in (2000, 3000, 4000, 5000)),
        (5500, 0),
    ]
    assert 2 <= len([at_us for at_us, _ in said if at_us >= 10 * S]) <= 12
    assert said[-1][1].spn == 0


def test_a13_an_answer_to_all_waits_for_the_message_before_it() -> None:
    """While several faults are told to all by BAM, a tool asks all for their identification."""
    peer, now_us = joined(cyclic=True)
    peer.safety.raise_cause(StopCause.SENSES_OLD, now_us, "")
    peer.safety.raise_cause(StopCause.CONFIG_MISMATCH, now_us, "")
    opened = peer.step(Timer(), now_us)
    assert any(isinstance(e, Send) and isinstance(e.message, TransportManagement) for e in opened)
    asked(peer, 64965, now_us, GLOBAL_ADDRESS)
    asked(peer, 64653, now_us, GLOBAL_ADDRESS)
    managed = told(peer, now_us + 3 * S, TransportManagement)
    assert [m.pgn for _, m in managed][:2] == [64965, 64653]


def test_faults_that_have_waited_are_not_told_after_newer_ones() -> None:
    """A tool that asked all for four texts read faults last that had ended a second before."""
    peer, now_us = joined(cyclic=True)
    for pgn in TEXTS:
        asked(peer, pgn, now_us, GLOBAL_ADDRESS)
    for cause in (StopCause.SENSES_OLD, StopCause.CONFIG_MISMATCH):
        peer.safety.raise_cause(cause, now_us, "")
    told(peer, now_us + 300 * MS, TransportManagement)
    for cause in (StopCause.SENSES_OLD, StopCause.CONFIG_MISMATCH):
        peer.safety.clear_cause(cause, now_us + 300 * MS)
    said = told(peer, now_us + 5 * S, (ActiveFaults, TransportManagement))
    assert any(isinstance(m, ActiveFaults) for _, m in said)
    assert 65226 not in [m.pgn for _, m in said if isinstance(m, TransportManagement)]
    assert len(said) > len(TEXTS) - 1, "all other answers came"


def received(
    peer: Peer, message: Message, now_us: int, destination: int | None = None
) -> list[Any]:
    """What it sends when a tool sends this to it."""
    address = peer.address if destination is None else destination
    assert address is not None
    frame = encode(message, TOOL, address)
    return [e for e in peer.step(Received(frame), now_us) if isinstance(e, Send)]


def test_a13_request2_is_answered_as_a_request() -> None:
    peer, now_us = joined()
    (said,) = received(peer, Request2(65226, 0), now_us)
    assert isinstance(said.message, ActiveFaults)
    assert received(peer, Request2(65226, 1), now_us) == [
        acknowledged(AcknowledgmentControl.NACK, 65226)
    ]


def test_a13_the_standard_heartbeat_is_sent_on_request_until_it_is_ended() -> None:
    peer, now_us = joined()
    assert received(peer, RepetitionRateRequest(61668, 100), now_us) == []
    said = told(peer, now_us + 30 * S, StandardHeartbeat)
    assert [m.sequence for _, m in said[:3]] == [251, 0, 1]
    assert [m.sequence for _, m in said[250:254]] == [249, 250, 0, 1]
    assert len(said) >= 299 and {b[0] - a[0] for a, b in pairwise(said)} == {100 * MS}
    (end,) = received(peer, RepetitionRateRequest(61668, 0), now_us + 30 * S)
    assert end.message == StandardHeartbeat(255)
    assert told(peer, now_us + 32 * S, StandardHeartbeat) == []


@pytest.mark.parametrize(("pgn", "rate_ms"), [(61668, 20), (65226, 100), (0xFF10, 0)])
def test_a13_another_rate_is_refused(pgn: int, rate_ms: int) -> None:
    peer, now_us = joined()
    refused = [acknowledged(AcknowledgmentControl.NACK, pgn)]
    assert received(peer, RepetitionRateRequest(pgn, rate_ms), now_us) == refused


def test_a13_no_tool_makes_a_robot_silent() -> None:
    """DM13 asks all devices to stop talking. The beats of robots hold the fleet."""
    peer, now_us = joined()
    refused = [acknowledged(AcknowledgmentControl.NACK, 57088)]
    assert received(peer, BroadcastControl(0), now_us) == refused
    assert received(peer, BroadcastControl(0), now_us, GLOBAL_ADDRESS) == []
    assert told(peer, now_us + S, Pose)


def test_a13_dm22_is_refused_with_its_reason() -> None:
    """The bytes of requests as can-j1939 writes them, and the reasons of its table."""
    peer, now_us = joined()
    peer.safety.raise_cause(StopCause.SENSES_OLD, now_us, "")
    spn, mode = fault_of(StopCause.SENSES_OLD)
    other, its_mode = fault_of(StopCause.DISK_ERROR)
    for control, number, fmi, expected in (
        (17, spn, mode, (19, 1)),
        (17, other, its_mode, (19, 4)),
        (17, 110, 3, (19, 2)),
        (1, spn, mode, (3, 3)),
    ):
        asked_for = ClearFault(control, 255, number & 0xFFFF, fmi, number >> 16)
        (said,) = received(peer, asked_for, now_us)
        assert said.destination == TOOL and said.message == asked_for._replace(
            control=expected[0], refusal=expected[1]
        )
    assert received(peer, ClearFault(18, 255, 1, 1, 0), now_us) == []


def commanded(peer: Peer, name: int, address: int, now_us: int) -> None:
    """A tool commands an address by a broadcast of nine bytes."""
    data = name.to_bytes(8, "little") + bytes((address,))
    head = b"\x09\x00\x02\xff"
    received(peer, TransportManagement(32, head, 65240), now_us, GLOBAL_ADDRESS)
    for k in (1, 2):
        part = data[7 * k - 7 : 7 * k].ljust(7, b"\xff")
        received(peer, TransportData(k, part), now_us, GLOBAL_ADDRESS)


def test_a13_a_commanded_address_is_claimed_and_taken() -> None:
    peer, now_us = joined()
    commanded(peer, IDENTITY.name.pack() + 1, 150, now_us)  # another device is meant
    assert peer.address == 128
    commanded(peer, IDENTITY.name.pack(), 20, now_us)  # not an address for us
    assert peer.address == 128
    commanded(peer, IDENTITY.name.pack(), 150, now_us)
    assert peer.address is None, "for 250 ms another device may object"
    told(peer, now_us + S, Pose)
    assert peer.address == 150 and peer.joining.joined
    commanded(peer, IDENTITY.name.pack(), 151, now_us + S)  # too soon
    assert peer.address == 150


def test_a13_each_cause_has_its_own_number() -> None:
    numbers = [fault_of(cause)[0] for cause in StopCause]
    assert len(set(numbers)) == len(numbers) and min(numbers) > 516_096


def test_a13_faults_of_other_devices_hold_nobody() -> None:
    """DM1 and DM2 of a tractor's devices, of any length."""
    peer, now_us = joined()
    layouts = {layout.pgn: layout for layout in GROUPS}
    for pgn in FRAMES:
        identifier = layouts[pgn].priority << 26 | pgn << 8 | TOOL
        for data in (bytes.fromhex("4000 6e000304 ffff"), b"\xff" * 8, b"\x00" * 4):
            peer.step(Received(Frame(identifier, data)), now_us)
    assert peer.safety.free or peer.safety.may_move
