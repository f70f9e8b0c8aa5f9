"""The stop before an unannounced obstacle: stand still, ask an operator, and obey the answer.

`QUESTION_TABLE` has the states of the question. An answer is an operator's WAIT, CONTINUE or
REPLAN; STOP, GO_HOME and SET_GOAL end the question as well. An obstacle that leaves closes it.

A robot that goes round the obstacle creeps near it, at most as fast as it can stop before it.
Points found behind the obstacle belong to it. A different obstacle in the way, or no free way at
all, raises a new question. An answer with a number other than that of the open question is ignored.
"""

from collections.abc import Mapping, Sequence
from enum import Enum
from math import hypot, sqrt
from typing import Final

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Drive, Effect, Send, Trace
from agent.interface.geometry import Point
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour, Observation
from agent.motion.bar_guard import BarGuard
from agent.motion.obstacle_detector import (
    CHAIN_M,
    MARGIN_M,
    Detection,
    GroundCell,
    ObstacleDetector,
    middle,
)
from protocol.frames.operator_frames import NUMBERS, OperatorReport, ReportKind
from protocol.frames.safety_frames import Command
from protocol.state_machine import StateMachine, matrix

FREE_US: Final = 1 * S  # if the way is free for this long, the obstacle has left
ASK_US: Final = 1 * S  # repeat interval of the question, for operators that connect later
NEAR_M: Final = 3.0  # within this distance of the obstacle a robot that goes round it creeps
CREEP_M_S: Final = 1.0  # walking pace
KEEP_M: Final = 0.25  # a robot that goes round stops this far from an obstacle ahead
# Beside points that are within the margin of the hull. From this speed it stops within 0.1 m.
PASSING_M_S: Final = 0.3
STUCK_US: Final = 4 * S  # a robot that is slower than this for this long asks again
STUCK_M_S: Final = 0.05
AHEAD_US: Final = 100 * MS  # time to accelerate until the next check is in force
STANDING_M_S: Final = 0.02  # slower motion does not count
NOWHERE: Final = frozenset[Point]()
ANSWERS: Final = (Command.WAIT, Command.CONTINUE, Command.REPLAN)


class QuestionState(Enum):
    """How far one robot's question about an obstacle is."""

    NONE = "no question is open"
    ASKING = "the robot stands still and repeats its question"
    WAITING = "the robot stands still by an operator's order, until the obstacle leaves"
    GOING_ROUND = "an operator has confirmed the obstacle, and the robot drives round it"


class QuestionEvent(Enum):
    """What moves a question from one state to another."""

    BLOCKED = "an obstacle that nobody has announced is in the way, or there is no way round"
    TOLD_TO_WAIT = "an operator's WAIT"
    TOLD_TO_PASS = "an operator's CONTINUE or REPLAN, or an order that sends the robot somewhere"
    WAY_FREE = "nothing was in the way for a second"
    PASSED = "no point of the confirmed obstacle is seen any more"


NONE, ASKING, WAITING, GOING_ROUND = QuestionState
stay = None

# fmt: off
QUESTION_TABLE = matrix(
    QuestionEvent,
    # state        BLOCKED  TOLD_TO_WAIT  TOLD_TO_PASS  WAY_FREE  PASSED
    (NONE,         ASKING,  stay,         stay,         stay,     stay),
    (ASKING,       stay,    WAITING,      GOING_ROUND,  NONE,     stay),
    (WAITING,      stay,    stay,         GOING_ROUND,  NONE,     stay),
    (GOING_ROUND,  ASKING,  stay,         stay,         stay,     NONE),
)
# fmt: on
# The report to people at each event; there is none at PASSED.
REPORT: Mapping[QuestionEvent, ReportKind] = {
    QuestionEvent.BLOCKED: ReportKind.ASKING,
    QuestionEvent.TOLD_TO_WAIT: ReportKind.WAITING,
    QuestionEvent.TOLD_TO_PASS: ReportKind.GOING_ROUND,
    QuestionEvent.WAY_FREE: ReportKind.GONE,
}


