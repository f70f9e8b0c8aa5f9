"""Whose frames a robot believes: by the NAME that has claimed their address (finding A2)."""

from collections.abc import Iterable, Sequence

import pytest

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Effect, Send
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard, Received
from agent.peer.member_discovery import MEMBER_PGN
from agent.peer.network_join import CLAIM_PGN
from agent.peer.peer import Peer
from agent.peer.sender_origins import DOUBTED_HOLD_US
from agent.safety.stop_cause import StopCause
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.frames.safety_frames import Command, EmergencyReset, EmergencyStop, OperatorCommand
from protocol.frames.work_frames import TaskClaim
from protocol.name import Name, fleet_name, tool_name
from tests.agent.lone_peer import held_by, introduce, peer_in, turn

FOREIGN = Name(77, manufacturer=100, function=25)  # of another maker
AT, STOP = 38, EmergencyStop(0xDE, 0xAD, 0xBE, 0xEF & 7)
COMMANDS: Sequence[Message] = (
    OperatorCommand(Command.HOLD, 255, 0x31), OperatorCommand(Command.START, 255, 0x31),
    OperatorCommand(Command.GO_HOME, 255, 1), EmergencyReset(1, 1, 1, 200),
    TaskClaim(0, 3, 2, 0, 9, 1), Member(1, 1, 0x123456), Member(1, 0, 1),
    Pose(1.0, 1.0, 0.0, 0.0, 1, False, 255),
    Heartbeat(1, 1, False, False, True, False, 1.0, 1, 1),
)  # fmt: skip


def claims(peer: Peer, name: Name, address: int = AT, now_us: int = 0) -> Sequence[Effect]:
    return peer.step(Heard(address, AddressClaimed(name.pack())), now_us)


def asked(effects: Iterable[Effect], pgn: int) -> list[int]:
    """The addresses that were asked for a group."""
    found = [e for e in effects if isinstance(e, Send) and isinstance(e.message, Request)]
    return [e.destination for e in found if e.message == Request(pgn)]


def pass_until(peer: Peer, until_us: int) -> list[Effect]:
    effects, now_us = list[Effect](), 0
    while (due_at_us := max(peer.due_at_us, now_us + 1)) <= until_us:
        now_us = due_at_us
        effects += turn(peer, now_us)
    return effects


@pytest.mark.parametrize("message", [*COMMANDS, STOP], ids=lambda m: type(m).__name__)
def test_a2_a_frame_of_another_maker_does_nothing(message: Message) -> None:
    peer = peer_in(State.WORKING, None)
    peer.safety.start(0)
    claims(peer, FOREIGN)
    for k in range(20):
        peer.step(Received(encode(message, AT)), k * 100 * MS)
    assert peer.state is State.WORKING and not held_by(peer)
    assert sum(peer.named.origins.foreign.values()) == 20, "each is counted, by its group"
    assert not peer.allocation.entries() and peer.membership.live == {0}


@pytest.mark.parametrize("message", COMMANDS, ids=lambda m: type(m).__name__)
def test_a2_a_frame_from_an_address_that_nobody_has_claimed_commands_nothing(
    message: Message,
) -> None:
    peer = peer_in(State.WORKING, None)
    peer.step(Received(encode(message, AT)), 0)
    assert not held_by(peer) and not peer.allocation.entries()
    assert sum(peer.named.origins.unclaimed.values()) == 1


def test_a2_another_makers_device_is_not_asked_which_robot_it_is() -> None:
    peer = peer_in(State.IDLE, None)
    pass_until(peer, 2 * S)
    claims(peer, FOREIGN, now_us=2 * S)
    effects: list[Effect] = []
    for k in range(200):
        now_us = 2 * S + k * 50 * MS
        effects += peer.step(Received(encode(COMMANDS[-2], AT)), now_us)
        effects += turn(peer, now_us)
    assert asked(effects, MEMBER_PGN) == [] and asked(effects, CLAIM_PGN) == []


def test_a2_who_has_claimed_nothing_is_asked_for_its_name() -> None:
    peer = peer_in(State.IDLE, None)
    pass_until(peer, 2 * S)
    effects: list[Effect] = []
    for k in range(200):
        now_us = 2 * S + k * 50 * MS
        effects += peer.step(Received(encode(COMMANDS[-2], AT)), now_us)
        effects += turn(peer, now_us)
    assert asked(effects, MEMBER_PGN) == []
    assert 2 <= len(asked(effects, CLAIM_PGN)) <= 5, "ever more seldom"


def test_a2_a_stop_from_an_unknown_address_holds_and_asks_until_its_name_is_known() -> None:
    peer = peer_in(State.WORKING, None)
    pass_until(peer, 2 * S)
    assert not held_by(peer)
    effects = [*peer.step(Received(encode(STOP, AT)), 2 * S)]
    assert HALT in effects and held_by(peer) == {StopCause.UNAUTHENTICATED_STOP}
    effects += turn(peer, 2 * S)
    assert asked(effects, CLAIM_PGN) == [AT], "at once"
    for k in range(1, 18):
        effects += turn(peer, 2 * S + k * 50 * MS)
        assert held_by(peer) == {StopCause.UNAUTHENTICATED_STOP}, "said once, it holds all the same"
    assert asked(effects, CLAIM_PGN) == [AT] * 5, "again and again, not faster"
    claims(peer, FOREIGN, now_us=2 * S + 900 * MS)
    turn(peer, 2 * S + DOUBTED_HOLD_US)
    turn(peer, 2 * S + DOUBTED_HOLD_US + MS)
    assert not held_by(peer) and not peer.safety.latched, "it was no stop"


