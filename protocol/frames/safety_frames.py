"""Frames that stop a fleet and release it. Highest priorities; see `docs/how/safety_case.md`."""

from enum import IntEnum
from typing import NamedTuple

from protocol.frames.layout import (
    ANY_DEVICE,
    ROBOT,
    TOOL,
    FrameLayout,
    choice,
    flag,
    integer,
    reserved,
)

EVERYBODY = 0xFF  # target of an operator's command to all robots


class Reason(IntEnum):
    """Why a stop was pressed: four bits. The first three are the mission's."""

    OBSTACLE_DETECTED = 0
    OPERATOR_INTERVENTION = 1
    SYSTEM_FAULT = 2
    COLLISION_DETECTED = 3
    PERSON_IN_FIELD = 4
    EQUIPMENT_MALFUNCTION = 5
    MAINTENANCE_REQUIRED = 6


class Command(IntEnum):
    """What an operator can order with OPERATOR_COMMAND."""

    MANUAL_RESET = 0
    START = 1
    HOLD = 2
    WAIVE = 3  # argument: the silent member to continue without
    GO_HOME = 4  # give back the work, drive to where it was switched on, and stay there
    CONTINUE = 5  # continue past what is in the way; leave out the ground under it
    # Continue with the remaining work, round what is in the way; return to its place last.
    REPLAN = 6
    WAIT = 7  # stand until it has left
    STOP = 8  # give back the work and stand until START
    SET_GOAL = 9  # give back the work and drive to the place that OPERATOR_GOAL named


class Switch(IntEnum):
    """SPN 5140 of ISO 11783-7: the state of an all implements stop switch."""

    STOP = 0
    PERMIT = 1
    ERROR = 2
    NOT_AVAILABLE = 3


PRESSER = "the presser: robot slot, or 128 to 254 for a panel or an operator device"
OPERATOR = "operator device (192 to 254 in a fleet with keys)"
OPERATOR_PROOF = (
    integer("freshness", 8, "low byte of the operator's freshness counter"),
    integer("tag", 24, "AES-CMAC with the operator's key; 0 in a fleet without keys"),
)


class EmergencyStop(NamedTuple):
    """A press of an emergency stop: all robots stop.

    Any device sends it, and repeats it every 5 ms until all live members are stopped, at most for
    2 s. Each receiver brakes, latches, and sends an echo. The press is identified by its dot: slot,
    incarnation and counter.
    """

    slot: int
    incarnation: int
    counter: int
    reason: int
    echo: bool = False
    freshness: int = 0
    tag: int = 0
    spent: bool = False


EMERGENCY_STOP = FrameLayout(
    EmergencyStop, "EMERGENCY_STOP", pgn=0xFF00, priority=0, sender=ANY_DEVICE,
    fields=(
        integer("slot", 8, PRESSER),
        integer("incarnation", 8, "low byte of the presser's incarnation"),
        integer("counter", 8, "the presser's stop counter"),
        choice("reason", 4, Reason, "why the stop was pressed", strict=False),
        flag("echo", "repeated by a receiver, which is the source of the frame"),
        flag("spent", "of an echo: this dot was cleared before; press with another counter"),
        reserved(2),
        integer("freshness", 8, "low byte of the sender's freshness counter"),
        integer("tag", 24, "AES-CMAC; 0 in a fleet without keys"),
    ),
)  # fmt: skip


class EmergencyReset(NamedTuple):
    """Clears the one stop dot that it names.

    An operator tool sends it once for each stop, after the operator has asked for the reset.
    Receivers keep the dot as cleared; a robot is released when none of its dots is left. With keys
    it needs two frames that agree.
    """

    slot: int
    incarnation: int
    counter: int
    operator: int
    freshness: int = 0
    tag: int = 0


EMERGENCY_RESET = FrameLayout(
    EmergencyReset, "EMERGENCY_RESET", pgn=0xFF01, priority=1, sender=TOOL,
    fields=(
        integer("slot", 8, "of the dot"),
        integer("incarnation", 8, "of the dot"),
        integer("counter", 8, "of the dot"),
        integer("operator", 8, OPERATOR, signal="operator_id"),
        *OPERATOR_PROOF,
    ),
)  # fmt: skip


class StopsHeld(NamedTuple):
    """The sum of all stops that hold a latched robot.

    The robot sends it when a tool asks for its stops. The tool can then clear exactly these with
    HELD_RESET.
    """

    slot: int
    stops: int
    digest: int
    tag: int = 0


