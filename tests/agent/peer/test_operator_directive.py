"""What an operator sends a robot to do instead of its work."""

import pytest

from agent.interface.effects import Send
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard
from agent.peer.peer import Peer
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.frames.safety_frames import Command, OperatorCommand
from tests.agent.lone_peer import introduce_tools, peer_in

TOOL = 249


def told(peer: Peer, command: Command) -> list[ReportKind]:
    """What it reports of this order to it alone."""
    effects = peer.step(Heard(TOOL, OperatorCommand(command, 0, TOOL, 0)), 0)
    said = [effect.message for effect in effects if isinstance(effect, Send)]
    return [ReportKind(each.matter) for each in said if isinstance(each, OperatorReport)]


@pytest.mark.parametrize("held", [Command.STOP, Command.HOLD], ids=lambda command: command.name)
def test_a_robot_that_waits_for_a_start_goes_on_no_errand(held: Command) -> None:
    """It said that it was under way and stood on, and its start ended the errand."""
    peer = introduce_tools(peer_in(State.WORKING, None), TOOL)
    assert told(peer, Command.GO_HOME) == [ReportKind.REFUSED], "it knows no home yet"
    peer.named.directive.home = (5.0, 0.0)
    told(peer, held)
    assert told(peer, Command.GO_HOME) == [ReportKind.REFUSED]
    told(peer, Command.START)
    assert told(peer, Command.GO_HOME) == [ReportKind.UNDER_WAY]
