"""Makes the parts of one peer, each from those that it works with, and sets their order.

The order is a contract: timers and notices go through the parts in it. First comes what must be
durable before anything is sent, then stops, the members on the bus, work, and at last
announcements.
"""

from collections.abc import Mapping
from math import inf
from random import Random

from agent.interface import config
from agent.interface.config import CONTROL_PERIOD_US
from agent.interface.identity import Identity
from agent.interface.lifecycle import Event
from agent.interface.mission import Mission
from agent.interface.motion_controller import MotionController
from agent.peer.announcements import Announcements, first_beat_for_us
from agent.peer.control_cycle import ControlCycle
from agent.peer.departure import Departure
from agent.peer.diagnostic_broadcasts import DiagnosticBroadcasts
from agent.peer.durable_records import DurableRecords
from agent.peer.fleet_clock import FleetClock
from agent.peer.fleet_summary import FLEET_SUMMARY_PGN, compose, write
from agent.peer.fleet_views import FleetViews
from agent.peer.frame_origin import Origins
from agent.peer.implement_check import ImplementCheck
from agent.peer.journal_recovery import LOST, sensible
from agent.peer.key_renewal import KeptKeys, KeyRenewal
from agent.peer.leader_election import OPERATOR_GATEWAY, Election
from agent.peer.leader_votes import LeaderVotes
from agent.peer.map_exchange import MapExchange
from agent.peer.member_conflicts import Conflicts
from agent.peer.member_discovery import CLAIM_PGN, MEMBER_PGN
from agent.peer.member_reports import MemberReports
from agent.peer.membership import Membership
from agent.peer.mission_messages import MissionMessages
from agent.peer.name_discovery import NameDiscovery
from agent.peer.network_join import NetworkJoin
from agent.peer.obstacle_hold import ObstacleHold
from agent.peer.operator_directive import OperatorDirective
from agent.peer.part import Part
from agent.peer.peer_lifecycle import PeerLifecycle
from agent.peer.pgn_responder import PgnResponder
from agent.peer.progress_announcements import ProgressAnnouncements
from agent.peer.proven_frames import ProvenFrames
from agent.peer.range_freshness import RangeSensing
from agent.peer.section_claims import SectionClaims
from agent.peer.section_work import SectionWork
from agent.peer.self_check import SelfCheck
from agent.peer.self_health import SelfKnowledge
from agent.peer.sender_limits import SenderLimits
from agent.peer.sender_origins import SenderOrigins
from agent.peer.sense_freshness import Senses
from agent.peer.slot_discovery import SlotDiscovery
from agent.peer.state_sync import StateSync
from agent.peer.stop_reception import StopReception
from agent.peer.stop_release import StopRelease
from agent.peer.task_reporting import TaskReporting
from agent.peer.terminal_service import TerminalService
from agent.peer.work_admission import Admission
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from crdt import FieldAllocationCRDT, Progress, VectorClock
from protocol.authentication import Keyring
from protocol.frame_proofs import FIRST, START_BITS, FleetTime, ProofKeys
from protocol.sync.map_sync import MapSync
from protocol.sync.synchronizer import Synchronizer
from protocol.sync.vouchers import Vouched, Vouchers


