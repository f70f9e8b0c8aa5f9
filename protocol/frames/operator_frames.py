"""Frames between a robot and its operator; the commands are in `safety_frames.py`."""

from enum import IntEnum
from typing import NamedTuple

from protocol.frames.layout import ROBOT, TOOL, FrameLayout, choice, flag, integer, scaled
from protocol.frames.safety_frames import OPERATOR, OPERATOR_PROOF

PLACE_M = 0.1  # step of coordinates and distances in reports
GOAL_M = 0.2  # step of goals: 15 bits for each coordinate
LOWEST_M = -3276.8  # lowest coordinate, as in POSE; both kinds count steps from it
NUMBERS = 15  # questions are numbered 1 to 15, then from 1 again
GOAL_BITS = 15
GOAL_VALUES = 1 << GOAL_BITS


class ReportKind(IntEnum):
    """What a robot tells: four bits."""

    ASKING = 0  # something that is no robot is in the way: what now?
    WAITING = 1  # it waits until that has left
    GOING_ROUND = 2  # it drives round it
    GONE = 3  # it has left by itself
    STOPPED = 4  # work given back; it stands until an operator's start
    UNDER_WAY = 5  # to the place it was sent to
    ARRIVED = 6  # there
    REFUSED = 7  # the order cannot be obeyed now
    WORKING = 8  # back from where it was sent to
    STALLED = 9  # it wants to drive, gets nowhere, and plans again
    RELEASE_ASKED = 10  # at the virtual terminal that it serves: a key holder has to confirm it


class OperatorReport(NamedTuple):
    """A robot's question to its operators, or what it does about their answer.

    A robot sends the question once a second until it is answered or the obstacle has left, and one
    report for each change after that. RELEASE_ASKED is sent twice a second, at its own place, until the
    release is confirmed or given up. Operator tools display it; robots ignore it.
    """

    slot: int
    number: int
    matter: ReportKind
    x_m: float
    y_m: float
    distance_m: float = 0.0
    radius_m: float = 0.0


OPERATOR_REPORT = FrameLayout(
    OperatorReport, "OPERATOR_REPORT", pgn=0xFF05, priority=4, sender=ROBOT,
    fields=(
        integer("slot", 8, "of the sender"),
        integer("number", 4, "of the question; 0: none was asked", special=((0, "NONE_ASKED"),)),
        choice("matter", 4, ReportKind, "what the robot does or asks", as_enum=True),
        scaled("x_m", 16, PLACE_M, "m", "east: the obstacle, or where the robot is going", LOWEST_M,
               clamped=True),
        scaled("y_m", 16, PLACE_M, "m", "north of the same", LOWEST_M, clamped=True),
        scaled("distance_m", 8, PLACE_M, "m", "from the robot's hull; 25.5: that or more",
               clamped=True),
        scaled("radius_m", 8, PLACE_M, "m", "of what can be seen of the obstacle", clamped=True),
    ),
)  # fmt: skip


class OperatorGoal(NamedTuple):
    """One coordinate of a place for one robot.

    An operator tool sends both coordinates and then the command SET_GOAL, which means the pair.
    The priority is higher than that of the command, because the goal must leave before it.
    """

    target: int
    operator: int
    value: int
    north: bool
    freshness: int = 0
    tag: int = 0

    @property
    def metres(self) -> float:
        """The coordinate in metres from the field origin."""
        return self.value * GOAL_M + LOWEST_M


OPERATOR_GOAL = FrameLayout(
    OperatorGoal, "OPERATOR_GOAL", pgn=0xFF06, priority=1, sender=TOOL,
    fields=(
        integer("target", 8, "slot"),
        integer("operator", 8, OPERATOR, signal="operator_id"),
        integer("value", GOAL_BITS, "steps of 0.2 m from -3276.8 m"),
        flag("north", "0: east, 1: north"),
        *OPERATOR_PROOF,
    ),
)  # fmt: skip


def goal_frames(target: int, operator: int, x_m: float, y_m: float) -> tuple[OperatorGoal, ...]:
    """Both coordinates. Raises ValueError if they are out of range.

    >>> [round(frame.metres, 1) for frame in goal_frames(3, 200, 12.34, -7.0)]
    [12.4, -7.0]
    """
    values = [round((v - LOWEST_M) / GOAL_M) for v in (x_m, y_m)]
    if not all(0 <= value < GOAL_VALUES for value in values):
        raise ValueError(f"{x_m}, {y_m} is not within {-LOWEST_M} m of the field origin")
    return tuple(
        OperatorGoal(target, operator, value, north)
        for value, north in zip(values, (False, True), strict=True)
    )


def goal_check(east: int, north: int) -> int:
    """SET_GOAL's argument: 8 bits that a mixture of an old and a new goal changes, most likely.

    `east` and `north` are the raw values of the two OPERATOR_GOAL frames that it belongs to.
    """
    return (east + (east >> 8) + 3 * north + 5 * (north >> 8)) & 0xFF
