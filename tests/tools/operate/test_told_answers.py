"""What an order and a release say to a person where there is little to say."""

import json

import pytest

from protocol.frames.operator_frames import OperatorReport, ReportKind
from tools.operate import order
from tools.operate.operator_device import KnownRobot


@pytest.mark.parametrize(
    ("obeyed", "line"),
    [(True, "robot 0: obeys start"), (False, "robot 0: DOES NOT OBEY start; it has not answered")],
)
def test_a_robot_that_says_nothing_is_not_quoted(
    obeyed: bool, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`obeys start; it says: nothing` sounded as if something were wrong."""
    order._tell(KnownRobot(0, 128, 0.0), "start", False, obeyed, True, False)
    assert capsys.readouterr().out == f"{line}\n"


@pytest.mark.parametrize(
    ("what", "asked", "ends"),
    [
        ("replan", False, "it says: REFUSED: replan answers a robot that asks what to do about an "
         "obstacle, and it has not asked"),
        ("replan", True, "it says: REFUSED"),
    ],
)  # fmt: skip
def test_an_answer_to_nothing_is_told_as_one(
    what: str, asked: bool, ends: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tutorial's `order 2 replan` was refused, and nothing said why."""
    robot = KnownRobot(0, 128, 0.0, report=OperatorReport(0, 0, ReportKind.REFUSED, 0.0, 0.0))
    order._tell(robot, what, asked, False, True, False)
    assert capsys.readouterr().out.endswith(f"{ends}\n")
    order._tell(robot, what, asked, False, True, True)
    assert bool(json.loads(capsys.readouterr().out)["why"]) == ("not asked" in ends)


@pytest.mark.parametrize(
    ("what", "stopped", "started", "ends"),
    [
        ("go-home", False, False, "REFUSED: it waits for a start: headland order 3 start"),
        ("set-goal", False, False, "REFUSED: it waits for a start: headland order 3 start"),
        ("set-goal", True, False, "in which it takes no orders: headland release"),
        ("stop", True, True, "in which it takes no orders: headland release"),
        ("go-home", False, True, "its work has no home to which it may drive"),
        ("set-goal", False, True, "or its work takes no places"),
    ],
)
def test_a_refusal_says_what_a_person_can_do(
    what: str, stopped: bool, started: bool, ends: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`DOES NOT OBEY go-home; it says: REFUSED` was all that a person was told."""
    refused = OperatorReport(3, 0, ReportKind.REFUSED, 0.0, 0.0)
    robot = KnownRobot(3, 128, 0.0, stopped=stopped, started=started, report=refused)
    order._tell(robot, what, False, False, True, False)
    assert capsys.readouterr().out.endswith(f"{ends}\n")


def test_a_robot_that_is_not_heard_is_a_document_for_programs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Asked for JSON, it printed nothing, and a program that read it failed."""
    monkeypatch.setattr(order, "LISTEN_S", 0.01)
    nobody = ("virtual", "a bus without robots", 250_000, "127.0.0.1", 0)
    assert order.order(1, "wait", None, nobody, None, 0.1, True) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["robot"], told["obeyed"], told["why"]) == (1, False, "not heard")
