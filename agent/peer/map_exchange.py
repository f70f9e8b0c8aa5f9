"""Exchanges the fleet's map with the other members, if the mission makes one."""

from collections.abc import Mapping
from typing import Any

from agent.interface.config import S
from agent.interface.effects import Persist, Send
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.durable_records import DurableRecords
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from crdt.passing_map import PassingMap
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.sync.map_sync import MapSync

KEPT_US = (
    2 * S
)  # between two writes of what others have seen: one write to the disk for many patches
KEPT_MAX = 256  # patches in one of them, of 48 bytes: a tenth of a full bus, and about 5 ms of work


class MapExchange(Part):
    """The part that passes map frames to the map's synchronisation, and sends its frames."""

    def __init__(self, chart: MapSync | None, joining: NetworkJoin) -> None:
        """`chart`: None if the fleet has no map; then frames about it are ignored."""
        self.chart, self.joining = chart, joining
        # Patches that others have changed since we wrote them down; the oldest first. What passes is not
        # worth it: it is out of date after a restart.
        self._told: dict[int, None] = {}
        self._lasts = chart is not None and not isinstance(chart.chart, PassingMap)
        self._kept_at_us = 0

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {MapPatch: self._map, MapDigests: self._map}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.MembershipChanged: self._members}

    @property
    def due_at_us(self) -> int:
        joined = self.joining.joined
        return FOREVER_US if self.chart is None or not joined else self.chart.due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        """Announce patches, persisted first so that our observations survive a restart. From time to time
        persist what others have seen, too: they may be gone by then.
        """
        if self.chart is None or not ctx.joined:
            return NOTHING
        outputs: list[Any] = []
        if self._told and not 0 <= ctx.now_us - self._kept_at_us < KEPT_US:
            self._kept_at_us = ctx.now_us
            for patch in list(self._told)[:KEPT_MAX]:
                outputs.append(Persist(*DurableRecords.patch(self.chart.chart, patch)))
                del self._told[patch]
        for message in self.chart.on_tick(ctx.now_us):
            if isinstance(message, MapPatch):
                outputs.append(Persist(*DurableRecords.patch(self.chart.chart, message.patch)))
                self._told.pop(message.patch, None)
            outputs.append(Send(message))
        return outputs

    def _map(self, ctx: StepContext, header: Header, m: Any) -> Outputs:
        if self.chart is not None and header.slot is not None:
            changed = self.chart.on_message(header.slot, m, ctx.now_us)
            if changed and self._lasts:  # digests change nothing
                self._told[m.patch] = None
        return NOTHING

    def _members(self, ctx: StepContext, notice: notices.MembershipChanged) -> Outputs:
        if self.chart is not None:
            self.chart.live(notice.live)
        return NOTHING
