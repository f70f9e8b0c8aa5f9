"""Work in fields against a plan that OR-Tools makes for the whole fleet in one place.

The opponent plans with the same sections, each in one of two directions, the same starts, the same
paths (`Route.path`) and the same bodies: a trapezoid of speed on each straight piece, and a stop at
each corner. It minimises the time of the last robot by guided local search. Its plan is not driven:
no robot is in another's way, and nothing is sent. The fleet's own time is that of true bodies.
"""

from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from itertools import pairwise
from math import hypot, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.field.field_map import Polyline
from agent.interface.vehicle import Vehicle
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from sim.world.ground_truth import TrackPoint
from tools.bench.drawn_fields import drawn_setup
from tools.bench.field_changes import FleetChange, changed_run
from tools.bench.figure import Figure
from tools.bench.routing_opponents import guided_search

SEARCH_S, QUICK_SEARCH_S = 40.0, 5.0
QUICK: Final = (("small", 3),)
CASES: Final = (
    ("small", 3), ("small", 6), ("oxted", 6), ("oxted", 12), ("oxted", 24),
    ("curitiba", 8), ("curitiba", 16),
)  # fmt: skip
TICK_S = 0.01  # unit of time of the opponent, whose times are whole numbers
SPAN_COST = 100  # of the last finish, in those of travel
STILL_M_S = 0.05  # a slower robot stands
MEAN_MAX, WORST_MAX = 1.03, 1.10
ALONE: Final = ("small", "oxted", "curitiba")
ALONE_MAX = 1.02
CHANGES: Final = (("small", 6), ("oxted", 6), ("curitiba", 8))
CHANGE_MAX = 1.10
DRAWN: Final = range(50)
QUICK_DRAWN: Final = (8, 18, 32)  # of few robots, so that they take seconds
IDLE_MAX = {6: 0.04, 24: 0.08}

Point = tuple[float, float]
Times = NDArray[np.int64]


class FleetProblem(NamedTuple):
    """The whole problem in units of `TICK_S`. Node 2 k is section k from its first end, 2 k + 1 from
    its last."""

    work: Times  # (2 sections,): to work a section
    lead: Times  # (robots, 2 sections): from a start to where a section is begun
    link: Times  # (2 sections, 2 sections): from where one ends to where another is begun


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """One figure for the time of each fleet and field, and their mean and worst."""
    search_s = QUICK_SEARCH_S if quick else SEARCH_S
    against = f"OR-Tools {version('ortools')}, guided local search, {search_s:g} s"
    ratios = []
    for name, robots in QUICK if quick else CASES:
        setup = FieldSetup(load(name).changed(robots, seed))
        run = FieldRun(setup)
        outcome = run.run()
        planned_s = central_plan_s(problem_of(setup), search_s)
        ratios.append(outcome.makespan_s / planned_s)
        idle = standing_share(list(run.tracks.values()), outcome.makespan_s)
        scope = (
            f"{len(setup.field.sections)} sections, {outcome.makespan_s:.0f} s driven against "
            f"{planned_s:.0f} s planned; same sections, starts, paths and bodies; seed {seed}"
        )
        yield Figure(f"makespan, {name}, {robots} robots", ratios[-1], "x", f"<= {WORST_MAX:g}",
                     ratios[-1] <= WORST_MAX and outcome.success, against, scope)  # fmt: skip
        most = IDLE_MAX.get(robots)
        yield Figure(f"time standing, {name}, {robots} robots", idle, "",
                     "" if most is None else f"<= {most:g}", None if most is None else idle <= most,
                     "", f"mean share of the robots until the fleet's end; seed {seed}")  # fmt: skip
    mean = float(np.mean(ratios))
    yield Figure("makespan, mean of all", mean, "x", f"<= {MEAN_MAX:g}", mean <= MEAN_MAX, against,
                 f"{len(ratios)} fleets, seed {seed}")  # fmt: skip
    for name in ALONE[:1] if quick else ALONE:
        yield _alone(name, search_s, seed, against)
    for name, robots in CHANGES[:1] if quick else CHANGES:
        for change in (FleetChange.DIES,) if quick else FleetChange:
            yield _changed(name, robots, change, search_s, seed, against)
    yield from _drawn(QUICK_DRAWN if quick else DRAWN)


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
                 f"{len(seeds)} stars, combs, letters U, slivers and fields with islands, "
                 f"{robots} robots in sum{named}")  # fmt: skip


