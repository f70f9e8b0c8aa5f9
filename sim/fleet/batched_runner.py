"""A runner that takes routine beacons in batches, for simulations with thousands of them a second.

The simulated bus puts beacons of robots that are neither stopped nor leaving into a buffer, and the
runner processes them before its next turn, each as if received at its time of arrival. Nothing on a
robot works like this: what a robot does with each frame is `PeerRunner`, and the result is the same.
"""

from collections.abc import Callable, Sequence

from agent.interface.effects import Effect, Persist
from agent.interface.observation import Neighbour
from agent.interface.ports import Body, Bus, Journal
from agent.peer.inputs import Heard, Input
from agent.peer.peer import Peer
from agent.runtime.peer_runner import PeerRunner
from protocol.frames.agreement_frames import AgreementMessage
from protocol.frames.fleet_frames import Heartbeat
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from sim.can.simulated_bus import BufferedBeacon, FieldBus


class BatchedRunner(PeerRunner):
    """A runner that buffers beacons until its peer takes a turn for another reason."""

    def __init__(
        self,
        peer: Peer,
        bus: Bus,
        body: Body | None,
        journal: Journal | None,
        on_effect: Callable[[int, Effect], None] | None = None,
        clock: Callable[[], int] | None = None,
    ) -> None:
        # Not `*parts`: mypyc 2 hands them to a base class as one tuple.
        super().__init__(peer, bus, body, journal, on_effect, clock)
        wire = self.bus.bus if isinstance(self.bus, CanBus) else None
        self._wire = wire if isinstance(wire, FieldBus) else None
        self._buffered: list[BufferedBeacon] = []  # buffered beacons, for the next turn
        self._buffering = False  # whether the bus puts beacons there

    @property
    def _local(self) -> Callable[[int], int] | None:
        """Converts bus time to our clock; None: they are the same."""
        return None

    def operate(self, *calls: Input) -> None:
        self._catch_up()
        super().operate(*calls)
        self._attend()

    def freeze(self, for_s: float) -> None:
        self._catch_up()
        super().freeze(for_s)
        self._attend()

    def on_tick(self) -> None:
        self._catch_up()
        super().on_tick()
        self._attend()

    def _process(self, frame: Frame) -> bool:
        if self._buffered:
            self._catch_up()
        changed = super()._process(frame)
        if changed:
            self._attend()
        return changed

    def _attend(self) -> None:
        """Buffer beacons, unless we are stopped: then each is an echo or needs an answer."""
        wait = self._listening and not self._freeze_ends_at_us and not self.peer.safety.latched
        if wait is not self._buffering:
            self._buffering = wait
            if self._wire is not None:
                self._wire.buffer_beacons(self._buffered if wait else None)

    def _catch_up(self) -> None:
        """Process the buffered beacons."""
        if self._buffered:
            effects = self._take(self._buffered)
            self._buffered.clear()
            if effects:
                self.perform(effects)

    def _take(self, beacons: Sequence[BufferedBeacon]) -> list[Effect]:
        """What the peer does with beacons of live members while no stop holds it, without the calls.

        A pose is `Membership.on_pose`, a heartbeat what listens to `HeartbeatHeard`, a word of an
        agreement `MissionMessages`. Everything else goes through `Peer.step`."""
        peer, local = self.peer, self._local
        effects: list[Effect] = []
        reports, sync, safety = peer.reports, peer.sync, peer.safety
        membership, own, proven = peer.membership, peer.slot, peer.proven.kinds
        slot_of, signs, neighbours = (
            membership.slot_of,
            membership.last_sign_at_us,
            membership.neighbours,
        )
        mission = peer.mission
        # After a step back of our clock the peer is told by the first of them.
        back = local is not None and local(beacons[0][2]) < peer.reached_at_us
        for beacon in beacons:
            source, message, bus_at_us, seen = beacon
            slot = slot_of.get(source)
            if local is not None and seen is not None:
                seen = Neighbour(seen.pose, local(seen.heard_at_us))
            if seen is not None and slot in signs and not back:
                neighbours[slot] = seen  # this counts as a sign of life too
                if seen.pose.heard == own:
                    membership.reflected_at_us = seen.heard_at_us
            else:
                t_us = bus_at_us if local is None else local(bus_at_us)
                plain = not proven and not safety.latched and not back
                if slot in signs and type(message) is Heartbeat and plain:
                    signs[slot] = t_us
                    reports.heard(slot, message)
                    sync.heard_digest(slot, message.digest, t_us)
                elif slot in signs and type(message) is AgreementMessage and plain:
                    signs[slot] = t_us
                    records = () if mission is None else mission.on_message(slot, message, t_us)
                    effects += [Persist(*record) for record in records]
                else:
                    effects += peer.step(Heard(source, message), t_us)
                    back = False
        return effects
