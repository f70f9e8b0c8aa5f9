"""Frames that members send about themselves: identity, position, state, and votes for a leader."""

from enum import IntEnum
from math import pi
from typing import Final, NamedTuple

from protocol.frames.layout import (
    ROBOT,
    FrameLayout,
    choice,
    flag,
    integer,
    integers,
    reserved,
    scaled,
    share,
)

# Of agent.interface.lifecycle.State.
STATES = (
    (0, "DISCONNECTED"),
    (1, "IDLE"),
    (2, "SYNCHRONIZING"),
    (3, "WORKING"),
    (4, "EMERGENCY_STOP"),
)
NOBODY = 255  # value of `heard` in POSE
LENGTH_M: Final = 0.05  # step of x and y in POSE
SPEED_M_S: Final = 0.05  # step of the speed in POSE
# The speed in a frame of a robot that does not know its position.
PLACE_UNKNOWN_M_S: Final = 255 * SPEED_M_S
COURSES: Final = 512  # steps of a full turn in POSE
COORDINATE_BITS = 17
# The lowest coordinate, and x and y of a robot that has never known its position.
NOWHERE_M: Final = -(1 << COORDINATE_BITS - 1) * LENGTH_M


class Pose(NamedTuple):
    """Where a robot is, where it is going, and whether it stands stopped.

    Every robot sends it as its sign of life: every 50 ms in fleets of up to 30 robots, every 200 ms
    in the largest. Receivers avoid the robot, and stop when a member has been silent for 0.3 s to
    1 s. A robot that does not know its position sends its last one with speed 255.
    """

    x_m: float
    y_m: float
    course_rad: float  # 0 to 2 pi
    speed_m_s: float
    state: int
    stopped: bool
    heard: int
    at_work: bool = False  # its implement is down, or soon will be

    @property
    def placed(self) -> bool:
        """Whether the frame contains the robot's present position."""
        return self.speed_m_s < PLACE_UNKNOWN_M_S


POSE = FrameLayout(
    Pose, "POSE", pgn=0xFF10, priority=5, sender=ROBOT,
    fields=(
        scaled("x_m", COORDINATE_BITS, LENGTH_M, "m", "east of the field origin", NOWHERE_M),
        scaled("y_m", COORDINATE_BITS, LENGTH_M, "m", "north of the field origin", NOWHERE_M),
        scaled("course_rad", 9, 2 * pi / COURSES, "rad", "direction of motion, or the heading of a "
               "robot that stands; counter-clockwise from east", cyclic=True),
        scaled("speed_m_s", 8, SPEED_M_S, "m/s", "255: the position is not known; x and y are the "
               "last known position, or the lowest values", unavailable=True),
        choice("state", 3, STATES, "lifecycle state"),
        flag("stopped", "latched emergency stop"),
        integer("heard", 8, "slot of a member that the sender receives, in rotation; 255: none",
                special=((255, "NONE"),)),
        flag("at_work", "the implement is down, or within a few metres of work; others keep as far "
             "away as it reaches"),
    ),
)  # fmt: skip


class Heartbeat(NamedTuple):
    """The state of a robot and of its replica of the shared state.

    Every robot sends it twice a second, less often in large fleets. A receiver whose digest differs
    begins to synchronize. This is a proprietary group, not the heartbeat of ISO 11783-7 (PGN 61668),
    which a robot sends only on request; only the counter takes the values of its sequence number
    (SPN 7345).
    """

    counter: int
    state: int
    stopped: bool
    held: bool
    started: bool
    leaving: bool
    health: float  # 0.0 failed to 1.0 healthy
    operations: int
    digest: int
    keyed: bool = False  # its fleet has keys


HEARTBEAT = FrameLayout(
    Heartbeat, "HEARTBEAT", pgn=0xFF11, priority=6, sender=ROBOT,
    fields=(
        integer("counter", 8, "0 to 250; 251: the first after power up; 255: leaving"),
        choice("state", 3, STATES, "lifecycle state"),
        flag("stopped", "latched emergency stop"),
        flag("held", "something other than a latch keeps it from moving"),
        flag("started", "an operator has given the start"),
        flag("leaving", "it leaves the fleet on purpose"),
        flag("keyed", "its fleet has keys: it obeys nobody without one"),
        share("health", 8, 250, "0: failed, 1: healthy"),
        integer("operations", 16, "own component of the vector clock, modulo 2^16"),
        integer("digest", 24, "of registers and progress"),
    ),
)  # fmt: skip


