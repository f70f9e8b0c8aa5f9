"""A gateway between a segment and the rest of the fleet: facts in, effects out, like a peer.

It is not a member: its silence stops no robot, and it claims nothing. It forwards stops first and
always, whether it leads or not, and needs no secret for them (`agent/segments/stop_relay.py`). In a
fleet with keys it passes on only work that it can prove (`agent/segments/gateway_proofs.py`). Only the
leading gateway forwards work at the border (`agent/segments/work_relay.py`). All heartbeats of the
segment become one summary. Frames of gateways are never forwarded, messages of the own segment are
dropped, and everything is idempotent. So loops end where they begin. All its traffic except stops
and proofs is limited to `SHARE` of the bus.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from agent.interface.config import FRAME_US, MS, S
from agent.interface.effects import Effect, Send
from agent.peer.frame_origin import PROPRIETARY, Origin, Origins
from agent.peer.member_discovery import CLAIM_PGN
from agent.segments.gateway_election import GatewayElection
from agent.segments.gateway_proofs import TAGGED, GatewayProofs
from agent.segments.map_relay import MapRelay
from agent.segments.segment_area import Area
from agent.segments.segment_reachability import SegmentReachability
from agent.segments.stop_relay import LIVE_US, StopRelay
from agent.segments.token_bucket import TokenBucket
from agent.segments.work_relay import FLUSH_US, WorkRelay
from protocol import backbone_messages as backbone
from protocol.authentication import Keys
from protocol.backbone_messages import BackboneHeader, BackboneKind, Body, Summary
from protocol.frames.codec import Malformed, decode_once, destination_of
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.key_frames import KeySwitch
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed, Request, refusal
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.segment_frames import FleetReset, FleetStop, SegmentSummary, gateway_slot
from protocol.frames.work_frames import (
    STOPS,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)
from protocol.name import GATEWAY_FUNCTION, Name
from protocol.sync.synchronizer import Synchronizer

SHARE = 0.10  # share of the bus for all frames that are not stops
BURST_US = 20 * FRAME_US  # bus time of the longest burst
SUMMARY_US = 500 * MS  # period of our segment's summary on the backbone
# One other segment's summary is sent to the robots this often: 0.6 % of the bus, for any number of
# segments.
ROTATION_US = 100 * MS
MAP_STEP_US = 2 * MS  # shortest time between two turns of the map: three in ten frames at most
LOOK_US = 200 * MS  # period of the liveness check of our segment
LEFT_US = 60 * S  # a robot silent for longer is no longer counted as silent
TELL_STEP_US = 20 * MS  # gateways send their stops to a new segment one after the other
TELL_SPACING_US = 1 * S  # shortest time between two such sendings of one gateway
STOPS_PER_MESSAGE = 64
DEFENCE_GAP_US = 200 * MS  # between two answers to devices that claim our address: five a second


class Publish(NamedTuple):
    """Put one message on the backbone. Stops go before everything else."""

    kind: BackboneKind
    data: bytes
    target: int = 0  # the segment that it concerns; 0: all


Out = Effect | Publish


class Gateway:
    """One gateway candidate of a segment.

    `on_frame` takes frames of its own bus, `on_backbone_message` takes messages of the backbone,
    and `on_tick` is called at `due_at_us`. All return effects in order. Times are microseconds on
    one clock of this gateway.
    """

    def __init__(
        self, area: Area, name: Name, boot: int, now_us: int, chart: MapRelay | None = None,
        keys: Keys | None = None,
    ) -> None:  # fmt: skip
        """`area`: the sections that concern this segment. `name`: the gateway's NAME on the bus.
        `boot`: 32 bits, different at each start. `chart`: the map, if segments share one. `keys`: of the
        file of panels; None: a fleet without keys, or a gateway that carries only stops and resets.
        """
        self.area, self.name, self.boot = area, name, boot & 0xFFFF_FFFF
        self.candidacy = GatewayElection(boot, name.hash16, now_us)
        self.reach = SegmentReachability(area.segment)
        self.stops = StopRelay(area.segment, now_us)
        self.border = WorkRelay(area)
        self.sync = Synchronizer(
            self.candidacy.election.slot, self.border.allocation, self.border.progress
        )
        self.chart = chart
        self.counts: Counter[str] = Counter()
        self._limit = TokenBucket(SHARE, BURST_US, now_us)
        self._slot_of: dict[int, int] = {}  # address -> slot, from MEMBER frames
        # Address -> the NAME that claimed it, in a fleet with keys.
        self._name_at: dict[int, int] = {}
        self._heard_at_us: dict[int, int] = {}  # slot -> last sign of life
        self._live: frozenset[int] = frozenset()
        self._look_at_us = self._flush_at_us = self._summary_at_us = self._rotate_at_us = now_us
        self._tell_at_us: int | None = None  # when we send all stops to all segments
        self._told_at_us = -TELL_SPACING_US
        self._stops_differ: Counter[int] = Counter()
        self._sequence = self._turn = 0
        self._announced: int | None = None  # the address that we have announced
        self._defended_at_us = now_us - DEFENCE_GAP_US
        self.proofs = None if keys is None else GatewayProofs(keys, self.boot, now_us)
        self.origins = Origins(name)  # frames of other makers are not forwarded

    @property
    def segment(self) -> int:
        """Number of our segment."""
        return self.area.segment

    @property
    def leads(self) -> bool:
        """Whether this candidate leads the gateways of the segment."""
        return self.candidacy.leads

    def rekey(self, keys: Keys, now_us: int) -> None:
        """The fleet has other keys. What we have heard of work we forget, because a robot that was
        revoked may have said it, and learn again from the robots what they still believe."""
        assert self.proofs is not None, "a gateway without keys is given none"
        self.proofs.rekey(keys, now_us)
        self.stops.keys_changed()
        self.border = WorkRelay(self.area)
        self.sync = Synchronizer(self.sync.slot, self.border.allocation, self.border.progress)
        self.sync.live(self._live, now_us)

    # ---------------------------------------------------------------- from our segment

    def on_frame(self, frame: Frame, now_us: int) -> Sequence[Out]:
        """A frame of our own bus. A frame that cannot be read is counted and has no effect."""
        source, message = decode_once(frame)
        if isinstance(message, Malformed):
            self.counts[f"malformed {message.reason}"] += 1
            return ()
        if isinstance(message, AddressClaimed | Request):
            return self._on_network_message(source, message, destination_of(frame), now_us)
        if type(message) in PROPRIETARY and self.origins.of(source) is Origin.FOREIGN:
            self.counts["foreign"] += 1
            return ()
        number = gateway_slot(source)
        if isinstance(message, EmergencyStop) and message.spent:
            return ()  # an answer to a press; the press itself is forwarded
        if isinstance(message, EmergencyStop) and message.tag == 0:  # a fleet without keys
            dot = message.slot, message.incarnation, message.counter
            message = FleetStop(self.segment, *dot, told=message.echo)
        if isinstance(message, FleetStop):
            return self._on_stop(source, message, number is not None, now_us)
        if isinstance(message, FleetReset):
            halves = self.stops.on_reset(message)
            return (
                self._publish(BackboneKind.RESETS, tuple(halves))
                if halves and number is None
                else ()
            )
        if isinstance(message, KeySwitch):
            self.stops.keys_changed()
            return ()
        if number is not None:
            self.candidacy.on_message(number, message, now_us)
        if self.proofs is None:
            self._on_message(source, number, message, now_us)
            return ()
        believed = self.proofs.hear(source, self._slot_of.get(source), message, now_us)
        if believed is None:
            self._on_message(source, number, message, now_us)
        for _, proven in believed or ():
            self._on_message(source, number, proven, now_us)
        return ()

    def _on_network_message(
        self, source: int, message: AddressClaimed | Request, destination: int, now_us: int
    ) -> Sequence[Out]:
        """Track devices by NAME."""
        if isinstance(message, AddressClaimed):
            origin = self.origins.claimed(source, message.name)
            if self.proofs is not None and self._name_at.get(source) != message.name:
                # Another device: its slot is to be proven again.
                self._name_at[source] = message.name
                self._slot_of.pop(source, None)
                self.proofs.checker.forget(source)
            gateway = Name.unpack(message.name).function == GATEWAY_FUNCTION
            if origin is Origin.OURS and gateway:
                return ()  # gateways settle by their beats who has a number
            return self._on_foreign_claim(source, message.name, now_us)
        here = self._announced is not None and destination in (GLOBAL_ADDRESS, self._announced)
        if here and message.pgn == CLAIM_PGN:
            return [self._send(AddressClaimed(self.name.pack()))]
        if here and destination == self._announced and source < NULL_ADDRESS:
            return [self._send(refusal(source, message.pgn))]
        return ()

    def _on_foreign_claim(self, source: int, name: int, now_us: int) -> Sequence[Out]:
        """A device that is no gateway claims an address. The lower NAME keeps one that both want."""
        number = gateway_slot(source)
        if number is None:
            return ()
        if number != self.candidacy.number or name < self.name.pack():
            if source == self._announced:
                self._announced = None  # it is announced again if it is taken again
            self.candidacy.lose(number, now_us)
        elif now_us - self._defended_at_us >= DEFENCE_GAP_US:
            self._defended_at_us = now_us
            return [self._send(AddressClaimed(self.name.pack()))]
        return ()

    def _on_stop(
        self, source: int, stop: FleetStop, from_gateway: bool, now_us: int
    ) -> Sequence[Out]:
        news = self.stops.on_stop(source, stop, now_us)
        if news:
            self._stops_differ.clear()  # the others may miss this one
        return self._publish(BackboneKind.STOPS, tuple(news)) if news and not from_gateway else ()

    def _on_message(self, source: int, number: int | None, message: Message, now_us: int) -> None:
        slot = self._slot_of.get(source) if number is None else number
        if isinstance(message, Member):
            self._slot_of[source] = slot = message.slot
        if slot is not None and number is None:
            self._heard_at_us[slot] = now_us
        if isinstance(message, Pose):
            self.stops.on_pose(source, message.stopped, now_us)
        elif isinstance(message, Heartbeat) and slot is not None:
            if message.leaving:
                self._heard_at_us.pop(slot, None)
            else:
                self.sync.heard_digest(slot, message.digest, now_us)
        elif isinstance(message, MapPatch | MapDigests):
            if self.chart is not None and slot is not None:
                self.chart.on_message(slot, message, now_us)
        elif isinstance(message, TaskClaim | StateSyncResponse | WorkProgress):
            before = self.sync.replica.version
            # Another gateway may have the number that we take, took, or have not given up yet.
            sender = -1 if slot is None or slot == self.sync.slot else slot
            self.sync.on_message(sender, message, now_us)
            if self.sync.replica.version != before:
                self.border.on_message(message, number is not None)

    # ---------------------------------------------------------------- from the backbone

    def on_backbone_message(self, data: bytes, now_us: int) -> Sequence[Out]:
        """A message of the backbone. One that cannot be read, or that is not news, is counted and
        has no effect.
        """
        vouched = True
        if self.proofs is not None:
            data, vouched = self.proofs.opened(data)
        message = backbone.unpack(data)
        if message is None:
            self.counts["malformed message"] += 1
            return ()
        header, body = message
        if not vouched and header.kind in TAGGED:
            self.counts["unproven message"] += 1
            return ()
        if not self.reach.accepts(header, now_us):
            return ()
        self.counts[BackboneKind(header.kind).name] += 1
        if header.kind == BackboneKind.STOPS:
            stops = [stop for stop in body if isinstance(stop, FleetStop)]
            self.stops.on_backbone_stops(stops, now_us)
            if len(stops) >= len(self.stops.stops):
                self._tell_at_us = None  # another gateway has sent them all
            return self.on_tick(now_us)
        if header.kind == BackboneKind.RESETS:
            self.stops.on_backbone_resets([h for h in body if isinstance(h, FleetReset)], now_us)
        elif isinstance(body, Summary):
            self._on_summary(header, body, now_us)
        elif header.kind == BackboneKind.MAP:
            for entry in body if self.chart is not None else ():
                if isinstance(entry, backbone.Entry) and self.chart is not None:
                    self.chart.on_entry(header.segment, entry, now_us)
        elif self.leads:
            self._on_work(header.segment, body, now_us)
        return ()

    def _on_summary(self, header: BackboneHeader, summary: Summary, now_us: int) -> None:
        self.reach.on_summary(header, summary, now_us)
        term = summary.heard.get(self.segment, 0)
        if self.candidacy.number is not None and term > self.candidacy.term:
            self.candidacy.on_fence(term, now_us)
        # Else what we send is lost, and repairs would become rare.
        if self.segment in summary.heard:
            self.border.on_digest(header.segment, summary.shared.get(self.segment, 0))
        if summary.stops == self.stops.digest:
            del self._stops_differ[header.segment]
            return
        tries = self._stops_differ[header.segment] = self._stops_differ[header.segment] + 1
        # One that stands by may lack stops of before its start, and no gateway compares with it. It
        # tries at 2, 4, 8 ... so that such a difference, which lasts, costs little.
        rare = not self.leads and (tries & tries - 1) != 0
        if tries >= 2 and not rare and self._tell_at_us is None:
            place = sorted(self.reach.heard(now_us)).index(header.segment)
            earliest_at_us = self._told_at_us + TELL_SPACING_US
            self._tell_at_us = max(now_us + place * TELL_STEP_US, earliest_at_us)

    def _on_work(self, source: int, body: Body, now_us: int) -> None:
        before = self.border.version
        entries = [entry for entry in body if isinstance(entry, backbone.Entry)]
        for section, block in self.border.on_entries(source, entries):
            self.sync.changed_here(section, block, now_us)
        self.counts["news"] += self.border.version != before

    # ---------------------------------------------------------------- time

    @property
    def due_at_us(self) -> int:
        """When `on_tick` has something to do next."""
        times = [self.candidacy.due_at_us]
        if self.candidacy.address is not None:
            times += [self.stops.due_at_us, self._look_at_us]
            sync_at_us = self.sync.due_at_us
            if sync_at_us is not None:
                times.append(sync_at_us)
            if self.proofs is not None:
                times.append(self.proofs.due_at_us)
            if self._tell_at_us is not None:
                times.append(self._tell_at_us)
            if self.leads:
                times += [self._summary_at_us, self._rotate_at_us]
                if self.chart is not None:
                    times.append(max(self.chart.due_at_us, self._map_at_us))
                if self.border.has_entries:
                    times.append(self._flush_at_us)
                if self.border.has_frames:
                    times.append(self._say_at_us)
        return min(times)

    _map_at_us = 0  # earliest time of the next frame of the map
    _say_at_us = 0  # when the rate limit lets the next frame of work pass

    def on_tick(self, now_us: int) -> Sequence[Out]:
        """Everything that is due now; call it at `due_at_us`."""
        effects, number = self._due(now_us), self.candidacy.number
        if self.proofs is None or number is None or self.candidacy.address is None:
            return effects
        return self.proofs.cover(effects, number, self.candidacy.address, now_us)

    def _due(self, now_us: int) -> Sequence[Out]:
        candidacy = self.candidacy
        effects: list[Out] = [
            *candidacy.on_tick(len(self.reach.reached(now_us)), self.reach.ever, now_us)
        ]
        self.stops.leads = self.leads
        if candidacy.address is None:
            return effects
        if self._announced != candidacy.address:
            self._announced = candidacy.address
            effects[:0] = self._announce()
        effects += [self._send(message) for message in self.stops.on_tick(now_us)]
        if now_us >= self._look_at_us:
            self._observe_members(now_us)
        effects += [self._send(message) for message in self.sync.on_tick(now_us)]
        if self._tell_at_us is not None and now_us >= self._tell_at_us:
            self._tell_at_us, self._told_at_us = None, now_us
            effects += self._publish_stops()
        if self.leads:
            effects += self._lead(now_us)
        else:
            self.border.forget_injections()
        return effects

    def _announce(self) -> list[Out]:
        """We have an address: announce it, and ask which stops hold the robots here."""
        claim = AddressClaimed(self.name.pack())
        return [self._send(claim), self._send(StateSyncRequest(0, 0, STOPS, 0))]

    def _observe_members(self, now_us: int) -> None:
        self._look_at_us = now_us + LOOK_US
        live = frozenset(
            s for s, heard_at_us in self._heard_at_us.items() if now_us - heard_at_us < LIVE_US
        )
        if live != self._live:
            assert self.candidacy.number is not None
            self._live = live
            self.sync.slot = self.sync.divergence.slot = self.candidacy.number
            self.sync.live(live | {self.candidacy.number}, now_us)
        if self.chart is not None:
            self.chart.observe(live, frozenset(self.reach.heard(now_us)))

    def _lead(self, now_us: int) -> list[Out]:
        effects: list[Out] = []
        if self.border.has_entries and now_us >= self._flush_at_us:
            self._flush_at_us = now_us + FLUSH_US
            for neighbour, entries in self.border.outgoing():
                effects += self._publish(BackboneKind.WORK, entries, neighbour)
        if now_us >= self._summary_at_us:
            self._summary_at_us = now_us + SUMMARY_US
            effects += self._publish(BackboneKind.SUMMARY, self.summary(now_us))
        if now_us >= self._rotate_at_us:
            self._rotate_at_us = now_us + ROTATION_US
            if self._limit.take(FRAME_US, now_us):
                effects += self._next_summary(now_us)
        if self.chart is not None and now_us >= max(self.chart.due_at_us, self._map_at_us):
            near, far = self.chart.on_tick(self._limit, now_us)
            self._map_at_us = now_us + MAP_STEP_US
            effects += [self._send(message) for message in near]
            effects += self._publish(BackboneKind.MAP, tuple(far)) if far else []
        if self.border.has_frames:
            if self._limit.take(FRAME_US, now_us):
                effects.append(self._send(self.border.next_frame()))
            self._say_at_us = self._limit.ready_at_us(FRAME_US, now_us)
        return effects

    def _next_summary(self, now_us: int) -> list[Out]:
        """The summary of the next other segment, for the robots here."""
        heard = sorted(self.reach.heard(now_us))
        if not heard:
            return []
        self._turn = (self._turn + 1) % len(heard)
        summary = self.reach.remotes[heard[self._turn]].summary
        if summary is None:
            return []
        done = round(250 * min(summary.done / summary.home, 1.0)) if summary.home else 0
        told = SegmentSummary(
            heard[self._turn], summary.live, summary.silent, summary.halted, done,
            summary.digest & 0xFFFF,
        )  # fmt: skip
        return [self._send(told)]

    def summary(self, now_us: int) -> Summary:
        """Our segment for the others: counts of robots (each at most 255), sections done, and
        digests.
        """
        live, halted = self.stops.halted(now_us)
        silent = sum(LIVE_US <= now_us - t_us < LEFT_US for t_us in self._heard_at_us.values())
        done, digest = self.border.home_state()
        shared = {n: self.border.digest(n) for n in self.area.neighbours}
        heard = self.reach.heard(now_us)
        return Summary(
            min(live, 255), min(silent, 255), min(halted, 255), done, self.area.home, digest,
            self.stops.digest, 0 if self.chart is None else self.chart.digest, shared, heard,
        )  # fmt: skip

    # ---------------------------------------------------------------- out

    def _publish_stops(self) -> list[Out]:
        effects: list[Out] = []
        stops = [stop._replace(told=True) for stop in self.stops.stops]
        halves = [half for both in self.stops.resets.values() for half in both.values()]
        for at in range(0, len(halves), STOPS_PER_MESSAGE):
            effects += self._publish(
                BackboneKind.RESETS, tuple(halves[at : at + STOPS_PER_MESSAGE])
            )
        for at in range(0, len(stops), STOPS_PER_MESSAGE):
            effects += self._publish(BackboneKind.STOPS, tuple(stops[at : at + STOPS_PER_MESSAGE]))
        return effects

    def _publish(self, kind: BackboneKind, body: Body, target: int = 0) -> list[Out]:
        self._sequence = self._sequence + 1 & 0xFFFF_FFFF
        number = self.candidacy.number
        header = BackboneHeader(
            kind, self.segment, self.candidacy.term, 0 if number is None else number, self.boot,
            self._sequence,
        )  # fmt: skip
        data = backbone.pack(header, body)
        if self.proofs is not None and kind in TAGGED:
            data = self.proofs.sealed(data)
        return [Publish(kind, data, target)]

    def _send(self, message: Message) -> Send:
        return Send(message, source=self.candidacy.address)

    def status(self, now_us: int) -> dict[str, object]:
        """For people: the state of the gateway and the segments that it reaches."""
        live, halted = self.stops.halted(now_us)
        return {
            "segment": self.segment, "number": self.candidacy.number, "leads": self.leads,
            "term": self.candidacy.term, "reached": sorted(self.reach.reached(now_us)),
            "heard": sorted(self.reach.heard(now_us)), "robots": live, "stopped": halted,
            "counts": dict(self.counts + self.reach.counts + self.border.counts),
        }  # fmt: skip