class ObstacleStop:
    """The obstacle stop of one robot. While it is `asking`, the peer holds the robot.

    It implements `ObstacleQuestion` of `agent/interface/motion_controller.py`.
    """

    def __init__(
        self, slot: int, limits: BodyLimits, lookout: ObstacleDetector,
        half_bar_m: float = 0.0, steers: bool = False,
    ) -> None:  # fmt: skip
        """`slot`: ours. `limits`: our body. `lookout`: finds and remembers the obstacles. `half_bar_m`:
        from our middle to an end of the implement; 0 without one. `steers`: the course turns as the
        body does.
        """
        self.slot, self.limits, self.lookout = slot, limits, lookout
        self.bar = BarGuard(half_bar_m, steers, lookout) if half_bar_m > limits.radius_m else None
        self.number = 0  # of the newest question
        self.machine = StateMachine("obstacle question", QUESTION_TABLE, NONE)
        # Ground cells to go round by an operator's answer.
        self.things: frozenset[GroundCell] = frozenset()
        self.leave_out = False  # the units under them are not worked
        self._known_as, self._places = self.things, frozenset[Point]()
        self.why = ""  # of the newest question
        self._course: Point = (0.0, 0.0)  # the motion that was stopped, as a direction
        self._sighting = Detection(0.0, 0.0, 0.0)
        self._seen_at_us = self._asked_at_us = self._moved_at_us = 0

    @property
    def asking(self) -> bool:
        """Whether a question is open, so that the robot has to stand still."""
        return self.machine.state in (ASKING, WAITING)

    @property
    def passing(self) -> bool:
        """Whether the robot goes round an obstacle that an operator has confirmed."""
        return bool(self.things)

    @property
    def round(self) -> tuple[frozenset[Point], bool]:
        """For the mission: the places to go round, (x, y) metres, and whether to skip the units
        under them.
        """
        if self.things is not self._known_as:
            self._known_as, self._places = self.things, frozenset(map(middle, self.things))
        return self._places, self.leave_out

    @property
    def under_bar(self) -> frozenset[Point]:
        """For the mission: places that have kept the implement up for some time, (x, y) metres."""
        return NOWHERE if self.bar is None else self.bar.stay

    # ---------------------------------------------------------------- each control period

    def watch(
        self, wanted: Drive, here: Observation, neighbours: Mapping[int, Neighbour],
        may_move: bool, now_us: int, way: Point | None = None,
    ) -> tuple[Drive, list[Effect]]:  # fmt: skip
        """Each control period: the drive that avoids the obstacle, and the effects.

        `wanted`: the drive of the motion controller. `neighbours`: newest poses by slot.
        `may_move`: no stop cause holds the robot. The safety gate comes after the result. The implement
        is up where it would be drawn over something. `way`: the velocity of the mission, before it
        gives way to robots, (x, y) metres a second; None: `wanted` is that. What is beside that way
        stops the robot, but it does not ask.
        """
        drive, effects = self._before_body(wanted, here, neighbours, may_move, now_us, way)
        if self.bar is None or not drive.tool_on:
            return drive, effects
        if self.bar.must_be_up(drive, here, self._motions(drive, here), neighbours, now_us):
            drive = drive._replace(tool_on=False)
        return drive, effects

    def _before_body(
        self, wanted: Drive, here: Observation, neighbours: Mapping[int, Neighbour],
        may_move: bool, now_us: int, way: Point | None,
    ) -> tuple[Drive, list[Effect]]:  # fmt: skip
        """The drive that keeps the body off obstacles."""
        if self.asking:
            if not here.ranges_m:
                self._seen_at_us = now_us  # a robot that sees nothing does not see that it has gone
            ux, uy = self._course
            way = (ux * self.limits.speed_m_s, uy * self.limits.speed_m_s)
            return HALT, self._stand(self.lookout.observe(here, (way,), neighbours, now_us), now_us)
        if not may_move:
            return wanted, []  # another cause holds it
        motions = self._motions(wanted, here)
        sighting = self.lookout.observe(here, motions, neighbours, now_us)
        if self.things:
            self._keep_in_mind()
        approached = self.lookout.is_approached(here, neighbours, now_us)
        if sighting is None:
            self._moved_at_us = now_us
            if approached:
                return HALT, []  # a robot that is cut off from us, as it seems: it stops, too
            return (self._slowed(wanted, here) if self.things else wanted), []
        if self._known((sighting.x_m, sighting.y_m)):
            return self._creep(wanted, here, sighting, may_move, now_us)
        if (
            way is not None
            and self.lookout.ahead(here, way, self.lookout.reach_m(hypot(*way))) is None
        ):
            return HALT, []  # it swerved for a robot, or was turning
        return HALT, self._ask(here, motions, sighting, now_us)

    def _motions(self, wanted: Drive, here: Observation) -> list[Point]:
        """The motion of the body now, and the one that it would have next."""
        moves_m_s = hypot(here.vx_m_s, here.vy_m_s)
        wants_m_s = hypot(wanted.vx_m_s, wanted.vy_m_s)
        motions = [(here.vx_m_s, here.vy_m_s)] if moves_m_s > STANDING_M_S else []
        if wants_m_s > STANDING_M_S:
            next_m_s = moves_m_s + self.limits.acceleration_m_s2 * AHEAD_US / S
            share = max(moves_m_s, min(wants_m_s, next_m_s)) / wants_m_s
            motions.append((wanted.vx_m_s * share, wanted.vy_m_s * share))
        return motions

    def _ask(
        self, here: Observation, motions: list[Point], sighting: Detection, now_us: int
    ) -> list[Effect]:
        """Stop and raise a new question."""
        motion = motions[-1] if self.lookout.ahead(here, motions[-1], 1e3) else motions[0]
        speed_m_s = hypot(*motion)
        self._course = motion[0] / speed_m_s, motion[1] / speed_m_s
        self.number = self.number % NUMBERS + 1
        self._seen_at_us = now_us
        self.why = f"{sighting.free_m:.1f} m ahead at {sighting.x_m:.1f}, {sighting.y_m:.1f}"
        self._sighting = sighting
        return self._turn(QuestionEvent.BLOCKED, self.why, now_us)

    def _stand(self, seen: Detection | None, now_us: int) -> list[Effect]:
        """Stand still until an answer arrives or the obstacle has gone."""
        if seen is not None:
            self._sighting, self._seen_at_us = seen, now_us
        elif now_us - self._seen_at_us >= FREE_US:
            return self._turn(QuestionEvent.WAY_FREE, "the way is free", now_us)
        if self.machine.state is ASKING and now_us - self._asked_at_us >= ASK_US:
            self._asked_at_us = now_us
            return [Send(self.report(ReportKind.ASKING))]
        return []

    def _creep(
        self, wanted: Drive, here: Observation, sighting: Detection, may_move: bool, now_us: int
    ) -> tuple[Drive, list[Effect]]:
        """Drive past a confirmed obstacle, never too fast to stop before it."""
        if sighting.free_m > KEEP_M:
            most_m_s = min(self._slow_m_s(sighting.free_m), CREEP_M_S)
        else:  # it is beside us, or it will be
            most_m_s = self._beside_m_s(wanted, here)
        drive = _at_most(wanted, most_m_s)
        if hypot(drive.vx_m_s, drive.vy_m_s) > STUCK_M_S or not may_move:
            self._moved_at_us = now_us
        if now_us - self._moved_at_us < STUCK_US:
            return drive, []
        self._moved_at_us = now_us
        return HALT, self._ask(here, self._motions(wanted, here), sighting, now_us)

    def _slow_m_s(self, free_m: float) -> float:
        """A speed at which it stops `KEEP_M` before an obstacle, with half of the way to spare."""
        return sqrt(2 * self.limits.acceleration_m_s2 * max(0.0, free_m - KEEP_M)) / 2

    def _beside_m_s(self, wanted: Drive, here: Observation) -> float:
        """How fast the hull may pass points that are beside it, or will be."""
        reach_m, beside_to_m = self.lookout.reach_m(PASSING_M_S), self.limits.radius_m + KEEP_M
        way = wanted.vx_m_s, wanted.vy_m_s
        seen = self.lookout.ahead(here, way, reach_m, beside_to_m)
        return PASSING_M_S if seen is None else min(PASSING_M_S, self._slow_m_s(seen.free_m))

    def _slowed(self, wanted: Drive, here: Observation) -> Drive:
        places = map(middle, self.things)
        near = any(hypot(x - here.x_m, y - here.y_m) < NEAR_M for x, y in places)
        return _at_most(wanted, CREEP_M_S) if near else wanted

    # ---------------------------------------------------------------- what is gone round

    def _known(self, at: Point) -> bool:
        return any(hypot(at[0] - x, at[1] - y) <= CHAIN_M for x, y in map(middle, self.things))

    def _keep_in_mind(self) -> None:
        """Add points of the obstacle that are seen from its side, and drop those that have gone."""
        seen = self.lookout.points.keys()
        if seen != self.things:
            kept = self.things.intersection(seen)
            self.things = kept.union(g for g in seen - kept if self._known(middle(g)))
        if not self.things:
            self.machine.fire(QuestionEvent.PASSED)

    # ---------------------------------------------------------------- answers

    def answer(self, command: Command, number: int, now_us: int) -> Sequence[Effect]:
        """An operator's WAIT, CONTINUE or REPLAN to question `number`; 0 means the open one.

        An answer to a question that is not open is refused with a report.
        """
        if not self.asking or number not in (0, self.number):
            why = f"question {number} is not open"
            return [
                Send(self.report(ReportKind.REFUSED)),
                Trace("pause", "", command.name, "REFUSED", why),
            ]
        if command is Command.WAIT:
            return self._turn(QuestionEvent.TOLD_TO_WAIT, "an operator's answer", now_us)
        self.leave_out = command is Command.CONTINUE
        return self.go_round(f"an operator's {command.name}", now_us)

    def go_round(self, why: str, now_us: int) -> list[Effect]:
        """Treat the obstacle in the way as confirmed from now on; `why` is for the trace."""
        if not self.asking:
            return []
        self.things = frozenset(self.lookout.points)
        self._moved_at_us = now_us
        return self._turn(QuestionEvent.TOLD_TO_PASS, why, now_us)

    def report(self, matter: ReportKind) -> OperatorReport:
        """The frame that tells people about the obstacle: where it is, its radius, and the free way
        before it.
        """
        seen = self._sighting
        away_m = [hypot(x - seen.x_m, y - seen.y_m) for x, y in map(middle, self.lookout.points)]
        radius_m = max((m for m in away_m if m <= 2 * CHAIN_M), default=0.0)
        return OperatorReport(
            self.slot, self.number, matter, seen.x_m, seen.y_m, seen.free_m, radius_m
        )

    def _turn(self, event: QuestionEvent, why: str, now_us: int) -> list[Effect]:
        """Move to the next state, and report that to people."""
        source, _ = self.machine.fire(event)
        was, matter = "" if source is NONE else source.name, REPORT[event]
        self._asked_at_us = now_us
        return [
            Send(self.report(matter)),
            Trace("pause", was, f"question {self.number}", matter.name, why),
        ]


def _at_most(drive: Drive, speed_m_s: float) -> Drive:
    wants_m_s = hypot(drive.vx_m_s, drive.vy_m_s)
    if wants_m_s <= speed_m_s:
        return drive
    share = speed_m_s / wants_m_s
    return drive._replace(vx_m_s=drive.vx_m_s * share, vy_m_s=drive.vy_m_s * share)


assert KEEP_M < MARGIN_M, "clearance while passing must be below the stopping clearance"