class PeerParts:
    """The parts of one peer by name, for what reads them, and in order, for the peer."""

    def __init__(
        self,
        identity: Identity,
        rng: Random,
        now_us: int,
        recalled: Mapping[str, bytes],
        mission: Mission | None = None,
        motion: MotionController | None = None,
        keyring: Keyring | None = None,
        chart: MapSync | None = None,
    ) -> None:
        """`recalled`: what the journal has. `chart`: the fleet's map, if the mission makes one."""
        self.identity, self.mission, self.motion, self.chart = identity, mission, motion, chart
        slot, recalled = identity.slot, sensible(recalled)
        beat = self.beat = config.beat_of(len(identity.members))

        # What is kept, and what all members keep equal.
        self.records = DurableRecords(recalled, identity.first_boot, rng)
        self.allocation = FieldAllocationCRDT(identity.field_hash)
        units = mission.section_units if mission else {}
        self.progress = Progress(units)
        given = None if keyring is None else keyring.keys
        kept, vouchers = KeptKeys(recalled, given), None
        if keyring is not None:
            keyring.rekey(kept.newest(keyring.keys))
            vouchers = Vouchers(slot, keyring.keys.generation)
            vouchers.forgot = self.records.lost
        ends = self.records.restore(self.allocation, self.progress, vouchers)
        if chart is not None:
            self.records.restore_map(chart.chart)
            chart.recalled(now_us)
        self.clock = VectorClock({slot: self.records.operations})
        self.sync = Synchronizer(slot, self.allocation, self.progress)
        self.sync.replica.vouchers = vouchers
        for section, key in ends.items():
            self.sync.replica.await_units(section, key, {slot: [Vouched(key, 0)]})
        self.admission = Admission(mission.sections if mission else (), identity.members, now_us)

        # Stops, and the members on the bus.
        incarnation = self.records.incarnation
        self.safety = StopController(slot, incarnation, identity.silence, keyring, recalled, now_us)
        self.lifecycle = PeerLifecycle(self.safety)
        self.joining = NetworkJoin(identity, incarnation, rng, now_us)
        self.origins = Origins(identity.name)
        self.membership = Membership(
            identity, beat.silence_for_us, self.safety, self.origins, recalled, now_us
        )
        self._make_trust(keyring, now_us)
        for revoked in sorted(kept.revoked):
            self.membership.revoke(revoked, now_us)
        self.keys = KeyRenewal(slot, self.safety.authority, kept)
        self.names = NameDiscovery(slot, self.joining)
        self.slots = SlotDiscovery(slot, self.joining, self.origins)
        self.conflicts = Conflicts(self.safety, self.joining)
        self.senders = SenderOrigins(
            self.origins, self.safety, self.joining, self.conflicts, self.names
        )
        self.stops = StopReception(self.safety, self.senders, self.joining, self.membership)
        self.release = StopRelease(self.safety, self.membership)
        self.reports = MemberReports(slot, self.clock)
        self.votes = LeaderVotes(
            Election(
                OPERATOR_GATEWAY,
                slot,
                identity.name.hash16,
                self.records.term,
                self.records.lost,
                self.records.voted,
            )
        )
        self.letters = PgnResponder(
            identity, frozenset((MEMBER_PGN, CLAIM_PGN)), self.joining, self.safety
        )
        self.diagnostics = DiagnosticBroadcasts(
            self.safety, self.letters, self.votes, self.reports, identity.diagnostics
        )
        self.tasks = TaskReporting(identity, self.letters, self.safety)
        self.letters.answer(
            FLEET_SUMMARY_PGN,
            lambda ctx: write(compose(ctx, self.membership, self.allocation)),
            lambda: self.votes.leader == slot,
        )
        self.state_sync = StateSync(
            self.sync, self.admission, self.joining, beat.heartbeat_period_us, SenderLimits(now_us)
        )
        self.map_exchange = MapExchange(chart, self.joining)

        # This robot: what it senses, decides and does.
        drives = mission is not None and motion is not None
        needed_m = inf if mission is None else mission.position_accuracy_max_m
        self.senses = Senses(self.safety, motion, drives, needed_m, recalled)
        self.ranges = RangeSensing(self.safety, self.senses, recalled)
        self.implement = ImplementCheck(self.safety, self.senses)
        self.check = SelfCheck(self.safety, self.joining, self.membership, beat, now_us)
        self.knowledge = SelfKnowledge(self.safety, self.senses, self.check)
        question = None if motion is None else motion.obstacle_question()
        self.obstacle = ObstacleHold(question, self.safety)
        self.views = FleetViews(
            self.senses, self.allocation, self.progress, self.membership, self.obstacle, self.safety
        )
        self.directive = OperatorDirective(
            slot, self.safety, self.senses, mission, self.obstacle, recalled
        )
        self.mission_messages = MissionMessages(mission, identity.members)
        self.progress_told = ProgressAnnouncements(self.progress, self.sync, beat, now_us)
        self.progress_told.with_heartbeats = bool(self.proven.kinds)
        self.claims = SectionClaims(slot, self.allocation)
        self.work = SectionWork(
            self.claims, self.clock, self.sync, self.progress_told, self.lifecycle, self.safety,
            self.directive, self.views, mission,
        )  # fmt: skip
        self.control = ControlCycle(
            now_us + first_beat_for_us(identity, beat) % CONTROL_PERIOD_US, mission, motion, self.work,
            self.directive, self.obstacle, self.senses, self.views, self._may_choose,
        )  # fmt: skip
        self.control.implement_off = self.tasks.raises_implement
        self.voice = Announcements(
            identity, beat, self.safety, self.joining, self.conflicts, self.senses, self.knowledge,
            self.clock, self.sync, now_us,
        )  # fmt: skip
        self.departure = Departure(self.safety)
        self.terminal = TerminalService(
            identity, self.safety, self.votes, self.letters, self.membership, self.reports,
            self.views, mission, rng,
        )  # fmt: skip
        self._boot(now_us, recalled)

    @property
    def in_order(self) -> list[Part]:
        """Every part, in the order of timers and notices."""
        return [
            self.records, self.lifecycle, self.stops, self.senders, self.keys, self.fleet_clock,
            self.membership, self.joining,
            self.conflicts, self.names, self.reports, self.state_sync, self.map_exchange,
            self.letters, self.votes, self.mission_messages, self.slots, self.work, self.check,
            self.senses, self.ranges, self.implement, self.directive, self.control, self.progress_told,
            self.voice, self.release, self.departure, self.diagnostics, self.tasks, self.terminal,
            self.proven,
        ]  # fmt: skip

    def _make_trust(self, keyring: Keyring | None, now_us: int) -> None:
        """What proves frames in a fleet with keys, and does nothing in one without."""
        keys = None if keyring is None else ProofKeys(keyring.keys, keyring.badges)
        lot = b"" if keyring is None else keyring.lot + bytes((keyring.sender,))
        start = 0 if keys is None else FIRST + keys.number(b"start", lot, START_BITS)
        time, identity = FleetTime(start, now_us), self.identity
        self.fleet_clock = FleetClock(identity.slot, keys, time, lot, len(identity.members))
        self.proven = ProvenFrames(identity.slot, keys, time, self.membership, self.joining)
        if keys is not None:
            self.membership.life_for_us = self.beat.life_for_us

    def _may_choose(self, now_us: int) -> bool:
        """No section is chosen before our state is equal and no unknown robot may be at work."""
        return (
            self.sync.ready(now_us) and not self.slots.asks.wonders and not self.names.asks.wonders
        )

    def _boot(self, now_us: int, recalled: Mapping[str, bytes]) -> None:
        safety = self.safety
        if self.records.lost:
            why = recalled.get(LOST, b"durable memory was lost").decode(errors="replace")
            safety.raise_cause(StopCause.BOOT_UNCONFIRMED, now_us, why)
        if self.identity.started and not safety.latched and not safety.held:
            safety.start(now_us)
        if safety.latched:
            self.lifecycle.fire(Event.EMERGENCY, "latched before the restart")
