"""One robot's brain: facts in, with their time; effects out. It reads no clock, socket, file or die.

`Peer` conducts and contains no rules of its own: each rule lives with its noun (safety, membership,
claims, sync, election, mission, motion). The order inside a turn is fixed: safety first.
"""

from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

from agent import config
from agent.claims import Claims
from agent.effects import HALT, Drive, Effect, Persist, Send, Trace
from agent.election import OPERATOR_GATEWAY, Election
from agent.fsm import Machine
from agent.joining import Joining
from agent.lifecycle import TABLE, Event, State
from agent.membership import Membership, Neighbour
from agent.mission import STILL, Choice, FleetView, Mission, Wish
from agent.motion import Motion
from agent.ports import Observation
from agent.records import Records
from agent.safety import Cause, Safety, SilencePolicy
from agent.voice import Voice
from crdt import FieldAllocationCRDT, Phase, Progress, VectorClock
from protocol.authentication import Keyring
from protocol.codec import Malformed, decode
from protocol.fleet_frames import Heartbeat, LeaderElectionVote, Member, Pose, VectorSlice
from protocol.frame import Frame
from protocol.messages import Message
from protocol.name import Name
from protocol.network_frames import AddressClaimed, Request
from protocol.safety_frames import (
    AllImplementsStop, Command, EmergencyReset, EmergencyStop, OperatorCommand, Reason,
)  # fmt: skip
from protocol.sync import Sync
from protocol.work_frames import (
    Digests, StateSyncRequest, StateSyncResponse, TaskClaim, WorkProgress,
)  # fmt: skip

NOTHING: Sequence[Effect] = ()  # an empty answer promises that `deadline_us` did not move earlier


class Identity(NamedTuple):
    """What a peer is told before it starts."""

    slot: int
    members: frozenset[int]  # every configured slot, our own included
    name: Name
    field_hash: int  # u24; peers of another field description are not of this fleet
    silence: SilencePolicy = SilencePolicy.STOP
    started: bool = False  # permission to move is given at boot, not by a separate start


