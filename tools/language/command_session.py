"""From a phrase to what robots confirm: one operator's device on a bus that takes phrases.

A stop of all robots does not wait until it is known which robots are there. It is sent immediately and
repeated. A robot that has not confirmed it after half a second gets an emergency stop.
"""

import asyncio
from collections.abc import Awaitable, Callable

from agent.peer import fleet_summary as bulletin
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.operator_frames import ReportKind
from protocol.frames.safety_frames import Command, Reason
from protocol.links.bus import CanBus
from protocol.links.socketcand_link import SocketcandLink
from tools.common.bus_attach import connections_of
from tools.inspect.inspector import Inspector
from tools.language import view
from tools.language.alarm import may_be_alarm
from tools.language.answer import answer
from tools.language.authorize import Authorization, AuthorizedOrder, weigh
from tools.language.fleet_state import FleetNow
from tools.language.goal_queue import GoalQueue, Queued, QueueError
from tools.language.intent import AnyIntent, Control
from tools.language.outcome import Outcome
from tools.language.parse import read
from tools.language.places import Places
from tools.language.question import Question
from tools.language.question import QuestionReason as Why
from tools.operate.device_keys import DeviceKeys
from tools.operate.estop import press
from tools.operate.operator_device import LIVE_S, KnownRobot, Operator
from tools.operate.order import LISTEN_S, convey
from tools.operate.pgn_client import PgnClient

REPEAT_S = 0.05  # interval at which a stop of all is repeated: one control period
PLAIN_STOP_S = 0.5  # then an emergency stop follows; a robot obeys within a period and a bus delay
HOLD_S = 3.0  # two of the slowest heartbeats (every 1.4 s), which confirm a hold
SERVE_S = 0.5  # the queue is looked at this often
HEARD_S = 0.3  # by then we are on the bus
PEER_S = 1.0  # longest wait for the answer of one peer
ANY = "any"  # the leader is asked, and without its answer one peer after the other
Reader = Callable[[str], Awaitable[tuple[tuple[AnyIntent, ...] | Question, bool]]]
Asker = Callable[[str], Awaitable[bool]]  # a question with yes or no


