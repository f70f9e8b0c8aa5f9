"""Fleets on one machine that talk by UDP multicast, each in a group of its own."""

import sys
from secrets import randbelow

import can
import pytest

from protocol.links.bus import open_bus

INTERFACE = "udp_multicast"
WAIT_S = 5.0


@pytest.mark.skipif(sys.platform != "linux", reason="other systems separate the groups themselves")
def test_a_fleet_of_another_group_on_this_machine_is_not_heard() -> None:
    """Linux gave every socket of the port all groups that the machine had joined. A field of two robots
    was not worked at all, because a test of another fleet ran beside it."""
    last = randbelow(125)
    mine, other = f"239.74.162.{1 + last}", f"239.74.162.{126 + last}"
    listener, speaker, stranger = (open_bus(INTERFACE, g).bus for g in (mine, mine, other))
    try:
        for _ in range(20):
            stranger.send(can.Message(arbitration_id=1, is_extended_id=True, data=b"other"))
        speaker.send(can.Message(arbitration_id=2, is_extended_id=True, data=b"mine"))
        heard = listener.recv(WAIT_S)
        assert heard is not None and bytes(heard.data) == b"mine"
        assert listener.recv(0.0) is None
    finally:
        for bus in (listener, speaker, stranger):
            bus.shutdown()