class Member(NamedTuple):
    """Binds a fleet slot to the source address of the frame.

    Every robot sends it after its address claim, when it is asked, and with every twentieth
    heartbeat. Receivers refuse a slot that is in use, and a robot of another configuration.
    """

    slot: int
    incarnation: int
    config_hash: int
    flags: int = 0


MEMBER = FrameLayout(
    Member, "MEMBER", pgn=0xFF14, priority=6, sender=ROBOT,
    fields=(
        integer("slot", 8, "of the sender"),
        integer("incarnation", 16, "raised whenever durable memory was lost"),
        integer("config_hash", 24, "of the field and the version of frames; another is another fleet"),
        integer("flags", 8, "reserved, 0"),
        reserved(8, ones=True),
    ),
)  # fmt: skip


class StandsBy(IntEnum):
    """Causes for which a robot stands, as numbered on the bus; `agent/safety/stop_cause.py` says
    what they mean."""

    OTHER = 0
    NOT_STARTED = 1
    OBSTACLE_AHEAD = 2
    CREEP = 3
    MEMBER_SILENT = 4
    BACKBONE_LOST = 5
    BACKBONE_CREEP = 6
    BUS_OFF = 7
    ERROR_PASSIVE = 8
    UNHEARD = 9
    ADDRESS_LOST = 10
    CONFIG_MISMATCH = 11
    DUPLICATE_ID = 12
    LATE_TICK = 13
    UNAUTHENTICATED_STOP = 14
    IMPLEMENTS_STOP = 15
    DISK_ERROR = 16
    STOP_DOT = 17
    BOOT_UNCONFIRMED = 18
    SPENT_STOP = 19
    SENSES_OLD = 20
    PLACE_FROZEN = 21
    PLACE_LOST = 22
    WORK_OFF = 23
    SCAN_LOST = 24
    IMPLEMENT_DOWN = 25


class Standstill(NamedTuple):
    """One cause for which a robot stands or creeps.

    A robot that may not drive freely sends one frame a second and goes through its causes in turn.
    Robots keep the causes of others for the summary of the fleet; tools and the map display them.
    """

    slot: int
    cause: int
    place: int
    causes: int
    about: int = NOBODY
    number: int = 0


STANDSTILL = FrameLayout(
    Standstill, "STANDSTILL", pgn=0xFF19, priority=6, sender=ROBOT,
    fields=(
        integer("slot", 8, "of the sender"),
        choice("cause", 8, StandsBy, "why it stands or creeps", strict=False),
        integer("place", 4, "of this cause in the list of causes; 0: the worst"),
        integer("causes", 4, "length of that list"),
        integer("about", 8, "the address or slot that the cause is about; 255: none",
                special=((255, "NONE"),)),
        integer("number", 16, "STOP_DOT: stops that hold it; MEMBER_SILENT, CREEP: further robots; "
                "else 0"),
        reserved(16, ones=True),
    ),
)  # fmt: skip


class LeaderElectionVote(NamedTuple):
    """One vote; a voter never changes its vote of one election and term.

    Robots vote when their view of the fleet has settled, and repeat the vote every 10 s. Gateways of
    a segment elect their leader with the same frame. The leader only answers questions to the whole
    fleet, and no safety function depends on it.
    """

    election: int
    term: int
    candidate: int
    flags: int = 0
    name_hash: int = 0


LEADER_ELECTION_VOTE = FrameLayout(
    LeaderElectionVote, "LEADER_ELECTION_VOTE", pgn=0xFF04, priority=3, sender=ROBOT,
    fields=(
        integer("election", 16, "which leader is elected"),
        integer("term", 16, "a later term makes earlier ones void"),
        integer("candidate", 8, "slot"),
        integer("flags", 8, "reserved, 0"),
        integer("name_hash", 16, "of the voter's NAME"),
    ),
)  # fmt: skip


class VectorSlice(NamedTuple):
    """Seven components of the sender's vector clock.

    Every robot sends one with every twentieth heartbeat and goes through all slots in turn.
    Receivers raise their own clock to it, except for their own component.
    """

    base: int
    counts: tuple[int, ...]


VECTOR_SLICE = FrameLayout(
    VectorSlice, "VECTOR_SLICE", pgn=0xFF12, priority=7, sender=ROBOT,
    fields=(
        integer("base", 8, "slot of the first component"),
        integers("counts", 8, 7, "low bytes of the components of slots base to base + 6"),
    ),
)  # fmt: skip
