"""Many segments in one event loop: whole peers on whole wires, gateways between them, no bodies.

The areas form a ring: each segment shares its first sections with the one before it and its last
with the one after it. Peers claim, work and finish sections as scripted, through their operator
calls.
"""

from collections import Counter
from collections.abc import Callable
from random import Random

import can

from agent.interface.effects import Drive, Effect
from agent.interface.identity import SilencePolicy
from agent.peer.inputs import ClaimSection, Cover, Finish
from agent.peer.peer import Peer
from agent.runtime.gateway_runner import GatewayRunner
from agent.runtime.peer_factory import MissionParts, identity_of, keyring_of, make_peer
from agent.runtime.peer_runner import PeerRunner
from agent.segments.gateway import Gateway
from agent.segments.map_relay import MapRelay
from agent.segments.segment_area import Area, SegmentPlace
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import Geometry, OccupancyMap
from crdt.sighting import TIME_MAX, MergeOrder
from protocol.authentication import Keys
from protocol.frames.frame import Frame
from protocol.frames.segment_frames import gateway_slot
from protocol.links.bus import CanBus
from protocol.name import GATEWAY_FUNCTION, Name
from protocol.sync.map_sync import MapSync
from sim.can.frame_timing import BIT_US, frame_bits
from sim.can.simulated_bus import Segment, forget, segment
from sim.fleet.event_loop import EventLoop, RunnerHandle
from sim.fleet.scheduler import Script
from sim.rigs.simulated_backbone import SimulatedBackbone

FIELD_HASH = 0x5E6
MAP_TICK_US = 1_000_000  # of the map's clock


def ring_area(number: int, segments: int, home: int, shared: int) -> Area:
    """The area of segment `number` (from 1) in a ring: `home` sections of its own, `shared` of them
    at each border."""
    if segments == 1:
        return Area(number, home)
    before, after = (number - 2) % segments + 1, number % segments + 1
    lent = {section: frozenset({before}) for section in range(shared)}
    for section in range(home - shared, home):
        lent[section] = lent.get(section, frozenset()) | {after}
    theirs = [SegmentPlace(before, section) for section in range(home - shared, home)]
    theirs += [SegmentPlace(after, section) for section in range(shared)]
    borrowed = {home + k: place for k, place in enumerate(dict.fromkeys(theirs))}
    return Area(number, home, lent, borrowed)


