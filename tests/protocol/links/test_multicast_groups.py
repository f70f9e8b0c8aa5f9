"""Fleets on one machine that talk by UDP multicast, each in a group of its own."""

import sys
from secrets import randbelow

import can
import pytest

from protocol.links.bus import open_bus

INTERFACE = "udp_multicast"
WAIT_S = 5.0


@pytest.mark.skipif(sys.platform != "linux", reason="other systems separate the groups themselves")
@pytest.mark.parametrize("prefix", ["239.74.162.", "ff15:7079:7468:6f6e:6465:6d6f:6d63:"])
def test_a_fleet_of_another_group_on_this_machine_is_not_heard(prefix: str) -> None:
    """Linux gives every socket of the port all groups that the machine has joined."""
    last = randbelow(90)  # also four digits of hexadecimal
    mine, other = f"{prefix}{10 + last}", f"{prefix}{110 + last}"
    try:
        listener, speaker, stranger = (open_bus(INTERFACE, g).bus for g in (mine, mine, other))
    except (OSError, can.CanError) as problem:
        if ":" not in prefix:
            raise
        pytest.skip(f"this machine has no IPv6 multicast: {problem}")
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
