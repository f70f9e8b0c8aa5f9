"""Machines with which a robot cannot work, for as long as they speak (T1, M17), and farewells (T6)."""

from collections.abc import Iterator

import pytest

from agent.interface.config import LEAVES_WITHIN_US, MS, S
from agent.interface.effects import Drive, Send
from agent.interface.lifecycle import State
from agent.peer.inputs import BusState, Heard, Leave, Received, Sensed, Start
from agent.peer.member_conflicts import GONE_US, TOLD_APART_US
from agent.peer.membership import FAREWELL_US, MemberStatus
from agent.peer.peer import Peer
from agent.safety.stop_cause import StopCause, about
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import PLACE_UNKNOWN_M_S, Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyStop
from protocol.name import fleet_name
from tests.agent.lone_peer import held_by, introduce, peer_in, turn

POSE = Pose(1.0, 1.0, 0.0, 0.0, State.IDLE, False, 255)
OTHER_FIELD = 0x123456


def robot(until_us: int = 2 * S) -> Peer:
    """It has its address and stands for nothing."""
    peer = peer_in(State.IDLE, None)
    list(running(peer, 0, until_us))
    assert peer.joining.joined and not held_by(peer)
    return peer


def running(peer: Peer, from_us: int, until_us: int) -> Iterator[tuple[int, Message]]:
    """What it says, and when; it has a turn each 10 ms."""
    for now_us in range(from_us, until_us, 10 * MS):
        for effect in turn(peer, now_us):
            if isinstance(effect, Send) and effect.source is None:
                yield now_us, effect.message


def test_t1_a_member_frame_from_an_address_without_a_name_holds_nobody() -> None:
    peer = robot()
    peer.step(Heard(200, Member(77, 0, OTHER_FIELD)), 2 * S)
    assert not held_by(peer)


def test_t1_another_field_description_holds_while_its_robot_speaks() -> None:
    peer = robot()
    peer.step(Heard(200, AddressClaimed(fleet_name("total", 2).pack())), 2 * S)
    peer.step(Heard(200, Member(2, 0, OTHER_FIELD)), 2 * S)
    for k in range(10):
        peer.step(Heard(200, POSE), (3 + k) * S)
        list(running(peer, (3 + k) * S, (4 + k) * S))
        assert StopCause.CONFIG_MISMATCH in held_by(peer), k
    list(running(peer, 13 * S, 13 * S + GONE_US))
    assert not held_by(peer), "it is gone"


def test_t1_it_ends_when_the_other_agrees() -> None:
    peer = robot()
    peer.step(Heard(200, AddressClaimed(fleet_name("total", 2).pack())), 2 * S)
    peer.step(Heard(200, Member(2, 0, OTHER_FIELD)), 2 * S)
    assert held_by(peer) == {StopCause.CONFIG_MISMATCH}
    peer.step(Heard(200, Member(2, 0, 1)), 3 * S)
    assert not held_by(peer) and peer.membership.live == {0, 2}


def test_t1_a_robot_beyond_our_number_of_robots_holds_while_it_speaks() -> None:
    """Two robots were added, and the files of the others still said two. These did not see the new ones,
    drove through them, and worked their sections again."""
    peer = robot()
    beyond = len(peer.identity.members)
    peer.step(Heard(200, AddressClaimed(fleet_name("total", beyond).pack())), 2 * S)
    peer.step(Heard(200, Member(beyond, 0, 1)), 2 * S)
    assert held_by(peer) == {StopCause.CONFIG_MISMATCH} and peer.membership.live == {0}
    assert f"robot {beyond}, and our fleet has {beyond} robots" in held_for(peer)
    for k in range(10):
        peer.step(Heard(200, POSE), (3 + k) * S)
        list(running(peer, (3 + k) * S, (4 + k) * S))
        assert StopCause.CONFIG_MISMATCH in held_by(peer)
    list(running(peer, 13 * S, 13 * S + GONE_US))
    assert StopCause.CONFIG_MISMATCH not in held_by(peer), "it is gone"


