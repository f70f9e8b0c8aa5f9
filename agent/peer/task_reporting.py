"""Reports this robot's work to a task controller of another maker that is on the bus (ISO 11783-10).

The session is `protocol/task_client.py`. This part counts what it is asked for. It obeys two settings:
a robot whose section is off drives on with the implement up, and one whose work is off stands.
"""

from collections.abc import Mapping, Sequence
from math import hypot
from typing import Any, Final

from agent.interface.config import S
from agent.interface.effects import Effect, Send, Trace
from agent.interface.identity import Identity
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from agent.peer.pgn_responder import PgnResponder
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.device_description import (
    CONDENSED_WORK_STATE,
    DEVICE,
    EFFECTIVE_DISTANCE,
    EFFECTIVE_TIME,
    FUNCTION,
    INEFFECTIVE_TIME,
    SECTION_CONTROL_STATE,
    SETPOINT_CONDENSED,
    SETPOINT_WORK_STATE,
    SPEED,
    TOTAL_AREA,
    WORK_STATE,
    DeviceDescription,
)
from protocol.frames.network_frames import Acknowledgment, AcknowledgmentControl
from protocol.frames.task_frames import PROCESS_DATA, ProcessData, WorkingSetMaster
from protocol.task_client import (
    JoinWorkingSet,
    SessionOutput,
    SessionState,
    TaskClient,
)

SECTIONS_ABSENT: Final = 0xFFFF_FFFC  # two bits each: sections 2 to 16 do not exist
SET_AT_FIRST: Final = {  # before a task controller sets them: manual, and everything is on
    (FUNCTION, SECTION_CONTROL_STATE): 0,
    (FUNCTION, SETPOINT_WORK_STATE): 1,
    (FUNCTION, SETPOINT_CONDENSED): SECTIONS_ABSENT + 1 - (1 << 32),
}
STEP_MAX_S: Final = 1.0  # a longer time without a reading is not counted as a way


