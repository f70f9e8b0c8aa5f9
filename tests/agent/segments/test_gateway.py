"""What one gateway makes of frames on its bus; fleets of gateways are in test_segments_rig.py."""

import pytest

from agent.interface.config import MS, S
from agent.interface.effects import Send
from agent.segments.gateway import DEFENCE_GAP_US, Gateway, Out
from agent.segments.gateway_election import LISTEN_US
from agent.segments.segment_area import Area
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.network_frames import AddressClaimed, Request, refusal
from protocol.frames.segment_frames import CANDIDATES_MAX, GATEWAY_ADDRESS, GatewayBeat
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


# File servers of other makers, which prefer 240 (ISO 11783-1). The second one may take another address.
LOWER, HIGHER = (
    Name(1, 3, function=40, device_class=0, industry_group=0, arbitrary_address=able).pack()
    for able in (0, 1)
)


def began(now_us: int) -> Gateway:
    gateway = Gateway(Area(2, 10), Name(5, function=GATEWAY_FUNCTION, arbitrary_address=0), 5, 0)
    gateway.on_tick(now_us)
    return gateway


def said(effects: list[Out], kind: type) -> list[int | None]:
    """The addresses from which messages of this kind are sent."""
    return [e.source for e in effects if isinstance(e, Send) and isinstance(e.message, kind)]


def claimed(gateway: Gateway, name: int, address: int, now_us: int) -> list[Out]:
    frame = encode(AddressClaimed(name), address, GLOBAL_ADDRESS)
    return [*gateway.on_frame(frame, now_us)]


@pytest.mark.parametrize("early", [True, False])
def test_a_gateway_leaves_its_address_to_a_device_with_a_lower_name(early: bool) -> None:
    """It spoke on from the address of another maker's device, and no robot believed its stops."""
    gateway = began(0 if early else LISTEN_US)
    claimed(gateway, LOWER, GATEWAY_ADDRESS, LISTEN_US + MS)
    effects = [*gateway.on_tick(2 * LISTEN_US + MS)]
    assert said(effects, AddressClaimed) == said(effects, GatewayBeat) == [GATEWAY_ADDRESS + 1]


def test_a_gateway_keeps_its_address_from_a_device_with_a_higher_name() -> None:
    gateway = began(LISTEN_US)
    answers = list[Out]()
    for k in range(10):
        at_us = LISTEN_US + k * DEFENCE_GAP_US // 5
        answers += claimed(gateway, HIGHER, GATEWAY_ADDRESS, at_us)
    assert said(answers, AddressClaimed) == [GATEWAY_ADDRESS] * 2
    assert gateway.candidacy.address == GATEWAY_ADDRESS


def test_a_gateway_refuses_a_group_that_it_alone_is_asked_for() -> None:
    """A terminal that gets no answer asks again and again (ISO 11783-3)."""
    gateway = began(0)
    gateway.on_tick(LISTEN_US)
    asked = [
        effect
        for source, destination in ((38, GATEWAY_ADDRESS), (38, GLOBAL_ADDRESS), (38, ROBOT),
                                    (NULL_ADDRESS, GATEWAY_ADDRESS))
        for effect in gateway.on_frame(encode(Request(0xFEDA), source, destination), 2 * LISTEN_US)
    ]  # fmt: skip
    assert asked == [Send(refusal(38, 0xFEDA), source=GATEWAY_ADDRESS)]


def test_a_gateway_without_another_address_tries_each_again_now_and_then() -> None:
    gateway = began(0)
    tried = list[int | None]()
    for now_us in range(LISTEN_US, 12 * LISTEN_US, 50 * MS):
        for address in said([*gateway.on_tick(now_us)], AddressClaimed):
            assert address is not None
            tried.append(address)
            claimed(gateway, LOWER, address, now_us)
    every = [GATEWAY_ADDRESS + k for k in range(CANDIDATES_MAX)]
    assert 8 <= len(tried) <= 12 and set(tried) == set(every), tried
