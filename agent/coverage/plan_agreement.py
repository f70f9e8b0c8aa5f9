"""How a fleet on a grid agrees on its next plan, in rounds, and on how far each robot has come in
it.

A robot that detects other members than those of the plan calls a round with the next number: after
a boot, a death, a join, a network split or its healing, or if an unknown obstacle is in the way.
Every robot stops in a cell and announces it, with the digest of all covered cells. When all live
robots have done so and the digests are equal, each computes the same plan and announces the digest
of its inputs. When these are equal too, all go. A robot that knows other obstacles announces them
to all. A member that never knew its place cannot announce it. One that does not know where it is now
is waited for only `PLACELESS_US`, and takes part as soon as it announces a cell.

From then on each robot announces the step of the plan that it has reached. It drives the next one
when the robots that were in its cell before have gone on (`agent/coverage/joint_course.py`).
Nothing here carries safety: a robot also sees robots ahead of it
(`agent/coverage/proximity_guard.py`).

One silent robot counts as a wreck, and its work is cut again immediately. Where several fall silent
together, the bus is cut and they go on working. Their part is kept for them until ours is done and
their lease is over.
"""

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_map import NONE, CellMap
from agent.coverage.joint_course import CourseInputs, GridCourse, course_of
from agent.interface.config import LEASE_US, MS, S
from agent.interface.instants import FOREVER_US
from agent.mapf.agreement_phase import CALM_US, AgreementPhase, after, ahead
from crdt.progress import BLOCK_UNITS, Progress
from protocol.frames.agreement_frames import AgreementKind, AgreementMessage, AgreementReply
from protocol.state_machine import StateMachine, matrix

SETTLE_US = 300 * MS  # the view must be unchanged for this long, because boots come in bursts
# A robot that receives no other for this long after boot is alone: two heartbeats (1.4 s).
BOOT_US = 3 * S
STAGGER_US = 20 * MS  # times the rank among live robots, so that one calls and the others join
HURRY_US, HURRY_ROBOT_US = 200 * MS, 8 * MS  # between repeats: a tenth of the bus for all together
PATIENCE_US = 5 * S  # longer than a sync (2 s) or a protective stop (2 s) and the way to the cell
PLACELESS_US = 2 * S  # for a member that knew its place before: ten words, 30 % of them lost
PLAIN_US = 1 * S  # without agreement for this long, plan without reserving silent robots' cells
OBSTACLE_US = 20 * S  # lifetime of an obstacle, because it may have gone since
SPARE_US = 5 * S  # margin so that all robots drop a reported obstacle in the same round
AGAIN_MAX = 2  # an obstacle seen more often than this is permanent until the members change
ANYBODY = 0xFFFF  # slot of an unannounced body
NOWHERE = 0xFFFF  # told as the cell of a robot that stands in none, so that no robot waits for it


class CoveragePlanEvent(Enum):
    """What moves a round of agreement from one phase to the next."""

    BEGUN = "a round with a later number was called, by us or by another robot"
    GATHERED = "every live robot stands in a cell of its own and knows the same covered cells"
    CHANGED = "a robot has left, joined or moved, or reports an obstacle: the plan is out of date"
    AGREED = "every live robot has computed the same plan"


FREE, GATHER, AGREE, GO = AgreementPhase
stay = None

# fmt: off
COVERAGE_PLAN_TABLE = matrix(
    CoveragePlanEvent,
    # phase   BEGUN   GATHERED  CHANGED  AGREED
    (FREE,    GATHER, stay,     stay,    stay),
    (GATHER,  stay,   AGREE,    stay,    stay),
    (AGREE,   GATHER, stay,     GATHER,  GO),
    (GO,      GATHER, stay,     stay,    stay),  # a change of the members calls a new round
)
# fmt: on


class CellPlace(NamedTuple):
    """Where one robot stands in this round, as it announced it."""

    number: int
    digest: int  # 24 bits, of all registers of progress
    answer: AgreementReply


class CellObstacle(NamedTuple):
    """Something in a cell that is not part of the plan, and until when to avoid it."""

    slot: int  # or ANYBODY
    ends_at_us: int  # ignored after this time


class FleetSnapshot(NamedTuple):
    """What a peer knows about the others now."""

    live: frozenset[int]
    fell_silent_at_us: Mapping[int, int]
    progress: Progress
    placeless: frozenset[int] = frozenset()  # live members that do not know where they are