STOPS_HELD = FrameLayout(
    StopsHeld, "STOPS_HELD", pgn=0xFF09, priority=4, sender=ROBOT,
    fields=(
        integer("slot", 8, "of the robot"),
        integer("stops", 8, "number of stops; 255: as many or more, or some without a name",
                special=((255, "AS_MANY_OR_MORE"),)),
        integer("digest", 24, "of all of them"),
        integer("tag", 24, "AES-CMAC with the operator's key, also over the 48 bits of the "
                "question; 0 in a fleet without keys"),
    ),
)  # fmt: skip


class HeldReset(NamedTuple):
    """Clears all stops of every robot that holds exactly those of the digest.

    An operator tool sends it for robots that hold more stops than can be named one by one. A robot
    with another digest ignores it.
    """

    digest: int
    operator: int
    freshness: int = 0
    tag: int = 0


HELD_RESET = FrameLayout(
    HeldReset, "HELD_RESET", pgn=0xFF07, priority=1, sender=TOOL,
    fields=(
        integer("digest", 24, "of the stops that it clears, as in STOPS_HELD"),
        integer("operator", 8, OPERATOR, signal="operator_id"),
        *OPERATOR_PROOF,
    ),
)  # fmt: skip


class OperatorCommand(NamedTuple):
    """An order of an operator to one robot or to all.

    An operator tool sends it once for each order. The robot obeys it immediately. With keys it
    needs two frames that agree.
    """

    command: int
    target: int
    operator: int
    argument: int = 0
    freshness: int = 0
    tag: int = 0


OPERATOR_COMMAND = FrameLayout(
    OperatorCommand, "OPERATOR_COMMAND", pgn=0xFF02, priority=2, sender=TOOL,
    fields=(
        choice("command", 8, Command, "what the operator orders"),
        integer("target", 8, "slot; 255: every robot", special=((255, "EVERY_ROBOT"),)),
        integer("operator", 8, OPERATOR, signal="operator_id"),
        integer("argument", 8, "WAIVE: the silent slot; SET_GOAL: check of the goal; CONTINUE, "
                "REPLAN and WAIT: number of the question that they answer, 0: any"),
        *OPERATOR_PROOF,
    ),
)  # fmt: skip


class Challenge(NamedTuple):
    """Asks a sender to prove its freshness counter.

    A robot of a fleet with keys sends it when it cannot verify a frame, at most ten times a second.
    The sender that is asked answers with FRESHNESS.
    """

    asked: int
    asker: int
    number: int


CHALLENGE = FrameLayout(
    Challenge, "CHALLENGE", pgn=0xFF03, priority=2, sender=ANY_DEVICE,
    fields=(
        integer("asked", 8, "the sender that is asked"),
        integer("asker", 8, "slot of the robot or device that asks"),
        integer("number", 48, "used once"),
    ),
)  # fmt: skip


class Freshness(NamedTuple):
    """Proves the sender's freshness counter; the answer to a CHALLENGE.

    It is sent to the address that asked. The asker then accepts counters after this one.
    """

    sender: int
    counter: int
    tag: int


FRESHNESS = FrameLayout(
    Freshness, "FRESHNESS", pgn=0xEF00, priority=2, sender=ANY_DEVICE,
    fields=(
        integer("sender", 8, "the sender that was asked"),
        integer("counter", 32, "of its last signed frame"),
        integer("tag", 24, "AES-CMAC over sender, asker, number of the challenge, and counter"),
    ),
)  # fmt: skip


class AllImplementsStop(NamedTuple):
    """The state of an "all implements stop operations" switch, as in ISO 11783-7 (PGN 64770).

    Any device sends it once a second; a robot sends it while the fleet is latched. Receivers stop
    while a device says STOP, and for 3 s after its last frame.
    """

    transition: int
    switch: int


ALL_IMPLEMENTS_STOP = FrameLayout(
    AllImplementsStop, "ALL_IMPLEMENTS_STOP", pgn=0xFD02, priority=3, sender=ANY_DEVICE,
    fields=(
        reserved(48, ones=True),
        integer("transition", 8, "SPN 7443: stop transitions since power up"),
        choice("switch", 2, Switch, "SPN 5140", signal="state"),
        reserved(6, ones=True),
    ),
)  # fmt: skip
