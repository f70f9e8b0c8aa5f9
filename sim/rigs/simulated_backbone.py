"""A backbone for segments in one event loop: delay, cuts, one-way links, duplicates, loss.

Messages of one sender to one receiver keep their order, as with Zenoh at one priority.
"""

from collections.abc import Callable
from random import Random

from agent.segments.gateway import Publish
from protocol.backbone_messages import BackboneKind
from sim.fleet.event_loop import EventLoop

DELAY_US = (300, 3_000)  # from end to end; Zenoh over one switch takes 0.3 to 1 ms
URGENT = (BackboneKind.STOPS, BackboneKind.RESETS)


class SimulatedBackbone:
    """Carries messages between gateways in virtual time, with the faults that are set."""

    def __init__(self, event_loop: EventLoop, seed: int | str) -> None:
        self.event_loop = event_loop
        self.nodes: list[BackboneNode] = []
        self.deaf: set[tuple[int, int]] = set()  # (from segment, to segment): nothing arrives
        self.loss = self.duplicate = 0.0
        self.messages = self.bytes = 0
        self._rng = Random(f"{seed}/backbone")

    def attach(self, segment: int) -> "BackboneNode":
        """Connect another gateway of a segment."""
        node = BackboneNode(self, segment)
        self.nodes.append(node)
        return node

    def cut(self, *islands: set[int]) -> None:
        """Segments of different islands do not receive each other."""
        island_of = {segment: k for k, island in enumerate(islands) for segment in island}
        segments = {node.segment for node in self.nodes}
        self.deaf = {
            (a, b) for a in segments for b in segments if island_of.get(a) != island_of.get(b)
        }

    def heal(self) -> None:
        """Undo every cut and every one-way link."""
        self.deaf = set()

    def carry(self, sender: "BackboneNode", message: Publish) -> None:
        """Deliver a message to every other open node that it is meant for, unless a fault takes it."""
        for node in self.nodes:
            if node is sender or not node.open or message.target not in (0, node.segment):
                continue
            self.messages += 1
            self.bytes += len(message.data)
            if (sender.segment, node.segment) in self.deaf or self._chance(self.loss):
                continue
            for _ in range(1 + self._chance(self.duplicate)):
                self._deliver(sender, node, message)

    def _chance(self, rate: float) -> bool:
        return rate > 0.0 and self._rng.random() < rate

    def _deliver(self, sender: "BackboneNode", node: "BackboneNode", message: Publish) -> None:
        at_us = self.event_loop.now_us() + self._rng.randint(*DELAY_US)
        lane = id(sender), message.kind in URGENT
        at_us = node.last_at_us[lane] = max(at_us, node.last_at_us.get(lane, 0))
        self.event_loop.at(at_us, lambda: node.hear(message.data))


class BackboneNode:
    """One gateway's end of the backbone."""

    def __init__(self, backbone: SimulatedBackbone, segment: int) -> None:
        self.backbone, self.segment, self.open = backbone, segment, True
        self.last_at_us: dict[tuple[int, bool], int] = {}
        self._callback: Callable[[bytes], None] | None = None

    def publish(self, message: Publish) -> None:
        """Send a message to the other gateways."""
        self.backbone.carry(self, message)

    def subscribe(self, callback: Callable[[bytes], None]) -> None:
        """Call `callback` with the bytes of each message from now on."""
        self._callback = callback

    def hear(self, data: bytes) -> None:
        """Take a message, if the node is open and somebody has subscribed."""
        if self.open and self._callback is not None:
            self._callback(data)

    def close(self) -> None:
        """Send and receive nothing more."""
        self.open = False
