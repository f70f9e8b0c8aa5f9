"""Why a robot may not move freely: each stop cause with its severity and its clear condition.

This follows the failsafe framework of PX4. Severities are ordered, and the worst active one wins.
The clear condition is declared beside the cause, not in the code that happens to run.
"""

import re
from enum import Enum, IntEnum
from typing import NamedTuple

from protocol.frames.fleet_frames import NOBODY, StandsBy


class Severity(IntEnum):
    """What a cause forbids, from nothing to all motion until a person resets the machine."""

    CLEAR = 0
    SLOW = 1  # creep
    PAUSE = 2  # stand still: a person decided so, or a person has to decide
    PROTECTIVE = 3  # stand still; ends by itself when the cause is gone
    LATCHED = 4  # stand still until a person at this machine resets it


class ClearCondition(Enum):
    """What ends a cause, in words for people; `cause_table` prints them."""

    BY_START = "an operator's start"
    BY_ANSWER = "it has left for 1 s, or an operator's answer"
    BY_POLICY = "the silent member is heard again and the membership is stable for 2 s; or as the policy says"
    WHEN_GONE = "the cause is gone"
    WHEN_IN_TIME = "it is sensed in time for 1 s; look at the receiver, its cable and its driver"
    WHEN_SCANNED = (
        "scans arrive and change for 1 s; look at the range sensors, their cable and their driver"
    )
    WHEN_RAISED = (
        "the implement is up; look at its lift, and at the sensor that says that it is down"
    )
    BY_MOVE_OR_START = (
        "the place changes, or an operator's start after a look at receiver and wheels"
    )
    BY_RETURN_OR_START = "it is accurate, and back where it was before it jumped, for 1 s; or an operator's start of this robot alone"
    BY_TIMEOUT = "it is not repeated for its time"
    BY_RESET = "every stop dot is cleared by an operator's reset, then a person resets this machine"
    WHEN_APART = "that machine agrees, changes its address or has not been heard for 5 s"
    NEVER = "never by itself: repair and restart"


class _Rule(NamedTuple):
    severity: Severity
    clears: ClearCondition
    why: str
    do: str = ""  # what a person can do about it


class StopCause(Enum):
    """Every cause that can stop or slow a robot: severity, clear condition, reason, and what a
    person can do. docs/use/stopping.md prints the table.
    """

    NOT_STARTED = _Rule(
        Severity.PAUSE,
        ClearCondition.BY_START,
        "no start was given since boot or reset",
        "give the start: headland release --start, or START on the map",
    )
    OBSTACLE_AHEAD = _Rule(
        Severity.PAUSE,
        ClearCondition.BY_ANSWER,
        "something that is not a robot blocks the way",
        "look at what blocks it; take it away, or answer its question",
    )
    WORK_OFF = _Rule(
        Severity.PAUSE,
        ClearCondition.WHEN_GONE,
        "a task controller of the bus has switched its work off",
        "switch its work on at the terminal of that task controller",
    )
    CREEP = _Rule(
        Severity.SLOW,
        ClearCondition.BY_POLICY,
        "a member is silent and the policy is slow",
        "find the silent robot, or waive it by name",
    )
    MEMBER_SILENT = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_POLICY,
        "a member stopped speaking without leaving",
        "look for the silent robot: power, bus, an accident; waive it by name if it stays away",
    )
    BACKBONE_LOST = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_GONE,
        "no other segment is reached and the policy is stop",
        "look at the gateway and its link to the other segments",
    )
    BACKBONE_CREEP = _Rule(
        Severity.SLOW,
        ClearCondition.WHEN_GONE,
        "no other segment is reached and the policy is slow",
        "look at the gateway and its link to the other segments",
    )
    BUS_OFF = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_GONE,
        "the controller left the bus",
        "look at the wiring, the bit rate and the termination of this robot",
    )
    ERROR_PASSIVE = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_GONE,
        "the controller has been error passive for 1 s",
        "look at the wiring, the bit rate and the termination of this robot",
    )
    UNHEARD = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_GONE,
        "our frames do not leave, or nobody says that it hears us",
        "look at the connection of this robot to the bus, and whether something floods the bus",
    )
    SENSES_OLD = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_IN_TIME,
        "where the robot is was sensed more than 0.1 s ago, or not at all",
        "look at the receiver of this robot, its cable and its driver",
    )
    PLACE_FROZEN = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_MOVE_OR_START,
        "the wheels were told to drive and the place did not change",
        "look at receiver and wheels of this robot, then give it a start",
    )
    PLACE_LOST = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_RETURN_OR_START,
        "the sensed place is inaccurate, or jumped further than the wheels can drive",
        "look at the receiver and its corrections; if the new place is right, headland order ROBOT start",
    )
    SCAN_LOST = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_SCANNED,
        "no scan of the range sensors arrives, or always the same one",
        "look at the range sensors of this robot, their cable and their driver",
    )
    IMPLEMENT_DOWN = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_RAISED,
        "the implement was told to rise and is sensed down for more than 1 s",
        "look at the implement of this robot and its lift, by hand if need be",
    )
    ADDRESS_LOST = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_GONE,
        "another device took the source address",
        "look for a device that claims the addresses of robots",
    )
    CONFIG_MISMATCH = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_APART,
        "a robot of this fleet has another field description, other frames, or a slot beyond our number "
        "of robots",
        "start all with the same release, fleet and field, or switch that robot off",
    )
    DUPLICATE_ID = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.WHEN_APART,
        "another machine has the identity of this one",
        "give one of the two machines another slot, or switch it off",
    )
    LATE_TICK = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_TIMEOUT,
        "a control period came later than its drive command lives",
        "it goes on by itself; if it comes again, look at the load of its computer",
    )
    UNAUTHENTICATED_STOP = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_TIMEOUT,
        "a stop without a valid tag, or from an address that nobody has claimed",
        "look for the device that says it; give it a key or a NAME of ours",
    )
    SPENT_STOP = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_TIMEOUT,
        "a stop with a name that was cleared before",
        "look for the panel that says it; a press there again takes a new name",
    )
    IMPLEMENTS_STOP = _Rule(
        Severity.PROTECTIVE,
        ClearCondition.BY_TIMEOUT,
        "ISO 11783-7 all implements stop",
        "release the stop button that is pressed",
    )
    DISK_ERROR = _Rule(
        Severity.LATCHED,
        ClearCondition.NEVER,
        "durable memory failed",
        "replace the disk of this robot and restart it",
    )
    STOP_DOT = _Rule(
        Severity.LATCHED,
        ClearCondition.BY_RESET,
        "an emergency stop",
        "see that no person is in danger, then headland release",
    )
    BOOT_UNCONFIRMED = _Rule(
        Severity.LATCHED,
        ClearCondition.BY_RESET,
        "durable memory was lost or is unreadable",
        "look at this robot, then headland release",
    )

    severity: Severity
    clears: ClearCondition

    def __init__(self, severity: Severity, clears: ClearCondition, why: str, do: str = "") -> None:
        self.severity, self.clears = severity, clears  # read with every beat of a standing fleet

    @property
    def number(self) -> StandsBy:
        """The number of this cause on the bus."""
        return StandsBy.__members__.get(self.name, StandsBy.OTHER)

    __hash__ = object.__hash__  # members are their own identity; Enum's hash is a call in Python