@pytest.mark.parametrize("first_agrees", [True, False])
def test_t1_of_two_such_robots_the_one_that_still_speaks_is_named(first_agrees: bool) -> None:
    """People were sent to a machine that had been mended, or switched off, long ago."""
    peer = robot()
    for address, slot in ((200, 1), (201, 2)):
        peer.step(Heard(address, AddressClaimed(fleet_name("total", slot).pack())), 2 * S)
        peer.step(Heard(address, Member(slot, 0, OTHER_FIELD)), 2 * S)
    assert about(StopCause.CONFIG_MISMATCH, held_for(peer)) == 200
    if first_agrees:
        peer.step(Heard(200, Member(1, 0, 1)), 2 * S)
    for k in range(6):
        peer.step(Heard(201, POSE), (3 + k) * S)
    assert about(StopCause.CONFIG_MISMATCH, held_for(peer)) == 201
    peer.step(Heard(201, Member(2, 0, 1)), 9 * S)
    assert StopCause.CONFIG_MISMATCH not in held_by(peer), "no robot that differs is left"


def held_for(peer: Peer) -> str:
    """What its stop for another field description is about."""
    return dict(peer.safety.causes)[StopCause.CONFIG_MISMATCH]


def test_m17_a_robot_of_another_fleet_holds_nobody_and_is_no_member() -> None:
    peer = robot()
    peer.step(Heard(200, AddressClaimed(fleet_name("another", 1).pack())), 2 * S)
    for message in (Member(1, 0, OTHER_FIELD), Member(1, 0, 1), POSE):
        peer.step(Heard(200, message), 2 * S)
    assert not held_by(peer) and peer.membership.live == {0}
    assert sum(peer.named.origins.elsewhere.values()) == 3
    peer.step(Heard(200, EmergencyStop(1, 1, 1, 1)), 2 * S)
    assert peer.safety.latched, "its stop holds us"


def test_m17_our_slot_from_another_address() -> None:
    peer = robot()
    peer.step(Heard(200, AddressClaimed(fleet_name("total", 0).pack() | 1 << 56)), 2 * S)
    peer.step(Heard(200, Member(0, 5, 1)), 2 * S)
    assert held_by(peer) == {StopCause.DUPLICATE_ID}
    list(running(peer, 2 * S, 2 * S + GONE_US + S))
    assert not held_by(peer)


def test_m17_our_name_from_another_address() -> None:
    peer = robot()
    peer.step(Heard(200, AddressClaimed(peer.identity.name.pack())), 2 * S)
    assert held_by(peer) == {StopCause.DUPLICATE_ID}


@pytest.mark.parametrize("late_us", [0, 300 * MS])
def test_m17_two_machines_with_one_identity_at_one_address_both_stand(late_us: int) -> None:
    """Equal NAMEs do not contend. Each hears the other's beats from its own address."""
    one, two = peer_in(State.IDLE, None), peer_in(State.IDLE, None)
    two.step(Sensed(one.here._replace(x_m=7.0)), 0)  # type: ignore[union-attr]
    for now_us in range(0, 6 * S, 10 * MS):
        for peer, other in ((one, two), (two, one)):
            if peer is two and now_us < late_us:
                continue
            for effect in turn(peer, now_us):
                if isinstance(effect, Send) and effect.destination == GLOBAL_ADDRESS:
                    source = peer.address if effect.source is None else effect.source
                    if source is not None:
                        other.step(Heard(source, effect.message), now_us)
    assert StopCause.DUPLICATE_ID in held_by(one) and StopCause.DUPLICATE_ID in held_by(two)
    list(running(one, 6 * S, 7 * S + GONE_US))
    assert StopCause.DUPLICATE_ID not in held_by(one), "the other is gone"


def test_m17_frames_that_a_driver_gives_back_are_our_own() -> None:
    """Also twice, and also those from the address that we had before."""
    peer = robot()
    address = peer.address
    assert address is not None
    said = 0
    for now_us, message in running(peer, 2 * S, 5 * S):
        for _ in range(2):
            peer.step(Heard(address, message), now_us)
        said += isinstance(message, Pose | Heartbeat)
    assert said > 40 and not held_by(peer)
    peer.step(Heard(address, AddressClaimed(1)), 5 * S)  # a lower NAME takes it
    list(running(peer, 5 * S, 6 * S))
    assert peer.address not in (None, address)
    peer.step(Heard(address, AddressClaimed(peer.identity.name.pack())), 5 * S + S)
    assert StopCause.DUPLICATE_ID not in held_by(peer)