class TaskReporting(Part):
    """The part that logs in at a task controller and tells it values."""

    def __init__(self, identity: Identity, letters: PgnResponder, safety: StopController) -> None:
        self.letters, self.safety = letters, safety
        self.client = TaskClient(
            DeviceDescription(
                identity.name,
                f"robot {identity.slot}",
                identity.release,
                identity.implement_width_mm,
            )
        )
        self._takes_part = identity.diagnostics
        self._width_mm = identity.implement_width_mm
        self.at_work = False  # the implement is down
        self._raised = False  # as we have said last: our section is off
        self._counted_at_us: int | None = None
        self._work_for_us = self._rest_for_us = 0
        self._distance_mm = 0.0

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {ProcessData: self._process_data, Acknowledgment: self._acknowledged}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.ImplementLowered: self._implement, notices.AddressLost: self._away}

    @property
    def due_at_us(self) -> int:
        due_at_us = self.client.due_at_us
        return FOREVER_US if due_at_us is None else due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        if self.client.state is SessionState.WAITING:
            self._counted_at_us = None
            return self._obey(ctx.now_us) if self.safety.holds(StopCause.WORK_OFF) else NOTHING
        if ctx.now_us < self.due_at_us and self.client.state is not SessionState.CONNECTED:
            return NOTHING
        self._count(ctx)
        said = self.client.on_timer(self.values(ctx), ctx.now_us)
        return [*self._sends(said, ctx.now_us), *self._obey(ctx.now_us)]

    def values(self, ctx: StepContext) -> dict[tuple[int, int], int]:
        """What a task controller may ask for, by element and DDI, in the units of ISO 11783-11."""
        here = ctx.here
        speed_m_s = 0.0 if here is None else hypot(here.vx_m_s, here.vy_m_s)
        sections = SECTIONS_ABSENT | self.at_work
        return {
            (DEVICE, SPEED): round(1000 * speed_m_s),
            (FUNCTION, WORK_STATE): int(self.at_work),
            (FUNCTION, CONDENSED_WORK_STATE): sections - (1 << 32),  # as a signed number
            **SET_AT_FIRST,
            (FUNCTION, TOTAL_AREA): int(self._distance_mm / 1000 * self._width_mm / 1000),
            (FUNCTION, EFFECTIVE_DISTANCE): int(self._distance_mm),
            (FUNCTION, EFFECTIVE_TIME): self._work_for_us // S,
            (FUNCTION, INEFFECTIVE_TIME): self._rest_for_us // S,
            **self.client.setpoints,
        }

    def _count(self, ctx: StepContext) -> None:
        """Add time and way since the last count; the totals begin with the session."""
        before_at_us, self._counted_at_us = self._counted_at_us, ctx.now_us
        if before_at_us is None:
            return
        if not self.at_work:
            self._rest_for_us += ctx.now_us - before_at_us
            return
        self._work_for_us += ctx.now_us - before_at_us
        step_for_s = (ctx.now_us - before_at_us) / 1e6
        if ctx.here is not None and step_for_s <= STEP_MAX_S:
            self._distance_mm += 1000 * hypot(ctx.here.vx_m_s, ctx.here.vy_m_s) * step_for_s

    def _process_data(self, ctx: StepContext, header: Header, m: ProcessData) -> Outputs:
        if not ctx.joined or not self._takes_part:
            return NOTHING
        self._count(ctx)
        said = self.client.on_message(header.source, m.body, self.values(ctx), ctx.now_us)
        return [*self._sends(said, ctx.now_us), *self._obey(ctx.now_us)]

    def _acknowledged(self, ctx: StepContext, header: Header, m: Acknowledgment) -> Outputs:
        ours = ctx.joined and m.address == self.letters.joining.address
        if not ours or m.pgn != PROCESS_DATA.pgn or m.control != AcknowledgmentControl.NACK:
            return NOTHING
        self.client.refused(header.source)
        return self._obey(ctx.now_us)

    def raises_implement(self) -> bool:
        """Whether the implement is to be up, because a task controller has switched our section off."""
        return self.client.section_off

    def _obey(self, now_us: int) -> list[Effect]:
        """Stand while the work is off; say what a task controller has switched."""
        client, outputs = self.client, list[Effect]()
        if client.work_off is not self.safety.holds(StopCause.WORK_OFF):
            if client.work_off:
                where = f"address {client.server}"
                self.safety.raise_cause(StopCause.WORK_OFF, now_us, where)
                outputs.append(Trace("task controller", "", "WORK_OFF", "", where))
            else:
                self.safety.clear_cause(StopCause.WORK_OFF, now_us)
                outputs.append(Trace("task controller", "", "WORK_ON", "", ""))
        if client.section_off is not self._raised:
            self._raised = client.section_off
            event = "SECTION_OFF" if self._raised else "SECTION_ON"
            outputs.append(Trace("task controller", "", event, "", "section 1"))
        return outputs

    def _implement(self, ctx: StepContext, notice: notices.ImplementLowered) -> Outputs:
        self._count(ctx)
        self.at_work = notice.down
        if self.client.state is not SessionState.CONNECTED:
            return NOTHING
        return self._sends(self.client.changed(self.values(ctx), ctx.now_us), ctx.now_us)

    def _away(self, ctx: StepContext, notice: notices.AddressLost) -> Outputs:
        self.client.reset()
        return self._obey(ctx.now_us)

    def _sends(self, said: Sequence[SessionOutput], now_us: int) -> list[Effect]:
        effects: list[Effect] = []
        for each in said:
            if isinstance(each, JoinWorkingSet):
                effects.append(Send(WorkingSetMaster(1)))
            elif self.client.server is None:
                continue
            elif len(each.data) == PROCESS_DATA.length:
                effects.append(Send(ProcessData(each.data), self.client.server))
            else:
                effects += self.letters.sends(
                    PROCESS_DATA.pgn, each.data, self.client.server, now_us
                )
        return effects
