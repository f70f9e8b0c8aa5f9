"""Exchanges the fleet's map with the other members, if the mission makes one."""

from collections.abc import Mapping
from typing import Any

from agent.interface.effects import Persist, Send
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.durable_records import DurableRecords
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.sync.map_sync import MapSync


class MapExchange(Part):
    """The part that passes map frames to the map's synchronisation, and sends its frames."""

    def __init__(self, chart: MapSync | None, joining: NetworkJoin) -> None:
        """`chart`: None if the fleet has no map; then frames about it are ignored."""
        self.chart, self.joining = chart, joining

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
        """Announce patches, persisted first so that our observations survive a restart."""
        if self.chart is None or not ctx.joined:
            return NOTHING
        outputs: list[Any] = []
        for message in self.chart.on_tick(ctx.now_us):
            if isinstance(message, MapPatch):
                outputs.append(Persist(*DurableRecords.patch(self.chart.chart, message.patch)))
            outputs.append(Send(message))
        return outputs

    def _map(self, ctx: StepContext, header: Header, m: Any) -> Outputs:
        if self.chart is not None and header.slot is not None:
            self.chart.on_message(header.slot, m, ctx.now_us)
        return NOTHING

    def _members(self, ctx: StepContext, notice: notices.MembershipChanged) -> Outputs:
        if self.chart is not None:
            self.chart.live(notice.live)
        return NOTHING
