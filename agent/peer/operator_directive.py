"""An operator's orders to this robot: what to do instead of its work, or about an obstacle.

GO_HOME and SET_GOAL: the robot releases its work, drives to where it was switched on or to the given
place, and stays there until START, CONTINUE or REPLAN. After a restart meanwhile it stands until a start:
an operator sent it there for a reason. STOP: it releases its work and stands still
until START. WAIT, CONTINUE and REPLAN answer its question (`agent/motion/obstacle_stop.py`).
"""

from collections.abc import Mapping
from math import hypot
from typing import Any

from agent.interface.config import S
from agent.interface.effects import HALT, Effect, Persist, Send, Trace
from agent.interface.geometry import Point
from agent.interface.mission import STILL, THERE_M, FleetView, Mission, MotionRequest
from agent.peer import inputs, notices
from agent.peer.obstacle_hold import ObstacleHold
from agent.peer.part import (
    NOTHING,
    DirectListener,
    Handler,
    Header,
    Listener,
    Outputs,
    Part,
    StepContext,
)
from agent.peer.sense_freshness import Senses
from agent.safety.stop_controller import StopController
from protocol.frames.operator_frames import OperatorGoal, OperatorReport, ReportKind, goal_check
from protocol.frames.safety_frames import EVERYBODY, Command, OperatorCommand

DIRECTED = (
    Command.WAIT,
    Command.CONTINUE,
    Command.REPLAN,
    Command.STOP,
    Command.GO_HOME,
    Command.SET_GOAL,
)
DIRECTIVE_KEY, WORKS, SENT = "directive", b"\0", b"\1"  # durable: whether it is sent to a place
GOAL_LIFE_US = 2 * S  # coordinates wait this long for the order that uses them


