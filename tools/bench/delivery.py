"""Deliveries: plans against their bound, PyVRP and OR-Tools; streams; batteries; whole peers in trouble."""

import time
from collections.abc import Iterator
from random import Random

import numpy as np

from agent.auction import Planner
from agent.cost_matrix import Carrier, CostMatrix, Trip, workload
from agent.floor import Floor
from agent.nav_mesh import Mesh, Point
from agent.workload import Workload
from sim.floor_plan import warehouse
from tools.bench.figure import Figure
from tools.bench.routing_opponents import bound_ms, ortools_plan, pyvrp_makespan

SIZES = {(10, 50): 1.10, (10, 100): 1.08, (20, 200): 1.10, (50, 500): 1.15}  # and the target
MOVES = 1_000_000  # of one peer's search
OPPONENT_S = 10.0
WHERE = "warehouse of 164 x 342 m, random starts, pickups and dropoffs; ways of the planning map, 1 m/s"


def building() -> CostMatrix:
    """As large as the map warehouse-20-40-10-2-2 of the reference, and drawn alike."""
    floor = Floor.drawn(warehouse(20, 40, 10, 2, 2, 51), 1.0, 0.3)
    return CostMatrix(Mesh(floor.inflated, floor.origin, floor.fine_m))


def places(costs: CostMatrix, count: int, rng: Random) -> list[Point]:
    mesh = costs.mesh
    free = np.argwhere(~mesh.blocked)
    found = (free[rng.randrange(len(free))].tolist() for _ in range(count))
    return [
        (mesh.origin[0] + (c + 0.5) * mesh.cell_m, mesh.origin[1] + (r + 0.5) * mesh.cell_m)
        for r, c in found
    ]


def instance(costs: CostMatrix, robots: int, tasks: int, seed: int) -> Workload:
    rng = Random(f"{seed}/delivery/{robots}/{tasks}")
    trips = [Trip(*places(costs, 2, rng)) for _ in range(tasks)]
    return workload(costs, Carrier(1.0, 0.0), trips, places(costs, robots, rng), [0] * robots)


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    costs = building()
    for (robots, tasks), target in SIZES.items():
        opposed = not quick or (robots, tasks) == (10, 50)
        seeds = range(seed, seed + (1 if quick or tasks > 200 else 2))
        yield from plans(costs, robots, tasks, target, seeds, opposed)


def plans(
    costs: CostMatrix, robots: int, tasks: int, target: float, seeds: range, opposed: bool
) -> Iterator[Figure]:
    ours, rivals, travels, cpu_s = [], [], [], []
    for seed in seeds:
        work = instance(costs, robots, tasks, seed)
        planner, bound = Planner(work), bound_ms(work)
        planner.improved(planner.auctioned(), seed, 1)  # compiled
        began = time.process_time()
        first = planner.auctioned()
        plan = planner.improved(first, seed, MOVES)
        cpu_s.append(time.process_time() - began)
        worth = planner.worth(plan)
        ours.append(worth.makespan_ms / bound)
        if opposed:
            most = planner.worth(first).makespan_ms
            rivals.append(worth.makespan_ms / pyvrp_makespan(work, first, most, OPPONENT_S, seed))
            total = ortools_plan(work, OPPONENT_S, balanced=False)
            travels.append(worth.total_ms / (worth.total_ms if total is None else total.total_ms))
    name = f"{robots} robots, {tasks} tasks"
    scope = f"{WHERE}; {len(seeds)} seeds; one peer's search, {MOVES:,} moves, {np.mean(cpu_s):.2f} s CPU"
    value = float(np.mean(ours))
    yield Figure(f"makespan over the relaxation bound, {name}", value, "x", f"<= {target:.2f}",
                 value <= target, "assignment relaxation, shared by all robots", scope)  # fmt: skip
    if not opposed:
        return
    value = float(np.mean(rivals))
    yield Figure(f"makespan against PyVRP, {name}", value, "x", "<= 1.05", value <= 1.05,
                 f"PyVRP, {OPPONENT_S:.0f} s, four limits of the route's duration by bisection",
                 scope)  # fmt: skip
    value = float(np.mean(travels))
    yield Figure(f"total travel against OR-Tools, {name}", value, "x", "<= 1.10", value <= 1.10,
                 f"OR-Tools, {OPPONENT_S:.0f} s, total travel alone", scope)  # fmt: skip
