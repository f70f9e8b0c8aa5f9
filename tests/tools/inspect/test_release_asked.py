"""A release that is asked for at a terminal, as tools show it beside what a robot asks for itself."""

from io import StringIO

from rich.console import Console

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.name import fleet_name
from tools.inspect.robot_table import RELEASE_ASKED, show
from tools.livemap.map_state import Watcher
from tools.report.timeline import History

AT, SLOT = 129, 1
ASKS = OperatorReport(SLOT, 3, ReportKind.ASKING, 1.0, 2.0)
RELEASE = OperatorReport(SLOT, 0, ReportKind.RELEASE_ASKED, 0.0, 0.0)


def test_a_release_is_asked_for_while_a_robot_says_so_and_its_own_question_stays() -> None:
    watcher, timeline = Watcher(), History()
    for listener in (watcher, timeline):
        listener.hear(0.0, encode(AddressClaimed(fleet_name("n", SLOT).pack()), AT))
        listener.hear(0.1, encode(Member(SLOT, 1, 7), AT))
        listener.hear(0.9, encode(ASKS, AT))
        for k in range(6):
            listener.hear(1.0 + k * 0.5, encode(RELEASE, AT))
    (robot,) = watcher.to_dict()["robots"]
    assert robot["release_asked"] is True and robot["question"] == 3
    assert watcher.asking[SLOT].number == 3
    said = StringIO()
    show(watcher.to_dict(), Console(file=said, width=200))
    assert f"robot {SLOT}: {RELEASE_ASKED}" in said.getvalue()
    asked = [event for event in timeline.seen if "release" in event.what]
    assert len(asked) == 1, "one line, not one for each frame"
    watcher.hear(9.0, encode(Heartbeat(1, 4, True, False, True, False, 1.0, 0, 0), AT))
    (robot,) = watcher.to_dict()["robots"]
    assert robot["release_asked"] is False
