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


@pytest.mark.parametrize(("held_back_for_us", "set_back"), [(0, True), (2 * S, False)])
def test_only_an_answer_of_just_now_sets_the_time_back(
    held_back_for_us: int, set_back: bool
) -> None:
    """One that an attacker held back may be of any age."""
    rig = KeyedRig(1)
    tool = desk(rig)
    assert all(believed(rig, tool, 1))
    for slot in list(rig.peers):
        rig.boot(slot)
    rig.run_for(8 * S)
    rig.forge(AddressClaimed(tool_name(5).pack()), ADDRESS)
    before = tool._time.at(0)
    order = TaskOrder(2, 1, 2)
    for said in (order, *tool.after(order, ADDRESS, rig.now_us)):
        rig.forge(said, ADDRESS)
    rig.recorded.clear()
    rig.run_for(500 * MS)
    answers = list(rig.recorded)
    rig.run_for(held_back_for_us)
    for frame in answers:
        source, message = decode(frame)
        tool.hear(source, message, rig.now_us)
    assert (tool._time.at(0) < before) is set_back
