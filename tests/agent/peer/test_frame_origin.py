"""Where frames come from, and what is kept until the NAME of their sender is known."""

import pytest

from agent.interface.config import MS, S
from agent.peer.frame_origin import KEPT_US, Origin, Origins
from protocol.frames.safety_frames import Command, EmergencyReset, OperatorCommand
from protocol.name import GATEWAY_FUNCTION, DeviceFields, Name, fleet_name, tool_name

TOOL, OPERATOR = 249, 200


@pytest.mark.parametrize("stopped_at_us", [0, 1 * S, 2 * S])
def test_a_kept_reset_does_not_end_a_stop_that_came_after_it(stopped_at_us: int) -> None:
    """Found by `headland chaos`, profile press, seed 950145, and flood, seed 950180: after a flood the
    orders of an operator left before the stop that they then released. What is cleared stays cleared,
    because it names its stop."""
    origins = Origins(fleet_name("field", 1))
    cleared = EmergencyReset(3, 1, 1, OPERATOR)
    reset = OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR)
    origins.keep(TOOL, cleared, 1 * S)
    origins.keep(TOOL, reset, 1 * S + 5 * MS)
    kept = origins.kept(TOOL, 1 * S + 20 * MS, stopped_at_us)
    assert kept == ([cleared, reset] if stopped_at_us <= 1 * S else [cleared])
    assert origins.kept(TOOL, 1 * S + 20 * MS, 0) == []


def test_a_kept_order_is_void_after_its_time() -> None:
    origins = Origins(fleet_name("field", 1))
    origins.keep(TOOL, OperatorCommand(Command.START, 255, OPERATOR), 1 * S)
    assert origins.kept(TOOL, 1 * S + KEPT_US + 1, 0) == []


DEVICE = DeviceFields(manufacturer=555, function=140, device_class=24, ecu_instance=1)


def test_robots_of_another_manufacturer_code_know_each_other_and_our_tools() -> None:
    origins = Origins(fleet_name("field", 1, DEVICE))
    for address, name, origin in (
        (128, fleet_name("field", 2, DEVICE), Origin.OURS),
        (129, fleet_name("field", 3), Origin.OURS),  # its robot file has no such table
        (130, fleet_name("meadow", 2, DEVICE), Origin.ANOTHER_FLEET),
        (131, fleet_name("field", 2, DEVICE._replace(function=141)), Origin.FOREIGN),
        (132, fleet_name("field", 2, DEVICE._replace(manufacturer=556)), Origin.FOREIGN),
        (133, fleet_name("field", 2, DEVICE)._replace(industry_group=1), Origin.FOREIGN),
        (249, tool_name(7), Origin.OURS),
        (250, Name(7, function=GATEWAY_FUNCTION, device_class=0), Origin.OURS),
    ):
        assert origins.claimed(address, name.pack()) is origin, address
    assert [address for address in range(256) if origins.is_robot(address)] == [128, 129]


def test_a_gateway_takes_no_gateway_for_a_robot() -> None:
    origins = Origins(Name(1, function=GATEWAY_FUNCTION, device_class=0))
    other = Name(2, function=GATEWAY_FUNCTION, device_class=0)
    assert origins.claimed(250, other.pack()) is Origin.OURS and not origins.is_robot(250)


def test_a_fleet_of_the_default_reads_no_robot_of_another_code() -> None:
    origins = Origins(fleet_name("field", 1))
    assert origins.claimed(128, fleet_name("field", 2, DEVICE).pack()) is Origin.FOREIGN
