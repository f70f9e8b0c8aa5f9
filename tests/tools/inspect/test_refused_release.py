"""A release that robots refuse is none for a listener on the bus (T11)."""

import pytest

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset, Reason
from protocol.name import fleet_name
from tools.inspect.inspector import Inspector

DOT = (1, 1, 7)


def listener(keyed: bool) -> Inspector:
    """It has heard a robot whose fleet has keys or none, and a press there."""
    inspector = Inspector()
    beat = Heartbeat(1, State.EMERGENCY_STOP, True, True, True, False, 1.0, 0, 0, keyed)
    claim = AddressClaimed(fleet_name("held", 1).pack())
    stop = EmergencyStop(*DOT, Reason.OPERATOR_INTERVENTION, False, 9, 9)
    for message in (claim, Member(1, 1, 7), beat, stop):
        inspector.hear(0.1, encode(message, 129))
    assert inspector.keyed is keyed and inspector.latched == [DOT]
    return inspector


@pytest.mark.parametrize("signs", [False, True])
@pytest.mark.parametrize("reset", [HeldReset(5, 249), EmergencyReset(*DOT, 249)], ids=type)
@pytest.mark.parametrize("keyed", [False, True])
def test_t11_a_fleet_with_keys_is_not_shown_as_released_by_a_reset_without_a_tag(
    keyed: bool, reset: HeldReset | EmergencyReset, signs: bool
) -> None:
    """`headland release` without the keys cleared the stop in `inspect`, on the map and in figures
    for Prometheus, and the robots stood latched."""
    inspector = listener(keyed)
    said: Message = reset._replace(freshness=1, tag=2) if signs else reset
    inspector.hear(0.2, encode(said, 249))
    assert inspector.latched == ([DOT] if keyed and not signs else [])