def test_a2_a_stop_from_an_address_that_changed_hands_unheard_latches_once_it_is_asked() -> None:
    """Our panel has taken the address of another maker's device, and its claim was lost."""
    peer = peer_in(State.WORKING, None)
    pass_until(peer, 2 * S)
    claims(peer, FOREIGN, now_us=2 * S)
    peer.step(Received(encode(STOP, AT)), 3 * S)
    assert asked(turn(peer, 3 * S), CLAIM_PGN) == [], "it has just said that it is of another maker"
    effects = list[Effect]()
    for k in range(200):
        peer.step(Received(encode(STOP, AT)), 15 * S + k * 50 * MS)
        effects += turn(peer, 15 * S + k * 50 * MS)
    assert not held_by(peer) and 1 <= len(asked(effects, CLAIM_PGN)) <= 4
    peer.step(Received(encode(STOP, AT)), 25 * S)
    claims(peer, tool_name(1), now_us=25 * S + 100 * MS)
    assert peer.safety.latched and peer.state is State.EMERGENCY_STOP


def test_a2_a_stop_whose_sender_never_says_its_name_latches() -> None:
    """Its claims are lost, or it answers nothing: nobody knows that it was no stop of ours."""
    peer = peer_in(State.WORKING, None)
    pass_until(peer, 2 * S)
    peer.step(Received(encode(STOP, AT)), 2 * S)
    effects = list[Effect]()
    for k in range(1, 21):
        effects += turn(peer, 2 * S + k * 50 * MS)
    assert peer.safety.latched and peer.state is State.EMERGENCY_STOP
    dot = peer.safety.stops.active
    assert any(isinstance(e, Send) and isinstance(e.message, EmergencyStop) for e in effects)
    for k in range(21, 100):
        turn(peer, 2 * S + k * 50 * MS)
    assert peer.safety.latched, "until a person resets it"
    other = STOP._replace(counter=STOP.counter + 1)
    peer.step(Received(encode(other, AT)), 8 * S)
    assert peer.safety.stops.active > dot, "it was asked in vain: its next stop is believed at once"


def test_a2_a_used_stop_of_a_sender_without_a_name_is_a_press() -> None:
    """Said for half a second with a name that was cleared before, then never again."""
    peer = peer_in(State.WORKING, None)
    pass_until(peer, 2 * S)
    claims(peer, tool_name(1), 249)
    peer.step(
        Received(encode(EmergencyReset(STOP.slot, STOP.incarnation, STOP.counter, 249), 249)), 2 * S
    )
    for k in range(41):
        peer.step(Received(encode(STOP, AT)), 3 * S + k * 20 * MS)
        turn(peer, 3 * S + k * 20 * MS)
        assert StopCause.UNAUTHENTICATED_STOP in held_by(peer)
    for k in range(41, 60):
        turn(peer, 3 * S + k * 20 * MS)
        assert held_by(peer)
    assert peer.safety.latched


def test_a2_the_stop_latches_when_the_name_turns_out_to_be_ours() -> None:
    """A newly booted robot or tool whose claim was missed must still stop us."""
    for name in (fleet_name("total", 1), tool_name(5)):
        peer = peer_in(State.WORKING, None)
        peer.step(Received(encode(STOP, AT)), 0)
        assert not peer.safety.latched
        effects = claims(peer, name, now_us=150 * MS)
        assert HALT in effects and peer.safety.latched and peer.state is State.EMERGENCY_STOP


def test_a2_a_foreign_cyclic_0xff00_does_not_hold_once_its_name_is_known() -> None:
    peer = peer_in(State.WORKING, None)
    for k in range(100):
        if k == 5:
            claims(peer, FOREIGN, now_us=500 * MS)
        peer.step(
            Received(Frame(0x00FF0000 | AT, b"\xde\xad\xbe\xef\x01\x02\x03\x04")), k * 100 * MS
        )
        turn(peer, k * 100 * MS)
    assert not held_by(peer) and not peer.safety.latched


def test_a2_a_tool_with_our_name_commands() -> None:
    peer = peer_in(State.WORKING, None)
    claims(peer, tool_name(1), 249)
    peer.step(Received(encode(OperatorCommand(Command.HOLD, 255, 249), 249)), 0)
    assert held_by(peer) == {StopCause.NOT_STARTED}
    peer.step(Received(encode(STOP, 249)), 0)
    assert peer.safety.latched


def test_a2_an_address_that_changes_hands_loses_its_belief() -> None:
    peer = peer_in(State.WORKING, None)
    introduce(peer, 140, 1)
    assert peer.membership.live == {0, 1}
    claims(peer, FOREIGN, 140, MS)
    peer.step(Received(encode(TaskClaim(0, 0, Phase.CLAIMED, 0, 9, 1), 140)), 2 * MS)
    peer.step(Received(encode(STOP, 140)), 2 * MS)
    assert not peer.allocation.entries() and not peer.safety.latched


def test_a2_a_member_is_believed_whichever_of_claim_and_member_comes_first() -> None:
    peer = peer_in(State.IDLE, None)
    peer.step(Heard(140, Member(1, 0, 1)), 0)
    assert peer.membership.live == {0}
    claims(peer, fleet_name("total", 1), 140, 100 * MS)
    assert peer.membership.live == {0, 1}
