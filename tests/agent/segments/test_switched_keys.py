"""Two segments that switch to new keys one after the other, while a stop is pressed in one of them."""

from collections.abc import Iterator

import can
import pytest

from agent.interface.config import S
from agent.peer.inputs import Press
from protocol.authentication import Keys
from protocol.frames.codec import encode
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import Reason
from protocol.links.bus import CanBus
from protocol.name import tool_name
from protocol.rekeying import Rekeying, seal
from sim.rigs.segments_rig import SegmentFleet

SEED = 29
OWN = bytes(range(32))  # of every robot, because the rig gives all the same keys
NEW = Rekeying(1, b"n" * 16)
OWNER, OWNER_ADDRESS = 200, 249
FRAME_US = 3_000  # time for a frame of the owner to pass
DISBELIEVED_US = 10 * S  # by then gateways repeat a stop no more that no robot knows as genuine


@pytest.fixture(params=[True, False], ids=["gateways with keys", "gateways without keys"])
def fleet(request: pytest.FixtureRequest) -> Iterator[SegmentFleet]:
    keys = Keys(b"m" * 16, b"o" * 16, OWN)
    made = SegmentFleet(2, 2, SEED, keys=keys, gateways_with_keys=request.param)
    assert made.run(10 * S, lambda: made.leader(1) is not None and made.leader(2) is not None)
    made.run(2 * S)
    yield made
    made.end()


def switch(fleet: SegmentFleet, number: int) -> None:
    """The owner's tool on the bus of a segment gives its robots new keys."""
    bus = CanBus(can.Bus(interface="fieldbus", channel=fleet.channel(number)))
    said: list[Message] = [AddressClaimed(tool_name(OWNER).pack())]
    said += [part for slot in range(fleet.robots) for part in seal(NEW, OWN, slot)]
    for message in (*said, NEW.switch()):
        bus.send(encode(message, OWNER_ADDRESS))
        fleet.run(FRAME_US)
    bus.close()
    for peer in fleet.peers(number):
        ring = peer.safety.authority.keyring
        assert ring is not None and ring.keys.generation == NEW.generation


def latched(fleet: SegmentFleet, number: int) -> bool:
    return all(peer.safety.latched for peer in fleet.peers(number))


def press_in_first_segment(fleet: SegmentFleet) -> None:
    """The second one has other keys, so it only brakes while the stop is repeated there."""
    fleet.runners[1, 0].operate(Press(Reason.PERSON_IN_FIELD))
    assert fleet.run(S, lambda: latched(fleet, 1)), f"seed {SEED}"
    fleet.run(DISBELIEVED_US)
    assert not latched(fleet, 2)


def test_a_stop_of_a_segment_that_switched_first_holds_the_other_one_when_it_has_switched(
    fleet: SegmentFleet,
) -> None:
    """Its gateways had said the stop in vain while the robots had the old keys, and said it no more:
    the robots drove while it stood."""
    switch(fleet, 1)
    press_in_first_segment(fleet)
    switch(fleet, 2)
    assert fleet.run(3 * S, lambda: latched(fleet, 2)), f"seed {SEED}"


def test_a_stop_of_a_segment_that_switches_last_holds_the_other_one_after_the_switch(
    fleet: SegmentFleet,
) -> None:
    """No robot told the stop under the new keys, so the other segment never believed it."""
    switch(fleet, 2)
    press_in_first_segment(fleet)
    switch(fleet, 1)
    assert fleet.run(3 * S, lambda: latched(fleet, 2)), f"seed {SEED}"
