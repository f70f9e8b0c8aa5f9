"""N maps with their `MapSync` on the real wire model, without the other parts of a peer."""

from random import Random

import numpy as np

from agent.interface.config import S
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import Geometry, OccupancyMap
from crdt.sighting import LEVELS, TIME_MAX, MergeOrder
from protocol.frames.codec import decode_once, encode
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.sync.map_sync import MapSync
from sim.can.can_wire import Wire

ADDRESS = 128


class MapFleet:
    """A fleet in virtual time. `now_us` only moves in `run`."""

    def __init__(self, size: int, geometry: Geometry, order: MergeOrder, seed: int = 0) -> None:
        self.rng = Random(f"{seed}/map fleet")
        self.wire = Wire(seed)
        self.geometry, self.order = geometry, order
        self.members: dict[int, MapSync] = {}
        self.nodes: dict[int, int] = {}  # node -> slot
        self.islands: list[set[int]] = [set()]
        self.now_us = self.frames = 0
        for slot in range(size):
            self.boot(slot)

    def boot(self, slot: int) -> MapSync:
        """Start a member with an empty map; an earlier one of that slot is removed."""
        for node in [n for n, s in self.nodes.items() if s == slot]:
            self.wire.detach(node)
            del self.nodes[node]
        clock = HybridClock(self.now_us, S, TIME_MAX)
        chart = OccupancyMap(self.geometry, self.order)
        self.members[slot] = MapSync(slot, chart, clock, self.now_us)
        self.nodes[self.wire.attach()] = slot
        if not any(slot in island for island in self.islands):
            self.islands[0].add(slot)
        self.cut(*self.islands)
        return self.members[slot]

    def cut(self, *islands: set[int]) -> None:
        """Cut the wire into islands; each member knows the others of its island as live."""
        self.islands = [set(island) for island in islands]
        self.wire.partition(*({n for n, s in self.nodes.items() if s in i} for i in islands))
        for island in self.islands:
            for slot in island:
                self.members[slot].live(frozenset(island))

    def heal(self) -> None:
        """Undo every cut."""
        self.cut(set(self.members))

    def look(self, slot: int) -> None:
        """A robot observes some cells of some patch, correctly or not."""
        member, rng = self.members[slot], self.rng
        patches = np.flatnonzero(member.chart._inside.any(axis=1))
        values = np.array([rng.choice((0, 0, 1, 1, 2)) for _ in range(16)], dtype=np.int64)
        patch = int(rng.choice(patches.tolist()))
        member.see(patch, np.where(member.chart._inside[patch], values, 0), rng.randrange(LEVELS))

    def run(self, duration_us: int) -> None:
        """Let this much virtual time pass: members send when they are due, and the wire delivers."""
        end_at_us = self.now_us + duration_us
        while self.now_us < end_at_us:
            times = [end_at_us, *(m.due_at_us for m in self.members.values())]
            if self.wire.next_at_us is not None:
                times.append(self.wire.next_at_us)
            self.now_us = max(self.now_us, min(times))
            for delivery in self.wire.advance(self.now_us):
                source, message = decode_once(delivery.frame)
                assert isinstance(message, MapPatch | MapDigests)
                for node in delivery.receivers:
                    if node in self.nodes:
                        member = self.members[self.nodes[node]]
                        member.on_message(source - ADDRESS, message, delivery.t_us)
            for node, slot in list(self.nodes.items()):
                if self.members[slot].due_at_us <= self.now_us:
                    for said in self.members[slot].on_tick(self.now_us):
                        self.frames += 1
                        self.wire.submit(node, encode(said, ADDRESS + slot), self.now_us)

    @property
    def equal(self) -> bool:
        """Whether in each island all maps are equal, bit for bit."""
        return all(
            len({self.members[slot].chart.serialize() for slot in island}) <= 1
            for island in self.islands
        )
