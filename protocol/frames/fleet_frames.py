"""Frames by which members know each other: identity, place, state, and the leader."""

from enum import IntEnum
from math import pi
from struct import Struct
from typing import Final, NamedTuple

STATES: Final = 5  # values of agent.interface.lifecycle.State
NOBODY = 255  # value of `heard` in POSE
LENGTH_M: Final = 0.05  # unit of x and y in POSE
SPEED_M_S: Final = 0.05  # unit of the speed in POSE
_FASTEST: Final = 254  # in that unit; 255 is what J1939 calls not available
# The speed in a frame of a robot that does not know its position.
PLACE_UNKNOWN_M_S: Final = 255 * SPEED_M_S
COURSES: Final = 512  # steps of a full turn in POSE
_COURSE_RAD: Final = 2 * pi / COURSES
_HALF: Final = 1 << 16  # offset of the 17-bit coordinates
_LAST: Final = 2 * _HALF - 1
_ORIGIN: Final = _HALF + 0.5  # makes truncation round to nearest
# No robot has turned this many times, so the sum is positive too.
_TURNED: Final = (1 << 20) * COURSES + 0.5
_LOWEST_M: Final = _HALF * LENGTH_M
NOWHERE_M: Final = -_LOWEST_M  # x and y of a robot that has never known its position
_HALVES = Struct("<II").unpack
_tuple = tuple.__new__

HEARTBEAT = Struct("<BBBHHB")
MEMBER = Struct("<BHHBBB")
VOTE = Struct("<HHBBH")
assert HEARTBEAT.size == MEMBER.size == VOTE.size == 8


