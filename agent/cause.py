"""Why a robot may not move as it wishes: each cause with its severity and what clears it.

After PX4's failsafe framework: severities are ordered, the worst active one wins, and the clear
condition is declared beside the cause, not in the code that happens to run.
"""

from enum import Enum, IntEnum
from typing import NamedTuple


class Severity(IntEnum):
    CLEAR = 0
    SLOW = 1  # creep
    PAUSE = 2  # stand, by decision of a person or for one
    PROTECTIVE = 3  # stand; ends by itself when the cause is gone
    LATCHED = 4  # stand until a person at this machine resets it


class Clears(Enum):
    BY_START = "an operator's start"
    BY_ANSWER = "it has left for 1 s, or an operator's answer"
    BY_POLICY = "the silent member is heard again and the membership is stable for 2 s; or as the policy says"
    WHEN_GONE = "the cause is gone"
    WHEN_IN_TIME = "it is sensed in time for 1 s; look at the receiver, its cable and its driver"
    BY_MOVE_OR_START = (
        "the place changes, or an operator's start after a look at receiver and wheels"
    )
    BY_TIMEOUT = "it is not repeated for its time"
    BY_RESET = "every stop dot is cleared by an operator's reset, then a person resets this machine"
    NEVER = "never by itself: repair and restart"


class _Rule(NamedTuple):
    severity: Severity
    clears: Clears
    why: str


class Cause(Enum):
    NOT_STARTED = _Rule(Severity.PAUSE, Clears.BY_START, "no start was given since boot or reset")
    OBSTACLE_AHEAD = _Rule(
        Severity.PAUSE, Clears.BY_ANSWER, "something that is not a robot blocks the way"
    )
    CREEP = _Rule(Severity.SLOW, Clears.BY_POLICY, "a member is silent and the policy is slow")
    MEMBER_SILENT = _Rule(
        Severity.PROTECTIVE, Clears.BY_POLICY, "a member stopped speaking without leaving"
    )
    BACKBONE_LOST = _Rule(
        Severity.PROTECTIVE, Clears.WHEN_GONE, "no other segment is reached and the policy is stop"
    )
    BACKBONE_CREEP = _Rule(
        Severity.SLOW, Clears.WHEN_GONE, "no other segment is reached and the policy is slow"
    )
    BUS_OFF = _Rule(Severity.PROTECTIVE, Clears.WHEN_GONE, "the controller left the bus")
    ERROR_PASSIVE = _Rule(
        Severity.PROTECTIVE, Clears.WHEN_GONE, "the controller has been error passive for 1 s"
    )
    UNHEARD = _Rule(
        Severity.PROTECTIVE,
        Clears.WHEN_GONE,
        "our frames do not leave, or nobody says that it hears us",
    )
    SENSES_OLD = _Rule(
        Severity.PROTECTIVE,
        Clears.WHEN_IN_TIME,
        "where the robot is was sensed more than 0.1 s ago, or not at all",
    )
    PLACE_FROZEN = _Rule(
        Severity.PROTECTIVE,
        Clears.BY_MOVE_OR_START,
        "the wheels were told to drive and the place did not change",
    )
    ADDRESS_LOST = _Rule(
        Severity.PROTECTIVE, Clears.WHEN_GONE, "another device took the source address"
    )
    CONFIG_MISMATCH = _Rule(
        Severity.PROTECTIVE, Clears.NEVER, "a member has another field description"
    )
    LATE_TICK = _Rule(
        Severity.PROTECTIVE,
        Clears.BY_TIMEOUT,
        "a control period came later than its drive command lives",
    )
    UNAUTHENTICATED_STOP = _Rule(
        Severity.PROTECTIVE, Clears.BY_TIMEOUT, "a stop without a valid tag"
    )
    SPENT_STOP = _Rule(
        Severity.PROTECTIVE, Clears.BY_TIMEOUT, "a stop with a name that was cleared before"
    )
    IMPLEMENTS_STOP = _Rule(
        Severity.PROTECTIVE, Clears.BY_TIMEOUT, "ISO 11783-7 all implements stop"
    )
    DISK_ERROR = _Rule(Severity.LATCHED, Clears.NEVER, "durable memory failed")
    STOP_DOT = _Rule(Severity.LATCHED, Clears.BY_RESET, "an emergency stop")
    BOOT_UNCONFIRMED = _Rule(
        Severity.LATCHED, Clears.BY_RESET, "durable memory was lost or is unreadable"
    )

    severity: Severity
    clears: Clears

    def __init__(self, severity: Severity, clears: Clears, why: str) -> None:
        self.severity, self.clears = severity, clears  # read with every beat of a standing fleet

    __hash__ = object.__hash__  # members are their own identity; Enum's hash is a call in Python


# Names of their own for what is asked for with every beat of a standing fleet.
WORST, LEAST = Severity.LATCHED, Severity.SLOW
NOT_STARTED, SILENT, CREEP = Cause.NOT_STARTED, Cause.MEMBER_SILENT, Cause.CREEP


def cause_table() -> str:
    """The table in the documents."""
    rows = [f"| {c.name} | {c.severity.name} | {c.value.why} | {c.clears.value} |" for c in Cause]
    return "\n".join(["| cause | severity | why | what clears it |", "|---|---|---|---|", *rows])
