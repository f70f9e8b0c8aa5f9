"""Robots whose frames differ have other configuration hashes, so that none misreads another."""

from hashlib import sha256

from agent.peer.inputs import Heard
from agent.safety.stop_cause import StopCause
from protocol.frames.fleet_frames import Member
from protocol.frames.messages import (
    FRAMES_VERSION,
    GROUPS,
    HASH_BITS,
    configuration_hash,
)
from protocol.frames.network_frames import AddressClaimed
from protocol.name import fleet_name
from protocol.units import S
from tests.agent.lone_peer import held_by
from tests.agent.peer.test_member_conflicts import robot

# Of the layouts of each version. If this test fails, a layout has changed: raise `FRAMES_VERSION` in
# `protocol/frames/messages.py`, and add its digest. Those of before stay as they are.
LAYOUTS = {1: "4d0475774ecc2304"}


def digest() -> str:
    """Of what a frame means to a program: group, place, size and scale of each field."""
    said = []
    for group in GROUPS:
        said.append(f"{group.name} {group.pgn:x} {group.priority} {group.padded}")
        said += [
            f"{start} {field.name} {field.bits} {field.repeat} {field.octets} {field.boolean} "
            f"{field.scale:g} {field.offset:g} {field.parts} {field.cyclic} {field.reserved}"
            for field, start in group.placed()
        ]
    return sha256("\n".join(said).encode()).hexdigest()[:16]


def test_the_layouts_of_this_version_are_those_that_were_recorded() -> None:
    assert {**LAYOUTS, FRAMES_VERSION: digest()} == LAYOUTS
    assert max(LAYOUTS) == FRAMES_VERSION


def test_each_version_has_a_hash_of_its_own_and_the_first_is_that_of_the_work() -> None:
    for work in (0, 1, 0xFFFFFF):
        assert configuration_hash(work, 1) == work
        hashes = {configuration_hash(work, version) for version in range(1, 1000)}
        assert len(hashes) == 999 and all(value < 1 << HASH_BITS for value in hashes)


def test_a_robot_with_other_frames_holds_ours_while_it_speaks() -> None:
    """Robots of two releases worked in one field, and one could misread what the other said."""
    peer = robot()
    other = configuration_hash(peer.identity.field_hash, FRAMES_VERSION + 1)
    peer.step(Heard(200, AddressClaimed(fleet_name("total", 2).pack())), 2 * S)
    peer.step(Heard(200, Member(2, 0, other)), 2 * S)
    assert held_by(peer) == {StopCause.CONFIG_MISMATCH} and peer.membership.live == {0}