def standing_share(tracks: Sequence[Sequence[TrackPoint]], end_s: float) -> float:
    """Mean share of the time up to `end_s`, seconds, in which a robot stands."""
    shares = []
    for track in tracks:
        rows = np.array([point[:3] for point in track], dtype=np.float64)
        rows = rows[rows[:, 0] <= end_s * 1e6]
        passed_s = np.diff(rows[:, 0]) / 1e6
        driven_m = np.hypot(np.diff(rows[:, 1]), np.diff(rows[:, 2]))
        stood = driven_m < STILL_M_S * np.maximum(passed_s, 1e-9)
        unseen_s = max(0.0, end_s - rows[-1, 0] / 1e6)  # a track may end where the robot stands
        shares.append((float(passed_s[stood].sum()) + unseen_s) / end_s)
    return float(np.mean(shares))


def drive_s(points: Sequence[Point], vehicle: Vehicle) -> float:
    """Seconds for a polyline in metres, with a stop at each of its points."""
    return sum(
        _straight_s(hypot(bx - ax, by - ay), vehicle) for (ax, ay), (bx, by) in pairwise(points)
    )


def _straight_s(length_m: float, vehicle: Vehicle) -> float:
    up, down, top = vehicle.acceleration_m_s2, vehicle.braking_m_s2, vehicle.speed_m_s
    ramps_m = top * top / 2 * (1 / up + 1 / down)
    if length_m < ramps_m:
        top = sqrt(2 * length_m / (1 / up + 1 / down))
        ramps_m = length_m
    return top * (1 / up + 1 / down) + (length_m - ramps_m) / max(top, 1e-9)


def problem_of(setup: FieldSetup) -> FleetProblem:
    """All times of a field and its fleet."""
    return problem_at(setup, setup.starts, [section.swaths for section in setup.field.sections])


def problem_at(
    setup: FieldSetup, places: Sequence[Point], left: Sequence[Sequence[Polyline]]
) -> FleetProblem:
    """All times of what is left of a field: the swaths of each section, for robots at `places`."""
    vehicle, route = setup.vehicle, setup.plan.route
    begins = [end for lines in left for end in (lines[0][0], lines[-1][-1])]
    ends = [end for lines in left for end in (lines[-1][-1], lines[0][0])]

    def way_s(start: Point, goal: Point) -> float:
        return drive_s(route.path(start, goal), vehicle)

    work = [_work_s(lines, way_s, vehicle) for lines in left for _ in range(2)]
    lead = [[way_s(place, begin) for begin in begins] for place in places]
    link = [[way_s(end, begin) for begin in begins] for end in ends]
    return FleetProblem(_ticks(work), _ticks(lead), _ticks(link))


def snake_s(problem: FleetProblem) -> float:
    """Seconds of one robot that works the sections in their order, each from the end that is nearer."""
    now, at = 0, -1
    for section in range(len(problem.work) // 2):
        ways = (problem.lead[0] if at < 0 else problem.link[at])[2 * section : 2 * section + 2]
        at = 2 * section + int(np.argmin(ways))
        now += int(ways.min()) + int(problem.work[at])
    return now * TICK_S


def _work_s(
    lines: Sequence[Polyline], way_s: Callable[[Point, Point], float], vehicle: Vehicle
) -> float:
    turns_s = sum(way_s(a[-1], b[0]) for a, b in pairwise(lines))
    return turns_s + sum(drive_s(line, vehicle) for line in lines)


def _ticks(seconds: object) -> Times:
    return np.round(np.asarray(seconds, dtype=np.float64) / TICK_S).astype(np.int64)


def central_plan_s(problem: FleetProblem, search_s: float) -> float:
    """Seconds until the last finish of the best plan that OR-Tools finds."""
    from ortools.constraint_solver import pywrapcp

    robots, nodes = problem.lead.shape
    size = nodes + robots + 1
    times = np.zeros((size, size), dtype=np.int64)
    times[:nodes, :nodes] = problem.work[:, None] + problem.link
    times[nodes : nodes + robots, :nodes] = problem.lead
    times[:nodes, -1] = problem.work
    rows = times.tolist()
    manager = pywrapcp.RoutingIndexManager(
        size, robots, [nodes + robot for robot in range(robots)], [size - 1] * robots
    )
    routing = pywrapcp.RoutingModel(manager)

    def passed(a: int, b: int) -> int:
        return int(rows[manager.IndexToNode(a)][manager.IndexToNode(b)])

    arc = routing.RegisterTransitCallback(passed)
    routing.SetArcCostEvaluatorOfAllVehicles(arc)
    routing.AddDimension(arc, 0, 1 << 40, True, "time")
    dimension = routing.GetDimensionOrDie("time")
    dimension.SetGlobalSpanCostCoefficient(SPAN_COST)
    for section in range(nodes // 2):  # in one of its two directions
        both = [manager.NodeToIndex(2 * section), manager.NodeToIndex(2 * section + 1)]
        routing.AddDisjunction(both, 1 << 40)
    found = routing.SolveWithParameters(guided_search(search_s))
    assert found is not None, "a robot can do all the work alone"
    last = max(found.Value(dimension.CumulVar(routing.End(robot))) for robot in range(robots))
    return float(last) * TICK_S