class Peer:
    def __init__(
        self,
        identity: Identity,
        rng: Random,
        now_us: int,
        recalled: Mapping[str, bytes],
        mission: Mission | None = None,
        motion: Motion | None = None,
        keyring: Keyring | None = None,
    ) -> None:
        self.identity, self.slot = identity, identity.slot
        self.beat = config.beat_of(len(identity.members))
        self.mission, self.motion = mission, motion
        self.records = Records(recalled)
        self.allocation = FieldAllocationCRDT(identity.field_hash)
        self.progress = Progress(mission.section_units if mission else {})
        self.records.restore(self.allocation, self.progress)
        self.clock = VectorClock()
        self.lifecycle = Machine("lifecycle", TABLE, State.DISCONNECTED)
        self.membership = Membership(self.slot, identity.members, self.beat.silence_us, now_us)
        self.safety = Safety(
            self.slot, self.records.incarnation, identity.silence, keyring, recalled, now_us
        )
        self.joining = Joining(identity, self.records.incarnation, rng, now_us)
        self.sync = Sync(self.slot, self.allocation, self.progress, rng)
        self.election = Election(OPERATOR_GATEWAY, self.slot, identity.name.hash16, self.records.term)
        self.claims = Claims(self.slot, self.allocation)
        self.voice = Voice(self.slot, len(identity.members), self.beat, now_us)
        self.here: Observation | None = None
        self.wish: Wish = STILL
        self.malformed: dict[str, int] = {}
        self._handlers = self._table()
        if identity.started:
            self.safety.start(now_us)

    # ---------------------------------------------------------------- facts in

    def receive(self, frame: Frame, now_us: int) -> Sequence[Effect]:
        source, message = decode(frame)
        return self.hear(source, message, now_us)

    def hear(self, source: int, message: Message | Malformed, now_us: int) -> Sequence[Effect]:
        """A decoded frame; simulators decode once for all receivers."""
        kind = type(message)
        if kind is EmergencyStop:  # before anything that could fail or take long, in every state
            return self._stop(source, message, now_us)  # type: ignore[arg-type]
        slot = self.membership.slot_of.get(source)
        if slot is not None:
            if self.membership.heard(slot, now_us):
                return [*self._membership(now_us), *self._dispatch(kind, source, slot, message, now_us)]
            if kind is Pose:
                self.membership.neighbours[slot] = Neighbour(message, now_us)  # type: ignore[arg-type]
                if message.stopped or self.safety.latched:  # type: ignore[union-attr]
                    return self.safety.beat(slot, message.stopped, now_us)  # type: ignore[union-attr]
                return NOTHING
        return self._dispatch(kind, source, slot, message, now_us)

    def observe(self, observation: Observation, now_us: int) -> Sequence[Effect]:
        """What our own sensors say. Used at the next control period."""
        self.here = observation
        return NOTHING

    # ---------------------------------------------------------------- time

    @property
    def deadline_us(self) -> int:
        """When `tick` next has something to do, if nothing arrives before."""
        deadline = min(self.voice.deadline_us, self.safety.deadline_us)
        for other in (
            self.membership.deadline_us, self.joining.deadline_us,
            self.sync.deadline_us, self.claims.deadline_us,
        ):  # fmt: skip
            if other is not None and other < deadline:
                deadline = other
        return deadline

    def tick(self, now_us: int) -> Sequence[Effect]:
        effects: list[Effect] = [*self.safety.tick(now_us)]
        if self.membership.tick(now_us):
            effects += self._membership(now_us)
        effects += self._join(now_us)
        if self.joining.joined:
            effects += [Send(message) for message in self.sync.tick(now_us)]
            effects += self._synchronize(now_us)
            effects += self._claims(now_us)
        if self.voice.control_due(now_us):
            effects += self._control(now_us)
        if self.joining.joined:
            effects += self.voice.speak(self, now_us)
        return effects

    # ---------------------------------------------------------------- operator calls

    def press(self, reason: Reason, now_us: int) -> Sequence[Effect]:
        """Emergency stop at this machine."""
        return [*self.safety.press(reason, now_us), *self._latch("pressed here", now_us)]

    def manual_reset(self, now_us: int) -> Sequence[Effect]:
        """A person at this machine. Refused while any stop is not cleared or a cause persists."""
        if self.lifecycle.state is not State.EMERGENCY_STOP or not self.safety.manual_reset(now_us):
            return [Trace("safety", "LATCHED", "MANUAL_RESET", "LATCHED", "refused")]
        self.safety.hold(now_us)  # reset is not start
        self.joining.rejoin(now_us)
        return self._fire(Event.MANUAL_RESET, "a person at this machine")

    def start(self, now_us: int) -> Sequence[Effect]:
        self.safety.start(now_us)
        return [Trace("safety", "HELD", "START", "STARTED", "operator")]

    def claim(self, section: int, bid: int, now_us: int, takeover: bool = False) -> Sequence[Effect]:
        if self.lifecycle.state not in (State.IDLE, State.WORKING):
            return NOTHING
        key = self.claims.claim(Choice(section, bid, takeover), now_us)
        return NOTHING if key is None else self._announce(section, key, "claim")

    def release(self, section: int, now_us: int) -> Sequence[Effect]:
        key = self.claims.drop(section)
        effects = [] if key is None else [*self._announce(section, key, "release")]
        return [*effects, *self._idle_if_free("released")]

    def finish(self, section: int, now_us: int) -> Sequence[Effect]:
        if self.claims.current != section:
            return NOTHING
        key = self.claims.finish()
        effects = [] if key is None else [*self._announce(section, key, "done")]
        return [*effects, *self._idle_if_free("finished")]

    def leave(self, now_us: int) -> Sequence[Effect]:
        """Say goodbye, so that our silence stops nobody."""
        effects: list[Effect] = [HALT]
        for section in [*self.claims.contested_until_us]:
            effects += self.release(section, now_us)
        if self.joining.joined:
            effects.append(Send(self.voice.farewell(self)))
        self.joining.leave()
        self.membership.forget_all(now_us)
        return [*effects, *self._fire(Event.LEFT, "leaving")]

    def bus_lost(self, now_us: int) -> Sequence[Effect]:
        """The interface reports bus-off: nothing we say is heard."""
        self.safety.raise_cause(Cause.BUS_OFF, now_us)
        return [HALT, *self._fire(Event.BUS_LOST, "bus-off")]

    def bus_back(self, now_us: int) -> Sequence[Effect]:
        self.safety.clear_cause(Cause.BUS_OFF, now_us)
        self.joining.rejoin(now_us)
        return NOTHING

    # ---------------------------------------------------------------- one handler a frame kind

    def _table(self) -> dict[type[Any], Callable[[int, int | None, Any, int], Sequence[Effect]]]:
        return {
            EmergencyReset: lambda source, slot, m, now: self._reset(m, now),
            AllImplementsStop: lambda source, slot, m, now: self.safety.receive_implements_stop(
                source, m, now
            ),
            OperatorCommand: lambda source, slot, m, now: self._command(m, now),
            Pose: self._stranger,
            Heartbeat: self._heartbeat,
            Member: self._member,
            TaskClaim: self._merge,
            StateSyncResponse: self._merge,
            WorkProgress: self._merge,
            StateSyncRequest: self._merge,
            Digests: self._merge,
            LeaderElectionVote: self._vote,
            VectorSlice: self._slice,
            AddressClaimed: self._address,
            Request: self._address,
        }

    def _dispatch(
        self, kind: type[Any], source: int, slot: int | None, message: Any, now_us: int
    ) -> Sequence[Effect]:
        handler = self._handlers.get(kind)
        if handler is not None:
            return handler(source, slot, message, now_us)
        if kind is Malformed:
            self.malformed[message.reason] = self.malformed.get(message.reason, 0) + 1
        return NOTHING

    def _stop(self, source: int, message: EmergencyStop, now_us: int) -> Sequence[Effect]:
        slot = self.membership.slot_of.get(source)
        effects = self.safety.receive_stop(message, slot, now_us)
        if slot is not None and self.membership.heard(slot, now_us):
            effects = [*effects, *self._membership(now_us)]
        return [*effects, *self._latch(f"stop {message.slot}.{message.counter}", now_us)]

    def _latch(self, why: str, now_us: int) -> Sequence[Effect]:
        if self.safety.latched and self.lifecycle.state is not State.EMERGENCY_STOP:
            return self._fire(Event.EMERGENCY, why)
        return NOTHING

    def _reset(self, message: EmergencyReset, now_us: int) -> Sequence[Effect]:
        return self.safety.receive_reset(message, now_us)

    def _command(self, message: OperatorCommand, now_us: int) -> Sequence[Effect]:
        if message.target not in (self.slot, 0xFF) or not self.safety.accept_command(message, now_us):
            return NOTHING
        match message.command:
            case Command.MANUAL_RESET:
                return self.manual_reset(now_us)
            case Command.START:
                return self.start(now_us)
            case Command.HOLD:
                self.safety.hold(now_us)
                return [HALT]
            case Command.WAIVE if self.membership.waive(message.argument, now_us):
                return self._membership(now_us)
        return NOTHING

    def _stranger(self, source: int, slot: int | None, m: Any, now_us: int) -> Sequence[Effect]:
        if slot is not None:  # the first pose after a silence
            self.membership.neighbours[slot] = Neighbour(m, now_us)
            return self.safety.beat(slot, m.stopped, now_us)
        self.membership.strangers += 1
        return [*self.joining.ask_who(source, now_us)]

    def _heartbeat(self, source: int, slot: int | None, m: Heartbeat, now_us: int) -> Sequence[Effect]:
        if slot is None:
            return self._stranger(source, slot, m, now_us)
        if m.leaving:
            self.membership.leave(slot, now_us)
            return self._membership(now_us)
        self.clock.witness(slot, m.operations)
        self.sync.heard_digest(slot, m.digest, now_us)
        if m.stopped or self.safety.latched:
            return self.safety.beat(slot, m.stopped, now_us)
        return NOTHING

    def _member(self, source: int, slot: int | None, m: Member, now_us: int) -> Sequence[Effect]:
        if m.config_hash != self.identity.field_hash:
            self.safety.raise_cause(Cause.CONFIG_MISMATCH, now_us, f"address {source}")
            return NOTHING
        known = self.membership.live
        self.membership.returned(m.slot, now_us) if m.slot in self.membership.standing else None
        if not self.membership.bind(source, m.slot, m.incarnation, now_us):
            return [Trace("membership", "", "REFUSED", "", f"slot {m.slot} at address {source}")]
        return NOTHING if known == self.membership.live else self._membership(now_us)

    def _merge(self, source: int, slot: int | None, m: Any, now_us: int) -> Sequence[Effect]:
        if slot is None:
            return self._stranger(source, slot, m, now_us)
        changed = self.sync.receive(slot, m, now_us)
        effects: list[Effect] = []
        for section in self.claims.recheck(changed):
            effects.append(Trace("claim", f"S{section}", "LOST", "", f"told by {slot}"))
            if self.mission is not None and self.claims.current is None:
                self.mission.abandon()
            effects += self._idle_if_free(f"lost S{section}")
        if not changed and self.sync.deadline_us is not None:
            effects.append(Trace("sync", "", type(m).__name__, "", f"from {slot}"))
        return effects or NOTHING

    def _vote(self, source: int, slot: int | None, m: LeaderElectionVote, now_us: int) -> Sequence[Effect]:
        if slot is None or m.election != self.election.election:
            return NOTHING
        before = self.election.leader
        return self._voted(self.election.receive(slot, m, self.membership.live), before)

    def _slice(self, source: int, slot: int | None, m: VectorSlice, now_us: int) -> Sequence[Effect]:
        if slot is not None:
            self.clock.witness_slice(m.base, m.counts)
        return NOTHING

    def _address(self, source: int, slot: int | None, m: Any, now_us: int) -> Sequence[Effect]:
        if isinstance(m, AddressClaimed) and slot is not None and self.joining.changed_hands(source, m):
            self.membership.unbind(source)
        return self.joining.receive(source, m, now_us)

    # ---------------------------------------------------------------- parts of a tick

    def _join(self, now_us: int) -> Sequence[Effect]:
        was_joined = self.joining.joined
        effects = [*self.joining.tick(now_us)]
        if self.joining.lost_address:
            self.safety.raise_cause(Cause.ADDRESS_LOST, now_us)
            effects += [HALT, *self._fire(Event.BUS_LOST, "lost the address")]
            self.joining.rejoin(now_us)
        elif self.joining.joined and not was_joined:
            self.safety.clear_cause(Cause.ADDRESS_LOST, now_us)
            self.sync.joined(now_us)
            effects += self._fire(Event.FLEET_JOINED, f"address {self.joining.address}")
            effects += self._latch("latched while joining", now_us)
        return effects

    def _synchronize(self, now_us: int) -> Sequence[Effect]:
        state = self.lifecycle.state
        if self.sync.synchronizing and state in (State.IDLE, State.WORKING):
            return self._fire(Event.SYNC_RECEIVED, "digests differ")
        if not self.sync.synchronizing and state is State.SYNCHRONIZING:
            effects = [*self._fire(Event.SYNC_COMPLETE, "in step")]
            if self.claims.current is not None:
                effects += self._fire(Event.CLAIMED, f"resumes S{self.claims.current}")
            return effects
        return NOTHING

    def _claims(self, now_us: int) -> Sequence[Effect]:
        if self.lifecycle.state is not State.IDLE:
            return NOTHING
        if self.claims.current is not None:  # kept through a stop and its reset
            return self._fire(Event.CLAIMED, f"resumes S{self.claims.current}")
        section = self.claims.start_due(now_us)
        if section is None:
            return NOTHING
        key = self.claims.start(section)
        if key is None:
            return [Trace("claim", f"S{section}", "LOST", "", "at the start")]
        if self.mission is not None and self.here is not None:
            self.mission.begin(section, self._view(now_us))
        return [
            *self._announce(section, key, "start"),
            *self._fire(Event.CLAIMED, f"holds S{section}"),
        ]

    def _control(self, now_us: int) -> Sequence[Effect]:
        """Sense to drive, once a control period. The gate is the last function before `Drive`."""
        if self.mission is None or self.motion is None or self.here is None:
            return NOTHING
        effects: list[Effect] = []
        view = self._view(now_us)
        self.wish = self._wish(view, effects)
        wanted = self.motion.drive(self.here, self.wish, self.membership.neighbours, now_us)
        drive: Drive = self.safety.gate(wanted, now_us)
        return [drive, *effects]

    def _wish(self, view: FleetView, effects: list[Effect]) -> Wish:
        assert self.mission is not None
        state, now_us = self.lifecycle.state, view.now_us
        if state not in (State.IDLE, State.WORKING) or not self.safety.may_work:
            return STILL
        if self.claims.room and (self.claims.current is None or self.wish.near_end):
            choice = self.mission.choose(view) if self.sync.ready(now_us) else None
            if choice is not None:
                effects += self.claim(choice.section, choice.bid, now_us, choice.takeover)
        if state is State.WORKING and self.claims.current is not None:
            wish = self.mission.work(view)
            if wish.covered:
                effects += self.voice.cover(self, self.claims.current, wish.covered, now_us)
            if wish.finished:
                effects += self.voice.flush(self, now_us)
                effects += self.finish(self.claims.current, now_us)
            return wish
        if self.claims.next is not None:
            return self.mission.approach(self.claims.next, view)
        return self.mission.rest(view)

    # ---------------------------------------------------------------- what several of them need

    def _view(self, now_us: int) -> FleetView:
        assert self.here is not None
        return FleetView(
            self.slot, now_us, self.here, self.allocation, self.progress,
            self.membership.live, self.membership.silent_since_us, self.membership.neighbours,
        )  # fmt: skip

    def _membership(self, now_us: int) -> list[Effect]:
        """The live view changed: tell the parts that depend on it."""
        live, silent = self.membership.live, self.membership.silent
        self.sync.live(live)
        effects = [*self.safety.members(live, silent, now_us)]
        effects.append(Trace("membership", "", "VIEW", "", f"live {sorted(live)} silent {sorted(silent)}"))
        if self.joining.joined:
            before = self.election.leader
            effects += self._voted(self.election.call(live), before)
        return effects

    def _voted(self, vote: LeaderElectionVote | None, before: object) -> list[Effect]:
        effects: list[Effect] = []
        if vote is not None:
            effects += [Persist(*self.records.vote(vote.term, vote.candidate)), Send(vote)]
        if self.election.leader != before and self.election.leader is not None:
            leader = self.election.leader
            effects.append(Trace("election", "", "LEADER", f"{leader.slot}", f"term {leader.term}"))
        return effects

    def _announce(self, section: int, key: int, what: str) -> list[Effect]:
        """An own operation: counted, durable, then revealed."""
        self.clock.increment(self.slot)
        claim = self.allocation.entry(section)
        message = TaskClaim(
            section, claim.epoch, claim.phase, claim.bid, claim.lamport, claim.owner
        )
        return [
            Persist(*self.records.operation(self.clock[self.slot], section, key)),
            Send(message),
            Trace("claim", f"S{section}", what.upper(), Phase(claim.phase).name, f"epoch {claim.epoch}"),
        ]

    def _idle_if_free(self, why: str) -> Sequence[Effect]:
        if self.claims.current is None and self.lifecycle.state is State.WORKING:
            return self._fire(Event.TASK_COMPLETE, why)
        return NOTHING

    def _fire(self, event: Event, why: str) -> list[Effect]:
        source, target = self.lifecycle.fire(event)
        if source is target:
            return []
        return [Trace("lifecycle", source.name, event.name, target.name, why)]
