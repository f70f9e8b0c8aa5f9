"""Where frames come from, and what is kept until the NAME of their sender is known."""

import pytest

from agent.interface.config import MS, S
from agent.peer.frame_origin import KEPT_US, Origins
from protocol.frames.safety_frames import Command, EmergencyReset, OperatorCommand
from protocol.name import fleet_name

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
