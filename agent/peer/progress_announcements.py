"""Announces the units that this robot has covered: together, and persisted first.

They join our replica when they are announced, not before: a digest with unannounced entries would
look like a difference to repair.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

from agent.interface.config import BEATS, BeaconTiming, S
from agent.interface.effects import Effect, Persist, Send
from agent.interface.mission import CoveredUnits
from agent.peer import inputs, notices
from agent.peer.durable_records import DurableRecords
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from crdt import Progress
from crdt.progress import BLOCK_UNITS
from protocol.frames.work_frames import WorkProgress
from protocol.sync.synchronizer import Synchronizer

PROGRESS_PERIOD_US: Final = 2 * S  # covered units are announced together, at most this often


class ProgressAnnouncements(Part):
    """The part that collects the units that we cover and announces them together."""

    def __init__(
        self, progress: Progress, sync: Synchronizer, beat: BeaconTiming, now_us: int
    ) -> None:
        self.progress, self.sync = progress, sync
        # A large fleet announces progress less often, because all robots share the bus.
        self.period_us = PROGRESS_PERIOD_US * beat.pose_period_us // BEATS[0].pose_period_us
        self.next_at_us = now_us + self.period_us
        # In a fleet with keys: announce only with heartbeats, so that one proof covers both.
        self.with_heartbeats = False
        self.pending: dict[tuple[int, int], int] = {}  # (section, block) -> bits to announce
        self.redone = 0  # units that another robot had announced before us

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.BeatDue: self._beat, inputs.Cover: self._cover}

    def _beat(self, ctx: StepContext, notice: notices.BeatDue) -> Outputs:
        if not self.pending or ctx.now_us < self.next_at_us:
            return NOTHING
        if self.with_heartbeats and not notice.heartbeat:
            return NOTHING
        return self.flush(ctx.now_us)

    def _cover(self, ctx: StepContext, call: inputs.Cover) -> Outputs:
        return self.cover(call.section, call.units, ctx.now_us)

    def cover(self, section: int, units: Iterable[int], now_us: int) -> list[Effect]:
        """Units were covered; they are announced now if the last announcement is long enough ago."""
        for unit in units:
            block, bit = divmod(unit, BLOCK_UNITS)
            self.pending[section, block] = self.pending.get((section, block), 0) | 1 << bit
        due = now_us >= self.next_at_us and not self.with_heartbeats
        return self.flush(now_us) if due else []

    def sweep(self, swept: CoveredUnits, now_us: int) -> list[Effect]:
        """Units of any section were covered."""
        effects: list[Effect] = []
        for section, unit in swept.units:
            effects += self.cover(section, (unit,), now_us)
        if swept.at_once and self.pending:
            effects += self.flush(now_us)
        return effects

    def flush(self, now_us: int) -> list[Effect]:
        """Persist and announce the pending units, and put them into the replica under the digest."""
        effects: list[Effect] = []
        for (section, block), new in sorted(self.pending.items()):
            known = self.progress.bits(section, block)
            self.redone += (known & new).bit_count()
            bits = known | new
            self.progress.apply(section, block, bits)
            self.sync.changed_here(section, block, now_us, new)
            vouchers = self.sync.replica.vouchers
            effects.append(Persist(*DurableRecords.progress(section, block, bits, vouchers)))
            effects.append(Send(WorkProgress(section, block, bits)))
        self.pending.clear()
        self.next_at_us = now_us + self.period_us
        return effects
