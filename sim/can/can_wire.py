"""One CAN segment, sans I/O: which node sends, for how long, and which nodes receive.

Frames submitted at one instant all enter the arbitration that starts at the next bit boundary, so
the order of submissions inside an instant does not matter. The lowest identifier among the heads of
the nodes' transmit queues goes first; it is not interrupted. An idle wire schedules nothing.

Faults: islands (a cut bus), one-way links, loss, duplicates, bus errors with retransmission, error
counters through error passive to bus-off and back, inconsistent omission. Each kind of fault has
its own random generator, so removing one fault does not change the random numbers of the others.

Every frame is acknowledged, also that of a robot that is alone, because a machine has a second
controller on its bus, that of its implement. So `Node.sent` is what a CAN controller can confirm.
"""

from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from random import Random
from typing import Final, NamedTuple

from protocol.frames.frame import Frame
from sim.can.frame_timing import BIT_US, WORST_BITS, frame_bits
from sim.can.other_frame import OtherFrame

QUEUE_MAX = 256  # frames that a node may have waiting: 0.15 s of a bus used by it alone
ERROR_US = 31 * BIT_US  # error flag, its superposition and delimiter, interframe space
PASSIVE = 127  # above this a node is error passive
BUS_OFF_TEC = 256
SUSPEND_US = 8 * BIT_US  # an error passive node waits this long after its own frame (ISO 11898-1)
NEVER_US: Final = -1
ENDLESS_US: Final = (1 << 62) - 1
NO_FRAME = Frame(0, b"")
RECOVERY_US = 128 * 11 * BIT_US  # 128 times 11 recessive bits


_tuple = tuple.__new__


class Delivery(NamedTuple):
    """A frame that was sent completely, with the nodes that accepted it."""

    t_us: int
    frame: Frame
    sender: int
    receivers: tuple[int, ...]


@dataclass
class Node:
    """One controller on the wire: its queue of frames, its error counters, and in which part of a
    cut bus it is."""

    name: str
    island: int = 0
    queue: list[tuple[int, int, Frame]] = field(default_factory=list)
    tec: int = 0  # transmit error counter
    rec: int = 0  # receive error counter
    off_ends_at_us: int | None = None  # bus-off until that time
    recovered_at_us: int = 0  # when its newest bus-off ended
    # an error passive node must not send before this time, after its own frame
    ready_at_us: int = 0
    refused: int = 0  # frames rejected because the queue was full or the node off the bus
    sent: int = 0  # frames sent and acknowledged; its driver can report the number
    flood: Frame | None = None  # this node always has this frame to send


@dataclass
class Faults:
    """Rates are probabilities per frame, and per receiver if receivers can differ."""

    loss: float = 0.0  # a receiver misses a frame, and no node detects it
    omission: float = 0.0  # inconsistent omission: some receivers miss it (Rufino et al. 1998)
    duplicate: float = 0.0  # the frame is repeated although all received it
    error: float = 0.0  # a bit error: error frame and retransmission
    deaf: set[tuple[int, int]] = field(default_factory=set)  # (sender, receiver) links that are cut


