"""Deliveries: plans against PyVRP and OR-Tools, streams, batteries, and whole peers in trouble."""

import time
from collections.abc import Iterator
from math import nan
from random import Random

import numpy as np

from agent.delivery.cost_matrix import FULL, Carrier, CostMatrix, Trip, workload
from agent.delivery.routing_problem import Workload
from agent.delivery.tour_auction import RoutingPlanner
from agent.interface.geometry import Point
from agent.mapping.building import Floor
from agent.paths.nav_mesh import Mesh
from sim.scenarios.building_generator import warehouse
from tools.bench.delivery_decision import ROBOTS, decisions
from tools.bench.delivery_trouble import MIXED, TROUBLES, troubled
from tools.bench.figure import Figure
from tools.bench.routing_opponents import bound_ms, ortools_plan, pyvrp_makespan
from tools.bench.task_stream import LeastWaiting, arrivals, latency_s, least_travel

SIZES = {(10, 50): 1.10, (10, 100): 1.08, (20, 200): 1.10, (50, 500): 1.15}  # and the target
MOVES = 1_000_000  # of one peer's search
OPPONENT_S = 10.0
STREAMS = 4  # seeds of streams: the other policy varies by 3x between seeds
TIGHT_M = 900.0  # of a battery, where a task is 230 m on the average
VISITS = 6  # of a bay that OR-Tools may use
WHERE = (
    "warehouse of 164 x 342 m, random starts, pickups and dropoffs; ways of the planning map, 1 m/s"
)


def places(costs: CostMatrix, count: int, rng: Random) -> list[Point]:
    """So many free places, drawn at random, as metres (x, y)."""
    mesh = costs.mesh
    free = np.argwhere(~mesh.blocked)
    found = (free[rng.randrange(len(free))].tolist() for _ in range(count))
    return [
        (mesh.origin[0] + (c + 0.5) * mesh.cell_m, mesh.origin[1] + (r + 0.5) * mesh.cell_m)
        for r, c in found
    ]


def instance(costs: CostMatrix, robots: int, tasks: int, seed: int) -> Workload:
    """A problem with random starts and tasks that are all known from the start."""
    rng = Random(f"{seed}/delivery/{robots}/{tasks}")
    trips = [Trip(*places(costs, 2, rng)) for _ in range(tasks)]
    return workload(costs, Carrier(1.0, 0.0), trips, places(costs, robots, rng), [0] * robots)


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """In a building as large as the map warehouse-20-40-10-2-2 of the reference, and drawn alike."""
    floor = Floor.drawn(warehouse(20, 40, 10, 2, 2, 51), 1.0, 0.3)
    costs = CostMatrix(Mesh(floor.inflated, floor.origin, floor.fine_m))
    peers = range(0, ROBOTS, 12 if quick else 1)
    yield from decisions(floor, costs.twin(), peers, 1 if quick else 5, seed)
    yield from streams(costs, quick, seed)
    yield from batteries(costs, quick, seed)
    yield from trouble(quick, seed)
    for (robots, tasks), target in SIZES.items():
        if quick and (robots, tasks) == (20, 200):
            continue  # the largest one and the smaller ones show the same, in 50 s
        opposed = not quick or (robots, tasks) == (10, 50)
        seeds = range(seed, seed + (1 if quick or tasks > 200 else 2))
        opponent_s = 1.0 if quick else OPPONENT_S
        yield from plans(costs, robots, tasks, target, seeds, opponent_s if opposed else 0.0)


