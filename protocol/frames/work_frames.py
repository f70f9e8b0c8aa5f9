"""Frames about work: claims, progress, and the anti-entropy that repairs lost frames."""

from struct import Struct
from typing import NamedTuple

CLAIM = Struct("<HBBHBB")
REQUEST = Struct("<HBHBBB")
DIGESTS = Struct("<BBHHH")
PROGRESS = Struct("<HBIB")
assert CLAIM.size == REQUEST.size == DIGESTS.size == PROGRESS.size == 8

# scopes of STATE_SYNC_REQUEST
REGISTERS, BLOCKS, STOPS, BUCKETS_SINCE, ALL_BUCKETS = range(5)
PHASES = (0, 1, 2, 7)  # crdt.Phase: FREE, CLAIMED, STARTED, DONE


class TaskClaim(NamedTuple):
    """One section's register as its owner wrote it: claim, start, release and done. Priority 4.

    byte  field    type  meaning
    0..1  section  u16
    2     epoch    u8    fencing token: release and takeover raise it
    3     phase    bits  bits 0-2: 0 FREE, 1 CLAIMED, 2 STARTED, 7 DONE; bits 3-7: bid, 0 to 31
    4..6  lamport  u24   Lamport time of the writing operation
    7     owner    u8    slot
    """

    section: int
    epoch: int
    phase: int
    bid: int
    lamport: int
    owner: int

    def pack(self) -> bytes:
        return _packed(self)

    @classmethod
    def unpack(cls, data: bytes) -> "TaskClaim":
        return cls(*_register(data))


class StateSyncResponse(NamedTuple):
    """A register relayed to somebody who missed it. Layout as TASK_CLAIM. Priority 7."""

    section: int
    epoch: int
    phase: int
    bid: int
    lamport: int
    owner: int

    def pack(self) -> bytes:
        return _packed(self)

    @classmethod
    def unpack(cls, data: bytes) -> "StateSyncResponse":
        return cls(*_register(data))


def _packed(told: TaskClaim | StateSyncResponse) -> bytes:
    low, high = told.lamport & 0xFFFF, told.lamport >> 16
    return CLAIM.pack(told.section, told.epoch, told.phase | told.bid << 3, low, high, told.owner)


def _register(data: bytes) -> tuple[int, int, int, int, int, int]:
    section, epoch, mixed, low, high, owner = CLAIM.unpack(data)
    if mixed & 7 not in PHASES:
        raise ValueError("range")
    return section, epoch, mixed & 7, mixed >> 3, low | high << 16, owner


class StateSyncRequest(NamedTuple):
    """My replica differs from what I hear: tell me what is newer than the cut. Priority 6.

    byte  field   type  meaning
    0..1  cut     u24   with byte 2: Lamport time of the stable cut T0; 0 for a fresh join
    3..5  digest  u24   of the sender's replica
    6     scope   u8    0 registers and progress after the cut; 2 stops; DIGESTS of the sender follow,
                        tell what is in buckets that differ: 3 after the cut, 4 all; 1 reserved
    7     round   u8    counts the sender's requests
    """

    cut: int
    digest: int
    scope: int
    round: int

    def pack(self) -> bytes:
        return REQUEST.pack(
            self.cut & 0xFFFF, self.cut >> 16, self.digest & 0xFFFF, self.digest >> 16,
            self.scope, self.round,
        )  # fmt: skip

    @classmethod
    def unpack(cls, data: bytes) -> "StateSyncRequest":
        cut, cut_high, digest, digest_high, scope, turn = REQUEST.unpack(data)
        return cls(cut | cut_high << 16, digest | digest_high << 16, scope, turn)


class Digests(NamedTuple):
    """Three bucket digests of the sender's replica, the fall-back of the sync. Priority 7.

    byte  field  type  meaning
    0     triple u8    of the first bucket / 3
    1     salt   u8    mixed into the digests, so that one collision does not repeat
    2..7         3 u16 digests of buckets 3*triple .. 3*triple+2
    """

    triple: int
    salt: int
    first: int
    second: int
    third: int

    def pack(self) -> bytes:
        return DIGESTS.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "Digests":
        return cls._make(DIGESTS.unpack(data))


class WorkProgress(NamedTuple):
    """Covered units of a section: grow-only, joined by OR. Priority 6.

    byte  field    type  meaning
    0..1  section  u16
    2     block    u8    units 40*block .. 40*block+39
    3..7  bits     u40   bit i: unit 40*block+i is covered
    """

    section: int
    block: int
    bits: int

    def pack(self) -> bytes:
        return PROGRESS.pack(self.section, self.block, self.bits & 0xFFFFFFFF, self.bits >> 32)

    @classmethod
    def unpack(cls, data: bytes) -> "WorkProgress":
        section, block, low, high = PROGRESS.unpack(data)
        return cls(section, block, low | high << 32)