# Module-level names for members that are read with every beat of a stopped fleet: lookup is faster.
WORST, LEAST = Severity.LATCHED, Severity.SLOW
NOT_STARTED, SILENT, CREEP = StopCause.NOT_STARTED, StopCause.MEMBER_SILENT, StopCause.CREEP


def cause_table() -> str:
    """The Markdown table of all causes for the documents."""
    rows = [
        f"| {c.name} | {c.severity.name} | {c.value.why} | {c.clears.value} | {c.value.do} |"
        for c in StopCause
    ]
    head = "| cause | severity | why | what clears it | what a person can do |"
    return "\n".join([head, "|---|---|---|---|---|", *rows])


# The number in a cause's detail that says what it is about: an address, or the slot of a robot.
_ABOUT = {
    StopCause.CONFIG_MISMATCH: ("address", re.compile(r"address (\d+)")),
    StopCause.DUPLICATE_ID: ("address", re.compile(r"address (\d+)")),
    StopCause.UNAUTHENTICATED_STOP: ("address", re.compile(r"address (\d+)")),
    StopCause.SPENT_STOP: ("address", re.compile(r"address (\d+)")),
    StopCause.IMPLEMENTS_STOP: ("address", re.compile(r"address (\d+)")),
    StopCause.WORK_OFF: ("address", re.compile(r"address (\d+)")),
    StopCause.MEMBER_SILENT: ("robot", re.compile(r"(\d+)")),
    StopCause.CREEP: ("robot", re.compile(r"(\d+)")),
}


def about(cause: StopCause, detail: str) -> int:
    """The address or slot that a cause is about, 0 to 254; `NOBODY` (255) if there is none.

    `detail`: the text with which the cause was raised.
    """
    _, pattern = _ABOUT.get(cause, ("", None))
    found = None if pattern is None else pattern.search(detail)
    number = NOBODY if found is None else int(found[1])
    return min(number, NOBODY)


def further(cause: StopCause, detail: str) -> int:
    """How many robots a cause is about beyond the first one; 0 for causes that are not about
    silence.
    """
    if cause not in (StopCause.MEMBER_SILENT, StopCause.CREEP):
        return 0
    return max(0, len(re.findall(r"\d+", detail)) - 1)


def cause_of(number: int) -> StopCause | None:
    """The cause with this number on the bus; None for one that this release does not know."""
    name = StandsBy(number).name if number in set(StandsBy) else StandsBy.OTHER.name
    return StopCause.__members__.get(name)


def sentence(number: int, subject: int, count: int = 0) -> str:
    """One line for people: why a robot stands still and what they can do, from its frames on the
    bus.

    `number`: the cause on the bus. `subject`: an address or a slot, or `NOBODY`. `count`: how many
    stops hold it, or how many further robots are silent.

    >>> sentence(StandsBy.CONFIG_MISMATCH, 200)
    'CONFIG_MISMATCH with address 200: start all with the same release, fleet and field, or switch that robot off'
    >>> sentence(StandsBy.STOP_DOT, NOBODY, 3)
    'STOP_DOT (3 stops): see that no person is in danger, then headland release'
    """
    cause = cause_of(number)
    if cause is None:
        return f"{StandsBy.OTHER.name} ({number}): headland inspect --traces asks it what"
    kind = _ABOUT.get(cause, ("", None))[0]
    told = f" with {kind} {subject}" if kind and subject != NOBODY else ""
    if count and cause is StopCause.STOP_DOT:
        told = f" ({count} stop{'s' if count > 1 else ''})"
    elif count and told:
        told += f" and {count} more"
    return f"{cause.name}{told}: {cause.value.do}"
