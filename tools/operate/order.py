"""`headland order`: a person's answer to one robot, or where it shall go; the robot confirms."""

import asyncio
import sys
from math import hypot
from pathlib import Path

from agent.safety.stop_cause import StopCause
from protocol.frames.operator_frames import OperatorReport, ReportKind, goal_frames
from protocol.frames.safety_frames import Command
from sim.files.strict_json import dumps
from tools.common.bus_address import Attached, AttachError
from tools.common.bus_attach import attach
from tools.common.exit_codes import wrong
from tools.common.launch_keys import own_keys
from tools.common.told_wait import told_wait
from tools.operate.estop import NOT_ALL, listen_to
from tools.operate.operator_device import KnownRobot, Operator
from tools.operate.reset import NOT_SIGNED, operator_keyring

LISTEN_S = 1.3  # an open question is said again every second
STEP_S = 0.3  # time between two tries: a robot may first have to ask for our identity
SAME_M = 1.0  # a robot tells a place in coarser steps than an operator does
# What the robot tells when it obeys; those that answer a question also end an errand.
CONFIRMED = {
    "wait": (Command.WAIT, (ReportKind.WAITING,)),
    "continue": (Command.CONTINUE, (ReportKind.GOING_ROUND, ReportKind.WORKING)),
    "replan": (Command.REPLAN, (ReportKind.GOING_ROUND, ReportKind.WORKING)),
    "stop": (Command.STOP, (ReportKind.STOPPED,)),
    "go-home": (Command.GO_HOME, (ReportKind.UNDER_WAY, ReportKind.ARRIVED)),
    "set-goal": (Command.SET_GOAL, (ReportKind.UNDER_WAY, ReportKind.ARRIVED)),
    "start": (Command.START, ()),
}
# Causes that a start of one robot ends.
BY_START = {
    cause.number for cause in (StopCause.NOT_STARTED, StopCause.PLACE_FROZEN, StopCause.PLACE_LOST)
}


def order(
    robot: int, what: str, place: str | None, bus: Attached, key: Path | None, timeout_s: float,
    as_json: bool,
) -> int:  # fmt: skip
    """The exit code of `headland order`: 0 if the robot says that it obeys, 1 if it refuses or is
    not heard, 2 for an order that makes no sense or a bus that is not there. A ValueError inside
    becomes a line."""
    interface, _, _, host, port = bus
    key = key or own_keys(interface, host, port)
    try:
        if what not in CONFIRMED:
            raise ValueError(f"{what}: unknown; one of {', '.join(CONFIRMED)}")
        goal = _place(place) if what == "set-goal" else None
        if place is not None and goal is None:
            raise ValueError(f"{what} takes no place")
        return asyncio.run(_order(robot, what, goal, bus, key, timeout_s, as_json))
    except (ValueError, AttachError) as problem:
        return wrong(problem)


def _place(text: str | None) -> tuple[float, float]:
    try:
        x_m, y_m = map(float, (text or "").split(","))
        goal_frames(0, 0, x_m, y_m)
    except (ValueError, OverflowError):
        raise ValueError(
            f"set-goal {text or ''}: needs metres east,north within 3276 m, as 12.5,-40"
        ) from None
    return x_m, y_m


async def _order(
    slot: int, what: str, goal: tuple[float, float] | None, bus: Attached, key: Path | None,
    timeout_s: float, as_json: bool,
) -> int:  # fmt: skip
    keyring = operator_keyring(key, timeout_s)
    can_bus = attach(*bus)
    try:
        operator = Operator(can_bus, keyring)
        listen_to(can_bus, operator)
        await operator.listen(LISTEN_S)
        operator.check_address()
        robot = next((r for r in operator.live if r.slot == slot), None)
        if robot is None:
            heard = ", ".join(str(r.slot) for r in operator.live) or "none"
            if as_json:
                print(_document(slot, what, False, False, None, keyring is not None, "not heard"))
            print(f"headland: robot {slot} is not heard; heard: {heard}", file=sys.stderr)
            return NOT_ALL
        question = robot.question
        with told_wait(f"until robot {slot} obeys or says why not", timeout_s):
            obeyed = await convey(operator, robot, what, goal, timeout_s)
        if not obeyed:
            operator.check_address()
        _tell(robot, what, question is not None, obeyed, keyring is not None, as_json)
        return 0 if obeyed else NOT_ALL
    finally:
        can_bus.close()