def streams(costs: CostMatrix, quick: bool, seed: int) -> Iterator[Figure]:
    """Mean latency of a stream of tasks against insertion of least extra travel, at two loads."""
    for robots, tasks in [(10, 200)] if quick else [(10, 200), (20, 400)]:
        seeds = range(seed, seed + (STREAMS // 2 if quick else STREAMS))
        works = [(k, instance(costs.twin(), robots, tasks, k)) for k in seeds]
        for load in (0.7, 1.1):
            ours, theirs = [], []
            for k, work in works:
                at_ms = arrivals(work, load, Random(f"{k}/stream/{load}"))
                ours.append(latency_s(work, at_ms, LeastWaiting()))
                theirs.append(latency_s(work, at_ms, least_travel))
            shares = [a / b for a, b in zip(ours, theirs, strict=True)]
            share = sum(ours) / sum(theirs)
            scope = (
                f"{np.mean(ours):.0f} s against {np.mean(theirs):.0f} s; {len(seeds)} seeds, each by "
                f"itself {min(shares):.2f} to {max(shares):.2f}; no congestion; {WHERE}"
            )
            yield Figure(f"mean latency in a stream, {robots} robots, {tasks} tasks, load {load}",
                         share, "x", "<= 0.50", share <= 0.5, "insertion of least extra travel",
                         scope)  # fmt: skip


def batteries(costs: CostMatrix, quick: bool, seed: int) -> Iterator[Figure]:
    """Tight: a full battery lasts for three tasks or four."""
    for tasks in (50,) if quick else (50, 100):
        rng = Random(f"{seed}/battery/{tasks}")
        trips = [Trip(*places(costs, 2, rng)) for _ in range(tasks)]
        starts, bays = places(costs, 10, rng), places(costs, 4, rng)
        carrier = Carrier(1.0, 0.0, battery_m=TIGHT_M, dock_s=100.0, charge_s=0.0, reserve=0.0)
        work = workload(costs, carrier, trips, starts, [0] * 10, bays, [FULL] * 10)
        planner = RoutingPlanner(work)
        seconds = 2.0 if quick else OPPONENT_S
        began = time.process_time()
        plan = planner.improved(planner.auctioned(), seed, MOVES // 2)
        cpu_s = time.process_time() - began
        worth = planner.worth(plan)
        theirs = ortools_plan(work, seconds, balanced=True, bays=VISITS)
        name = f"last finish with tight batteries, 10 robots, {tasks} tasks"
        scope = (f"{WHERE}; {TIGHT_M:.0f} m a battery, 100 s a charge, 4 bays, each of them may turn "
                 f"out to give nothing; {worth.makespan_ms / 1000:.0f} s; {cpu_s:.1f} s CPU")  # fmt: skip
        if not worth.feasible or theirs is None:
            missed = "ours: none" if not worth.feasible else "OR-Tools found no plan"
            yield Figure(name, 0.0, "x", "<= 1.10", worth.feasible, missed, scope)
            continue
        value = worth.makespan_ms / theirs.makespan_ms
        yield Figure(name, value, "x", "<= 1.10", value <= 1.10,
                     f"OR-Tools, {seconds:.0f} s, energy as a dimension", scope)  # fmt: skip


def trouble(quick: bool, seed: int) -> Iterator[Figure]:
    """Whole peers on the wire: what a person would find on the floor in the end."""
    kinds = [MIXED] if quick else [MIXED, *TROUBLES]
    wrong, finished, empty, runs = 0, 0, 0, 0
    for kind in kinds:
        seeds = range(seed, seed + (1 if quick else 10 if kind == MIXED else 2))
        outcomes = [troubled(kind, k).run() for k in seeds]
        flaws = sum(sum(o.flaws.values()) + o.contacts for o in outcomes)
        arrived = sum(o.finished for o in outcomes)
        where = f"{len(outcomes)} runs, 4 robots, 10 tasks; judged by where parcels are; {arrived} "
        yield Figure(f"deliveries done twice, lost or by two robots, and contacts: {kind}", flaws, "",
                     "= 0", flaws == 0, "-", where + "in which every parcel arrived")  # fmt: skip
        wrong, finished, runs = wrong + flaws, finished + arrived, runs + len(outcomes)
        empty += sum(len(o.empty) for o in outcomes)
    where = f"{runs} runs, {', '.join(kinds)}"
    yield Figure("deliveries done twice, lost or by two robots, and contacts", wrong, "", "= 0",
                 wrong == 0, "-", where)  # fmt: skip
    yield Figure("robots whose battery was empty", empty, "", "= 0", empty == 0, "-", where)
    yield Figure(
        "runs in which every parcel arrived", finished / runs, "share", "", None, "-", where
    )


def plans(
    costs: CostMatrix, robots: int, tasks: int, target: float, seeds: range, seconds: float
) -> Iterator[Figure]:
    """Makespan against the bound, with its target as a factor of it, and against others that search
    for `seconds`."""
    ours, rivals, travels, cpu_s = [], [], [], []
    for seed in seeds:
        work = instance(costs, robots, tasks, seed)
        planner, bound = RoutingPlanner(work), bound_ms(work)
        planner.improved(planner.auctioned(), seed, 1)  # compiled
        began = time.process_time()
        first = planner.auctioned()
        plan = planner.improved(first, seed, MOVES)
        cpu_s.append(time.process_time() - began)
        worth = planner.worth(plan)
        ours.append(worth.makespan_ms / bound)
        if seconds:
            most = planner.worth(first).makespan_ms
            found_ms = pyvrp_makespan(work, most, seconds, seed)
            if found_ms is not None:
                rivals.append(worth.makespan_ms / found_ms)
            total = ortools_plan(work, seconds, balanced=False)
            if total is not None:
                travels.append(worth.total_ms / total.total_ms)
    name = f"{robots} robots, {tasks} tasks"
    scope = f"{WHERE}; {len(seeds)} seeds; one peer's search, {MOVES:,} moves, {np.mean(cpu_s):.2f} s CPU"
    value = float(np.mean(ours))
    yield Figure(f"makespan over the relaxation bound, {name}", value, "x", f"<= {target:.2f}",
                 value <= target, "assignment relaxation, shared by all robots", scope)  # fmt: skip
    if not seconds:
        return
    yield _compared(f"makespan against PyVRP, {name}", rivals, len(seeds), 1.05,
                    f"PyVRP, {seconds:.0f} s, four limits of the route's duration by bisection",
                    scope)  # fmt: skip
    yield _compared(f"total travel against OR-Tools, {name}", travels, len(seeds), 1.10,
                    f"OR-Tools, {seconds:.0f} s, total travel alone", scope)  # fmt: skip


def _compared(
    name: str, ratios: list[float], runs: int, target: float, against: str, scope: str
) -> Figure:
    """The mean of the seeds for which the other one found a plan; without any, nothing is compared."""
    if len(ratios) < runs:
        scope = f"{scope}; the other one found no plan for {runs - len(ratios)} of them"
    value = float(np.mean(ratios)) if ratios else nan
    holds = value <= target if ratios else None
    return Figure(name, value, "x", f"<= {target:.2f}", holds, against, scope)
