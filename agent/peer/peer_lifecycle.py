"""The lifecycle of one peer: its current state, moved by the table of `agent/interface/lifecycle.py`."""

from collections.abc import Mapping
from typing import Any

from agent.interface.effects import Trace
from agent.interface.lifecycle import TABLE, Event, State
from agent.peer import notices
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from agent.safety.stop_controller import StopController
from protocol.state_machine import StateMachine


class PeerLifecycle(Part):
    """The part that holds the lifecycle state and moves it when notices say so."""

    def __init__(self, safety: StopController) -> None:
        self.safety = safety
        self.machine = StateMachine("lifecycle", TABLE, State.DISCONNECTED)

    @property
    def state(self) -> State:
        """The current lifecycle state."""
        return self.machine.state

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.Latched: self._latched,
            notices.FleetJoined: self._joined,
            notices.AddressLost: lambda ctx, n: self.fire(Event.BUS_LOST, "lost the address"),
            notices.BusLost: lambda ctx, n: self.fire(Event.BUS_LOST, "bus-off"),
            notices.WasReset: lambda ctx, n: self.fire(
                Event.MANUAL_RESET, "a person at this machine"
            ),
            notices.Left: lambda ctx, n: self.fire(Event.LEFT, "leaving"),
            notices.SyncDiffers: lambda ctx, n: self.fire(Event.SYNC_RECEIVED, "digests differ"),
            notices.SyncAgrees: lambda ctx, n: self.fire(Event.SYNC_COMPLETE, "in step"),
        }

    def fire(self, event: Event, why: str) -> Outputs:
        """Move by the table. The trace of the move; nothing where the table ignores the event."""
        source, target = self.machine.fire(event)
        if source is target:
            return NOTHING
        return [Trace("lifecycle", source.name, event.name, target.name, why)]

    def _latched(self, ctx: StepContext, notice: notices.Latched) -> Outputs:
        return self.fire(Event.EMERGENCY, notice.why) if self.safety.latched else NOTHING

    def _joined(self, ctx: StepContext, notice: notices.FleetJoined) -> Outputs:
        return self.fire(Event.FLEET_JOINED, f"address {notice.address}")