class OperatorDirective(Part):
    """The part that obeys operators' orders to this robot. Places are (x, y) metres."""

    def __init__(
        self,
        slot: int,
        safety: StopController,
        senses: Senses,
        mission: Mission | None,
        obstacle: ObstacleHold,
        recalled: Mapping[str, bytes],
    ) -> None:
        """`recalled`: durable memory as it was before the start; the key is `DIRECTIVE_KEY`."""
        self._remembered = recalled.get(DIRECTIVE_KEY) == SENT
        safety.held = safety.held or self._remembered
        self.slot, self.safety, self.mission, self.obstacle = slot, safety, mission, obstacle
        self.senses = senses
        self.home: Point | None = None  # the first place that was believed since power-up
        self.goal: Point | None = None  # None: it does its own work
        self.arrived = False
        self._named: dict[tuple[int, bool], tuple[OperatorGoal, int]] = {}  # (operator, north)

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {OperatorCommand: self._command, OperatorGoal: self._name}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.WasStarted: self._started}

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {notices.ControlDue: self._period}

    def _period(self, notice: notices.ControlDue, now_us: int) -> Outputs:
        here = self.senses.known
        if self.home is None and here is not None:
            self.home = here.x_m, here.y_m
        return NOTHING

    def _started(self, ctx: StepContext, notice: notices.WasStarted) -> Outputs:
        return self._remember(self.goal is not None)

    def _remember(self, sent: bool) -> list[Effect]:
        """Make durable whether it is sent to a place."""
        if sent is self._remembered:
            return []
        self._remembered = sent
        return [Persist(DIRECTIVE_KEY, SENT if sent else WORKS)]

    # ---------------------------------------------------------------- received

    def _command(self, ctx: StepContext, header: Header, m: OperatorCommand) -> Outputs:
        """An order on the bus does what the person at the machine could do, with the same words."""
        refusal = self.safety.accept_order(m, ctx.now_us)
        if refusal is not None or m.target not in (self.slot, EVERYBODY):
            return refusal or NOTHING
        match m.command:
            case Command.MANUAL_RESET:
                return [inputs.ManualReset()]
            case Command.START:
                named = m.target == self.slot
                said = self._permitted(m.operator, named)
                return [*said, inputs.Start(named), *self.over("an operator's start")]
            case Command.HOLD:
                return [inputs.Hold()]
            case Command.WAIVE:
                return [notices.WaiveOrdered(m.argument, m.operator)]
        return self._order(ctx, m) if m.command in DIRECTED else NOTHING

    def _permitted(self, operator: int, named: bool) -> Outputs:
        """For the release log: the operator that lets this robot drive. Without keys none is proven."""
        safety = self.safety
        if not safety.keyed or safety.latched or not safety.waits_for_start(named):
            return NOTHING
        what = "start of this robot" if named else "start"
        return [Trace("safety", "", "PERMITTED", "", f"{what} by {operator}")]

    def _name(self, ctx: StepContext, header: Header, m: OperatorGoal) -> Outputs:
        """A coordinate for a following SET_GOAL, authenticated like an order."""
        refusal = self.safety.accept_order(m, ctx.now_us)
        if refusal is None and m.target == self.slot:
            self._named[m.operator, m.north] = (m, ctx.now_us)
        return refusal or NOTHING

    def _order(self, ctx: StepContext, m: OperatorCommand) -> Outputs:
        """One of `DIRECTED`, from an authorised operator."""
        command, now_us = Command(m.command), ctx.now_us
        if self.safety.latched:
            return [self._report(ReportKind.REFUSED, (0.0, 0.0))]
        if command is Command.STOP:
            return self._stop(ctx)
        if command in (Command.GO_HOME, Command.SET_GOAL):
            if not self.safety.started:  # its start would end the errand before it began
                return [self._report(ReportKind.REFUSED, (0.0, 0.0))]
            goal = self.home if command is Command.GO_HOME else self._meant(m, now_us)
            return self._send(command, goal, now_us)
        ended = [] if command is Command.WAIT else self.over(f"an operator's {command.name}")
        return ended or self.obstacle.answer(command, m.argument, now_us)

    def _stop(self, ctx: StepContext) -> Outputs:
        here = (0.0, 0.0) if ctx.here is None else (ctx.here.x_m, ctx.here.y_m)
        return [
            HALT,
            *self.safety.hold(ctx.now_us),
            notices.WorkGivenBack(),
            *self.over("an operator's STOP"),
            *self.obstacle.go_round("an operator's STOP", ctx.now_us),
            self._report(ReportKind.STOPPED, here),
            Trace("directive", "", "STOP", "HELD"),
        ]

    def _send(self, command: Command, goal: Point | None, now_us: int) -> Outputs:
        if goal is None or self.mission is None or not self.mission.accepts_goal(goal):
            return [self._report(ReportKind.REFUSED, goal or (0.0, 0.0))]
        self.goal, self.arrived = goal, False
        return [
            *self._remember(True),
            notices.WorkGivenBack(),
            *self.obstacle.go_round(f"an operator's {command.name}", now_us),
            self._report(ReportKind.UNDER_WAY, goal),
            Trace("directive", "", command.name, "UNDER_WAY", f"{goal[0]:.1f}, {goal[1]:.1f}"),
        ]

    def _meant(self, m: OperatorCommand, now_us: int) -> Point | None:
        east, north = self._named.get((m.operator, False)), self._named.get((m.operator, True))
        if east is None or north is None:
            return None
        fresh = now_us - min(east[1], north[1]) <= GOAL_LIFE_US
        ours = {east[0].target, north[0].target} == {self.slot}
        agreed = goal_check(east[0].value, north[0].value) == m.argument
        return (east[0].metres, north[0].metres) if fresh and ours and agreed else None

    def over(self, why: str) -> list[Effect]:
        """End the directive, so that the robot returns to its work."""
        if self.goal is None:
            return []
        was, self.goal = self.goal, None
        return [
            *self._remember(False),
            self._report(ReportKind.WORKING, was),
            Trace("directive", "", "OVER", "", why),
        ]

    def wish(self, view: FleetView) -> tuple[MotionRequest, Outputs]:
        """The motion towards the goal, and the report of the arrival."""
        assert self.goal is not None and self.mission is not None
        off_m = hypot(self.goal[0] - view.here.x_m, self.goal[1] - view.here.y_m)
        if off_m > THERE_M:
            return self.mission.travel(self.goal, view), NOTHING
        if self.arrived:
            return STILL, NOTHING
        self.arrived = True
        return STILL, [
            self._report(ReportKind.ARRIVED, self.goal),
            Trace("directive", "UNDER_WAY", "THERE", "ARRIVED"),
        ]

    def _report(self, matter: ReportKind, at: Point) -> Send:
        return Send(OperatorReport(self.slot, 0, matter, *at))