class SegmentFleet:
    """`segments` times `robots` peers in virtual time; time passes only in `run`."""

    def __init__(
        self,
        segments: int,
        robots: int,
        seed: int,
        candidates: int = 2,
        home: int = 40,
        shared: int = 5,
        keys: Keys | None = None,
        policy: SilencePolicy = SilencePolicy.CONTINUE,
        geometry: Geometry | None = None,
        gateways_with_keys: bool = True,
    ) -> None:
        """`geometry`: of the map that all segments make, if they make one. `gateways_with_keys`: of a
        fleet with keys; without, they carry stops and resets alone."""
        self.segments, self.robots, self.seed = range(1, segments + 1), robots, seed
        self.event_loop = EventLoop()
        self.backbone = SimulatedBackbone(self.event_loop, seed)
        self.rng = Random(f"{seed}/segments")
        self.keys, self.policy, self.geometry = keys, policy, geometry
        self.gateway_keys = None if keys is None else Keys(keys.master, None)
        if not gateways_with_keys:
            self.gateway_keys = None
        self.areas = {k: ring_area(k, segments, home, shared) for k in self.segments}
        self.wires: dict[int, Segment] = {}
        self.runners: dict[tuple[int, int], PeerRunner] = {}
        self._running: dict[tuple[int, int], RunnerHandle] = {}
        self.gateways: dict[int, list[GatewayRunner]] = {}
        self.halted_at_us: dict[tuple[int, int], int] = {}  # last zero command of each robot
        self.bits: Counter[int] = Counter()  # on each wire
        self.bridged: Counter[int] = Counter()  # bits of each wire sent by gateways
        for number in self.segments:
            self._segment(number, candidates)

    # ---------------------------------------------------------------- building

    def _segment(self, number: int, candidates: int) -> None:
        channel = self.channel(number)
        wire = segment(channel, seed=f"{self.seed}/{number}", clock=self.event_loop)
        wire.taps.append(self._tap(number))
        self.wires[number] = wire
        for slot in range(self.robots):
            self._boot(number, slot)
        self.gateways[number] = []
        for _ in range(candidates):
            self.add_gateway(number)

    def channel(self, number: int) -> str:
        """Name of the bus of a segment, unique to this fleet."""
        return f"segment {id(self)}/{number}"

    def _tap(self, number: int) -> Callable[[int, Frame], None]:
        def tap(t_us: int, frame: Frame) -> None:
            bits = frame_bits(*frame)
            self.bits[number] += bits
            if gateway_slot(frame.identifier & 0xFF) is not None:
                self.bridged[number] += bits

        return tap

    def _boot(self, number: int, slot: int) -> None:
        identity = identity_of(f"segment {number}", slot, self.robots, FIELD_HASH, first_boot=True)
        rng = Random(f"{self.seed}/{number}/{slot}")
        lot = f"{self.seed}/{number}/{slot}".encode()
        keyring = keyring_of(self.keys, slot, lot)
        chart = None
        if self.geometry is not None:
            clock = HybridClock(0, MAP_TICK_US, TIME_MAX)
            chart = MapSync(slot, OccupancyMap(self.geometry, MergeOrder.DECAYED), clock, 0)
        peer = make_peer(
            identity, rng, 0, parts=MissionParts(chart=chart), keyring=keyring,
            area=self.areas[number], backbone=self.policy,
        )  # fmt: skip
        bus = can.Bus(interface="fieldbus", channel=self.channel(number))
        place = number, slot

        def watch(now_us: int, effect: Effect) -> None:
            if type(effect) is Drive and not (effect.vx_m_s or effect.vy_m_s or effect.turn_rad_s):
                self.halted_at_us[place] = now_us

        runner = self.event_loop.make_runner(peer, CanBus(bus), None, None, watch)
        self._running[place] = self.event_loop.start(runner)
        self.runners[place] = runner

    def replace_robot(self, number: int, slot: int) -> None:
        """A new robot without a memory takes the place of one that is switched off."""
        self._running[number, slot].cancel()
        self.runners[number, slot].bus.close()
        self._boot(number, slot)

    def add_gateway(self, number: int) -> GatewayRunner:
        """Switch another gateway on in the segment with this number."""
        boot = self.rng.getrandbits(32)
        name = Name(boot & 0x1FFFFF, function=GATEWAY_FUNCTION, arbitrary_address=0)
        event_loop, chart = self.event_loop, None
        if self.geometry is not None:
            chart = MapRelay(number, self.geometry, MergeOrder.DECAYED, event_loop.now_us())
        runner = GatewayRunner(
            Gateway(self.areas[number], name, boot, event_loop.now_us(), chart, self.gateway_keys),
            CanBus(can.Bus(interface="fieldbus", channel=self.channel(number))),
            self.backbone.attach(number),
            event_loop.now_us,
            event_loop.at,
        )
        self.gateways[number].append(runner)
        event_loop.soon(runner.start)
        return runner

    # ---------------------------------------------------------------- acting

    def peer(self, number: int, slot: int) -> Peer:
        """The core of one robot."""
        return self.runners[number, slot].peer

    def peers(self, number: int) -> list[Peer]:
        """The cores of a segment's robots, in slot order."""
        return [self.peer(number, slot) for slot in range(self.robots)]

    def leader(self, number: int) -> GatewayRunner | None:
        """The gateway that leads a segment now."""
        return next((g for g in self.gateways[number] if g.gateway.leads), None)

    def kill_gateway(self, runner: GatewayRunner) -> None:
        """Switch a gateway off for good."""
        runner.stop()
        self.gateways[runner.gateway.segment].remove(runner)

    def run(self, duration_us: int, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; with `until`, stop when the condition holds (checked every 10 ms)."""
        end_at_us = self.event_loop.now_us() + duration_us

        def script() -> Script[bool]:
            while self.event_loop.now_us() < end_at_us:
                if until is not None and until():
                    return True
                yield (
                    end_at_us
                    if until is None
                    else min(self.event_loop.now_us() + 10_000, end_at_us)
                )
            return until is None or until()

        return self.event_loop.run(script())

    def finish(self, number: int, slot: int, section: int, units: int = 3) -> None:
        """An operation as by a fast robot: claim, start, cover, done."""
        runner = self.runners[number, slot]
        runner.operate(ClaimSection(section, 3))

        def work() -> Script[None]:
            due_at_us = self.event_loop.now_us() + 5_000_000
            while runner.peer.claims.current != section:
                if self.event_loop.now_us() >= due_at_us:
                    return
                yield self.event_loop.now_us() + 50_000
            runner.operate(Cover(section, tuple(range(units))))
            yield self.event_loop.now_us() + 100_000
            runner.operate(Finish(section))

        self.event_loop.spawn(work())

    def end(self) -> None:
        """Close all buses and forget their channels. The fleet cannot be used afterwards."""
        for runner in self.runners.values():
            runner.bus.close()
        for gateways in self.gateways.values():
            for gateway in gateways:
                gateway.stop()
        for number in self.segments:
            forget(self.channel(number))

    # ---------------------------------------------------------------- results

    @property
    def share(self) -> dict[int, tuple[float, float]]:
        """The load of each wire since `count_from_here`: (all frames, those of gateways)."""
        span_for_us = self.event_loop.now_us() - self._window_at_us
        bits = {k: (self.bits[k], self.bridged[k]) for k in self.segments}
        return {
            k: (a * BIT_US / span_for_us, b * BIT_US / span_for_us) for k, (a, b) in bits.items()
        }

    _window_at_us = 0

    def count_from_here(self) -> None:
        """Begin the counts of bits on the buses again, from now on."""
        self._window_at_us = self.event_loop.now_us()
        self.bits.clear()
        self.bridged.clear()

    @property
    def joined(self) -> bool:
        """Whether all robots are on their bus, and every segment has a gateway that reaches all
        others."""
        others = len(self.segments) - 1
        return all(runner.peer.joining.joined for runner in self.runners.values()) and all(
            (lead := self.leader(k)) is not None
            and len(lead.gateway.reach.reached(self.event_loop.now_us())) == others
            for k in self.segments
        )

    @property
    def borders_equal(self) -> bool:
        """Whether at every border both sides hold the same, robot by robot."""
        for number in self.segments:
            area = self.areas[number]
            for section, place in area.borrowed.items():
                here, home = self.peers(number), self.peers(place.segment)
                states = {
                    (p.allocation.phase_of(section), p.allocation.entry(section).epoch,
                     p.progress.bits(section, 0)) for p in here
                } | {
                    (p.allocation.phase_of(place.section), p.allocation.entry(place.section).epoch,
                     p.progress.bits(place.section, 0)) for p in home
                }  # fmt: skip
                if len(states) > 1:
                    return False
        return True
