"""The opponent of a fleet in a field: a plan that OR-Tools makes for all robots in one place.

It plans with the same sections, each in one of two directions, the same starts, the same paths
(`Route.path`) and the same bodies: a trapezoid of speed on each straight piece, and a stop at each
corner. It minimises the time of the last robot by guided local search. Its plan is not driven.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Point, Polyline
from agent.interface.vehicle import Vehicle
from sim.scenarios.field_setup import FieldSetup
from tools.bench.routing_opponents import guided_search

TICK_S = 0.01  # unit of time of the opponent, whose times are whole numbers
SPAN_COST = 100  # of the last finish, in those of travel

Times = NDArray[np.int64]


class FleetProblem(NamedTuple):
    """The whole problem in units of `TICK_S`. Node 2 k is section k from its first end, 2 k + 1 from
    its last."""

    work: Times  # (2 sections,): to work a section
    lead: Times  # (robots, 2 sections): from a start to where a section is begun
    link: Times  # (2 sections, 2 sections): from where one ends to where another is begun


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
    return FleetProblem(ticks(work), ticks(lead), ticks(link))


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


def ticks(seconds: object) -> Times:
    """Times in seconds, of any shape, in units of `TICK_S`."""
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