class Pose(NamedTuple):
    """The beat: where I am, where I am going, whether I stand stopped. Priority 5.

    bits    field      unit, meaning
    0..16   x_m        0.05 m, offset 2^16: -3276.8 to 3276.75 east of the field origin
    17..33  y_m        the same, north
    34..42  course     1/512 turn, counter-clockwise from east: direction of motion, or the heading
    43..50  speed      0.05 m/s, 0 to 12.7; 255: not available, x and y are of earlier, or 0 for nowhere
    51..53  state      lifecycle state
    54      stopped    latched emergency stop
    55..62  heard      slot of a member whom I hear, another with each beat; 255: nobody
    63      reserved   0
    """

    x_m: float
    y_m: float
    course_rad: float  # 0 to 2 pi
    speed_m_s: float
    state: int
    stopped: bool
    heard: int

    @property
    def placed(self) -> bool:
        """Whether the frame contains the robot's present position."""
        return self.speed_m_s < PLACE_UNKNOWN_M_S

    def pack(self) -> bytes:
        x_m, y_m, course_rad, speed_m_s, state, stopped, heard = self
        x, y = int(x_m / LENGTH_M + _ORIGIN), int(y_m / LENGTH_M + _ORIGIN)  # rounded, being > 0
        assert 0 <= x <= _LAST and 0 <= y <= _LAST, "outside of what POSE can say"
        course = int(course_rad / _COURSE_RAD + _TURNED) & 0x1FF
        speed = 255
        if speed_m_s < PLACE_UNKNOWN_M_S:
            speed = min(int(speed_m_s / SPEED_M_S + 0.5), _FASTEST)
        low = x | (y & 0x7FFF) << 17
        high = y >> 15 | course << 2 | speed << 11 | state << 19
        return (low | (high | stopped << 22 | heard << 23) << 32).to_bytes(8, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "Pose":
        halves: tuple[int, int] = _HALVES(data)  # nine frames in ten are this one
        low, high = halves
        state = high >> 19 & 7
        if state >= STATES or high >> 31:
            raise ValueError("range")
        return _tuple(
            cls,
            (
                float(low & 0x1FFFF) * LENGTH_M - _LOWEST_M,
                float(low >> 17 | (high & 3) << 15) * LENGTH_M - _LOWEST_M,
                float(high >> 2 & 0x1FF) * _COURSE_RAD,
                float(high >> 11 & 0xFF) * SPEED_M_S,
                state,
                high >> 22 & 1 == 1,
                high >> 23 & 0xFF,
            ),
        )


class Heartbeat(NamedTuple):
    """I am here, and this is how far my replica has got. Priority 6.

    This is a proprietary group, not the heartbeat of ISO 11783-7 (PGN 61668), which a robot does not
    send. Its counter only takes the values of that heartbeat's sequence number (SPN 7345).

    byte  field       type  meaning
    0     counter     u8    0..250, 251 the first after power up, 255 leaving
    1     state       bits  lifecycle state in bits 0-2; 3 stopped; 4 held; 5 started; 6 leaving
    2     health      u8    0.4 %
    3..4  operations  u16   own component of the vector clock, modulo 2^16
    5..7  digest      u24   of registers and progress
    """

    counter: int
    state: int
    stopped: bool
    held: bool  # something other than a latch keeps it from moving
    started: bool  # an operator has given the start
    leaving: bool
    health: float  # 0.0 failed to 1.0 healthy
    operations: int
    digest: int

    def pack(self) -> bytes:
        flags = (
            self.state | self.stopped << 3 | self.held << 4 | self.started << 5 | self.leaving << 6
        )
        health = min(max(round(self.health * 250), 0), 250)
        low, high = self.digest & 0xFFFF, self.digest >> 16
        return HEARTBEAT.pack(self.counter, flags, health, self.operations, low, high)

    @classmethod
    def unpack(cls, data: bytes) -> "Heartbeat":
        counter, flags, health, operations, low, high = HEARTBEAT.unpack(data)
        if flags & 7 >= STATES or health > 250:
            raise ValueError("range")
        return cls(
            counter, flags & 7, bool(flags & 8), bool(flags & 16), bool(flags & 32),
            bool(flags & 64), health / 250, operations, low | high << 16,
        )  # fmt: skip


class Member(NamedTuple):
    """Binds a fleet slot to this source address; its NAME was in the address claim. Priority 6.

    byte  field        type  meaning
    0     slot         u8
    1..2  incarnation  u16   raised whenever durable memory was lost
    3..5  config_hash  u24   of the field description; another hash is another fleet
    6     flags        u8    reserved, 0
    7     reserved     u8    0xFF
    """

    slot: int
    incarnation: int
    config_hash: int
    flags: int = 0

    def pack(self) -> bytes:
        low, high = self.config_hash & 0xFFFF, self.config_hash >> 16
        return MEMBER.pack(self.slot, self.incarnation, low, high, self.flags, 0xFF)

    @classmethod
    def unpack(cls, data: bytes) -> "Member":
        slot, incarnation, low, high, flags, _ = MEMBER.unpack(data)
        return cls(slot, incarnation, low | high << 16, flags)


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


class Standstill(NamedTuple):
    """Why the sender stands, or creeps: one cause a frame, about one frame a second. Priority 6.

    byte  field      type  meaning
    0     slot       u8    of the sender
    1     cause      u8    StandsBy
    2     place      bits  bits 0-3: place of this cause in the list, 0 the worst; 4-7: their number
    3     about      u8    the address or slot that the cause is about; 255: none
    4..5  number     u16   STOP_DOT: stops that hold it; MEMBER_SILENT, CREEP: further robots; else 0
    6..7  reserved         0xFF
    """

    slot: int
    cause: int
    place: int
    causes: int
    about: int = NOBODY
    number: int = 0

    def pack(self) -> bytes:
        head = (self.slot, self.cause, self.place | self.causes << 4, self.about)
        return bytes(head) + self.number.to_bytes(2, "little") + b"\xff\xff"

    @classmethod
    def unpack(cls, data: bytes) -> "Standstill":
        number = int.from_bytes(data[4:6], "little")
        return cls(data[0], data[1], data[2] & 15, data[2] >> 4, data[3], number)


class LeaderElectionVote(NamedTuple):
    """One vote, fixed for its voter, election and term. Priority 3.

    byte  field      type  meaning
    0..1  election   u16   which convenience is elected
    2..3  term       u16   a later term fences an earlier one
    4     candidate  u8    slot
    5     flags      u8    reserved, 0
    6..7  name_hash  u16   of the voter's NAME
    """

    election: int
    term: int
    candidate: int
    flags: int = 0
    name_hash: int = 0

    def pack(self) -> bytes:
        return VOTE.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "LeaderElectionVote":
        return cls._make(VOTE.unpack(data))


class VectorSlice(NamedTuple):
    """Seven components of the sender's vector clock. Priority 7, slow rotation.

    byte  field   type  meaning
    0     base    u8    slot of the first component
    1..7  counts  7 u8  low bytes of the components of base .. base+6
    """

    base: int
    counts: tuple[int, ...]

    def pack(self) -> bytes:
        assert len(self.counts) == 7
        return bytes((self.base, *self.counts))

    @classmethod
    def unpack(cls, data: bytes) -> "VectorSlice":
        return cls(data[0], tuple(data[1:]))