class CommandSession:
    """Make it inside of the loop that drives the bus."""

    def __init__(
        self, bus: CanBus | SocketcandLink, keys: DeviceKeys | None, places: Places,
        queue: GoalQueue, read: Reader, ask: Asker, timeout_s: float = 5.0, by: str | None = None,
    ) -> None:  # fmt: skip
        self.operator, self.inspector = Operator(bus, keys), Inspector()
        self.letters = PgnClient(bus, self.operator.device)
        self.places, self.queue, self.read, self.ask = places, queue, read, ask
        self.timeout_s, self.by = timeout_s, by
        self.bus, self.heard = bus, -1  # how often the link was made when the fleet was asked
        loop = asyncio.get_running_loop()
        bus.subscribe(lambda frame: self._hear(loop.time(), frame))

    def _hear(self, now_s: float, frame: Frame) -> None:
        for listener in (self.operator, self.inspector, self.letters):
            listener.hear(now_s, frame)

    async def hear_fleet(self) -> FleetNow:
        """The robots that are there. The first call takes as long as robots need to report themselves."""
        if self.heard != (made := connections_of(self.bus)):
            await self.operator.listen(HEARD_S)
            self.operator.ask_work()  # what was claimed before we came
            await self.operator.listen(LISTEN_S)
            self.heard = made
        self.operator.now_s = self.inspector.now_s = asyncio.get_running_loop().time()
        return view.as_heard(self.inspector)

    # ---------------------------------------------------------------- one phrase

    async def say(self, phrase: str) -> Outcome:
        """Read one phrase, weigh it against the fleet, send the orders and wait for what robots
        confirm. A phrase that may be an alarm holds all robots first."""
        self.operator.begin()
        alarm = may_be_alarm(phrase, self.places)
        # A language model takes seconds. What may be an alarm is read by the grammar alone.
        reading, by_model = (read(phrase, self.places), False) if alarm else await self.read(phrase)
        if isinstance(reading, Question):
            outcome = Outcome(phrase, question=reading)
            if alarm:
                await self._hold_all(outcome)
            return outcome
        outcome = Outcome(phrase, reading, by_model=by_model)
        if stops_all(reading) and not by_model:
            await self._stop_all(outcome, reading)
            if len(reading) == 1:
                return outcome
        fleet = await self.hear_fleet()
        verdict = weigh(reading, fleet, self.places)
        if isinstance(verdict, Question):
            outcome.question = verdict
            if outcome.stopped is None and any(map(_stops, reading)):
                await self._hold_all(outcome)
            return outcome
        if by_model and not await self.ask(f"the model read: {_told(reading)}; obey?"):
            outcome.question = Question(Why.AMBIGUOUS, f"read as {_told(reading)}; not confirmed")
            return outcome
        for doubt in verdict.first_ask:
            if not await self.ask(doubt):
                outcome.question = Question(Why.UNSAFE, doubt, ("the same with --yes",))
                return outcome
        await self._obey(outcome, reading, verdict)
        return outcome

    async def _obey(
        self, outcome: Outcome, intents: tuple[AnyIntent, ...], verdict: Authorization
    ) -> None:
        if (verdict.stop_all or verdict.emergency_stop) and outcome.stopped is None:
            await self._stop_all(outcome, intents)
        words = await asyncio.gather(*map(self._convey, verdict.orders))
        outcome.orders = list(zip(verdict.orders, words, strict=True))
        try:
            self._queue(outcome, verdict)
            names = self.queue.names if any(q.ask == "queue" for q in verdict.queries) else []
        except (QueueError, OSError) as problem:  # full, damaged, or no room on the disk
            why = problem.strerror if isinstance(problem, OSError) else None
            outcome.question = Question(Why.NOT_NOW, why or str(problem))
            return
        if verdict.queries:
            fleet = await self._view()
            outcome.told_by = fleet.told_by
            outcome.answers = [answer(q, fleet, self.places, names) for q in verdict.queries]

    def _queue(self, outcome: Outcome, verdict: Authorization) -> None:
        """Raises QueueError, OSError."""
        if verdict.clear_queue:
            self.queue.clear()
        for goal in verdict.waiting:
            self.queue.add(goal.name, goal.place)
            outcome.queued.append(goal.name)

    async def _convey(self, order: AuthorizedOrder) -> str | None:
        """What the robot says, or None where it does not obey."""
        robot = self.operator.robots.get(order.slot)
        if robot is None:
            return None
        obeyed = await convey(self.operator, robot, order.what, order.place, self.timeout_s)
        said = "STARTED" if robot.report is None else robot.report.matter.name
        return said.replace("_", " ") if obeyed else None

    # ---------------------------------------------------------------- stops

    async def _stop_all(self, outcome: Outcome, intents: tuple[AnyIntent, ...]) -> None:
        emergency = any(isinstance(i, Control) and i.action == "emergency_stop" for i in intents)
        late = await self._all_late() if not emergency else None
        outcome.latched = late is None or bool(late)
        if late is None or late:
            late = await press(self.operator, Reason.OPERATOR_INTERVENTION, self.timeout_s)
        self.operator.now_s = asyncio.get_running_loop().time()
        live = self.operator.live
        outcome.stopped = [robot.slot for robot in live if robot not in late]
        # A robot that was heard and fell silent without saying goodbye has confirmed nothing.
        outcome.not_stopped = self._missing(outcome.stopped)

    async def _hold_all(self, outcome: Outcome) -> None:
        """Everybody stands until a start; said again until all that beat have confirmed it."""
        loop, operator = asyncio.get_running_loop(), self.operator
        begun_s = loop.time()
        operator.ask_who()
        asked = set[int]()
        while True:
            for slot in (
                operator.robots.keys() - asked
            ):  # only a heartbeat after this time confirms it
                operator.robots[slot].started = True
                asked.add(slot)
            operator.command(Command.HOLD)
            await asyncio.sleep(REPEAT_S)
            operator.now_s = loop.time()
            free = [
                r for r in operator.live if (r.started or r.slot not in asked) and not r.stopped
            ]
            waited_s = loop.time() - begun_s
            unnamed = operator.unnamed(begun_s - LIVE_S)
            settled = waited_s >= PLAIN_STOP_S and not free and not unnamed
            if settled or waited_s >= HOLD_S:
                break
        outcome.held = sorted(robot.slot for robot in operator.live if robot not in free)
        outcome.not_stopped = self._missing(outcome.held)

    def _missing(self, standing: list[int]) -> list[int]:
        """Robots that are or were there, have said no farewell, and are none of these."""
        return [r.slot for r in self.operator.members if r.slot not in standing]

    async def _all_late(self) -> list[KnownRobot] | None:
        """An ordinary stop; robots that have not confirmed it in time. None: no robot is heard."""
        loop, operator = asyncio.get_running_loop(), self.operator
        begun_s = loop.time()
        end_s = begun_s + PLAIN_STOP_S
        operator.ask_who()
        for robot in operator.robots.values():
            robot.report = None
        while True:
            operator.command(Command.STOP)
            await asyncio.sleep(REPEAT_S)
            operator.now_s = loop.time()
            late = [robot for robot in operator.live if not _stands(robot)]
            if loop.time() >= end_s:
                # A conversation of hours has heard addresses that are long gone.
                named = not operator.unnamed(begun_s - LIVE_S)
                return late if operator.live and named else None

    # ---------------------------------------------------------------- answers

    async def _view(self) -> FleetNow:
        """Our own hearing, or what a peer tells when one is asked for."""
        own = await self.hear_fleet()
        if self.by is None:
            return own
        peers = [int(self.by)] if self.by != ANY else [r.slot for r in own.live]
        known = [self.operator.robots[slot] for slot in peers if slot in self.operator.robots]
        asked = [robot.address for robot in known]
        if self.by == ANY:  # the leader answers; without one any other robot is asked
            asked.insert(0, GLOBAL_ADDRESS)
        for address in asked:
            text = await self.letters.ask(bulletin.FLEET_SUMMARY_PGN, address, PEER_S)
            told = None if text is None else bulletin.read(text)
            if told is not None:
                return view.as_told(told)._replace(sections={**own.sections})
        return own._replace(told_by=f"robot {self.by} did not answer; heard on the bus")

    # ---------------------------------------------------------------- goals that wait

    async def serve(self, tell: Callable[[Outcome], None]) -> None:
        """Until the queue is empty: the oldest goal that can be given goes to the nearest robot that is
        idle."""
        while self.queue:
            with self.queue.delivering() as ours:
                outcome = await self._deliver_oldest() if ours else None
            if outcome is not None:
                tell(outcome)
            else:
                await asyncio.sleep(SERVE_S)

    async def _deliver_oldest(self) -> Outcome | None:
        """A goal that was given to a robot that is dead, or that does not answer, holds up no other."""
        tried = set[int]()
        while True:
            # Read again: another command may have cleared the queue meanwhile.
            goals = self.queue.goals
            goal = next((goal for goal in goals if goal.number not in tried), None)
            if goal is None:
                return None
            tried.add(goal.number)
            given = frozenset(one.given_to for one in goals if one.given_to is not None)
            outcome = await self._deliver(goal, given)
            if outcome is not None:
                return outcome

    async def _deliver(self, goal: Queued, given: frozenset[int]) -> Outcome | None:
        """One goal, if a robot can take it. Waiting does not help when a robot refuses it.

        `given`: robots that may have a goal of the queue already."""
        fleet = await self.hear_fleet()
        robot = fleet.nearest(goal.place, given)
        if goal.given_to is not None:  # it may go there: sent, and not confirmed
            robot = fleet.robots.get(goal.given_to)
        if robot is None or robot.silent:
            return None
        self.queue.give(goal.number, robot.slot)
        self.operator.begin()
        order = AuthorizedOrder(robot.slot, "set-goal", goal.place)
        word = await self._convey(order)
        known = self.operator.robots.get(robot.slot)  # None: its address is another maker's
        report = None if known is None else known.report
        if word is None and (report is None or report.matter is not ReportKind.REFUSED):
            return None  # not heard: the same robot gets the order again
        self.queue.done(goal.number)
        return Outcome(f"queued: {goal.name}", orders=[(order, word)])


def stops_all(intents: tuple[AnyIntent, ...]) -> bool:
    """Whether a phrase stops all robots, whatever else it asks."""
    return any(
        isinstance(intent, Control)
        and _stops(intent)
        and (intent.action == "emergency_stop" or isinstance(intent.robots, str))
        for intent in intents
    )


def _stops(intent: AnyIntent) -> bool:
    return isinstance(intent, Control) and intent.action in ("stop", "emergency_stop")


def _stands(robot: KnownRobot) -> bool:
    said = robot.report is not None and robot.report.matter is ReportKind.STOPPED
    return said or robot.stopped


def _told(intents: tuple[AnyIntent, ...]) -> str:
    return "; ".join(intent.model_dump_json(exclude_none=True) for intent in intents)
