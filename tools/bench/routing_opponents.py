"""Vehicle routing by others, to compare with: PyVRP and OR-Tools on the same workload. Test-only.

Both plan for all robots in one place, from scratch. Neither minimises the last finish by itself: PyVRP
gets a limit of each route's duration that is bisected, OR-Tools a cost of the greatest span.
"""

from typing import Any

import numpy as np

from agent.delivery.routing_problem import PlanCost, Power, Workload

STEPS = 4  # of PyVRP's bisection, each with its share of the time
SPAN_COST = 100  # of a millisecond of the last finish, in those of travel


def pyvrp_makespan(work: Workload, most_ms: int, seconds: float, seed: int) -> int | None:
    """Milliseconds until the last finish of the best plan that PyVRP finds in `seconds`, at most
    the number `most_ms`, that of a plan which is known already. None: it finds none."""
    low, high = bound_ms(work), most_ms
    best: int | None = None
    for _ in range(STEPS):
        limit = (low + high) // 2
        found = _pyvrp(work, limit, seconds / STEPS, seed)
        if found is None:
            low = limit
        else:
            best = found if best is None else min(best, found)
            high = min(limit, found)
    return best


def _pyvrp(work: Workload, limit_ms: int, seconds: float, seed: int) -> int | None:
    import pyvrp
    from pyvrp.stop import MaxRuntime

    robots, tasks = work.robots, work.tasks
    size = robots + 1 + tasks
    spots = [pyvrp.Location(0, 0) for _ in range(size)]
    depots = [pyvrp.Depot(k) for k in range(robots + 1)]  # starts, and an end that is nowhere
    clients = [pyvrp.Client(robots + 1 + k) for k in range(tasks)]
    types = [
        pyvrp.VehicleType(1, start_depot=r, end_depot=robots, shift_duration=int(limit_ms))
        for r in range(robots)
    ]
    matrix = np.zeros((size, size), dtype=np.int64)
    matrix[:robots, robots + 1 :] = work.lead
    matrix[robots + 1 :, robots + 1 :] = work.link
    np.fill_diagonal(matrix, 0)
    data = pyvrp.ProblemData(spots, clients, depots, types, [matrix], [matrix])  # type: ignore[list-item]
    result = pyvrp.solve(data, MaxRuntime(seconds), seed=seed, display=False)
    if not result.is_feasible():
        return None
    return max(route.duration() for route in result.best.routes())


def guided_search(seconds: float) -> Any:
    """The parameters with which OR-Tools searches in all of our comparisons: guided local search."""
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    search = pywrapcp.DefaultRoutingSearchParameters()
    search.first_solution_strategy = (
        routing_enums_pb2.FirstSolutionStrategy.PARALLEL_CHEAPEST_INSERTION
    )
    search.local_search_metaheuristic = (
        routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    )
    search.time_limit.FromMilliseconds(round(seconds * 1000))
    return search


def ortools_plan(work: Workload, seconds: float, balanced: bool, bays: int = 0) -> PlanCost | None:
    """By guided local search. `balanced`: the last finish, else total travel. `bays`: how many visits
    of each bay are modelled; a bay sets the energy back."""
    from ortools.constraint_solver import pywrapcp

    robots, tasks = work.robots, work.tasks
    time_ms, energy, visits = _tables(work, bays)
    size = len(time_ms)
    end = size - 1
    manager = pywrapcp.RoutingIndexManager(
        size, robots, [tasks + r for r in range(robots)], [end] * robots
    )
    routing = pywrapcp.RoutingModel(manager)

    def times(a: int, b: int) -> int:
        return int(time_ms[manager.IndexToNode(a)][manager.IndexToNode(b)])

    arc = routing.RegisterTransitCallback(times)
    routing.SetArcCostEvaluatorOfAllVehicles(arc)
    routing.AddDimension(arc, 0, 1 << 40, True, "time")
    if balanced:
        routing.GetDimensionOrDie("time").SetGlobalSpanCostCoefficient(SPAN_COST)
    if work.power is not None:
        _battery(routing, manager, work.power, energy, tasks, visits)
    found = routing.SolveWithParameters(guided_search(seconds))
    if found is None:
        return None
    dimension = routing.GetDimensionOrDie("time")
    spans = [found.Value(dimension.CumulVar(routing.End(r))) for r in range(robots)]
    return PlanCost(max(spans), sum(spans))


def _tables(work: Workload, copies: int) -> tuple[list[list[int]], list[list[int]], list[int]]:
    """Times and energy between nodes: tasks, starts, visits of bays, the end that is nowhere."""
    robots, tasks, power = work.robots, work.tasks, work.power
    bays = 0 if power is None else power.from_bay.shape[0] * copies
    size = tasks + robots + bays + 1
    time_ms = np.zeros((size, size), dtype=np.int64)
    time_ms[:tasks, :tasks] = work.link
    time_ms[tasks : tasks + robots, :tasks] = work.lead
    energy = np.zeros_like(time_ms)
    visits: list[int] = []
    if power is not None:
        energy[:tasks, :tasks], energy[tasks : tasks + robots, :tasks] = power.link, power.lead
        for visit in range(bays):
            node, bay = tasks + robots + visit, visit // copies
            visits.append(node)
            time_ms[node, :tasks] = power.from_bay_ms[bay] + power.dock_ms
            energy[node, :tasks] = power.from_bay[bay]
            time_ms[:tasks, node], energy[:tasks, node] = (
                power.to_bay_ms[:, bay],
                power.to_bay[:, bay],
            )
            time_ms[tasks : tasks + robots, node] = power.lead_bay_ms[:, bay]
            energy[tasks : tasks + robots, node] = power.lead_bay[:, bay]
    return time_ms.tolist(), energy.tolist(), visits


def _battery(
    routing: Any, manager: Any, power: Power, energy: list[list[int]], tasks: int, visits: list[int]
) -> None:
    """What is left in the battery: only a bay adds to it, and a task ends within reach of one."""

    def used(a: int, b: int) -> int:
        return -int(energy[manager.IndexToNode(a)][manager.IndexToNode(b)])

    arc = routing.RegisterTransitCallback(used)
    routing.AddDimension(arc, power.capacity, power.capacity, False, "left")
    left = routing.GetDimensionOrDie("left")
    for r in range(routing.vehicles()):
        left.CumulVar(routing.Start(r)).SetValue(int(power.left[r]))
        left.SlackVar(routing.Start(r)).SetValue(0)
    for task in range(tasks):
        index = manager.NodeToIndex(task)
        left.CumulVar(index).SetMin(int(power.home[task]))
        left.SlackVar(index).SetValue(0)
    for visit in visits:
        routing.AddDisjunction([manager.NodeToIndex(visit)], 0)


def bound_ms(work: Workload) -> int:
    """No plan's last finish is below this: the assignment relaxation (each task follows a robot's start
    or another task), shared by all robots."""
    from scipy.optimize import linear_sum_assignment

    costs = np.concatenate((work.lead, work.link)).astype(np.float64)
    costs[work.robots + np.arange(work.tasks), np.arange(work.tasks)] = 1e12  # none follows itself
    rows, columns = linear_sum_assignment(costs.T)
    return int(costs.T[rows, columns].sum() / work.robots)
