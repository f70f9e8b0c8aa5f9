"""Frames of the vector clock: a robot goes through the slots of its fleet, wherever they are."""

from collections.abc import Collection
from random import Random

import pytest

from agent.interface.config import S
from agent.interface.effects import Send
from agent.interface.identity import Identity
from agent.peer.inputs import BusState, Timer
from agent.runtime.peer_factory import make_peer
from protocol.controller_health import Health
from protocol.frames.fleet_frames import VectorSlice
from protocol.name import fleet_name


def bases(members: Collection[int]) -> list[int]:
    """The first slots of the slices that the robot with the lowest slot sends in four minutes."""
    slot = min(members)
    identity = Identity(
        slot, frozenset(members), fleet_name("gaps", slot), 1, started=True, first_boot=True
    )
    peer, now_us, sent, found = make_peer(identity, Random(1), 0, {}), 0, 0, []
    while now_us < 240 * S:
        now_us = max(now_us + 1, peer.due_at_us)
        peer.step(BusState(Health.ACTIVE, True, sent), now_us)
        for effect in peer.step(Timer(), now_us):
            sent += isinstance(effect, Send)
            if isinstance(effect, Send) and isinstance(effect.message, VectorSlice):
                found.append(effect.message.base)
    return found


@pytest.mark.parametrize(
    ("members", "expected"),
    [(range(5), {0}), (range(15), {0, 7, 14}), ((1, 50), {0, 49}), ((30, 31, 40), {28, 35})],
)
def test_slots_with_gaps_between_them_are_all_told(
    members: Collection[int], expected: set[int]
) -> None:
    """The highest slots of a fleet with gaps were never told."""
    told = bases(members)
    assert set(told) == expected
    turns = len(expected)
    assert all(set(told[k : k + turns]) == expected for k in range(len(told) - turns + 1))