class CoverageAgreement:
    """One robot's part in the rounds. It has no clock and no bus: messages and the time go in,
    messages come out.

    Cells are numbers of the `ground`; `turn_cost` is that of a quarter turn, in steps.
    """

    def __init__(self, slot: int, ground: CellMap, turn_cost: float = 0.0) -> None:
        self.slot, self.ground, self.turn_cost = slot, ground, turn_cost
        self.round = 0
        self.machine = StateMachine("coverage plan", COVERAGE_PLAN_TABLE, FREE)
        self.course: GridCourse | None = None  # the one agreed, or to be agreed, last
        self.me = NONE  # our index in it; -1: not one of it
        self.rounds = self.called = 0
        self.begun_at_us = 0  # of the round
        self._news_at_us = 0  # the newest of: round begun, plan made, plan agreed
        self._places: dict[int, CellPlace] = {}
        self._used: dict[int, CellPlace] = {}  # those the course was computed from
        self._plans: dict[int, int] = {}
        self._reached: dict[int, int] = {}
        # Cell -> what stands there that is not part of the plan.
        self.bodies: dict[int, CellObstacle] = {}
        self._seen: dict[int, int] = {}  # cell -> how often an obstacle was seen there
        self._plain = False
        self._left_out = False  # cells of our rooms are neither covered nor in the plan
        self.kept = False  # a part of the work is kept for silent robots
        self.owner: NDArray[np.int16] = np.full(len(ground), NONE, np.int16)
        # Since when the live members differ from those of the plan.
        self._differs_at_us: int | None = None
        self._said: dict[AgreementKind, tuple[object, int, int]] = {}  # what, how often, when

    @property
    def phase(self) -> AgreementPhase:
        """How far the round is, or FREE before the first one."""
        return self.machine.state

    # ---------------------------------------------------------------- hearing

    def call(self, now_us: int) -> None:
        """Begin a round with the next number; the others join when they receive our place."""
        self.called += 1
        self._begin(after(self.round), now_us)

    def _begin(self, number: int, now_us: int) -> None:
        self._remember()
        self.round = number
        self.machine.fire(CoveragePlanEvent.BEGUN)
        self.rounds += 1
        self.begun_at_us = self._news_at_us = now_us
        self._places, self._plans, self._plain = {}, {}, False
        self._differs_at_us = None
        self._said.clear()

    def on_message(self, slot: int, m: AgreementMessage, now_us: int) -> None:
        """Handle an agreement message of another robot; one of a round that is over is ignored."""
        if m.say == AgreementKind.BODY:
            self._hear_body(m, now_us)
            return
        later = ahead(m.round, self.round, fresh=self.rounds == 0)
        if later is None:
            return  # a round that is over
        if later:
            self._begin(m.round, now_us)
        if m.say == AgreementKind.PLACE:
            answer = AgreementReply(m.answer)
            nowhere = m.first == NOWHERE and answer is AgreementReply.STOPPED
            if m.first < len(self.ground) or nowhere:
                self._places[slot] = CellPlace(m.first, m.second | m.detail << 16, answer)
        elif m.say == AgreementKind.PLAN:
            self._plans[slot] = m.first | m.second << 16
        elif self.slot in self._plans and self._plans[self.slot] & 0xFFFF == m.second:
            self._plans[slot] = self._plans[self.slot]  # it goes by our plan already
            self._reached[slot] = max(self._reached.get(slot, 0), m.first)

    def _hear_body(self, m: AgreementMessage, now_us: int) -> None:
        if m.first < len(self.ground) and m.first not in self.bodies:
            ends_at_us = FOREVER_US if m.detail else now_us + OBSTACLE_US
            self.bodies[m.first] = CellObstacle(m.second, ends_at_us)
            self.machine.fire(CoveragePlanEvent.CHANGED)

    def meet(self, number: int, slot: int, now_us: int) -> None:
        """An obstacle outside our plan stands in that cell."""
        self._seen[number] = self._seen.get(number, 0) + 1
        lasting = slot != ANYBODY or self._seen[number] > AGAIN_MAX
        self.bodies[number] = CellObstacle(slot, FOREVER_US if lasting else now_us + OBSTACLE_US)

    # ---------------------------------------------------------------- the plan's progress

    @property
    def going(self) -> bool:
        """Whether an agreed plan is being driven and we have a part in it."""
        return self.phase is GO and self.me != NONE

    @property
    def stranded(self) -> bool:
        """Whether the plan counts us as between two cells."""
        own = self._used.get(self.slot)
        return own is not None and own.answer is AgreementReply.BUSY

    def reached(self, robot: int) -> int:
        """The number of the step that a robot of the plan has announced, by its index in the plan;
        0: the start."""
        assert self.course is not None
        return self._reached.get(self.course.slots[robot], 0)

    def reach(self, step: int) -> None:
        """We have reached this step of the plan, or are so near that we shall."""
        self._reached[self.slot] = max(step, self._reached.get(self.slot, 0))

    def may(self, step: int) -> bool:
        """Whether we may begin that step: the cell is free, or the robot in it may leave it.

        Robots that move on together form a ring, or a chain with a free cell before the first robot.
        """
        assert self.course is not None
        robot, chain = self.me, set[int]()
        while robot not in chain:
            chain.add(robot)
            wait = self.course.wait(robot, step)
            if wait.robot == NONE or self.reached(wait.robot) >= wait.leaves:
                return True
            if self.reached(wait.robot) < wait.step:
                return False
            robot = wait.robot
        return True

    def leaving(self, step: int) -> tuple[int, int]:
        """For the robot in the cell of our step: its cell one step before it leaves, and its next cell.

        Twice -1: it has gone.
        """
        assert self.course is not None
        other, _, leaves = self.course.wait(self.me, step)
        if other == NONE or self.reached(other) >= leaves:
            return NONE, NONE
        return self.course.place(other, max(0, leaves - 2)), self.course.place(other, leaves)

    def passed(self, slot: int) -> list[int]:
        """Cells that a robot has certainly gone through: up to the one before it said it was at."""
        if self.course is None or slot not in self.course.slots or self.phase is FREE:
            return []
        robot, step = self.course.slots.index(slot), self._told_step(slot)
        return [self.course.place(robot, s) for s in range(step)]

    def bound_for(self, slot: int) -> tuple[int, int]:
        """The cell that a robot has said it is at, or nearly, and the one it came from."""
        assert self.course is not None
        robot, step = self.course.slots.index(slot), self._told_step(slot)
        number = before = self.course.place(robot, step)
        while step > 0 and before == number:
            step -= 1
            before = self.course.place(robot, step)
        return number, before

    def _told_step(self, slot: int) -> int:
        """The step that a robot has said it is at; 0 if our course does not have it.

        The robot may be further in the plan than we have computed it, or say a step that is in no plan.
        """
        assert self.course is not None
        return self.course.told_step(self._reached.get(slot, 0))

    # ---------------------------------------------------------------- time

    def on_tick(
        self, number: int, answer: AgreementReply, ready: bool, crew: FleetSnapshot, now_us: int
    ) -> None:
        """One control period: call a round, gather, or agree, whichever is due.

        `number`: the cell in whose middle we are, -1 on the way, or where we are in none. `ready`: all
        that we have covered is part of our replica.
        """
        if self._call_due(answer, crew, now_us):
            self.call(now_us)
            return
        if self.phase is GATHER:
            nowhere = number == NONE and answer is AgreementReply.STOPPED
            if ready and (number != NONE or nowhere):
                told = NOWHERE if nowhere else number
                self._places[self.slot] = CellPlace(told, self._detail(crew), answer)
            self._gather(crew, now_us)
        if self.phase is AGREE:
            self._agree(crew, now_us)
        waiting = self.phase in (GATHER, AGREE)
        if waiting and now_us - self._news_at_us > PATIENCE_US and number != NONE:
            self.call(now_us)

    def _call_due(self, answer: AgreementReply, crew: FleetSnapshot, now_us: int) -> bool:
        if self.phase in (GATHER, AGREE):
            return False
        own = self._used.get(self.slot)
        same = self._announcing(crew) == self._used.keys()
        same = same and own is not None and own.answer == answer
        if same and not self._over(crew, now_us):
            self._differs_at_us = None
            return False
        if self._differs_at_us is None:
            self._differs_at_us = now_us
        rank = sum(slot < self.slot for slot in crew.live)
        early = self.phase is FREE and len(crew.live) == 1
        settle_for_us = BOOT_US if early else SETTLE_US
        return now_us - self._differs_at_us >= settle_for_us + rank * STAGGER_US

    def _announcing(self, crew: FleetSnapshot) -> set[int]:
        """The live members that know where they are, or have announced it in this round."""
        return {s for s in crew.live if s in self._places or s not in crew.placeless}

    @property
    def later(self) -> bool:
        """Whether something is left out of the plan that can perhaps be done at another time."""
        passing = any(body.ends_at_us < FOREVER_US for body in self.bodies.values())
        return self._left_out and (self.kept or passing)

    def _over(self, crew: FleetSnapshot, now_us: int) -> bool:
        """Our part is done, and what was left out of it can be done now."""
        if not self.going or self.course is None or not self.later:
            return False
        step = self._reached.get(self.slot, 0)
        if self.course.reaches(step + 1):
            return False
        start_at_us = max(crew.fell_silent_at_us.values(), default=0)
        if self.kept and now_us - start_at_us > LEASE_US and self._done(crew.progress):
            return True
        return any(body.ends_at_us <= now_us for body in self.bodies.values())

    def _done(self, progress: Progress) -> bool:
        assert self.course is not None
        return bool(covered_of(self.ground, progress)[self.course.todo].all())

    def _gather(self, crew: FleetSnapshot, now_us: int) -> None:
        places = {slot: p for slot, p in self._places.items() if slot in crew.live}
        waited = now_us - self.begun_at_us > PLACELESS_US
        expected = self._announcing(crew) if waited else crew.live
        if places.keys() < expected or self.slot not in places:
            return
        if not self._is_equal(places.values()):
            return  # the sync makes them equal
        movers = [p.number for p in places.values() if p.answer is AgreementReply.GRANT]
        stand = self._standing(places)
        if len(set(movers)) < len(movers) or not stand.isdisjoint(movers):
            return  # one place is outdated; its robot will announce another
        if places.keys() != self._used.keys():
            self._forget_lasting()
        self._used = places
        self._compute(crew, now_us)
        self.machine.fire(CoveragePlanEvent.GATHERED)
        self._news_at_us = now_us

    def _forget_lasting(self) -> None:
        """Other members plan: unannounced bodies that were taken to stay are tried again.

        A robot that does not drop one tells the others when the digests differ, so plans stay equal.
        """
        self._seen.clear()
        self.bodies = {
            number: body for number, body in self.bodies.items()
            if body.slot != ANYBODY or body.ends_at_us < FOREVER_US
        }  # fmt: skip

    def _detail(self, crew: FleetSnapshot) -> int:
        """24 bits that a robot sends with its place: the digest of what it knows as covered."""
        return crew.progress.digest

    def _is_equal(self, places: Iterable[CellPlace]) -> bool:
        """Whether the details of these places allow a plan: all know the same covered cells."""
        return len({place.digest for place in places}) <= 1

    def _standing(self, places: Mapping[int, CellPlace]) -> set[int]:
        """The cells of the robots that take no part, by the places of all."""
        stand = {p.number for p in places.values() if p.answer is not AgreementReply.GRANT}
        return {number for number in stand if number < len(self.ground)}

    def _movers(self, crew: FleetSnapshot, now_us: int) -> tuple[dict[int, int], set[int]]:
        """The cells of the robots that take part, by slot, and the cells that no robot enters."""
        self.bodies = {
            number: body for number, body in self.bodies.items()
            if body.ends_at_us > now_us + SPARE_US and body.slot not in crew.live
        }  # fmt: skip
        movers = {s: p.number for s, p in self._used.items() if p.answer is AgreementReply.GRANT}
        stand = self._standing(self._used)
        return movers, (stand | self.bodies.keys()) - set(movers.values())

    def _adopt(self, course: GridCourse, digest: int) -> None:
        """Take a course as the one to be agreed on, and announce the digest of its inputs."""
        self.course = course
        self.me = course.slots.index(self.slot) if self.slot in course.slots else NONE
        self._reached = {}
        self._plans[self.slot] = digest
        self._said.pop(AgreementKind.PLAN, None)

    def _compute(self, crew: FleetSnapshot, now_us: int) -> None:
        movers, blocked = self._movers(crew, now_us)
        covered = covered_of(self.ground, crew.progress)
        uncovered = ~covered
        ours_is_done = self.kept and self._done(crew.progress)
        kept = np.zeros_like(covered) if ours_is_done else self._kept(covered, crew)
        self.kept = bool(kept.any())
        covered |= kept
        covered[list(blocked)] = True
        slots = tuple(sorted(movers))
        terms = CourseInputs(
            slots, tuple(movers[s] for s in slots), np.packbits(covered).tobytes(),
            tuple(sorted(blocked)), self.turn_cost,
        )  # fmt: skip
        course = course_of(self.ground, terms)
        uncovered[course.todo] = False
        rooms = self.ground.room[self.ground.padded]
        self._left_out = bool((uncovered & np.isin(rooms, rooms[list(movers.values())])).any())
        self._adopt(course, terms.digest(self.ground))

    def _agree(self, crew: FleetSnapshot, now_us: int) -> None:
        places = {slot: p for slot, p in self._places.items() if slot in crew.live}
        if places != self._used:
            self.machine.fire(CoveragePlanEvent.CHANGED)
            return
        own = self._plans[self.slot]
        if all(self._plans.get(slot) == own for slot in self._used):
            self.machine.fire(CoveragePlanEvent.AGREED)
            self._news_at_us = now_us
        elif self.kept and not self._plain and now_us - self._news_at_us > PLAIN_US:
            self._plain = True
            self._compute(crew, now_us)

    # ---------------------------------------------------------------- who has what

    def _remember(self) -> None:
        """Remember the robot that each cell was assigned to by the last plan that all followed."""
        if self.course is None or self.phase is not GO:
            return
        self.course.finish()
        mine = self.course.owner != NONE
        slots = np.array(self.course.slots, np.int16)
        self.owner[mine] = slots[self.course.owner[mine]]

    def owing(self, progress: Progress, slots: Iterable[int]) -> list[int]:
        """Which of these slots have something left to do by the last plan."""
        left = self.owner[~covered_of(self.ground, progress)]
        return sorted(set(left.tolist()) & set(slots))

    def wrecks(self, crew: FleetSnapshot) -> list[int]:
        """Slots of silent robots that are taken to stand where their last command expired."""
        owing = self.owing(crew.progress, crew.fell_silent_at_us)
        return owing if len(owing) == 1 else []

    def _kept(self, covered: NDArray[np.bool_], crew: FleetSnapshot) -> NDArray[np.bool_]:
        """Cells that silent robots are believed to be working on."""
        owing = self.owing(crew.progress, crew.fell_silent_at_us)
        if self._plain or len(owing) < 2:
            return np.zeros_like(covered)
        theirs: NDArray[np.bool_] = np.isin(self.owner, owing) & ~covered
        return theirs

    # ---------------------------------------------------------------- saying

    def outgoing(self, now_us: int) -> list[AgreementMessage]:
        """What is due with this beat."""
        words: list[AgreementMessage] = []
        place = self._places.get(self.slot)
        if self.phase is FREE or (place is None and self.phase is GATHER):
            return words
        hurried = self.phase is not GO
        if place is not None and self._due(AgreementKind.PLACE, place, hurried, now_us):
            low, high = place.digest & 0xFFFF, place.digest >> 16
            words.append(
                AgreementMessage(
                    self.round, AgreementKind.PLACE, place.answer, place.number, low, high
                )
            )
        plan = self._plans.get(self.slot)
        if plan is None:
            return words
        if self._due(AgreementKind.PLAN, plan, hurried, now_us):
            words.append(
                AgreementMessage(self.round, AgreementKind.PLAN, 0, plan & 0xFFFF, plan >> 16, 0)
            )
            if any(self._plans.get(slot, plan) != plan for slot in self._used):
                words += [
                    AgreementMessage(
                        self.round,
                        AgreementKind.BODY,
                        0,
                        number,
                        body.slot,
                        int(body.ends_at_us == FOREVER_US),
                    )
                    for number, body in sorted(self.bodies.items())
                ]
        step = self._reached.get(self.slot, 0)
        if self.phase is GO and self._due(AgreementKind.AT, step, False, now_us):
            words.append(AgreementMessage(self.round, AgreementKind.AT, 0, step, plan & 0xFFFF, 0))
        return words

    def _due(self, say: AgreementKind, what: object, hurried: bool, now_us: int) -> bool:
        """Send news immediately, repeat it soon, and then rarely."""
        last, times, said_at_us = self._said.get(say, (None, 0, 0))
        if last == what:
            hurry_for_us = max(HURRY_US, HURRY_ROBOT_US * len(self._used))
            if now_us - said_at_us < (hurry_for_us if hurried or times < 2 else CALM_US):
                return False
        self._said[say] = (what, times + 1 if last == what else 1, now_us)
        return True


def covered_of(ground: CellMap, progress: Progress) -> NDArray[np.bool_]:
    """Whether each cell of the ground is covered, (cells,), by its number."""
    covered: NDArray[np.bool_] = np.zeros(len(ground), dtype=np.bool_)
    for section in ground.section_units:
        bits = progress.bits(section, 0)
        if bits:
            first = section * BLOCK_UNITS
            block = np.frombuffer(bits.to_bytes(5, "little"), np.uint8)
            units = np.unpackbits(block, bitorder="little")[: len(ground) - first]
            covered[first : first + BLOCK_UNITS] = units
    return covered
