"""Frames that stop a fleet and release it. Highest priorities; see `docs/how/safety_case.md`."""

from enum import IntEnum
from typing import NamedTuple


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
    """SPN 5140."""

    STOP = 0
    PERMIT = 1
    ERROR = 2
    NOT_AVAILABLE = 3


class EmergencyStop(NamedTuple):
    """Everybody stops. Priority 0.

    byte  field        type  meaning
    0     slot         u8    who pressed: robot slot, or 128.. for a panel or an operator device
    1     incarnation  u8    low byte of the presser's incarnation
    2     counter      u8    the presser's stop counter: (slot, incarnation, counter) is the dot
    3     reason, echo bits  reason in bits 0-3, bit 4: this is an echo by the frame's source; bit 5, of
                             an echo: this dot was cleared before, press with another
    4     freshness    u8    low byte of the sender's freshness counter
    5..7  tag          u24   AES-CMAC, little-endian; 0 in a fleet without keys
    """

    slot: int
    incarnation: int
    counter: int
    reason: int
    echo: bool = False
    freshness: int = 0
    tag: int = 0
    spent: bool = False

    def pack(self) -> bytes:
        flags = self.reason | self.echo << 4 | self.spent << 5
        head = (self.slot, self.incarnation, self.counter, flags, self.freshness)
        return bytes(head) + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "EmergencyStop":
        slot, incarnation, counter, flags, freshness = data[:5]
        tag = int.from_bytes(data[5:], "little")
        echo, spent = bool(flags & 16), bool(flags & 32)
        return cls(slot, incarnation, counter, flags & 15, echo, freshness, tag, spent)


class EmergencyReset(NamedTuple):
    """Clears the one stop dot it names. Priority 1.

    byte  field        type  meaning
    0..2  dot          3 u8  slot, incarnation, counter of the stop it clears
    3     operator     u8    operator device (192..254 in a fleet with keys)
    4     freshness    u8    low byte of the operator's freshness counter
    5..7  tag          u24   AES-CMAC with the operator's key
    """

    slot: int
    incarnation: int
    counter: int
    operator: int
    freshness: int = 0
    tag: int = 0

    def pack(self) -> bytes:
        head = (self.slot, self.incarnation, self.counter, self.operator, self.freshness)
        return bytes(head) + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "EmergencyReset":
        slot, incarnation, counter, operator, freshness = data[:5]
        tag = int.from_bytes(data[5:], "little")
        return cls(slot, incarnation, counter, operator, freshness, tag)


class StopsHeld(NamedTuple):
    """What holds a latched robot, in sum: the answer to a question for stops. Priority 4.

    byte  field   type  meaning
    0     slot    u8    of the robot
    1     stops   u8    how many it holds; 255: as many or more, or some without a name
    2..4  digest  u24   of all of them
    5..7  tag     u24   AES-CMAC with the operator's key, also over the 48 bits of the question; 0
                        in a fleet without keys
    """

    slot: int
    stops: int
    digest: int
    tag: int = 0

    def pack(self) -> bytes:
        head = bytes((self.slot, self.stops))
        return head + self.digest.to_bytes(3, "little") + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "StopsHeld":
        digest, tag = int.from_bytes(data[2:5], "little"), int.from_bytes(data[5:], "little")
        return cls(data[0], data[1], digest, tag)


class HeldReset(NamedTuple):
    """Clears all stops of every robot that holds exactly what the digest says. Priority 1.

    byte  field      type  meaning
    0..2  digest     u24   of the stops that it clears, as in STOPS_HELD
    3     operator   u8    operator device (192..254 in a fleet with keys)
    4     freshness  u8    low byte of the operator's freshness counter
    5..7  tag        u24   AES-CMAC with the operator's key
    """

    digest: int
    operator: int
    freshness: int = 0
    tag: int = 0

    def pack(self) -> bytes:
        head = self.digest.to_bytes(3, "little") + bytes((self.operator, self.freshness))
        return head + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "HeldReset":
        digest, tag = int.from_bytes(data[:3], "little"), int.from_bytes(data[5:], "little")
        return cls(digest, data[3], data[4], tag)


class OperatorCommand(NamedTuple):
    """What a person asks of one machine or of all. Priority 2.

    byte  field      type  meaning
    0     command    u8    Command
    1     target     u8    slot, 255: every robot
    2     operator   u8    operator device (192..254 in a fleet with keys)
    3     argument   u8    by command: the silent slot (WAIVE), goal_check (SET_GOAL); CONTINUE, REPLAN
                           and WAIT: the number of the question they answer, 0: any
    4     freshness  u8    low byte of the operator's freshness counter
    5..7  tag        u24   AES-CMAC with the operator's key
    """

    command: int
    target: int
    operator: int
    argument: int = 0
    freshness: int = 0
    tag: int = 0

    def pack(self) -> bytes:
        head = (self.command, self.target, self.operator, self.argument, self.freshness)
        return bytes(head) + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "OperatorCommand":
        if data[0] > max(Command):
            raise ValueError("command")
        command, target, operator, argument, freshness = data[:5]
        tag = int.from_bytes(data[5:], "little")
        return cls(command, target, operator, argument, freshness, tag)


class Challenge(NamedTuple):
    """Prove where your counter is: asked of a sender whose frames cannot be verified. Priority 2.

    byte  field   type  meaning
    0     asked   u8    sender that is asked
    1     asker   u8    slot of who asks
    2..7  number  u48   used once
    """

    asked: int
    asker: int
    number: int

    def pack(self) -> bytes:
        return bytes((self.asked, self.asker)) + self.number.to_bytes(6, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "Challenge":
        return cls(data[0], data[1], int.from_bytes(data[2:], "little"))


class Freshness(NamedTuple):
    """The proof, to the address that asked. Priority 2.

    byte  field    type  meaning
    0     sender   u8    who was asked
    1..4  counter  u32   of its last signed frame
    5..7  tag      u24   AES-CMAC over sender, asker, the number asked with, and the counter
    """

    sender: int
    counter: int
    tag: int

    def pack(self) -> bytes:
        head = bytes((self.sender,)) + self.counter.to_bytes(4, "little")
        return head + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "Freshness":
        counter, tag = int.from_bytes(data[1:5], "little"), int.from_bytes(data[5:], "little")
        return cls(data[0], counter, tag)


class AllImplementsStop(NamedTuple):
    """ISO 11783-7: all implements stop operations switch state, PGN 64770. From any device.

    byte  field       type  meaning
    0..5  reserved    0xFF
    6     transition  u8    SPN 7443, number of stop transitions since power up
    7     switch      bits  SPN 5140 in bits 0-1: 0 stop, 1 permit, 2 error, 3 not available
    """

    transition: int
    switch: int

    def pack(self) -> bytes:
        return b"\xff" * 6 + bytes((self.transition, 0xFC | self.switch))

    @classmethod
    def unpack(cls, data: bytes) -> "AllImplementsStop":
        return cls(data[6], data[7] & 3)
