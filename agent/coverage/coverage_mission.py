"""A mission: cover a grid map together, by plans that the whole fleet agrees on.

The plan says where to go, the rounds when (`agent/coverage/plan_agreement.py`); this mission drives
from cell to cell. Claims of sections inform observers and robots that join later which robot has
begun what. A section is done when all its cells are covered, by any robot.

A robot is never sent out of a joint plan, so the mission accepts no goal: an operator holds the
robot, and the others go round it.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import cos, hypot, sin
from random import Random

from agent.coverage.cell_map import NONE, CellMap
from agent.coverage.plan_agreement import ANYBODY, CoverageAgreement, FleetSnapshot
from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, GONE_QUIET_US, MS, S
from agent.interface.lifecycle import ABLE, State
from agent.interface.mission import (
    STILL,
    ClaimRequest,
    CoveredUnits,
    FleetView,
    Mission,
    MotionRequest,
    Record,
)
from agent.mapf.agreement_phase import AgreementPhase
from crdt import Phase
from protocol.frames.agreement_frames import AgreementMessage, AgreementReply
from protocol.frames.messages import Message

# A cell counts as covered when a robot's centre is this close to its own (share of a cell).
COVERED = 0.1
BOUND = 0.5  # share of the way into a cell from which a robot goes on and announces the cell
CLOSE = 0.1  # share of a cell by which a robot that follows round a corner may begin too early
# Share of a cell: a body this far off the middle blocks the next cell too. That cell has 0.7 left,
# of which the guard keeps 0.6, and a cell is covered from 0.1.
ASTRIDE = 0.3
NEAR = 0.8  # share of a cell: a body this near to a cell's middle is in it
BACK_US = 1500 * MS  # after being held up for this long on the way, go back and wait
GATHER_BACK_US = 200 * MS  # the same while all robots stop, because the robot ahead will not go on
WAIT_US = 1 * S  # wait there before the next try; both times are random, up to twice as long
STUCK_US = 4 * S  # after this a body in the way counts as an obstacle outside our plan
TELL_US = 20 * MS  # by rank: one robot announces a dead robot's cells, and the others overhear it
AHEAD = 60  # steps searched ahead for cells of a section: longer than there and back again
# Between two cells for this long in a round while it may drive: it cannot go on, and the cell behind it
# is taken. Driving on or going back takes less than 2 s with its waits; the others call the next round
# after 5 s.
STRANDED_US = 3 * S
LEFT_US = 1 * S  # between searches for covered sections that no robot has marked as done
# Not allowed to drive for this long: exceeds a protective stop or a sync (2 s each).
HELD_US = 5 * S
PERIOD_S = CONTROL_PERIOD_US / S


class GridWork(Mission):
    """One robot's part in covering a grid: it drives the agreed plan and announces what it has
    covered."""

    def __init__(
        self, slot: int, ground: CellMap, speed_m_s: float, rng: Random, turn_cost: float = 0.0
    ) -> None:
        self.slot, self.ground, self.speed_m_s, self.rng = slot, ground, speed_m_s, rng
        self.agreement = CoverageAgreement(slot, ground, turn_cost)
        self._from = self._to = NONE  # cells: the middle we left last, and the one we drive to
        self._step = 0  # the step of the plan that we are at or were at last
        self._onward = False  # to the next step's cell, not back
        self._round = -1
        self._news: list[tuple[int, int]] = []
        self._told: set[int] = set()  # cells in our news that our replica does not have yet
        self._at_once = False
        self._section: int | None = None
        self._turn = 0  # index of the first of the plan's turns that we have not had
        self._wish = STILL
        self._asked = False  # whether our motion request went to the drive the last time
        self._asked_at_us = 0  # when that was last the case
        self._held_at_us = 0  # since when we have made no progress; 0: we are making progress
        self._strayed_at_us = 0  # since when we have not reached a cell that we may enter
        self._wait_ends_at_us = 0  # we stand until then
        self._cut_off_at_us = 0
        self._stranded = False  # between two cells, until the one behind is free
        self._stopped_at_us = 0  # when it was last not up to us whether the robot drives
        self._last = (0.0, 0.0)

    @property
    def section_units(self) -> Mapping[int, int]:
        return self.ground.section_units

    @property
    def over(self) -> bool:
        """Our plan is at its end, or we have no part in it, nothing is left for later, and all that we
        have covered is in our replica."""
        rounds = self.agreement
        if self._told:
            return False
        if rounds.phase is not AgreementPhase.GO or rounds.course is None or rounds.later:
            return False
        if rounds.me == NONE:
            return not rounds.stranded  # from between two cells it comes back, and calls a round
        return not rounds.course.reaches(self._step + 1)

    # ---------------------------------------------------------------- each control period

    def on_control_period(self, view: FleetView, state: State) -> None:
        here, now_us = view.here, view.now_us
        if self._to == NONE:
            self._asked_at_us = now_us
            if view.placed:
                self._from = self._to = self.ground.at(here.x_m, here.y_m)
        elif view.placed and self._is_displaced(view):
            self._begin_here(view)
        if view.placed:
            self._sweep(view)
        self._forget_told(view)
        rounds = self.agreement
        if rounds.round != self._round:
            self._round, self._step, self._turn = rounds.round, 0, 0
            self._onward = False
            self._meet_wrecks(view)
        gathering = rounds.phase is not AgreementPhase.GO
        if gathering:
            self._tell_of_silent(view)
        self._at_once = gathering
        # A robot that was put down beside the map takes no part until it is put into a free cell.
        free = state in ABLE and now_us - self._asked_at_us < HELD_US and self._to != NONE
        number = self._standing(view, free, gathering)
        answer = AgreementReply.BUSY if self._stranded else AgreementReply.GRANT
        if not free:
            answer = AgreementReply.STOPPED
        crew = FleetSnapshot(
            view.live, view.fell_silent_at_us, view.progress, self._placeless(view)
        )
        rounds.on_tick(number, answer, not self._told, crew, now_us)
        self._note_holding(view)
        self._wish = self._drive(view)
        self._asked = False

    def _placeless(self, view: FleetView) -> frozenset[int]:
        """Live members that do not know where they are: their newest place is not a new one."""
        stale_at_us = view.now_us - GONE_QUIET_US
        return frozenset(
            s for s, n in view.neighbours.items() if n.heard_at_us <= stale_at_us and s in view.live
        )

    def _standing(self, view: FleetView, free: bool, gathering: bool) -> int:
        """The cell that we are in the middle of; a robot that cannot move counts as in its cell.

        A robot behind a wreck may stand between that cell and the one it left, which the next robot
        has entered. It counts as in the nearer cell, and goes back when the other has gone.
        """
        here = view.here
        near = self._from != NONE and (self._off_m(view, self._from) < COVERED * self.ground.cell_m)
        if not self._asked:
            self._stopped_at_us = view.now_us  # it drives on to the next cell after the stop
        start_at_us = max(self.agreement.begun_at_us, self._stopped_at_us)
        if self._from == self._to and near:
            self._stranded = False
        elif gathering and view.now_us - start_at_us > STRANDED_US:
            self._stranded = True
        if not free or self._stranded:
            return self.ground.at(here.x_m, here.y_m)
        return self._from if self._from == self._to and near else NONE

    def covered_units(self) -> CoveredUnits:
        news, self._news = tuple(self._news), []
        return CoveredUnits(news, self._at_once)

    def _forget_told(self, view: FleetView) -> None:
        """Forget the news that our replica has by now."""
        self._told = {n for n in self._told if not view.progress.has(*self.ground.unit(n))}

    def _is_displaced(self, view: FleetView) -> bool:
        """Whether people have moved us out of our cells: a straight way back may lead through a wall."""
        here_m = min(self._off_m(view, self._from), self._off_m(view, self._to))
        return here_m >= NEAR * self.ground.cell_m

    def _begin_here(self, view: FleetView) -> None:
        """Begin again in the cell that we are in now, with a new plan; stand if there is none."""
        self._from = self._to = self.ground.at(view.here.x_m, view.here.y_m)
        self._held_at_us = self._strayed_at_us = self._wait_ends_at_us = 0
        self._onward = False
        if self.agreement.phase is not AgreementPhase.FREE:
            self.agreement.call(view.now_us)

    def _off_m(self, view: FleetView, number: int) -> float:
        x_m, y_m = self.ground.centre(number)
        return hypot(x_m - view.here.x_m, y_m - view.here.y_m)

    def _sweep(self, view: FleetView) -> None:
        """Mark the cell that we stand on as covered."""
        number = self.ground.at(view.here.x_m, view.here.y_m)
        if number == NONE or number in self._told:
            return
        if self._off_m(view, number) <= COVERED * self.ground.cell_m:
            self._tell(number, view)

    def _tell(self, number: int, view: FleetView) -> None:
        unit = self.ground.unit(number)
        if not view.progress.has(*unit) and number not in self._told:
            self._told.add(number)
            self._news.append(unit)

    # ---------------------------------------------------------------- frames

    def on_message(self, slot: int | None, message: Message, now_us: int) -> Sequence[Record]:
        if slot is not None and isinstance(message, AgreementMessage):
            self.agreement.on_message(slot, message, now_us)
        return ()

    def outgoing(self, now_us: int) -> Iterable[Message]:
        return self.agreement.outgoing(now_us)

    # ---------------------------------------------------------------- of those that are silent

    def _tell_of_silent(self, view: FleetView) -> None:
        """Announce the cells that silent robots had reported as reached: these are covered."""
        rank = sum(slot < self.slot for slot in view.live)
        if (
            view.now_us < self.agreement.begun_at_us + rank * TELL_US
            or self.agreement.course is None
        ):
            return
        for slot in view.fell_silent_at_us:
            for number in self.agreement.passed(slot):
                self._tell(number, view)
            if slot in self.agreement.course.slots and slot in view.neighbours:
                pose = view.neighbours[slot].pose
                number, before = self.agreement.bound_for(slot)
                x_m, y_m = self.ground.centre(before)
                gone_m = hypot(pose.x_m - x_m, pose.y_m - y_m)
                if number == before or gone_m >= (1.0 - COVERED) * self.ground.cell_m:
                    self._tell(number, view)

    def _meet_wrecks(self, view: FleetView) -> None:
        """Mark the cells of robots that fell silent: each stands where its last command expired."""
        crew = FleetSnapshot(view.live, view.fell_silent_at_us, view.progress)
        for slot in self.agreement.wrecks(crew):
            if slot in view.neighbours:
                self._meet_wreck(slot, view)

    def _meet_wreck(self, slot: int, view: FleetView) -> None:
        pose = view.neighbours[slot].pose
        on_m = pose.speed_m_s * ACTUATOR_TTL_US / S
        at_x_m = pose.x_m + on_m * cos(pose.course_rad)
        at_y_m = pose.y_m + on_m * sin(pose.course_rad)
        row, column = self.ground.cell_at(at_x_m, at_y_m)
        x_m, y_m = self.ground.centre_of((row, column))
        cells = [(row, column)]
        for off_m, step in ((at_x_m - x_m, (0, 1)), (y_m - at_y_m, (1, 0))):
            if abs(off_m) > ASTRIDE * self.ground.cell_m:
                sign = 1 if off_m > 0 else -1
                cells.append((row + sign * step[0], column + sign * step[1]))
        for cell in cells:
            if self.ground.number(cell) != NONE:
                self.agreement.meet(self.ground.number(cell), slot, view.now_us)

    # ---------------------------------------------------------------- driving

    def _note_holding(self, view: FleetView) -> None:
        """Note whether the guard holds us up: we wanted to drive, were allowed to, and have not
        moved."""
        at = (view.here.x_m, view.here.y_m)
        moved_m = hypot(at[0] - self._last[0], at[1] - self._last[1])
        self._last = at
        wanted_m = hypot(self._wish.vx_m_s, self._wish.vy_m_s) * PERIOD_S
        if not self._asked or wanted_m == 0.0 or moved_m > 0.2 * wanted_m:
            self._held_at_us = 0
        elif not self._held_at_us:
            self._held_at_us = view.now_us
            self._strayed_at_us = self._strayed_at_us or view.now_us

    def _drive(self, view: FleetView) -> MotionRequest:
        here, now_us = view.here, view.now_us
        if self._to == NONE:
            return STILL
        speed_m = self.speed_m_s * PERIOD_S
        x_m, y_m = self.ground.centre(self._to)
        dx, dy = x_m - here.x_m, y_m - here.y_m
        left_m = hypot(dx, dy)
        if self._from != self._to:
            self._bind(left_m)
            if left_m <= speed_m:
                self._arrive()
            elif self._held_at_us and self._turns_back(left_m, now_us):
                return STILL
        if self._from == self._to and now_us >= self._wait_ends_at_us and self._next(view):
            # Past the middle, and on from there with what is left of the period.
            nx, ny = self.ground.centre(self._to)
            ex, ey = (nx - x_m) / self.ground.cell_m, (ny - y_m) / self.ground.cell_m
            rest_m = max(0.0, speed_m - left_m)
            dx, dy = dx + ex * rest_m, dy + ey * rest_m
            left_m = hypot(dx, dy)
        if (self._from == self._to or self._held_at_us) and self._is_stuck(now_us):
            self._report(view)
        scale = min(1.0, speed_m / left_m) / PERIOD_S if left_m > 1e-6 else 0.0
        return MotionRequest(dx * scale, dy * scale, tool_on=True)

    def _bind(self, left_m: float) -> None:
        if self._onward and left_m <= (1.0 - BOUND) * self.ground.cell_m:
            self.agreement.reach(self._step + 1)

    def _arrive(self) -> None:
        self._from = self._to
        if self._onward:
            self._step += 1
            self._strayed_at_us = 0
        self._onward = False

    def _next(self, view: FleetView) -> bool:
        """Set out for the next cell of the plan, if the robot may.

        Steps of the plan in which the robot stands are passed over, because it waits only for
        others.
        """
        rounds = self.agreement
        if not rounds.going or rounds.course is None:
            return False
        while rounds.course.reaches(self._step + 1):
            to = rounds.course.place(rounds.me, self._step + 1)
            if to != self._from:
                if not (rounds.may(self._step + 1) and self._is_behind(to, view)):
                    break
                self._to, self._onward = to, True
                rounds.reach(self._step)
                return True
            self._step += 1
        rounds.reach(self._step)
        return False

    def _is_behind(self, to: int, view: FleetView) -> bool:
        """Whether the robot that must leave that cell as we come has reached its middle, by our sensors.

        It announces the cell half a cell early, so coming from the side we would be there before it.
        """
        cell_m, (before, on) = self.ground.cell_m, self.agreement.leaving(self._step + 1)
        if on == NONE:
            return True
        (x_m, y_m), (on_x_m, on_y_m) = self.ground.centre(to), self.ground.centre(on)
        for bx_m, by_m in view.here.bodies:
            dx_m, dy_m = view.here.x_m + bx_m - x_m, view.here.y_m + by_m - y_m
            if CLOSE * cell_m < hypot(dx_m, dy_m) < NEAR * cell_m:
                out_m = (dx_m * (on_x_m - x_m) + dy_m * (on_y_m - y_m)) / cell_m
                if before == on or out_m < CLOSE * cell_m:
                    return False
        return True

    def _turns_back(self, left_m: float, now_us: int) -> bool:
        """Whether a robot that is held up goes back to the cell that it came from, so that others
        can pass.

        It does not where it has announced the next cell.
        """
        bound = self._onward and left_m <= (1.0 - BOUND) * self.ground.cell_m
        back_for_us = BACK_US if self.agreement.going else GATHER_BACK_US
        if bound or now_us - self._held_at_us < back_for_us:
            return False
        self._from, self._to = self._to, self._from
        self._held_at_us, self._onward = 0, not self._onward and self._is_next(self._to)
        self._wait_ends_at_us = now_us + round(WAIT_US * (1.0 + self.rng.random()))
        return True

    def _is_next(self, number: int) -> bool:
        rounds = self.agreement
        if not rounds.going or rounds.course is None or not rounds.course.reaches(self._step + 1):
            return False
        return rounds.course.place(rounds.me, self._step + 1) == number

    def _is_stuck(self, now_us: int) -> bool:
        start_at_us = self._strayed_at_us
        return self.agreement.going and start_at_us > 0 and now_us - start_at_us > STUCK_US

    def _report(self, view: FleetView) -> None:
        """Report a body that stays in the cell that we may enter as an obstacle, and call a new
        round."""
        self._strayed_at_us = 0
        rounds = self.agreement
        assert rounds.course is not None
        if not rounds.course.reaches(self._step + 1):
            return
        number = rounds.course.place(rounds.me, self._step + 1)
        x_m, y_m = self.ground.centre(number)
        for bx, by in view.here.bodies:
            gap_m = hypot(view.here.x_m + bx - x_m, view.here.y_m + by - y_m)
            if gap_m < NEAR * self.ground.cell_m:
                rounds.meet(number, ANYBODY, view.now_us)
                rounds.call(view.now_us)
                return

    # ---------------------------------------------------------------- sections

    def choose(self, view: FleetView) -> ClaimRequest | None:
        if not self.agreement.going:
            return None
        section = self._coming(view)
        if section is not None:
            choice = self._choice(section, view.live, view)
            if choice is not None:
                return choice
        if view.now_us < self._cut_off_at_us:
            return None
        self._cut_off_at_us = view.now_us + LEFT_US
        return self._unfinished(view)

    def _choice(self, section: int, owners: frozenset[int], view: FleetView) -> ClaimRequest | None:
        """A claim of a section that is free, or held by none of these robots."""
        phase = view.allocation.phase_of(section)
        if phase is Phase.FREE:
            return ClaimRequest(section, 0)
        gone = view.allocation.owner_of(section) not in owners
        gone = gone and not view.allocation.stays(section)
        return ClaimRequest(section, 0, takeover=True) if gone and phase is not Phase.DONE else None

    def _coming(self, view: FleetView) -> int | None:
        """The section of the next cell that we are to cover."""
        rounds = self.agreement
        assert rounds.course is not None
        turns = rounds.course.turns[rounds.me]
        while self._turn < len(turns) and turns[self._turn][0] <= self._step:
            self._turn += 1
        return self.ground.unit(turns[self._turn][1])[0] if self._turn < len(turns) else None

    def _unfinished(self, view: FleetView) -> ClaimRequest | None:
        """A covered section that no robot of the plan marks as done.

        A robot that stands is live, but has no part in the plan, and does not mark what it has claimed.
        """
        rounds = self.agreement
        assert rounds.course is not None
        planned = view.live.intersection(rounds.course.slots)
        rank = sum(slot < self.slot for slot in planned)
        for section in range(rank, len(self.ground.section_units), max(1, len(planned))):
            if view.progress.complete(section):
                if view.allocation.owner_of(section) == self.slot:
                    continue
                choice = self._choice(section, planned, view)
                if choice is not None:
                    return choice
        return None

    def begin(self, section: int, view: FleetView) -> None:
        self._section = section

    def abandon(self) -> None:
        self._section = None

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        return self.idle(view)

    def idle(self, view: FleetView) -> MotionRequest:
        self._asked, self._asked_at_us = True, view.now_us
        return self._wish

    def work(self, view: FleetView) -> MotionRequest:
        self._asked, self._asked_at_us = True, view.now_us
        if self._section is None:  # the section was claimed before a stop or a restart
            self._section = view.allocation.assigned_sections(view.slot)[0]
        if view.progress.complete(self._section):
            self._section = None
            return self._wish._replace(finished=True)
        if self.agreement.going and not self._comes_to(self._section, view):
            self._section = None
            return self._wish._replace(given_up=True)
        return self._wish

    def _comes_to(self, section: int, view: FleetView) -> bool:
        """Whether we shall cover anything in a section soon, or have just done so."""
        rounds = self.agreement
        assert rounds.course is not None
        rounds.course.reaches(self._step + AHEAD)
        self._coming(view)
        coming = rounds.course.turns[rounds.me][self._turn : self._turn + AHEAD]
        if any(self.ground.unit(number)[0] == section for _, number in coming):
            return True
        return any(self.ground.unit(number)[0] == section for number in self._told)
