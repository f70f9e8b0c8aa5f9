"""The register of one section: its owner and state, as one integer.

The join of two registers is the greater integer. The order, most significant first:

    done      1 bit   finished work is never undone, whatever the epoch
    epoch     8 bits  fencing token: release and takeover raise it
    phase     3 bits  started work is not robbed by a late cheaper bid
    31 - bid  5 bits  among claims of one epoch the cheaper wins
    ~lamport 24 bits  then the earlier
    ~owner    8 bits  then the lower slot

It is one total order, so the join is commutative, associative and idempotent by construction. Every
write is greater than what its writer had seen, so it extends causality. No wall clock is involved.
"""

from enum import IntEnum
from typing import NamedTuple

EPOCH_MAX = 0xFF
BID_MAX = 31
LAMPORT_MAX = 0xFFFFFF  # at ten operations a second of the whole fleet: 19 days on one field
OWNER_MAX = 0xFF
DONE_BIT = 1 << 48
KEY_BITS = 49


class Phase(IntEnum):
    """FREE also means released. The gap leaves room for further phases."""

    FREE = 0
    CLAIMED = 1
    STARTED = 2
    DONE = 7


class Claim(NamedTuple):
    """The fields of one register."""

    epoch: int
    phase: Phase
    bid: int
    lamport: int
    owner: int  # of a FREE register: the slot that released it

    def pack(self) -> int:
        """The key: the value that is stored, compared and joined."""
        assert 0 <= self.epoch <= EPOCH_MAX and 0 <= self.bid <= BID_MAX
        assert 0 <= self.lamport <= LAMPORT_MAX and 0 <= self.owner <= OWNER_MAX
        return pack(*self)

    @classmethod
    def unpack(cls, key: int) -> "Claim":
        """The fields of a key. Raises ValueError for an invalid phase, which no frame can carry,
        but a disk can."""
        return cls(epoch_of(key), Phase(phase_of(key)), bid_of(key), lamport_of(key), owner_of(key))


def pack(epoch: int, phase: int, bid: int, lamport: int, owner: int) -> int:
    """The key of a register from its fields; the fields of a frame are in range by their widths."""
    return (
        (phase == Phase.DONE) << 48 | epoch << 40 | phase << 37 | (BID_MAX - bid) << 32
        | (LAMPORT_MAX - lamport) << 8 | (OWNER_MAX - owner)
    )  # fmt: skip


def epoch_of(key: int) -> int:
    """The fencing token in a key, 0 to 255."""
    return key >> 40 & EPOCH_MAX


def bid_of(key: int) -> int:
    """The bid in a key, 0 to 31: what the claimant says that the section costs it."""
    return BID_MAX - (key >> 32 & BID_MAX)


def lamport_of(key: int) -> int:
    """The Lamport time at which a key was written, 24 bits."""
    return LAMPORT_MAX - (key >> 8 & LAMPORT_MAX)


def owner_of(key: int) -> int:
    """The slot that wrote a key; of a FREE register, the slot that gave the section back."""
    return OWNER_MAX - (key & 0xFF)


def phase_of(key: int) -> int:
    """The number of a `Phase`, as it stands in a key; in damaged bytes also 3 to 6, which are none."""
    return key >> 37 & 7
