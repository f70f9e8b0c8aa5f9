"""The map on the wire: new observations when they are made, and anti-entropy that makes all maps
equal bit for bit.

A new observation joins this robot's map when it is sent, not before. Lost frames are found by
digests. Every peer sends the digests of the 16 largest squares once a beat. A peer that differs in
one answers with the digests of its 16 parts, down to a tile, where both sides send the patches that
differ. A digest has 3 bits and a salt that changes with each beat, so a difference hidden by a
collision shows in the next one. A record that was on the bus a short time ago is not sent again by
any peer, because all peers of a segment have received it.

Map frames of the whole fleet stay below a share of the bus without a schedule. A peer that receives
one leaves a gap; then peers send in the cyclic order of slots after the last sender.
"""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from crdt.hybrid_clock import HybridClock
from crdt.occupancy import CELLS, FANOUT, MergeResult, OccupancyMap, mix
from crdt.sighting import RECORD_MASK, TIME_MAX, UNKNOWN, VALUE
from protocol.frames.map_frames import DIGEST_BITS, FIRST_NODES, SALTS, MapDigests, MapPatch
from protocol.units import FRAME_US, MS

NEWS_SHARE = 0.10  # of the bus: with digests and repairs a fleet stays below the mission's 15 %
# After a split or a join, for as long as it takes; as in `protocol/sync/synchronizer.py`.
REPAIR_SHARE = 0.30
NEWS_GAP_US = round(FRAME_US / NEWS_SHARE)
REPAIR_GAP_US = round(FRAME_US / REPAIR_SHARE)
SLOT_US = 700  # step of the sending order: a frame plus a margin
BEAT_US = 62_500  # between two digests of the whole map, by any sender: 1 % of the bus
ALONE_US = 1_000 * MS  # the same if no listener is known
SETTLE_US = 100 * MS  # younger changes may still be on their way to others
# Records this young on the bus are not sent again: a question may be older than they are.
FRESH_US = 100 * MS
AGAIN_US = 100 * MS  # between two digests of one square by one peer
AIRED_MAX = 256  # digests remembered: more than are sent in that time
ALL = np.ones(CELLS, dtype=np.bool_)
POWERS = 3 ** np.arange(CELLS, dtype=np.int64)

Said = MapPatch | MapDigests
Values = NDArray[np.int64]
Mask = NDArray[np.bool_]


def encode_cells(values: Values) -> int:
    """16 values, shape (16,), as digits to the base 3, the lowest first."""
    return int(values @ POWERS)


def decode_cells(cells: int) -> Values:
    """The 16 values, shape (16,), of such a number."""
    digits: Values = cells // POWERS % 3
    return digits