async def convey(
    operator: Operator,
    robot: KnownRobot,
    what: str,
    goal: tuple[float, float] | None,
    timeout_s: float,
) -> bool:
    """Repeat an order until the robot says that it obeys (True), or that it cannot, or the time is
    over. `goal`: metres east and north."""
    loop = asyncio.get_running_loop()
    command, matters = CONFIRMED[what]
    number = robot.question.number if robot.question is not None else 0
    answers = command in (Command.WAIT, Command.CONTINUE, Command.REPLAN)
    end_s = loop.time() + timeout_s
    robot.report = None
    robot.causes.forget()
    while (said_s := loop.time()) < end_s:
        if goal is not None:
            operator.send_to(robot.slot, *goal)
        else:
            operator.command(command, robot.slot, number if answers else 0)
        await asyncio.sleep(min(STEP_S, timeout_s))
        if command is Command.START and _started(robot, said_s, loop.time()):
            return True
        if robot.report is not None and robot.report.matter in (*matters, ReportKind.REFUSED):
            if goal is not None and _has_half(robot, robot.report, goal):
                continue
            return robot.report.matter in matters
    return False


def _has_half(robot: KnownRobot, report: OperatorReport, goal: tuple[float, float]) -> bool:
    """Whether a robot that may drive refuses another place: a frame of ours was lost, and it has not
    heard this one whole. `goal`: metres east and north."""
    able = robot.started and not robot.stopped
    elsewhere = hypot(report.x_m - goal[0], report.y_m - goal[1]) > SAME_M
    return report.matter is ReportKind.REFUSED and able and elsewhere


def _started(robot: KnownRobot, said_s: float, now_s: float) -> bool:
    """Whether a robot has taken the start that was said at `said_s`.

    A latched robot refuses it. A robot that has lost its place had its start before, so it must also
    say that it may move, or name only causes that no start ends."""
    if robot.stopped or not robot.started or robot.asked_s >= said_s:
        return False
    now_us = round(now_s * 1e6)
    named = {told.cause for told in robot.causes.fresh(now_us)}
    known = bool(named) and not robot.causes.missing(now_us)
    return not robot.held or (known and named.isdisjoint(BY_START))


# Orders that send a robot somewhere, and why one that may drive refuses them.
PLACES = {
    "go-home": "its work has no home to which it may drive",
    "set-goal": (
        "the place is not where it may drive: outside, or too near to something solid; or its work "
        "takes no places"
    ),
}
ANSWERS = ("wait", "continue", "replan")  # to a question of the robot


def _why(robot: KnownRobot, what: str, asked: bool) -> str:
    """Why a robot refuses and what a person can do, as far as can be known from outside; empty: no reason
    is known."""
    if robot.report is None or robot.report.matter is not ReportKind.REFUSED:
        return ""
    if robot.stopped:
        return "it stands in an emergency stop, in which it takes no orders: headland release"
    if what in PLACES:
        if not robot.started:
            return f"it waits for a start: headland order {robot.slot} start"
        return PLACES[what]
    if what in ANSWERS and not asked:
        return (
            f"{what} answers a robot that asks what to do about an obstacle, and it has not asked"
        )
    return ""


def _document(
    slot: int, what: str, asked: bool, obeyed: bool, report: OperatorReport | None, signed: bool,
    why: str,
) -> str:  # fmt: skip
    """What became of an order, as JSON."""
    return dumps({
        "robot": slot, "order": what, "obeyed": obeyed, "was_asking": asked,
        "answer": None if report is None else report.matter.name,
        "x_m": None if report is None else round(report.x_m, 1),
        "y_m": None if report is None else round(report.y_m, 1), "signed": signed, "why": why or None,
    })  # fmt: skip


def _tell(
    robot: KnownRobot, what: str, asked: bool, obeyed: bool, signed: bool, as_json: bool
) -> None:
    report = robot.report
    why = "" if obeyed else _why(robot, what, asked)
    if as_json:
        print(_document(robot.slot, what, asked, obeyed, report, signed, why))
        return
    said = "" if report is None else f"; it says: {report.matter.name.replace('_', ' ')}"
    if report is None and not obeyed:
        said = "; it has not answered"
    said += f": {why}" if why else ""
    print(f"robot {robot.slot}: {'obeys' if obeyed else 'DOES NOT OBEY'} {what}{said}")
    if not signed:
        print(NOT_SIGNED)
