"""Whether intents are obeyed, given the fleet as it is: orders, goals that wait, or a question back.

If one intent of a phrase cannot be obeyed, none is. A stop is never made smaller: if it is not clear
which robots it means, it means all robots.
"""

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

from agent.interface.geometry import Point
from tools.language.fleet_state import FleetNow, RobotNow
from tools.language.intent import (
    AnyIntent,
    At,
    Backlog,
    Beside,
    Control,
    Goal,
    Query,
    Target,
)
from tools.language.places import Places
from tools.language.question import Question, QuestionReason
from tools.operate.order import ANSWERS

# Between the places of two robots: a body is up to 1.6 m wide, and ORCA keeps them apart.
ROOM_M = 2.0
LEAVES = frozenset(("set-goal", "go-home"))  # orders after which a robot is no longer where it was


class AuthorizedOrder(NamedTuple):
    """As `headland order` says it."""

    slot: int
    what: str
    place: Point | None = None


class Waiting(NamedTuple):
    """A goal for the first robot that is idle."""

    place: Point
    name: str


class Authorization(NamedTuple):
    """What is done about the intents of one phrase, if none of them is refused."""

    orders: tuple[AuthorizedOrder, ...] = ()
    waiting: tuple[Waiting, ...] = ()
    queries: tuple[Query, ...] = ()
    stop_all: bool = False  # sent to all robots immediately, heard or not
    emergency_stop: bool = False
    clear_queue: bool = False
    first_ask: tuple[str, ...] = ()  # obeyed only after a yes


class Refused(Exception):
    """Raised inside of `weigh` where one intent cannot be obeyed; carries what is asked back."""

    def __init__(self, reason: QuestionReason, text: str, *instead: str) -> None:
        self.question = Question(reason, text, instead)


def weigh(
    intents: Sequence[AnyIntent], fleet: FleetNow, places: Places
) -> Authorization | Question:
    """Turn intents into orders, goals that wait and questions to answer; or ask back, if one of
    them cannot be obeyed."""
    scales = _Scales(fleet, places)
    try:
        for intent in intents:
            scales.add(intent)
    except Refused as problem:
        return problem.question
    return Authorization(
        tuple(scales.orders), tuple(scales.waiting), tuple(scales.queries), scales.stop_all,
        scales.emergency_stop, scales.clear_queue, tuple(scales.first_ask),
    )  # fmt: skip