class Island:
    """A connected part of the bus, and its state."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.free_at_us = 0  # when the last frame ended
        self.start_at_us = NEVER_US  # when arbitration is due
        # Start of the frame being sent; may be slightly ahead of the present time.
        self.begun_at_us = 0
        self.end_at_us = NEVER_US  # of the frame being sent
        self.sender = 0
        self.frame = NO_FRAME
        self.broken = False
        self.train_period_us = 0  # length of each frame in a train of equal frames; 0: no train

    @property
    def next_at_us(self) -> int:
        """When the next event occurs here, or `NEVER_US`. A train needs no events."""
        if self.train_period_us:
            return NEVER_US
        return self.start_at_us if self.end_at_us == NEVER_US else self.end_at_us


class Wire:
    """A segment without a clock of its own: frames are arbitrated, timed and delivered as the
    caller advances the time. The same seed and the same calls give the same frames."""

    def __init__(self, seed: int | str = 0, bit_us: int = BIT_US) -> None:
        self.bit_us = bit_us
        self.nodes: dict[int, Node] = {}
        self.faults = Faults()
        self.frames = self.errors = 0
        self.busy_for_us = 0
        self.worst_for_us = 0  # time of the same frames at worst-case stuffing
        self.by_group: dict[int, int] = {}  # frames of each parameter group
        self.others = 0  # frames with an 11-bit identifier, and remote frames
        self._rng = {
            k: Random(f"{seed}/wire/{k}") for k in ("loss", "omission", "duplicate", "error")
        }
        self._order = 0
        self._islands = [Island(0)]  # by their numbers; only one unless the bus was cut
        self._audience: dict[int, tuple[int, ...]] = {}
        self._off: dict[int, int] = {}  # nodes in bus-off -> end of it
        self._waiting: set[int] = set()  # nodes with something to send
        self._next_node = 0
        self._now_us = 0  # the latest time given by a caller
        self._next_at_us: int | None = None
        self._next_known = False  # nothing has changed since the next event was computed

    # ---------------------------------------------------------------- nodes

    def attach(self, name: str = "") -> int:
        """Connect another controller and return its number."""
        number = self._next_node
        self._next_node += 1
        self.nodes[number] = Node(name or f"node {number}")
        self._audience.clear()
        return number

    def detach(self, number: int, now_us: int = 0) -> None:
        """Remove the power of a node: its waiting frames are lost, and its frame on the wire breaks
        off. The others see an error and then arbitrate."""
        now_us = self._now_us = max(self._now_us, now_us)
        self._settle_all(now_us)
        self.nodes.pop(number, None)
        self._off.pop(number, None)
        self._waiting.discard(number)
        self._next_known = False
        for island in self._islands:
            if island.sender == number and island.end_at_us != NEVER_US:
                self._break_off(island, now_us)
        self._audience.clear()

    def _break_off(self, island: Island, now_us: int) -> None:
        """End the frame whose sender is gone."""
        if island.begun_at_us > now_us:
            self._withdraw(island)
            return  # a node with something to send arbitrates at that bit
        self.busy_for_us -= island.end_at_us - now_us - ERROR_US
        island.end_at_us, island.free_at_us = NEVER_US, now_us + ERROR_US
        island.start_at_us = island.free_at_us

    def flood(self, number: int, frame: Frame | None, now_us: int) -> None:
        """From now on the node always has this frame to send; None: no longer. While no other node
        can win, the frames follow one another without an event each: they are counted, but not
        delivered. So use it only for frames of groups that no robot reads."""
        self._now_us = max(self._now_us, now_us)
        self._settle_all(now_us)
        node = self.nodes[number]
        if node.flood is not None:
            node.queue = [entry for entry in node.queue if entry[2] is not node.flood]
            heapify(node.queue)
            if not node.queue:
                self._waiting.discard(number)
        node.flood = frame
        if frame is not None:
            self.submit(number, frame, now_us)

    def settle(self, now_us: int) -> None:
        """Count the flood frames sent until now."""
        self._settle_all(now_us)

    def _settle_all(self, now_us: int) -> None:
        for island in self._islands:
            if island.train_period_us:
                self._settle(island, now_us)

    def _settle(self, island: Island, now_us: int) -> None:
        """The train ends with the frame on the wire; the next arbitration follows it."""
        ended = max(0, (now_us - island.begun_at_us) // island.train_period_us)
        node, length = self.nodes[island.sender], len(island.frame[1])
        node.sent += ended
        self.frames += ended
        group = island.frame[0] >> 8 & 0x3FFFF
        self.by_group[group] = self.by_group.get(group, 0) + ended
        self.busy_for_us += (ended + 1) * island.train_period_us
        self.worst_for_us += ended * WORST_BITS[length] * self.bit_us
        island.begun_at_us += ended * island.train_period_us
        island.end_at_us = island.begun_at_us + island.train_period_us
        island.train_period_us = 0
        self._next_known = False

    def partition(self, *islands: set[int]) -> None:
        """Cut the bus: the named nodes form these islands, all others stay in the first."""
        self._settle_all(self._now_us)
        while len(self._islands) < len(islands):
            self._islands.append(Island(len(self._islands)))
        for number, node in self.nodes.items():
            node.island = next((i for i, names in enumerate(islands) if number in names), 0)
        self._audience.clear()
        for number in self._waiting:  # waiting frames continue in the new island
            self._wish(self._islands[self.nodes[number].island], self._now_us)

    def heal(self) -> None:
        """Undo every cut and every one-way link."""
        self.partition()
        self.faults.deaf.clear()

    # ---------------------------------------------------------------- sending

    def submit(self, number: int, frame: Frame, now_us: int) -> bool:
        """Queue a frame. False if the queue is full of frames that are at least as urgent, or the
        node is off the bus. A more urgent frame displaces the least urgent one."""
        node = self.nodes.get(number)
        if node is None:
            return False
        if node.off_ends_at_us is not None:
            node.refused += 1
            return False
        if len(node.queue) >= QUEUE_MAX:
            node.refused += 1
            if not self._displace(node, frame):
                return False
        self._order += 1
        self._now_us = max(self._now_us, now_us)
        heappush(node.queue, (frame.identifier, self._order, frame))
        self._waiting.add(number)
        island = self._islands[node.island]
        self._wish(island, now_us)
        # On an idle wire the arbitration is decided immediately, and again if another node joins
        # before its bit time. With error faults it is decided at its bit time, with the random
        # draws in order.
        if island.start_at_us > now_us and self.faults.error == 0.0:
            self._arbitrate(island, island.start_at_us)
            self._next_known = False
        return True

    @staticmethod
    def _displace(node: Node, frame: Frame) -> bool:
        last = max(node.queue)
        if last[0] <= frame.identifier:
            return False
        node.queue.remove(last)
        heapify(node.queue)
        return True

    def _wish(self, island: Island, now_us: int) -> None:
        if island.train_period_us:
            if self._undisturbed(self.nodes[island.sender]) and not self._outranks(island):
                return
            self._settle(island, now_us)
        if island.end_at_us != NEVER_US:
            if island.begun_at_us <= now_us:
                return
            self._withdraw(island)
        start_at_us = (now_us // self.bit_us + 1) * self.bit_us
        if start_at_us < island.free_at_us:
            start_at_us = island.free_at_us
        if island.start_at_us == NEVER_US or start_at_us < island.start_at_us:
            island.start_at_us = start_at_us
            self._next_known = False

    def _outranks(self, island: Island) -> bool:
        """Whether another node has a frame that wins against the train."""
        best = self.nodes[island.sender].queue[0]
        return any(
            self.nodes[n].queue[0] < best
            for n in self._waiting
            if n != island.sender and self.nodes[n].island == island.number
        )

    def _withdraw(self, island: Island) -> None:
        """Cancel an arbitration that was decided before its bit time."""
        sends_for_us = island.end_at_us - island.begun_at_us
        self.busy_for_us -= sends_for_us
        self.worst_for_us -= WORST_BITS[len(island.frame[1])] * self.bit_us
        island.start_at_us, island.end_at_us = island.begun_at_us, NEVER_US

    @property
    def next_at_us(self) -> int | None:
        """When the next event occurs by itself."""
        if self._next_known:
            return self._next_at_us
        next_at_us = NEVER_US
        for island in self._islands:
            due_at_us = island.next_at_us
            if due_at_us != NEVER_US and (next_at_us == NEVER_US or due_at_us < next_at_us):
                next_at_us = due_at_us
        if self._off:
            back_at_us = min(self._off.values())
            next_at_us = back_at_us if next_at_us == NEVER_US else min(next_at_us, back_at_us)
        self._next_at_us, self._next_known = (None if next_at_us == NEVER_US else next_at_us), True
        return self._next_at_us

    def advance(self, now_us: int) -> list[Delivery]:
        """Process everything that ends until now, in order."""
        deliveries: list[Delivery] = []
        self._now_us = max(self._now_us, now_us)
        while (t_us := self.next_at_us) is not None and t_us <= now_us:
            self._next_known = False
            for island in self._islands:
                if NEVER_US < island.end_at_us <= t_us:
                    self._end(island, t_us, deliveries)
            if self._off:
                self._recover(t_us)
            for island in self._islands:
                if NEVER_US < island.start_at_us <= t_us and island.end_at_us == NEVER_US:
                    self._arbitrate(island, t_us)
        return deliveries

    def _recover(self, t_us: int) -> None:
        """Return nodes whose bus-off time is over."""
        for number in [n for n, end_at_us in self._off.items() if end_at_us <= t_us]:
            del self._off[number]
            node = self.nodes[number]
            node.off_ends_at_us, node.tec, node.rec, node.recovered_at_us = None, 0, 0, t_us

    def _arbitrate(self, island: Island, t_us: int) -> None:
        island.start_at_us = NEVER_US
        best: tuple[int, int, Frame] | None = None  # no two entries have the same order
        sender, later_at_us = -1, list[int]()
        for number in self._waiting:
            node = self.nodes[number]
            if node.island != island.number:
                continue
            if node.ready_at_us > t_us:
                later_at_us.append(node.ready_at_us)
                continue
            head = node.queue[0]
            if best is None or head < best:
                best, sender = head, number
        if best is None:
            if later_at_us:
                island.start_at_us = min(later_at_us)
            return
        frame = best[2]
        identifier, data = frame
        if frame.__class__ is OtherFrame:
            bits = frame.bits
        else:
            bits = frame_bits(identifier, data)
        self.worst_for_us += WORST_BITS[len(data)] * self.bit_us
        node = self.nodes[sender]
        if frame is node.flood and not later_at_us and self._undisturbed(node):
            island.begun_at_us, island.end_at_us, island.sender = t_us, ENDLESS_US, sender
            island.frame, island.broken = frame, False
            island.train_period_us = bits * self.bit_us
            return
        broken = self.faults.error > 0.0 and self._rng["error"].random() < self.faults.error
        if broken:  # at a random bit of the frame all nodes send an error flag
            sends_for_us = self._rng["error"].randrange(1, bits) * self.bit_us + ERROR_US
        else:
            sends_for_us = bits * self.bit_us
        self.busy_for_us += sends_for_us
        island.begun_at_us, island.end_at_us, island.sender = t_us, t_us + sends_for_us, sender
        island.frame, island.broken = frame, broken

    def _end(self, island: Island, t_us: int, deliveries: list[Delivery]) -> None:
        number, frame, broken = island.sender, island.frame, island.broken
        island.end_at_us, island.free_at_us = NEVER_US, t_us
        node = self.nodes[number]
        if node.tec > PASSIVE:
            node.ready_at_us = t_us + SUSPEND_US
        if broken:
            self.errors += 1
            self._punish(number, node, t_us)
        else:
            if node.tec:
                node.tec -= 1
            if self.errors:
                self._heal_receivers(number, node.island)
            node.sent += 1
            self.frames += 1
            if frame.__class__ is OtherFrame:
                self.others += 1
            else:
                group = frame[0] >> 8 & 0x3FFFF
                self.by_group[group] = self.by_group.get(group, 0) + 1
            repeated = (
                self.faults.duplicate > 0
                and self._rng["duplicate"].random() < self.faults.duplicate
            )
            if not repeated and node.queue and frame is not node.flood:
                self._drop_head(node, frame)
            if not node.queue:
                self._waiting.discard(number)
            deliveries.append(_tuple(Delivery, (t_us, frame, number, self._hearers(number))))
        for waiting in self._waiting:
            if self.nodes[waiting].island == island.number:
                island.start_at_us = t_us
                break

    def _undisturbed(self, node: Node) -> bool:
        """Whether only a newly submitted frame can change which node wins."""
        faults = self.faults
        return not (faults.error or faults.duplicate or self._off or node.tec > PASSIVE)

    @staticmethod
    def _drop_head(node: Node, frame: Frame) -> None:
        """Remove the sent frame from the queue; a more urgent one may have been queued meanwhile.

        The frame is no longer in the queue if the bus was cut while it was sent and the node has
        completed it in its new island.
        """
        if node.queue[0][2] is frame:
            heappop(node.queue)
            return
        held = []
        while node.queue and node.queue[0][2] is not frame:
            held.append(heappop(node.queue))
        if node.queue:
            heappop(node.queue)
        for entry in held:
            heappush(node.queue, entry)

    def _punish(self, number: int, node: Node, t_us: int) -> None:
        """A broken frame: ISO 11898-1 fault confinement, 8 for the sender and 1 for receivers."""
        for other in self.nodes.values():
            if other is not node and other.island == node.island:
                other.rec = min(other.rec + 1, PASSIVE + 1)
        node.tec += 8
        if node.tec >= BUS_OFF_TEC:
            self.bus_off(number, t_us + RECOVERY_US)

    def _heal_receivers(self, number: int, island: int) -> None:
        for other, node in self.nodes.items():
            if node.rec and other != number and node.island == island:
                node.rec -= 1

    def bus_off(self, number: int, end_at_us: int) -> None:
        """Force a node off the bus."""
        self._settle_all(self._now_us)
        node = self.nodes[number]
        node.tec, node.off_ends_at_us, node.flood = BUS_OFF_TEC, end_at_us, None
        self._off[number] = end_at_us
        self._next_known = False
        node.queue.clear()
        self._waiting.discard(number)

    def _hearers(self, sender: int) -> tuple[int, ...]:
        audience = self._audience.get(sender)
        if audience is None:
            island = self.nodes[sender].island
            audience = tuple(
                n for n, node in self.nodes.items() if n != sender and node.island == island
            )
            self._audience[sender] = audience
        faults = self.faults
        if self._off:  # a node in bus-off neither sends nor receives
            audience = tuple(n for n in audience if n not in self._off)
        if faults.deaf:
            audience = tuple(n for n in audience if (sender, n) not in faults.deaf)
        if faults.loss > 0.0:
            audience = self._lucky(audience, "loss", faults.loss)
        if faults.omission > 0.0:
            audience = self._lucky(audience, "omission", faults.omission)
        return audience

    def _lucky(self, audience: tuple[int, ...], kind: str, rate: float) -> tuple[int, ...]:
        chance = self._rng[kind].random
        return tuple(n for n in audience if chance() >= rate)