class MapSync:
    """Keeps one robot's map equal to those of the fleet: decides what to send, and when.

    It has no clock and no bus: the caller passes received frames in and sends what `on_tick` returns.
    """

    hold_for_us = 400 * MS  # a patch waits this long for the rest of its cells before it is sent

    def __init__(self, slot: int, chart: OccupancyMap, clock: HybridClock, now_us: int) -> None:
        self.slot, self.chart, self.clock = slot, chart, clock
        self.counts: Counter[str] = Counter()
        self._order: list[int] = [slot]  # live slots
        self._news: dict[tuple[int, int], Values] = {}  # (patch, level) -> what we observed
        self._digests: dict[int, int] = {}  # node -> salt, to send
        self._repairs: dict[int, Mask] = {}  # patch -> cells to send
        self._heard_at_us: dict[MapDigests, int] = {}  # digests recently on the bus; oldest first
        self._said_at_us: dict[int, int] = {}  # node -> when we sent its digests
        # When each of our records was last on the bus.
        self._aired_at_us = np.full((chart.patches, CELLS), -FRESH_US, dtype=np.int64)
        self._recent: dict[int, None] = {}  # tiles that changed since we sent their digests
        self._changed_at_us = np.full(chart.patches, -SETTLE_US, dtype=np.int64)
        # Last map frame on the bus; our position in the order after it.
        self._last_digest_at_us, self._turn = now_us, 0
        self._own_at_us = now_us  # our own last one
        self._beats = 0
        self._beat_at_us = now_us + BEAT_US * (slot + 1)
        self._merged: Counter[int] = Counter()  # slot -> cells it has sent us since `merged`
        self.root = FIRST_NODES[int(np.log2(chart.patches)) // 4 - 1]

    # ---------------------------------------------------------------- here

    def recalled(self, now_us: int) -> None:
        """The map was read from a disk: advance our clock so that it is not behind the map."""
        times = self.chart.keys() >> 11 & TIME_MAX
        self.clock.witness(int(times.max(initial=0)), now_us)

    def live(self, slots: frozenset[int]) -> None:
        """The members that are received now; a new one is compared with immediately."""
        if not slots <= set(self._order):  # a new member: compare immediately
            self._beat_at_us = self._last_digest_at_us
        self._order = sorted(slots | {self.slot})

    def see(self, patch: int, values: Values, level: int) -> None:
        """Store an observation that the fleet's map lacks, to be sent when it is our turn.

        `values` are the 16 cells of the patch row by row, shape (16,), UNKNOWN for what was not
        seen; `level` is the confidence of all of them.
        """
        known = self._news.get((patch, level))
        self._news[patch, level] = values if known is None else np.where(values, values, known)

    @property
    def pending(self) -> int:
        """Number of patches observed and not sent yet."""
        return len(self._news)

    def merged(self, now_us: int) -> MergeResult:
        """What other robots have sent since the last call."""
        result = MergeResult(sum(self._merged.values()), len(self._merged), now_us)
        self._merged.clear()
        return result

    # ---------------------------------------------------------------- receiving

    def on_message(self, slot: int, message: Said, now_us: int) -> int:
        """Handle any map frame of the member `slot`; returns the number of changed cells."""
        self._floor_taken(slot, now_us)
        if isinstance(message, MapPatch):
            return self._patch(slot, message, now_us)
        if message.node == self.root:  # senders take turns, as with all map frames
            self._beat_at_us = now_us + BEAT_US * (self._turn + 1)
        self._note(message, now_us)
        self._compare(message, now_us)
        return 0

    def _patch(self, slot: int, m: MapPatch, now_us: int) -> int:
        time = self.chart.time_of(m.level, m.time, self.clock.read(now_us))
        self.clock.witness(time, now_us)
        values = decode_cells(m.cells)
        changed = self.chart.apply(m.patch, values, m.level, time, m.observer)
        if changed:
            self._merged[slot] += changed
            self._recent[m.patch // FANOUT] = None
            if m.observer == slot:  # a new observation: other robots may receive it a little later
                self._changed_at_us[m.patch] = now_us
        if m.patch < self.chart.patches:
            better = self._air(m, values, now_us)
            if better.any():  # the sender lacks something
                self._repair(m.patch, better)
        return changed

    def _air(self, m: MapPatch, values: Values, now_us: int) -> Mask:
        """Note a frame with records on the bus; return its cells of which our record is newer."""
        keys = self.chart.patch(m.patch)
        told = (m.time << 9 | m.level << 5 | m.observer) << 2 | values
        said, same = values != UNKNOWN, (keys & RECORD_MASK) == told
        self._aired_at_us[m.patch][said & same] = now_us
        if m.patch in self._repairs:
            self._repairs[m.patch] = self._repairs[m.patch] & ~(said & same)
        better: Mask = said & ~same & (keys > 0)
        return better

    def _repair(self, patch: int, cells: Mask) -> None:
        known = self._repairs.get(patch)
        self._repairs[patch] = cells if known is None else known | cells

    def _compare(self, m: MapDigests, now_us: int) -> None:
        size = next(k for k in (3, 2, 1, 0) if m.node >= FIRST_NODES[k])
        index, width = m.node - FIRST_NODES[size], FANOUT**size
        if (index + 1) * FANOUT * width > self.chart.patches:
            return  # a square of a larger map than ours
        ours = self._digest(m.node, m.salt)
        first = index * FANOUT
        differing = [
            first + k
            for k in range(FANOUT)
            if ours.digests[k] != m.digests[k] and self._settled(first + k, width, now_us)
        ]
        if not differing:
            return
        if size == 0:
            self._queue(m.node, m.salt, now_us)  # the other side needs our digests
            for patch in differing:
                self._repair(patch, ALL)
        else:
            for child in differing:
                self._queue(FIRST_NODES[size - 1] + child, m.salt, now_us)

    def _settled(self, square: int, width: int, now_us: int) -> bool:
        changed_at_us = self._changed_at_us[square * width : (square + 1) * width]
        return int(changed_at_us.max()) <= now_us - SETTLE_US

    def _queue(self, node: int, salt: int, now_us: int) -> None:
        """Queue our digests of a square, rarely: they change while records are being sent."""
        if self._said_at_us.get(node, -AGAIN_US) + AGAIN_US <= now_us:
            self._digests[node] = salt

    def _digest(self, node: int, salt: int) -> MapDigests:
        size = next(k for k in (3, 2, 1, 0) if node >= FIRST_NODES[k])
        width = FANOUT ** (size + 1)
        first = (node - FIRST_NODES[size]) * width
        sums = self.chart.sums()[first : first + width].reshape(FANOUT, -1).sum(axis=1)
        short = mix(sums.astype(np.uint64) + np.uint64(salt)) >> np.uint64(64 - DIGEST_BITS)
        return MapDigests(node, salt, tuple(short.tolist()))

    # ---------------------------------------------------------------- saying

    def _note(self, message: MapDigests, now_us: int) -> None:
        self._heard_at_us.pop(message, None)
        self._heard_at_us[message] = now_us
        if len(self._heard_at_us) > AIRED_MAX:
            del self._heard_at_us[next(iter(self._heard_at_us))]

    def _floor_taken(self, slot: int, now_us: int) -> None:
        """A peer has sent: those behind it in the cyclic order go first."""
        order = self._order
        last = next((k for k, member in enumerate(order) if member >= slot), 0)
        self._last_digest_at_us = now_us
        self._turn = (order.index(self.slot) - last - 1) % len(order)

    def _turn_at_us(self, quiet_for_us: int) -> int:
        return self._last_digest_at_us + quiet_for_us + self._turn * SLOT_US

    @property
    def _news_at_us(self) -> int:
        """When we may send observations: repairs by others delay us by one round of turns at
        most."""
        turn_at_us = max(
            self._own_at_us + len(self._order) * NEWS_GAP_US, self._turn_at_us(REPAIR_GAP_US)
        )
        return min(self._turn_at_us(NEWS_GAP_US), turn_at_us)

    @property
    def due_at_us(self) -> int:
        """When `on_tick` next has something to send, if nothing is received before."""
        due_at_us = self._beat_at_us
        if self._news:
            due_at_us = min(due_at_us, self._news_at_us)
        if self._digests or self._repairs:
            due_at_us = min(due_at_us, self._turn_at_us(REPAIR_GAP_US))
        return due_at_us

    def on_tick(self, now_us: int) -> list[Said]:
        """The frames to send now: one at most."""
        if now_us >= self._beat_at_us:
            alone = len(self._order) == 1
            self._beat_at_us = now_us + (ALONE_US if alone else BEAT_US * len(self._order))
            self._beats += 1
            salt = (
                self._beats + self.slot
            ) % SALTS  # so that peers differ in the salt they use at a time
            if self._recent:  # frames may have been lost where something changed recently
                tile = next(iter(self._recent))
                del self._recent[tile]
                self._queue(tile, (salt + SALTS // 2) % SALTS, now_us)
            return self._say(self._digest(self.root, salt), now_us)
        if self._news and now_us >= self._news_at_us:
            self.counts["news"] += 1
            return self._say(self._next_news(now_us), now_us)
        if (self._digests or self._repairs) and now_us >= self._turn_at_us(REPAIR_GAP_US):
            return self._say(self._next_repair(now_us), now_us)
        return []

    def _say(self, message: Said | None, now_us: int) -> list[Said]:
        if message is None:
            return []
        self.counts["digests" if isinstance(message, MapDigests) else "patches"] += 1
        if isinstance(message, MapPatch):
            self._air(message, decode_cells(message.cells), now_us)
        else:
            self._note(message, now_us)
        self._own_at_us = now_us
        self._floor_taken(self.slot, now_us)
        return [message]

    def _next_news(self, now_us: int) -> MapPatch | None:
        """The oldest of our observations, without cells that are known better by now."""
        while self._news:
            (patch, level), values = next(iter(self._news.items()))
            del self._news[patch, level]
            time = self.clock.read(now_us)
            before = self.chart.patch(patch)
            if not self.chart.apply(patch, values, level, time, self.slot):
                continue
            self._changed_at_us[patch] = now_us
            self._recent[patch // FANOUT] = None
            values = np.where(self.chart.patch(patch) > before, values, UNKNOWN)
            level, stamp = self.chart.stamp(level, time)
            return MapPatch(patch, stamp, level, self.slot, encode_cells(values))
        return None

    def _next_repair(self, now_us: int) -> Said | None:
        while self._repairs:
            patch, cells = next(iter(self._repairs.items()))
            message = self._record(patch, cells & (self._aired_at_us[patch] <= now_us - FRESH_US))
            if message is not None:
                return message  # the patch stays in the queue for its other records
            del self._repairs[patch]
        while self._digests:
            node, salt = self._digests.popitem()
            digest = self._digest(node, salt)
            if self._heard_at_us.get(digest, now_us - FRESH_US) <= now_us - FRESH_US:
                self._said_at_us[node] = now_us
                return digest
        return None

    def _record(self, patch: int, cells: Mask) -> MapPatch | None:
        """The newest of our records of some cells, with all cells of the same time and observer."""
        keys = self.chart.patch(patch)
        stamps = np.where(keys > 0, (keys & RECORD_MASK) >> 2, -1)
        wanted = stamps[cells]
        stamp = int(wanted.max(initial=-1))
        if stamp < 0:
            return None
        values = np.where(stamps == stamp, keys & VALUE, UNKNOWN)
        return MapPatch(patch, stamp >> 9, stamp >> 5 & 15, stamp & 31, encode_cells(values))
