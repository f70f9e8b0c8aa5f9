"""A gateway's part in the map: it keeps one map equal on its bus and on the backbone.

On its bus the gateway takes part in the robots' anti-entropy like a robot. On the backbone the
leading gateways run the same protocol (`protocol/sync/map_sync.py`) with each other. Data learned
on one side makes the digests of the other side differ and is then sent there. So patches and
digests cross by anti-entropy alone, and after a network cut only the changes are sent.

Segments that share a map share its geometry. An observer has five bits. So robots of two segments
with the same slot count as one observer, which trusts the data of the other as its own.
"""

from typing import Any

from agent.interface.config import FRAME_US, S
from agent.segments.token_bucket import TokenBucket
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import Geometry, OccupancyMap
from crdt.sighting import TIME_MAX, MergeOrder
from protocol.backbone_messages import Entry
from protocol.frames.codec import packed
from protocol.frames.layout import FrameLayout
from protocol.frames.map_frames import MAP_DIGESTS, MAP_PATCH, MapPatch
from protocol.frames.segment_frames import GATEWAY_SLOT
from protocol.sync.map_sync import MapSync, Said

PATCH, DIGESTS = 3, 4  # kinds of entries on the backbone
LAYOUTS: dict[int, FrameLayout[Any]] = {PATCH: MAP_PATCH, DIGESTS: MAP_DIGESTS}


class MapRelay:
    """The map as a gateway knows it, exchanged on its bus and on the backbone."""

    def __init__(self, segment: int, geometry: Geometry, order: MergeOrder, now_us: int) -> None:
        """`segment`: our number, which is our slot on the backbone. `geometry`, `order`: of the
        shared map.
        """
        self.segment = segment
        self.chart = OccupancyMap(geometry, order)
        clock = HybridClock(now_us, S, TIME_MAX)
        self.near = MapSync(GATEWAY_SLOT, self.chart, clock, now_us)
        self.far = MapSync(segment, self.chart, clock, now_us)
        self.refused = 0  # entries that are no frame of a map

    def observe(self, robots: frozenset[int], segments: frozenset[int]) -> None:
        """The slots of robots and the numbers of segments that are received now."""
        self.near.live(robots)
        self.far.live(segments)

    @property
    def digest(self) -> int:
        """32 bits of the digest of the whole map."""
        return self.chart.digest & 0xFFFF_FFFF

    def on_message(self, slot: int, message: Said, now_us: int) -> None:
        """A frame of the map from our own bus, sent by the robot or gateway `slot`."""
        self.near.on_message(slot, message, now_us)

    def on_entry(self, segment: int, entry: Entry, now_us: int) -> None:
        """An entry from another segment's gateway. One that is no frame of a map is counted in
        `refused`.
        """
        layout = LAYOUTS.get(entry.kind)
        try:
            message = None if layout is None else layout.unpack(entry.data)
        except ValueError:
            message = None
        if message is None:
            self.refused += 1
        else:
            self.far.on_message(segment, message, now_us)

    @property
    def due_at_us(self) -> int:
        """When `on_tick` has something to do next."""
        return min(self.near.due_at_us, self.far.due_at_us)

    def on_tick(self, limit: TokenBucket, now_us: int) -> tuple[list[Said], list[Entry]]:
        """The frames for our bus, as far as `limit` allows, and the entries for the backbone."""
        near: list[Said] = []
        if self.near.due_at_us <= now_us and limit.take(FRAME_US, now_us):
            near = self.near.on_tick(now_us)
        far = self.far.on_tick(now_us) if self.far.due_at_us <= now_us else []
        told = [
            Entry(PATCH if isinstance(m, MapPatch) else DIGESTS, self.segment, 0, 0, 0, packed(m))
            for m in far
        ]
        return near, told
