"""What a launch tells while it runs: at a terminal one line, elsewhere lines, and events once each."""

from io import StringIO

from rich.console import Console

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, StandsBy, Standstill
from protocol.frames.network_frames import AddressClaimed
from protocol.name import fleet_name
from tools.inspect.inspector import Inspector
from tools.run.launch_status import LaunchStatus


def heard(inspector: Inspector, t_s: float, state: State) -> None:
    stopped = state is State.EMERGENCY_STOP
    for message in (
        AddressClaimed(fleet_name("told", 1).pack()),
        Member(1, 0, 1),
        Heartbeat(1, state, stopped, False, True, False, 1.0, 0, 0),
    ):
        inspector.hear(t_s, encode(message, 141, 255))


def told(terminal: bool) -> str:
    inspector = Inspector()
    console = Console(file=StringIO(), force_terminal=terminal, width=100, color_system=None)
    with LaunchStatus(console, inspector, has_keys=True) as status:
        stop = State.EMERGENCY_STOP
        story = [State.IDLE, State.WORKING, stop, stop, State.IDLE, State.IDLE]
        for second, state in enumerate(story):
            heard(inspector, float(second), state)
            status.tell(float(second), second, 9, "sections")
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_in_a_pipe_the_line_comes_every_five_seconds_and_events_once() -> None:
    lines = told(terminal=False).splitlines()
    assert [line for line in lines if "sections" in line] == ["     5 s  5/9 sections  1:IDLE"]
    assert sum("EMERGENCY STOP: robot 1 stands" in line for line in lines) == 1
    assert lines.count("the stop is released") == 1


def test_at_a_terminal_one_line_renews_itself() -> None:
    text = told(terminal=True)
    assert "5/9 sections" in text or "robots start" in text
    assert "EMERGENCY STOP: robot 1 stands" in text and "the stop is released" in text
    assert "\n     5 s" not in text


def test_robots_are_silent_where_nothing_is_heard_at_all() -> None:
    """The hub of a launch was killed, and its line went on to say that all worked."""
    inspector = Inspector()
    console = Console(file=StringIO(), width=100, color_system=None)
    with LaunchStatus(console, inspector, has_keys=True) as status:
        heard(inspector, 1_000.0, State.WORKING)
        status.tell(5.0, 5, 9, "sections")
        status.tell(10.0, 5, 9, "sections")
        heard(inspector, 1_010.0, State.WORKING)
        status.tell(15.0, 5, 9, "sections")
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert [line[-9:] for line in lines] == ["1:WORKING", " 1:silent", "1:WORKING"]


def test_a_robot_that_may_not_move_says_why() -> None:
    """On a busy machine a fleet stood for minutes with old senses, and the line said WORKING."""
    inspector = Inspector()
    console = Console(file=StringIO(), width=100, color_system=None)
    with LaunchStatus(console, inspector, has_keys=True) as status:
        heard(inspector, 5.0, State.WORKING)
        for beat in (
            Heartbeat(1, State.WORKING, False, True, True, False, 1.0, 0, 0),
            Standstill(1, StandsBy.SENSES_OLD, 0, 1),
        ):
            inspector.hear(5.0, encode(beat, 141, 255))
        status.tell(5.0, 5, 9, "sections")
        heard(inspector, 10.0, State.WORKING)
        status.tell(10.0, 6, 9, "sections")
        for beat in (
            Heartbeat(2, State.EMERGENCY_STOP, True, True, True, False, 1.0, 0, 0),
            Standstill(1, StandsBy.STOP_DOT, 0, 1),
        ):
            inspector.hear(15.0, encode(beat, 141, 255))
        status.tell(15.0, 6, 9, "sections")
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert lines[-1].endswith("1:EMERGENCY_STOP"), "the state says why"
    assert lines[0].endswith("1:WORKING(SENSES_OLD)") and lines[1].endswith("1:WORKING")
