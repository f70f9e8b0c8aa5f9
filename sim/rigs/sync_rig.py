"""N replicas with their `Synchronizer`, on the real wire model, without the other parts of a peer.

Everything goes over the wire: claims, progress, heartbeats with their digests, sync frames. Members
in one island are live to each other, after a short silence.
"""

from collections import Counter
from collections.abc import Iterable
from heapq import heappop, heappush
from random import Random

from agent.interface.config import S, beat_of
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.codec import decode_once, encode
from protocol.frames.fleet_frames import Heartbeat
from protocol.frames.messages import Message
from protocol.frames.work_frames import (
    TaskClaim,
    WorkProgress,
)
from protocol.sync.synchronizer import Said, Synchronizer
from sim.can.can_wire import Delivery, Wire

ADDRESS = 128


class SyncMember:
    """One replica and its sync."""

    def __init__(self, slot: int, node: int) -> None:
        self.slot, self.node = slot, node
        self.allocation, self.progress = FieldAllocationCRDT(), Progress()
        self.sync = Synchronizer(slot, self.allocation, self.progress)
        self.counter = 0


class SyncFleet:
    """A fleet in virtual time. `now_us` only moves in `run`."""

    def __init__(self, size: int, seed: int = 0, heartbeat_period_us: int | None = None) -> None:
        self.rng = Random(f"{seed}/sync fleet")
        self.wire = Wire(seed)
        self.heartbeat_period_us = heartbeat_period_us or beat_of(size).heartbeat_period_us
        self.members: dict[int, SyncMember] = {}
        self.islands: list[set[int]] = [set()]
        self.now_us = 0
        self.sent: Counter[str] = Counter()  # sync frames sent by members, by kind
        self.first_at_us = self.last_at_us = -1  # sync frames on the bus
        self._due: list[tuple[int, int]] = []  # (time, slot) of heartbeats; a member's has slot
        for slot in range(size):
            self.boot(slot)
        self.see()

    # ---------------------------------------------------------------- members and links

    def boot(self, slot: int) -> SyncMember:
        """Start a member with an empty memory; others receive it from its next heartbeat on."""
        member = SyncMember(slot, self.wire.attach())
        self.members[slot] = member
        self.islands[0].add(slot)
        heappush(self._due, (self.now_us + self.rng.randrange(self.heartbeat_period_us), slot))
        return member

    def cut(self, *islands: set[int]) -> None:
        """Cut the wire into islands; each member knows the others of its island as live."""
        self.islands = [set(island) for island in islands]
        self.wire.partition(*({self.members[s].node for s in island} for island in islands))
        self.see()

    def part(self, operations: int, left: int, period_us: int) -> None:
        """After a common history, the first `left` peers are cut off; each side writes half."""
        peers = len(self.members)
        for section in range(200):
            self.write(section % peers, section, None)
        self.run(3 * S)
        self.cut(set(range(left)), set(range(left, peers)))
        for k in range(operations // 2):
            self.write(k % left, 1000 + k, None)
            self.write(left + k % (peers - left), 2000 + k, None)
            self.run(period_us)
        self.run(3 * S)

    def heal(self) -> None:
        """Undo every cut."""
        self.islands = [set(self.members)]
        self.wire.heal()
        self.see()

    def see(self) -> None:
        """Tell every member which others of its island are live."""
        for island in self.islands:
            for slot in island:
                self.members[slot].sync.live(frozenset(island), self.now_us)

    # ---------------------------------------------------------------- operations

    def write(self, slot: int, section: int, unit: int | None = 0) -> None:
        """Claim a section and cover one unit of it, announced as by a peer."""
        member = self.members[slot]
        key = member.allocation.claim(section, slot, self.rng.randrange(32))
        if key is not None:
            member.sync.changed_here(section, None, self.now_us)
            self.send(member, TaskClaim(section, *member.allocation.entry(section)))
        if unit is not None:
            block, bits = member.progress.cover(section, unit)
            member.sync.changed_here(section, block, self.now_us)
            self.send(member, WorkProgress(section, block, bits))

    def send(self, member: SyncMember, message: Message) -> None:
        """Queue a message of a member on the wire."""
        self.wire.submit(member.node, encode(message, ADDRESS + member.slot), self.now_us)

    # ---------------------------------------------------------------- time

    def run(self, duration_us: int, until_equal: bool = False) -> bool:
        """Let time pass; with `until_equal`, stop when all replicas of each island are equal."""
        end_at_us = self.now_us + duration_us
        while self.now_us < end_at_us:
            if until_equal and self.equal:
                return True
            self._step(end_at_us)
        return self.equal

    def _step(self, end_at_us: int) -> None:
        times = [end_at_us, self._due[0][0]]
        if self.wire.next_at_us is not None:
            times.append(self.wire.next_at_us)
        times += [d for m in self.members.values() if (d := m.sync.due_at_us) is not None]
        self.now_us = max(self.now_us, min(times))
        for delivery in self.wire.advance(self.now_us):
            self._deliver(delivery)
        while self._due[0][0] <= self.now_us:
            due_at_us, slot = heappop(self._due)
            heappush(self._due, (due_at_us + self.heartbeat_period_us, slot))
            self._beat(self.members[slot])
        for member in self.members.values():
            sync_at_us = member.sync.due_at_us
            if sync_at_us is not None and sync_at_us <= self.now_us:
                self._say(member, member.sync.on_tick(self.now_us))

    def _beat(self, member: SyncMember) -> None:
        member.counter = (member.counter + 1) % 251
        digest = member.sync.outgoing_digest()
        beat = Heartbeat(member.counter, 1, False, False, True, False, 1.0, 0, digest)
        self.send(member, beat)

    def _say(self, member: SyncMember, messages: Iterable[Said]) -> None:
        for message in messages:
            frame = encode(message, ADDRESS + member.slot)
            self.sent[type(message).__name__] += 1
            if self.first_at_us < 0:
                self.first_at_us = self.now_us
            self.last_at_us = self.now_us
            self.wire.submit(member.node, frame, self.now_us)

    def _deliver(self, delivery: Delivery) -> None:
        source, message = decode_once(delivery.frame)
        by_node = {m.node: m for m in self.members.values()}
        slot = source - ADDRESS
        for node in delivery.receivers:
            sync = by_node[node].sync
            if isinstance(message, Heartbeat):
                sync.heard_digest(slot, message.digest, delivery.t_us)
            else:
                sync.on_message(slot, message, delivery.t_us)

    # ---------------------------------------------------------------- results

    @property
    def equal(self) -> bool:
        """Whether all replicas within each island have one digest."""
        return all(
            len({self.members[slot].sync.digest for slot in island}) <= 1 for island in self.islands
        )

    @property
    def states(self) -> set[tuple[bytes, bytes]]:
        """The whole replicas, not their digests."""
        return {(m.allocation.serialize(), m.progress.serialize()) for m in self.members.values()}

    @property
    def frames(self) -> int:
        """Number of frames sent since the count began."""
        return sum(self.sent.values())

    def count_from_here(self) -> None:
        """Begin the counts of frames and bits again."""
        self.sent.clear()
        self.first_at_us = self.last_at_us = -1