def test_m17_two_names_at_one_address_are_told_apart_first() -> None:
    """After a cut a robot with another NAME may have our address: its claim settles that."""
    peer = robot()
    assert peer.address is not None
    peer.step(Heard(peer.address, POSE._replace(x_m=50.0)), 2 * S)
    peer.step(Heard(peer.address, POSE._replace(x_m=50.0)), 2 * S + TOLD_APART_US // 2)
    assert not held_by(peer)


def beat(leaving: bool = False) -> Heartbeat:
    return Heartbeat(255 if leaving else 1, 1, False, False, True, leaving, 1.0, 0, 0)


def test_t6_a_farewell_of_a_robot_that_goes_on_speaking_is_void() -> None:
    """Somebody says "leaving" in its name, 50 times a second; then it is killed: the others brake."""
    peer = robot()
    introduce(peer, 140, 1, 2 * S)
    for k in range(100):
        now_us = 2 * S + k * 20 * MS
        peer.step(Heard(140, beat(leaving=True)), now_us)
        peer.step(Heard(140, POSE), now_us)
    assert peer.membership.live == {0, 1} and peer.membership.void_farewells == 1
    list(running(peer, 4 * S, 5 * S))
    assert StopCause.MEMBER_SILENT in held_by(peer)


def test_t6_a_farewell_of_a_robot_that_moves_is_not_believed() -> None:
    """One forged "leaving" in its name, then it is killed at 2 m/s: the others brake."""
    peer = robot()
    introduce(peer, 140, 1, 2 * S)
    peer.step(Heard(140, POSE._replace(speed_m_s=2.0, state=State.WORKING)), 2 * S)
    peer.step(Heard(140, beat(leaving=True)), 2 * S)
    assert peer.membership.live == {0, 1} and 1 in peer.membership.neighbours
    assert peer.membership.void_farewells == 1
    list(running(peer, 2 * S, 3 * S))
    assert StopCause.MEMBER_SILENT in held_by(peer)


def beacons(peer: Peer, from_us: int, until_us: int) -> list[Pose | Heartbeat]:
    """Its beacons and heartbeats; it has a turn each 10 ms."""
    said: list[Pose | Heartbeat] = []
    for now_us in range(from_us, until_us, 10 * MS):
        for effect in turn(peer, now_us):
            if isinstance(effect, Send) and isinstance(effect.message, Pose | Heartbeat):
                said.append(effect.message)
    return said


def farewells(said: list[Pose | Heartbeat]) -> int:
    return sum(isinstance(message, Heartbeat) and message.leaving for message in said)


def test_t6_a_robot_stands_before_its_farewell() -> None:
    """Its last beacon before the farewell shows that it stands, so that the others believe it."""
    peer = robot()
    assert peer.here is not None
    peer.step(Sensed(peer.here._replace(vx_m_s=2.0)), 2 * S)
    assert any(isinstance(effect, Drive) for effect in peer.step(Leave(), 2 * S))
    assert peer.departure.leaving and not farewells(beacons(peer, 2 * S, 3 * S))
    assert not peer.safety.may_move and peer.joining.joined
    peer.step(Start(), 3 * S)
    assert not farewells(beacons(peer, 3 * S, 4 * S)) and not peer.safety.may_move, "held again"
    peer.step(Sensed(peer.here._replace(vx_m_s=0.0)), 4 * S)
    said = beacons(peer, 4 * S, 5 * S)
    assert farewells(said) == 1 and not peer.departure.leaving
    assert [m.speed_m_s for m in said if isinstance(m, Pose)] == [0.0], "nothing after it"
    assert peer.state is State.DISCONNECTED


def test_t6_a_robot_that_stands_or_is_told_twice_leaves_at_once() -> None:
    for speed_m_s, times in ((0.0, 1), (2.0, 2)):
        peer = robot()
        assert peer.here is not None
        peer.step(Sensed(peer.here._replace(vx_m_s=speed_m_s)), 2 * S)
        left = [peer.step(Leave(), 2 * S) for _ in range(times)][-1]
        beats = [e.message for e in left if isinstance(e, Send)]
        assert [isinstance(b, Heartbeat) and b.leaving for b in beats] == [True], speed_m_s


def test_t6_the_tail_of_a_farewell_is_none() -> None:
    peer = robot()
    introduce(peer, 140, 1, 2 * S)
    peer.step(Heard(140, beat(leaving=True)), 2 * S)
    peer.step(Heard(140, POSE), 2 * S + FAREWELL_US)
    assert peer.membership.live == {0}
    list(running(peer, 2 * S, 3 * S))
    assert not held_by(peer)


FOREIGN = AddressClaimed(0xA00284DE_0000_0000 | 12345)  # an ECU of another maker
SPEED_OF_VEHICLE = 0x18FEF100  # its frame


def test_one_claim_of_our_name_from_another_device_holds_for_a_while_only() -> None:
    peer = robot()
    peer.step(Heard(38, FOREIGN), 2 * S)
    peer.step(Heard(38, AddressClaimed(fleet_name("total", 0).pack())), 3 * S)
    assert StopCause.DUPLICATE_ID in held_by(peer)
    peer.step(Heard(38, FOREIGN), 4 * S)  # it says again who it is
    list(running(peer, 4 * S, 4 * S + 100 * MS))
    assert StopCause.DUPLICATE_ID not in held_by(peer)


def test_a_device_at_the_address_of_a_twin_that_is_gone_holds_nobody() -> None:
    peer = robot()
    peer.step(Heard(200, AddressClaimed(fleet_name("total", 0).pack())), 2 * S)
    list(running(peer, 2 * S, 2 * S + GONE_US + S))
    assert not held_by(peer)
    for now_us in range(9 * S, 12 * S, 100 * MS):
        peer.step(Received(Frame(SPEED_OF_VEHICLE | 200, bytes(8))), now_us)
        list(running(peer, now_us, now_us + 100 * MS))
    assert not held_by(peer)


def test_our_own_frames_that_a_driver_returns_do_not_keep_a_twin_alive() -> None:
    peer = robot()
    for now_us in range(2 * S, 4 * S, 50 * MS):
        address = peer.address
        assert address is not None
        peer.step(Heard(address, POSE._replace(x_m=now_us / S)), now_us)
        list(running(peer, now_us, now_us + 50 * MS))
    assert StopCause.DUPLICATE_ID in held_by(peer)
    for now_us in range(4 * S, 4 * S + 2 * GONE_US, 10 * MS):
        for effect in turn(peer, now_us):
            if isinstance(effect, Send) and effect.source is None:
                assert peer.address is not None
                frame = encode(effect.message, peer.address, effect.destination)
                peer.step(Received(frame), now_us)
    assert not held_by(peer)


def test_a_robot_that_stood_without_a_place_for_long_may_leave() -> None:
    peer = robot()
    introduce(peer, 129, 1, 2 * S)
    peer.step(Heard(129, POSE._replace(speed_m_s=2.0, state=State.WORKING)), 2 * S)
    farewell = Heartbeat(0, State.WORKING, False, True, True, True, 1.0, 0, 0, False)
    lost = POSE._replace(speed_m_s=PLACE_UNKNOWN_M_S, state=State.WORKING)
    end_at_us = 2 * S + LEAVES_WITHIN_US
    for now_us in range(2 * S, end_at_us, 50 * MS):
        peer.step(Heard(129, lost), now_us)
        list(running(peer, now_us, now_us + 50 * MS))
    peer.step(Heard(129, farewell), end_at_us)
    assert peer.membership.void_farewells == 0
    assert peer.membership.standing[1] is MemberStatus.LEFT


def test_a_robot_that_has_left_does_not_come_back_with_its_bus() -> None:
    peer = robot()
    for _ in range(2):  # the second one does not wait for its standstill
        peer.step(Leave(), 2 * S)
    peer.step(BusState(Health.OFF, True, 5), 3 * S)
    peer.step(BusState(Health.ACTIVE, True, 5), 4 * S)
    said = list(running(peer, 4 * S, 6 * S))
    assert peer.state is State.DISCONNECTED and not said
