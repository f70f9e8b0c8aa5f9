"""What a robot tells other segments of stops and resets; whole fleets are in test_segments_rig.py."""

import pytest

from agent.interface.config import S
from agent.interface.effects import Send
from agent.interface.lifecycle import State
from agent.segments.fleet_stops import TURN_US, FleetStops
from crdt.stops import RemoteStopDot, StopDot
from protocol.authentication import Keys
from protocol.fleet_tags import FleetTags
from protocol.frames.segment_frames import FleetReset, FleetStop
from tests.agent.lone_peer import introduce, peer_in

SEGMENT = 1
DOT = StopDot(140, 1, 1)  # of a panel
FAR = RemoteStopDot(*DOT, SEGMENT)
TAGS = FleetTags(Keys(bytes(16), bytes(range(16))))


def of_second_robot() -> FleetStops:
    """Of a robot that leaves it to the first one to tell, for one turn."""
    peer = peer_in(State.WORKING, None)
    introduce(peer, 141, 1)
    stops = FleetStops(SEGMENT, peer.safety, peer.senders, TAGS)
    stops.slot = 1
    return stops


@pytest.mark.parametrize("is_true", [True, False])
def test_a_stop_is_left_to_another_robot_only_if_its_tag_is_right(is_true: bool) -> None:
    """A device without keys said it with any tag. If the first robot had missed the stop, then no robot
    told the other segments."""
    stops = of_second_robot()
    stops.safety.stops.press(DOT)
    stops.observe({0, 1}, S)
    stops.on_stop(TAGS.stop(FAR) if is_true else FleetStop(SEGMENT, *DOT, tag=1), S)
    said = [] if is_true else [Send(TAGS.stop(FAR))]
    assert list(stops.outgoing(S + TURN_US)) == said


@pytest.mark.parametrize("is_true", [True, False])
def test_a_reset_is_left_to_another_robot_only_if_its_tag_is_right(is_true: bool) -> None:
    stops = of_second_robot()
    stops.safety.stops.clear(DOT)
    stops.observe({0, 1}, S)
    halves = TAGS.reset(FAR)
    for half in halves if is_true else (FleetReset(SEGMENT, 0, *DOT), FleetReset(SEGMENT, 1, *DOT)):
        stops.on_reset(half, S)
    assert list(stops.outgoing(S + TURN_US)) == ([] if is_true else [Send(half) for half in halves])
