"""How this robot leaves its fleet: it stands first, because nobody believes the farewell of a moving one.

A farewell disarms the silence rule of the others. So a member whose newest beacon shows it in motion
is not believed (`agent/peer/membership.py`), and a robot sends the beacon of its standstill before
its farewell.
"""

from collections.abc import Mapping
from math import hypot
from typing import Any

from agent.interface.config import FAREWELL_SPEED_M_S
from agent.interface.effects import HALT
from agent.peer import inputs, notices
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController


class Departure(Part):
    """The part that brakes this robot for its farewell, and sends the farewell when it stands."""

    def __init__(self, safety: StopController) -> None:
        self.safety = safety
        self.leaving = False  # braking; the farewell follows

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {inputs.Leave: self._leave, notices.BeatDue: self._beat}

    def _leave(self, ctx: StepContext, call: inputs.Leave) -> Outputs:
        """Leave at once if we stand or send no beacons, or if we are told a second time."""
        begun = [HALT, notices.WorkGivenBack()]
        if self.leaving or not ctx.joined or _stands(ctx):
            return [*begun, *self._left()]
        self.leaving = True
        self._brake(ctx)
        return begun

    def _beat(self, ctx: StepContext, notice: notices.BeatDue) -> Outputs:
        if not self.leaving:
            return NOTHING
        if _stands(ctx):
            return self._left()
        self._brake(ctx)  # also after a start that came meanwhile
        return NOTHING

    def _brake(self, ctx: StepContext) -> None:
        self.safety.raise_cause(StopCause.NOT_STARTED, ctx.now_us, "it leaves the fleet")

    def _left(self) -> Outputs:
        self.leaving = False
        return [notices.Leaving(), notices.Left()]


def _stands(ctx: StepContext) -> bool:
    """A robot that was never told its place has no motion that a beacon could show."""
    here = ctx.here
    return here is None or hypot(here.vx_m_s, here.vy_m_s) <= FAREWELL_SPEED_M_S / 2
