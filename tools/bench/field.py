"""Work in fields against a plan that OR-Tools makes for the whole fleet in one place.

`tools/bench/field_opponent.py` is the opponent. Its plan is not driven: no robot is in another's way, and
nothing is sent. The fleet's own time is that of true bodies. Tractors have an opponent of their own
(`tools/bench/field_tractors.py`).
"""

from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Final

import numpy as np

from agent.field.fleet_plan import FleetPlan, FreedRobot
from agent.field.travel_times import Remainder
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench.drawn_fields import drawn_setup
from tools.bench.field_changes import FleetChange, changed_run
from tools.bench.field_opponent import central_plan_s, problem_at, problem_of, snake_s
from tools.bench.field_tractors import tractor_problem
from tools.bench.figure import Figure
from tools.bench.last_sections import ideal_split
from tools.bench.standing_times import standing_times

SEARCH_S, QUICK_SEARCH_S = 40.0, 5.0
QUICK: Final = (("small", 3),)
CASES: Final = (
    ("small", 3), ("small", 6), ("oxted", 6), ("oxted", 12), ("oxted", 24),
    ("curitiba", 8), ("curitiba", 16),
)  # fmt: skip
MEAN_MAX, WORST_MAX = 1.03, 1.10
ALONE: Final = ("small", "oxted", "curitiba")
ALONE_MAX = 1.02
CHANGES: Final = (("small", 6), ("oxted", 6), ("curitiba", 8))
CHANGE_MAX = 1.10
DRAWN: Final = (*range(50), *range(1000, 1020))
QUICK_DRAWN: Final = (8, 18, 32, 1012)  # of few robots, so that they take seconds
IDLE_MAX = {6: 0.04, 24: 0.08}
SPEED_LEAST = {("oxted", 6): 60.0, ("oxted", 24): 12.0}  # times real time
TRACTORS: Final = (("small", 3), ("small", 6), ("curitiba", 3), ("curitiba", 6), ("oxted", 6))
TRACTORS_MAX = 1.15
PLANNING: Final = ("oxted", 24)
PLANNING_MAX_MS = 200.0


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """One figure for the time of each fleet and field, and their mean and worst."""
    search_s = QUICK_SEARCH_S if quick else SEARCH_S
    against = f"OR-Tools {version('ortools')}, guided local search, {search_s:g} s"
    ratios, whole = list[float](), True
    for name, robots in QUICK if quick else CASES:
        setup = FieldSetup(load(name).changed(robots, seed))
        run = FieldRun(setup)
        began_s = process_time()
        outcome = run.run()
        computed_s = process_time() - began_s
        planned_s = central_plan_s(problem_of(setup), search_s)
        ratios.append(outcome.makespan_s / planned_s)
        whole &= outcome.success
        stands = standing_times(list(run.tracks.values()), outcome.makespan_s)
        idle = stands.total_s / outcome.makespan_s
        scope = (
            f"{len(setup.field.sections)} sections, {outcome.makespan_s:.0f} s driven against "
            f"{planned_s:.0f} s planned; same sections, starts, paths and bodies; seed {seed}"
        )
        yield Figure(f"makespan, {name}, {robots} robots", ratios[-1], "x", f"<= {WORST_MAX:g}",
                     ratios[-1] <= WORST_MAX and outcome.success, against, scope)  # fmt: skip
        yield _speed(name, robots, outcome.makespan_s / computed_s)
        most = IDLE_MAX.get(robots)
        yield Figure(f"time standing, {name}, {robots} robots", idle, "",
                     "" if most is None else f"<= {most:g}", None if most is None else idle <= most,
                     "", "mean share of the robots until the fleet's end; of "
                     f"{stands.total_s:.1f} s, {stands.before_s:.1f} s before they leave and "
                     f"{stands.after_s:.1f} s after their last work; seed {seed}")  # fmt: skip
        split = ideal_split(run.tracks, setup.vehicle.speed_m_s)
        yield Figure(f"end if last sections were split, {name}, {robots} robots",
                     split.split_end_s / split.end_s, "x", "", None, "",
                     f"of {split.end_s:.0f} s, {split.splits} splits with hindsight; a robot's last work "
                     f"ends after {split.mean_end_s:.0f} s in the mean; seed {seed}")  # fmt: skip
    mean = float(np.mean(ratios))
    yield Figure("makespan, mean of all", mean, "x", f"<= {MEAN_MAX:g}",
                 mean <= MEAN_MAX and whole, against,
                 f"{len(ratios)} fleets, all work done: {whole}; seed {seed}")  # fmt: skip
    for name in ALONE[:1] if quick else ALONE:
        yield _alone(name, search_s, seed, against)
    for name, robots in CHANGES[:1] if quick else CHANGES:
        for change in (FleetChange.DIES,) if quick else FleetChange:
            yield _changed(name, robots, change, search_s, seed, against)
    yield from _planning(seed)
    for name, robots in TRACTORS[:1] if quick else TRACTORS:
        yield from _tractors(name, robots, search_s, seed)
    yield from _drawn(QUICK_DRAWN if quick else DRAWN)