class _Scales:
    def __init__(self, fleet: FleetNow, places: Places) -> None:
        self.fleet, self.places = fleet, places
        self.orders: list[AuthorizedOrder] = []
        self.waiting: list[Waiting] = []
        self.queries: list[Query] = []
        self.first_ask: list[str] = []
        self.stop_all = self.emergency_stop = self.clear_queue = False

    def add(self, intent: AnyIntent) -> None:
        match intent:
            case Goal():
                self._goal(intent)
            case Control():
                self._control(intent)
            case Query():
                self._query(intent)
            case Backlog():
                self.clear_queue = True

    # ---------------------------------------------------------------- goals

    def _goal(self, goal: Goal) -> None:
        place = self._place(goal.place)
        name = goal.place if isinstance(goal.place, str) else f"{place[0]:g}, {place[1]:g}"
        match goal.robot:
            case "unnamed":
                raise Refused(
                    QuestionReason.AMBIGUOUS, f"which robot? heard: {self.fleet.heard}",
                    f"send the nearest robot to {name}",
                )  # fmt: skip
            case "all" | "several":
                raise Refused(
                    QuestionReason.UNSAFE,
                    "one place has room for one robot: send one, or each to its own",
                )
            case "nearest":
                self._nearest(place, name)
            case slot:
                assert isinstance(slot, int)
                self._able(slot)
                self._room(place, slot)
                self.orders.append(AuthorizedOrder(slot, "set-goal", place))

    def _nearest(self, place: Point, name: str) -> None:
        if not self.fleet.live:
            raise Refused(QuestionReason.UNKNOWN_ROBOT, "no robot is heard on this bus")
        sent = frozenset(order.slot for order in self.orders)
        robot = self.fleet.nearest(place, sent)
        self._room(place, None if robot is None else robot.slot)
        if robot is None:
            self.waiting.append(Waiting(place, name))
        else:
            self.orders.append(AuthorizedOrder(robot.slot, "set-goal", place))

    def _place(self, target: Target) -> Point:
        match target:
            case At():
                return target.x_m, target.y_m
            case Beside():
                raise Refused(
                    QuestionReason.UNSAFE,
                    f"where robot {target.robot} stands is no room: say a free place",
                )
            case name:
                point = self.places.points.get(name)
                if point is None:
                    like = self.places.like(name)
                    hint = f"; did you mean {', '.join(like)}?" if like else ""
                    raise Refused(QuestionReason.UNKNOWN_PLACE, f"no place {name!r}{hint}")
                return point

    def _room(self, place: Point, mover: int | None) -> None:
        for other in self.fleet.live:
            leaves = any(o.slot == other.slot and o.what in LEAVES for o in self.orders)
            if other.slot == mover or leaves:
                continue
            there = other.goal or (other.x_m, other.y_m)
            stands = other.goal is not None or other.state != "WORKING"
            if stands and hypot(there[0] - place[0], there[1] - place[1]) < ROOM_M:
                how = "stands" if other.goal is None else "is sent"
                raise Refused(
                    QuestionReason.UNSAFE, f"robot {other.slot} {how} there: say a free place"
                )
        taken = [o.place for o in self.orders if o.place is not None]
        taken += [w.place for w in self.waiting]
        if any(hypot(x - place[0], y - place[1]) < ROOM_M for x, y in taken):
            raise Refused(QuestionReason.UNSAFE, f"two robots within {ROOM_M:g} m of one place")

    def _able(self, slot: int) -> RobotNow:
        """A robot that could move if it is ordered to."""
        robot = self._known(slot)
        if robot.stopped or robot.state == "EMERGENCY_STOP":
            raise Refused(
                QuestionReason.NOT_NOW,
                f"robot {slot} stands in emergency stop",
                "headland release --start",
            )
        if not robot.started:
            raise Refused(
                QuestionReason.NOT_NOW, f"robot {slot} was not started", f"start robot {slot}"
            )
        return robot

    def _known(self, slot: int) -> RobotNow:
        robot = self.fleet.robots.get(slot)
        if robot is None or robot.silent:
            was = "is silent" if robot is not None else "is not heard"
            raise Refused(
                QuestionReason.UNKNOWN_ROBOT, f"robot {slot} {was}; heard: {self.fleet.heard}"
            )
        return robot

    # ---------------------------------------------------------------- control

    def _control(self, control: Control) -> None:
        action = control.action
        if action == "emergency_stop":
            self.emergency_stop = True  # there is none for one robot
        elif action == "stop":
            self._stop(control)
        elif action in ANSWERS:
            self._answer(control)
        elif control.robots == "unnamed":
            raise Refused(
                QuestionReason.AMBIGUOUS, f"which robot? heard: {self.fleet.heard}",
                f"robot 2 {action.replace('_', ' ')}",
            )  # fmt: skip
        else:
            if action == "start" and control.robots == "all":
                self.first_ask.append("every robot begins to move: is everybody clear of them?")
            slots = [r.slot for r in self.fleet.live] if control.robots == "all" else control.robots
            for slot in slots:
                assert isinstance(slot, int)
                self._may(slot, action)
                self.orders.append(AuthorizedOrder(slot, action.replace("_", "-")))

    def _may(self, slot: int, action: str) -> None:
        if action != "start":
            self._able(slot)
        elif (robot := self._known(slot)).stopped or robot.state == "EMERGENCY_STOP":
            raise Refused(
                QuestionReason.NOT_NOW,
                f"robot {slot} stands in emergency stop",
                "headland release --start",
            )

    def _stop(self, control: Control) -> None:
        if isinstance(control.robots, str):
            self.stop_all = True
            return
        for slot in control.robots:
            if slot not in self.fleet.robots:
                raise Refused(
                    QuestionReason.UNKNOWN_ROBOT,
                    f"robot {slot} is not heard; heard: {self.fleet.heard}",
                    "stop all",
                )
            self.orders.append(AuthorizedOrder(slot, "stop"))

    def _answer(self, control: Control) -> None:
        """The answer to a question: only to a robot that asks, or that is on an errand."""
        asking = [r.slot for r in self.fleet.live if r.asking]
        if control.robots == "all" and len(asking) > 1:
            raise Refused(
                QuestionReason.UNSAFE,
                f"robots {asking} ask about different things: answer each by name",
            )
        if isinstance(control.robots, str):
            if len(asking) != 1:
                who = (
                    f"{len(asking)} robots are asking: {asking}" if asking else "no robot is asking"
                )
                raise Refused(
                    QuestionReason.AMBIGUOUS, f"{who}; say which", f"robot 2 {control.action}"
                )
            self.orders.append(AuthorizedOrder(asking[0], control.action))
            return
        for slot in control.robots:
            robot = self._able(slot)
            # A robot that does not work may be on an errand from before we listened; then it refuses.
            away = robot.state != "WORKING" and control.action != "wait"
            if not robot.asking and not away:
                raise Refused(QuestionReason.NOT_NOW, f"robot {slot} is not asking anything")
            self.orders.append(AuthorizedOrder(slot, control.action))

    # ---------------------------------------------------------------- questions

    def _query(self, query: Query) -> None:
        slots = [] if query.robots == "all" else list(query.robots)
        if isinstance(query.place, Beside):
            slots.append(query.place.robot)
        elif query.place is not None:
            self._place(query.place)
        for slot in slots:
            if slot not in self.fleet.robots:
                raise Refused(
                    QuestionReason.UNKNOWN_ROBOT,
                    f"robot {slot} is not heard; heard: {self.fleet.heard}",
                )
        self.queries.append(query)
