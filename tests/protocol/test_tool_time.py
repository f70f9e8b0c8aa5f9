"""A desk that outlives its fleet, which begins another time when it is switched on."""

import pytest

from agent.interface.config import MS, S
from protocol.frame_proofs import ToolProofs
from protocol.frames.codec import decode
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.network_frames import AddressClaimed
from protocol.name import tool_name
from sim.rigs.keyed_rig import KeyedRig

DEVICE, ADDRESS = 200, 150


def newest(rig: KeyedRig) -> list[int]:
    """What each robot has believed last of the desk; 0: nothing."""
    found = []
    for peer in rig.peers.values():
        assert peer.proven.checker is not None
        seen = peer.proven.checker._replay
        found.append(seen[DEVICE].newest if DEVICE in seen else 0)
    return found


def desk(rig: KeyedRig) -> ToolProofs:
    assert rig.keys is not None
    return ToolProofs(rig.keys, DEVICE, b"l" * 16)


def believed(rig: KeyedRig, tool: ToolProofs, task: int) -> list[bool]:
    """Whether each robot believes an order that the desk repeats for five seconds."""
    rig.forge(AddressClaimed(tool_name(5).pack()), ADDRESS)
    before = newest(rig)
    for _ in range(10):
        order = TaskOrder(task, 1, 2)
        rig.forge(order, ADDRESS)
        for said in tool.after(order, ADDRESS, rig.now_us):
            rig.forge(said, ADDRESS)
        rig.recorded.clear()
        rig.run_for(500 * MS)
        for frame in list(rig.recorded):
            source, message = decode(frame)
            tool.hear(source, message, rig.now_us)
    return [a != b for a, b in zip(before, newest(rig), strict=True)]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_desk_is_believed_after_its_fleet_was_switched_off(seed: int) -> None:
    """Found by a review: every second time the new time was smaller, and no order was proven again."""
    rig = KeyedRig(seed)
    tool = desk(rig)
    assert all(believed(rig, tool, 1))
    for slot in list(rig.peers):
        rig.boot(slot)
    rig.run_for(8 * S)
    assert all(believed(rig, tool, 2))


def test_an_answer_of_long_ago_sets_no_time_back() -> None:
    """A recorded answer, or one that an attacker held back."""
    rig = KeyedRig(1)
    tool = desk(rig)
    assert all(believed(rig, tool, 1))
    knows = tool._time.at(rig.now_us)
    assert not tool._time.begins_again(knows, rig.now_us)
    tool._asked_at_us = rig.now_us - 2 * S
    for slot in list(rig.peers):
        rig.boot(slot)
    rig.recorded.clear()
    rig.run_for(8 * S)
    for frame in list(rig.recorded):
        source, message = decode(frame)
        tool.hear(source, message, rig.now_us)
    assert tool._time.at(rig.now_us) >= knows
