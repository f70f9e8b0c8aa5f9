"""An operator's orders to this robot: what to do instead of its work, or about an obstacle.

GO_HOME and SET_GOAL: the robot releases its work, drives to where it was switched on or to the given
place, and stays there until START, CONTINUE or REPLAN. STOP: it releases its work and stands still
until START. WAIT, CONTINUE and REPLAN answer its question (`agent/motion/obstacle_stop.py`).
"""

from collections.abc import Sequence
from math import hypot
from typing import TYPE_CHECKING

from agent.interface.config import S
from agent.interface.effects import HALT, Effect, Send, Trace
from agent.interface.mission import STILL, FleetView, MotionRequest
from protocol.frames.operator_frames import OperatorGoal, OperatorReport, ReportKind, goal_check
from protocol.frames.safety_frames import Command, OperatorCommand

if TYPE_CHECKING:
    from agent.peer.peer import Peer

Point = tuple[float, float]

DIRECTED = (
    Command.WAIT,
    Command.CONTINUE,
    Command.REPLAN,
    Command.STOP,
    Command.GO_HOME,
    Command.SET_GOAL,
)
THERE_M = 0.5  # within this distance of the goal it has arrived
GOAL_LIFE_US = 2 * S  # coordinates wait this long for the order that uses them


class OperatorDirective:
    def __init__(self, peer: "Peer") -> None:
        self.peer = peer
        self.home: Point | None = None  # position at power-up
        self.goal: Point | None = None  # None: it does its own work
        self.arrived = False
        self._named: dict[tuple[int, bool], tuple[OperatorGoal, int]] = {}  # (operator, north)

    def name(self, m: OperatorGoal, now_us: int) -> None:
        """Store a coordinate for a following SET_GOAL."""
        self._named[m.operator, m.north] = (m, now_us)

    def order(self, m: OperatorCommand, now_us: int) -> Sequence[Effect]:
        """One of `DIRECTED`, from an authorised operator."""
        command = Command(m.command)
        if self.peer.safety.latched:
            return [self._report(ReportKind.REFUSED, (0.0, 0.0))]
        if command is Command.STOP:
            return self._stop(now_us)
        if command in (Command.GO_HOME, Command.SET_GOAL):
            goal = self.home if command is Command.GO_HOME else self._meant(m, now_us)
            return self._send(command, goal, now_us)
        pause = self.peer.pause
        ended = [] if command is Command.WAIT else self.over(f"an operator's {command.name}")
        if ended or pause is None:
            return ended
        asked = pause.asking
        effects = pause.answer(command, m.argument, now_us)
        self.peer.stand_while_asking(asked, now_us)
        return effects

    def _stop(self, now_us: int) -> Sequence[Effect]:
        peer = self.peer
        here = (0.0, 0.0) if peer.here is None else (peer.here.x_m, peer.here.y_m)
        return [
            HALT,
            *peer.safety.hold(now_us),
            *peer.give_back_all(now_us),
            *self.over("an operator's STOP"),
            *self._pass("an operator's STOP", now_us),
            self._report(ReportKind.STOPPED, here),
            Trace("directive", "", "STOP", "HELD"),
        ]

    def _send(self, command: Command, goal: Point | None, now_us: int) -> Sequence[Effect]:
        mission = self.peer.mission
        if goal is None or mission is None or not mission.accepts_goal(goal):
            return [self._report(ReportKind.REFUSED, goal or (0.0, 0.0))]
        given_back = self.peer.give_back_all(now_us)
        self.goal, self.arrived = goal, False
        return [
            *given_back,
            *self._pass(f"an operator's {command.name}", now_us),
            self._report(ReportKind.UNDER_WAY, goal),
            Trace("directive", "", command.name, "UNDER_WAY", f"{goal[0]:.1f}, {goal[1]:.1f}"),
        ]

    def _pass(self, why: str, now_us: int) -> list[Effect]:
        """Go round the obstacle in the way, because the operator who gave the order knows of it."""
        pause = self.peer.pause
        if pause is None:
            return []
        asked = pause.asking
        effects = pause.go_round(why, now_us)
        self.peer.stand_while_asking(asked, now_us)
        return effects

    def _meant(self, m: OperatorCommand, now_us: int) -> Point | None:
        east, north = self._named.get((m.operator, False)), self._named.get((m.operator, True))
        if east is None or north is None:
            return None
        fresh = now_us - min(east[1], north[1]) <= GOAL_LIFE_US
        ours = {east[0].target, north[0].target} == {self.peer.slot}
        agreed = goal_check(east[0].value, north[0].value) == m.argument
        return (east[0].metres, north[0].metres) if fresh and ours and agreed else None

    def over(self, why: str) -> list[Effect]:
        """End the directive, so that the robot returns to its work."""
        if self.goal is None:
            return []
        was, self.goal = self.goal, None
        return [self._report(ReportKind.WORKING, was), Trace("directive", "", "OVER", "", why)]

    def wish(self, view: FleetView, effects: list[Effect]) -> MotionRequest:
        assert self.goal is not None and self.peer.mission is not None
        off_m = hypot(self.goal[0] - view.here.x_m, self.goal[1] - view.here.y_m)
        if off_m <= THERE_M:
            if not self.arrived:
                self.arrived = True
                effects += [
                    self._report(ReportKind.ARRIVED, self.goal),
                    Trace("directive", "UNDER_WAY", "THERE", "ARRIVED"),
                ]
            return STILL
        return self.peer.mission.travel(self.goal, view)

    def _report(self, matter: ReportKind, at: Point) -> Send:
        return Send(OperatorReport(self.peer.slot, 0, matter, *at))
