"""Plausibility check of received work frames, before they are merged into the replica.

Replicas must become equal, so permanent refusal depends only on the configuration that all robots of
a fleet share: the sections of its field and its members. A register whose epoch is higher than the
hand-overs since boot, or since the epoch that is known, explain is only deferred: a robot that was away
receives it again until it accepts it, while a few forged frames are not accepted.

In a fleet with keys it is known which robot sends a claim. It must be the sender's own, and one robot
holds few sections, by claims or by sync answers.
"""

from collections import Counter
from collections.abc import Collection
from collections.abc import Set as AbstractSet

from agent.interface.config import CLAIM_AHEAD, S
from crdt import FieldAllocationCRDT
from crdt.claim_register import Phase, epoch_of
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.sync.vouchers import Vouchers

# Hand-overs of one section: a fault of the fleet costs one or two, and its lease lasts 20 s.
EPOCH_BURST = 16
EPOCH_EVERY_US = 10 * S
# Upper limit regardless of the uptime, because an hour would explain all 255. Higher epochs are
# deferred.
EPOCH_EXPLAINED_MAX = 64
# Hand-overs in a row of which a robot may lose every frame, since it knew the section last.
EPOCH_MISSED = 4
PERSISTS_US = 3 * S  # accepted if received for so long, because sync repeats differences
TOLD_MIN = 3  # times, because frames of a broken device may be alike by chance
FORGOTTEN_US = 60 * S  # sync asks at least every 38 s
# Sections that one robot may hold: four times what an honest one claims (`CLAIM_AHEAD`). More is a
# broken unit or a stolen key.
HELD_MAX = 8
assert HELD_MAX >= 4 * (1 + CLAIM_AHEAD)
PUT_OFF_MAX = 256  # sections with a deferred epoch; beyond that the oldest are dropped

Work = TaskClaim | StateSyncResponse | WorkProgress


class Admission:
    """Decides which received work frames may be merged, and counts the others."""

    def __init__(self, sections: Collection[int], owners: AbstractSet[int], now_us: int) -> None:
        """`sections`: those that exist or may appear; empty: any. `owners`: slots that may hold one."""
        self.sections, self.owners = sections, owners
        self.refused: Counter[str] = Counter()  # why -> frames
        self._boot_at_us = now_us
        # Section: epoch, when it was first and last told, and how often.
        self._put_off: dict[int, tuple[int, int, int, int]] = {}

    def admits(self, message: Work, allocation: FieldAllocationCRDT, now_us: int) -> bool:
        """Whether the frame may be merged; a refused one is counted.

        `allocation`: our own replica. A claim that follows what is known there is never deferred,
        because two robots would work the section meanwhile."""
        if self.sections and message.section not in self.sections:
            self.refused["section"] += 1
            return False
        if isinstance(message, WorkProgress):
            return True
        if message.owner not in self.owners:
            self.refused["owner"] += 1
            return False
        if message.epoch > message.lamport:  # each hand-over was an operation
            self.refused["epoch"] += 1
            return False
        explained = EPOCH_BURST + (now_us - self._boot_at_us) // EPOCH_EVERY_US
        explained = min(explained, EPOCH_EXPLAINED_MAX)
        if message.epoch <= explained:
            return True
        key = allocation.key(message.section)
        if key is not None and message.epoch <= epoch_of(key) + EPOCH_MISSED:
            return True
        if self._persists(message.section, message.epoch, now_us):
            return True
        self.refused["epoch"] += 1
        return False

    def excess(
        self, message: Work, slot: int, allocation: FieldAllocationCRDT, vouchers: Vouchers
    ) -> str | None:
        """What is wrong with a claim that this member has proven; None: nothing. It is counted.

        The same holds for a sync answer of which it is the owner. What others say in its name uses up
        nothing. A member that says such a thing is broken, or its key is stolen."""
        if isinstance(message, WorkProgress):
            return None
        if message.owner != slot:
            if isinstance(message, StateSyncResponse):
                return None
            self.refused["claim of another"] += 1
            return f"robot {slot} claims in the name of robot {message.owner}"
        if message.phase not in (Phase.CLAIMED, Phase.STARTED):
            return None
        held = allocation.assigned_sections(slot)
        if len(held) < HELD_MAX or message.section in held:
            return None
        said = [s for s in held if vouchers.said_by(s, slot) == allocation.key(s)]
        if len(said) < HELD_MAX:
            return None
        self.refused["too many sections"] += 1
        return f"robot {slot} claims more than {HELD_MAX} sections"

    def _persists(self, section: int, epoch: int, now_us: int) -> bool:
        new = epoch, now_us, now_us, 0
        known, first_at_us, last_at_us, told = self._put_off.pop(section, new)
        if known != epoch or now_us - last_at_us > FORGOTTEN_US:
            _, first_at_us, _, told = new
        told += 1
        if told >= TOLD_MIN and now_us - first_at_us >= PERSISTS_US:
            return True
        self._put_off[section] = epoch, first_at_us, now_us, told
        if len(self._put_off) > PUT_OFF_MAX:
            del self._put_off[next(iter(self._put_off))]
        return False
