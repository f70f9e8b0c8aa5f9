"""The sections of one peer: claimed, started, finished and given back, each announced as it happens.

`agent/peer/section_claims.py` has the claims themselves. An operation is counted, made durable, and
then sent. The lifecycle follows: WORKING while a section is held.
"""

from collections.abc import Callable, Mapping
from typing import Any

from agent.interface.effects import Persist, Send, Trace
from agent.interface.instants import FOREVER_US
from agent.interface.lifecycle import IDLE, WORKING, Event
from agent.interface.mission import ClaimRequest, Mission
from agent.peer import inputs, notices
from agent.peer.durable_records import DurableRecords
from agent.peer.fleet_views import FleetViews
from agent.peer.operator_directive import OperatorDirective
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from agent.peer.peer_lifecycle import PeerLifecycle
from agent.peer.progress_announcements import ProgressAnnouncements
from agent.peer.section_claims import SectionClaims
from agent.safety.stop_controller import StopController
from crdt import Phase, VectorClock
from protocol.frames.work_frames import TaskClaim
from protocol.sync.synchronizer import Synchronizer


class SectionWork(Part):
    """The part that claims, starts, finishes and gives back sections, and announces it."""

    def __init__(
        self,
        claims: SectionClaims,
        clock: VectorClock,
        sync: Synchronizer,
        progress: ProgressAnnouncements,
        lifecycle: PeerLifecycle,
        safety: StopController,
        directive: OperatorDirective,
        views: FleetViews,
        mission: Mission | None,
    ) -> None:
        self.claims, self.clock, self.sync, self.progress = claims, clock, sync, progress
        self.lifecycle, self.safety, self.directive = lifecycle, safety, directive
        self.views, self.mission = views, mission
        # Whether a section may be claimed now; a fleet of several segments sets another rule.
        self.may_claim: Callable[[int], bool] = lambda section: True

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            inputs.ClaimSection: lambda ctx, c: self.claim(ClaimRequest(*c), ctx.now_us),
            inputs.ReleaseSection: lambda ctx, c: self.release(c.section, ctx.now_us),
            inputs.Finish: lambda ctx, c: self.finish(c.section, ctx.now_us),
            notices.WorkGivenBack: lambda ctx, n: self.give_back_all(ctx.now_us),
            notices.SectionsMerged: self._merged,
        }

    @property
    def due_at_us(self) -> int:
        if self.lifecycle.state is not IDLE or not self.safety.may_move:
            return FOREVER_US  # the claim waits
        due_at_us = self.claims.due_at_us
        return FOREVER_US if due_at_us is None else due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        """A claim whose contention window has passed becomes work."""
        if not ctx.joined or ctx.state is not IDLE or not ctx.may_move:
            return NOTHING
        if self.directive.goal is not None:
            return NOTHING
        if self.claims.current is not None:  # the section is kept through a stop and its reset
            return self.lifecycle.fire(Event.CLAIMED, f"resumes S{self.claims.current}")
        section = self.claims.start_due(ctx.now_us)
        if section is None:
            return NOTHING
        key = self.claims.start(section)
        if not self.claims.works(section):
            return [Trace("claim", f"S{section}", "LOST", "", "at the start")]
        if self.mission is not None and ctx.here is not None:
            self.mission.begin(section, self.views.view(ctx.now_us))
        told = NOTHING if key is None else self._announce(section, key, "start", ctx.now_us)
        return [
            *told,
            *self.lifecycle.fire(Event.CLAIMED, f"holds S{section}"),
        ]

    # ---------------------------------------------------------------- operations

    def claim(self, request: ClaimRequest, now_us: int) -> Outputs:
        """Claim a section, if the state permits it and the section is free."""
        if self.lifecycle.state not in (IDLE, WORKING) or not self.may_claim(request.section):
            return NOTHING
        key = self.claims.claim(request, now_us)
        if key is None:
            return NOTHING
        return self._announce(request.section, key, "claim", now_us, request.why)

    def release(self, section: int, now_us: int, why: str = "") -> Outputs:
        """Give a section back, unfinished. `why`: for the trace."""
        key = self.claims.drop(section)
        outputs = [] if key is None else [*self._announce(section, key, "release", now_us, why)]
        return [*outputs, *self._idle_if_free("released")]

    def finish(self, section: int, now_us: int) -> Outputs:
        """The section being worked is done; nothing happens for another section."""
        if not self.claims.works(section):
            return NOTHING
        key = self.claims.finish()
        outputs = [] if key is None else [*self._announce(section, key, "done", now_us)]
        return [*outputs, *self._idle_if_free("finished")]

    def give_back_all(self, now_us: int) -> Outputs:
        """Release every claimed, unfinished section, after announcing its covered units."""
        held = [*self.claims.contest_ends_at_us]
        if self.claims.current is not None:
            held.append(self.claims.current)
        outputs: list[Any] = list(self.progress.flush(now_us)) if held else []
        for section in held:
            outputs += self.release(section, now_us)
        if held and self.mission is not None:
            self.mission.abandon()
        return outputs

    def give_back_forgotten(self, now_us: int) -> Outputs:
        """Release sections that we held before a restart, because we have no plan for them now.

        After that they are free for every robot, ours included, and their covered units are known."""
        if self.claims.current is not None or self.claims.next is not None:
            return NOTHING
        outputs: list[Any] = []
        for section in self.claims.allocation.assigned_sections(self.claims.slot):
            key = self.claims.drop(section)
            if key is not None:
                outputs += self._announce(section, key, "release", now_us)
        return outputs

    # ---------------------------------------------------------------- inside

    def _merged(self, ctx: StepContext, notice: notices.SectionsMerged) -> Outputs:
        """Registers changed: which of our sections are lost to a better claim."""
        outputs: list[Any] = []
        for section in self.claims.recheck(notice.sections):
            outputs.append(Trace("claim", f"S{section}", "LOST", "", f"told by {notice.by_slot}"))
            if self.mission is not None and self.claims.current is None:
                self.mission.abandon()
            outputs += self._idle_if_free(f"lost S{section}")
        return outputs

    def _announce(self, section: int, key: int, what: str, now_us: int, why: str = "") -> Outputs:
        """Announce an operation of our own: count it, persist it, then send it."""
        clock, slot = self.clock, self.claims.slot
        clock.increment(slot)
        self.sync.changed_here(section, None, now_us)
        vouchers = self.sync.replica.vouchers
        claim = self.claims.allocation.entry(section)
        message = TaskClaim(
            section, claim.epoch, claim.phase, claim.bid, claim.lamport, claim.owner
        )
        return [
            *(Persist(*r) for r in DurableRecords.operation(clock[slot], section, key, vouchers)),
            Send(message),
            Trace("claim", f"S{section}", what.upper(), Phase(claim.phase).name,
                  f"epoch {claim.epoch}, {why}" if why else f"epoch {claim.epoch}"),
        ]  # fmt: skip

    def _idle_if_free(self, why: str) -> Outputs:
        if self.claims.current is not None or self.lifecycle.state is not WORKING:
            return NOTHING
        return self.lifecycle.fire(Event.TASK_COMPLETE, why)
