"""Which robot works which free sections in which order, so that the last one finishes soonest.

Every robot plans for the whole fleet from the same replicated facts: the free sections, what is left
of each, and where and when each live robot will be free. Places and times are rounded, so that robots
whose views differ a little solve the same problem, and equal problems have equal plans. A robot acts
on the first section of its own row only, and plans again before it claims the next one. So delays,
deaths and joins change the next plan and need no messages. If views differ, claims decide.

The first plan is found by insertion and simulated annealing; later ones begin with the one before.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from agent.field.plan_kernels import exchanged, first_end, improve, insert_all
from agent.field.travel_times import Remainder, Solution, TravelTimes, Whole, nearest_jobs
from agent.interface.geometry import Point
from agent.mapf.linear_assignment import assigned

# Moves of the search. 400,000 take 0.2 s of a small computer; a plan that begins with the one before
# needs fewer, because little has changed.
FIRST_MOVES: Final = 400_000
AGAIN_MOVES: Final = 100_000
# First and last temperature, milliseconds: a move may cost a tenth of a section, or a fifth of a second.
# A cooler first search (5 s to 50 ms) made plans 4 % shorter, and the drive of `small` 11 % longer.
HOT_MS, AGAIN_HOT_MS, COLD_MS = 20_000.0, 5_000.0, 200.0
# Of the squares of all finishes in the cost. A fleet with one robot that is late still gains by less
# driving of the others.
SUM_SHARE: Final = 0.02
LATE_COST: Final = 1000  # of a millisecond after the last finish, in those of ways
NEAR: Final = 12  # neighbours of a section that moves consider
JOBS_MAX: Final = 256  # more free sections are planned in runs (`agent/field/section_shares.py`)
PLACE_STEP_M: Final = 0.5  # of rounded places; a robot drives it in 0.2 s
TIME_STEP_MS: Final = 1000  # of rounded times
PLANS_KEPT: Final = 4  # of the newest problems: the peers of one process ask one after another

Rows = dict[int, list[int]]  # slot -> its sections, in its order


class FreedRobot(NamedTuple):
    """Where and when a robot will have worked what it holds."""

    place: Point  # metres
    ready_at_ms: int


class PlanProblem(NamedTuple):
    """A problem in the form that the kernels take; `agent/field/plan_kernels.py` names the arrays."""

    ready: Whole
    lead: Whole
    work: Whole
    link: Whole


class FleetPlan:
    """The newest plan of one peer."""

    def __init__(self, travel: TravelTimes, seed: int = 0) -> None:
        """`seed`: of the search. Robots use 0, so that equal problems have equal plans."""
        self.travel, self.seed = travel, seed
        self.rows: Rows = {}
        self.entries: dict[int, int] = {}  # section that is first in a row -> the end to enter at
        self.last_finish_at_ms = 0

    def plan(
        self,
        left: Mapping[int, Remainder | None],
        robots: Mapping[int, FreedRobot],
    ) -> Rows:
        """Plan the free sections, by number, for these robots, by slot.

        `left`: what is left of each; None: all.
        """
        slots, jobs = sorted(robots), sorted(left)
        if not jobs or not slots:
            self.rows = {slot: [] for slot in slots}
            return self.rows
        problem = self.problem(left, [robots[s] for s in slots])
        kept = self._kept(slots, jobs)
        rows, ends, self.last_finish_at_ms = self._solved(problem, kept)
        self.rows = {slot: [jobs[j] for j in row] for slot, row in zip(slots, rows, strict=True)}
        self.entries = {jobs[row[0]]: end for row, end in zip(rows, ends, strict=True) if row}
        return self.rows

    def problem(
        self,
        left: Mapping[int, Remainder | None],
        robots: Sequence[FreedRobot],
    ) -> PlanProblem:
        """The problem of these sections, in the order of their numbers, and these robots."""
        jobs = sorted(left)
        ends = np.array([2 * job + end for job in jobs for end in range(2)], dtype=np.int64)
        places = [_rounded(robot.place) for robot in robots]
        problem = PlanProblem(
            np.array([_whole_seconds(robot.ready_at_ms) for robot in robots], dtype=np.int64),
            np.array([self.travel.lead_for_ms(place)[ends] for place in places]),
            self.travel.work_for_ms[jobs],
            np.ascontiguousarray(self.travel.link_for_ms[np.ix_(ends, ends)]),
        )
        begun = [(j, rest) for j, job in enumerate(jobs) if (rest := left[job]) is not None]
        at = [(2 * j + end, rest.ends[end]) for j, rest in begun for end in range(2)]
        for j, rest in begun:
            problem.work[j] = rest.work_for_ms
        for i, place in at:
            problem.link[i, :] = problem.link[:, i] = self.travel.lead_for_ms(place)[ends]
            problem.lead[:, i] = [self.travel.way_for_ms(start, place) for start in places]
        for (i, a), (j, b) in combinations(at, 2):
            problem.link[i, j] = problem.link[j, i] = self.travel.way_for_ms(a, b)
        return problem

    def _solved(self, problem: PlanProblem, begun: list[list[int]] | None) -> Solution:
        """`solve`, once for all peers of a process that have the same problem."""
        key = b"".join(array.tobytes() for array in problem) + repr((begun, self.seed)).encode()
        plans = self.travel.plans
        found = plans.get(key)
        if found is None:
            if len(plans) >= PLANS_KEPT:
                plans.clear()
            found = plans[key] = solve(problem, begun, self.seed)
        return found

    def _kept(self, slots: Sequence[int], jobs: Sequence[int]) -> list[list[int]] | None:
        """The rows of the plan before, as far as they still hold; None: nothing of them does.

        They hold for the same robots. Sections that were not planned go behind the shortest row.
        """
        if set(self.rows) != set(slots) or not any(self.rows.values()):
            return None
        at = {section: j for j, section in enumerate(jobs)}
        rows = [[at.pop(section) for section in self.rows[s] if section in at] for s in slots]
        for j in sorted(at.values()):
            min(rows, key=len).append(j)
        return rows


def solve(problem: PlanProblem, begun: Sequence[Sequence[int]] | None, seed: int = 0) -> Solution:
    """A good plan. `begun`: the rows to begin with; None: none. Equal arguments give equal plans."""
    ready, lead, work, link = problem
    jobs = len(work)
    route = np.zeros((len(ready), jobs), dtype=np.int64)
    size = np.zeros(len(ready), dtype=np.int64)
    if begun is None:
        insert_all(route, size, ready, lead, work, link)
    else:
        for r, row in enumerate(begun):
            route[r, : len(row)], size[r] = row, len(row)
    moves, hot_for_ms = (FIRST_MOVES, HOT_MS) if begun is None else (AGAIN_MOVES, AGAIN_HOT_MS)
    state = np.full(1, seed, dtype=np.uint64)
    last_at_ms = improve(
        route, size, ready, lead, work, link, nearest_jobs(link, NEAR), moves, hot_for_ms, COLD_MS,
        SUM_SHARE, state,
    )  # fmt: skip
    _uncross(route, size, problem, int(last_at_ms))
    rows = [route[r, : size[r]].tolist() for r in range(len(ready))]
    ends = [
        int(first_end(r, route[r], size[r], ready, lead, work, link)) if rows[r] else 0
        for r in range(len(ready))
    ]
    return Solution(rows, ends, int(last_at_ms))


def _uncross(route: Whole, size: Whole, problem: PlanProblem, last_at_ms: int) -> None:
    """Deal the rows to the robots so that the ways to their first sections are shortest in sum, and no
    row ends after `last_at_ms`.

    Robots that stand side by side then do not cross each other's way: two ways that cross are longer
    than the same two, exchanged.
    """
    ways, ends = exchanged(route, size, *problem)
    row_of = assigned(ways + LATE_COST * np.maximum(ends - last_at_ms, 0))
    route[:], size[:] = route[row_of], size[row_of]


def _rounded(place: Point) -> Point:
    return (
        round(place[0] / PLACE_STEP_M) * PLACE_STEP_M,
        round(place[1] / PLACE_STEP_M) * PLACE_STEP_M,
    )


def _whole_seconds(time_ms: int) -> int:
    return round(time_ms / TIME_STEP_MS) * TIME_STEP_MS