def _speed(name: str, robots: int, times: float) -> Figure:
    least = SPEED_LEAST.get((name, robots))
    return Figure(f"speed, {name}, {robots} robots", times, "x real time",
                  "" if least is None else f">= {least:g}", None if least is None else times >= least,
                  "", "simulated time of the work by CPU of the run, one core, interpreted, without "
                  "recordings; the first of a process loads its kernels")  # fmt: skip


def _planning(seed: int) -> Iterator[Figure]:
    """What a peer computes for its first plan and for a later one."""
    name, robots = PLANNING
    setup = FieldSetup(load(name).changed(robots, seed))
    travel = setup.plan.travel
    left: dict[int, Remainder | None] = {section.id: None for section in setup.field.sections}
    free = {slot: FreedRobot(place, 0) for slot, place in enumerate(setup.starts)}
    FleetPlan(travel, seed=1).plan(left, free)  # the matrix of ways, and the kernels
    plan = FleetPlan(travel)
    for what in ("the first plan", "a later plan"):
        began_s = process_time()
        rows = plan.plan(left, free)
        for_ms = 1000 * (process_time() - began_s)
        yield Figure(f"planning, {what}, {robots} robots, {len(setup.field.sections)} sections", for_ms,
                     "ms", f"<= {PLANNING_MAX_MS:g}", for_ms <= PLANNING_MAX_MS, "",
                     "CPU of one peer; a later plan begins with the one before")  # fmt: skip
        free = {slot: FreedRobot(at, 1_000 * slot) for slot, (at, _) in free.items()}
        left = {section: None for row in rows.values() for section in row[1:]}


def _tractors(name: str, robots: int, search_s: float, seed: int) -> Iterator[Figure]:
    setup = FieldSetup(load(name).changed(robots, seed, drive="ackermann"))
    outcome = FieldRun(setup).run()
    planned_s = central_plan_s(tractor_problem(setup), search_s)
    ratio, where = outcome.makespan_s / planned_s, f"{name}, {robots} tractors"
    yield Figure(f"makespan, {where}", ratio, "x", f"<= {TRACTORS_MAX:g}",
                 ratio <= TRACTORS_MAX and outcome.finished,
                 f"OR-Tools {version('ortools')}, guided local search, {search_s:g} s, single swaths, "
                 "Dubins words without fences",
                 f"{outcome.makespan_s:.0f} s driven against {planned_s:.0f} s planned; "
                 f"{outcome.contacts} contacts; seed {seed}")  # fmt: skip
    yield Figure(f"reachable ground worked, {where}", outcome.reached, "", ">= 1",
                 outcome.reached >= 1.0, "",
                 f"what their turning circle allows; seed {seed}")  # fmt: skip


def _alone(name: str, search_s: float, seed: int, against: str) -> Figure:
    setup = FieldSetup(load(name).changed(1, seed))
    outcome, problem = FieldRun(setup).run(), problem_of(setup)
    searched_s, rows_s = central_plan_s(problem, search_s), snake_s(problem)
    ratio = outcome.makespan_s / min(searched_s, rows_s)
    scope = (
        f"{outcome.makespan_s:.0f} s driven; {searched_s:.0f} s planned, {rows_s:.0f} s section after "
        f"section; seed {seed}"
    )
    return Figure(f"makespan, {name}, 1 robot", ratio, "x", f"<= {ALONE_MAX:g}",
                  ratio <= ALONE_MAX and outcome.success, f"{against}, or the sections in their order",
                  scope)  # fmt: skip


def _changed(
    name: str, robots: int, change: FleetChange, search_s: float, seed: int, against: str
) -> Figure:
    driven = changed_run(name, robots, seed, change)
    moment, outcome = driven.moment, driven.outcome
    rest_s = central_plan_s(problem_at(driven.setup, moment.places, moment.left), search_s)
    ratio = outcome.makespan_s / (moment.at_s + rest_s)
    scope = (
        f"at {moment.at_s:.0f} s; {outcome.makespan_s:.0f} s driven against {moment.at_s + rest_s:.0f} "
        f"s, planned again then, from the start; {outcome.contacts} contacts; seed {seed}"
    )
    return Figure(f"makespan, {name}, {robots} robots, one {change.value}", ratio, "x",
                  f"<= {CHANGE_MAX:g}", ratio <= CHANGE_MAX and outcome.finished, against,
                  scope)  # fmt: skip


def _drawn(seeds: Sequence[int]) -> Iterator[Figure]:
    """How many fields of odd shapes are left with a flaw."""
    flawed, robots = [], 0
    for seed in seeds:
        with TemporaryDirectory() as folder:
            outcome = FieldRun(drawn_setup(seed, Path(folder))).run()
        robots += outcome.robots
        whole = outcome.success and outcome.reached == 1.0 and outcome.units_twice == 0
        if not whole:
            flawed.append(seed)
    named = f"; seeds {flawed}" if flawed else ""
    yield Figure("drawn fields with a gap, a contact or a unit worked twice", len(flawed), "",
                 "<= 0", not flawed, "",
                 f"{len(seeds)} stars, combs, letters U, slivers, triangles, islands and necks, "
                 f"{robots} robots in sum{named}")  # fmt: skip
