"""The experiment of the navigation thesis: three robots, twenty starts and goals each, three inflations.

The thesis reports, for inflations of 0.05, 0.10 and 0.20 m: success 85, 98 and 50 %; RMSE 0.01, 0.08
and 0.16 m; replans a run 4, 1.0 and 0. Its hall is known only as a picture; ours is
`sim.scenarios.building_generator.office`, and the places are the same at every inflation. Error is
to the polyline that was followed, not to its vertices.
"""

from collections.abc import Iterator
from math import hypot, isnan
from pathlib import Path
from random import Random
from statistics import fmean
from time import perf_counter
from typing import NamedTuple

import numpy as np

from agent.interface.geometry import Point
from agent.mapping.building import Floor
from agent.mapping.dynamic_obstacles import ObstacleMap
from sim.runs.navigation_run import NavigationOutcome, NavigationRun
from sim.scenarios.building_generator import office
from sim.scenarios.navigation_setup import NavigationSetup
from tools.bench import whole_robots
from tools.bench.figure import Figure
from tools.run.path_picture import draw_paths

INFLATIONS_M = (0.05, 0.10, 0.20)
THESIS = {0.05: "85 %, 0.01 m", 0.10: "98 %, 0.08 m", 0.20: "50 %, 0.16 m"}
RADIUS_M = 0.35  # radius of a disc round the platform of the thesis, 0.58 m by 0.38 m
CELL_M, ROBOTS, PAIRS, QUICK_PAIRS = 0.2, 3, 20, 4
FAR_M, APART_M = 3.0, 1.0  # a goal from its start (thesis 6.1.3); robots from each other
LIMIT_S = 180.0  # the longest way takes 25 s at 1 m/s
RMSE_M, REPLAN_MS, SUCCESS = 0.06, 50.0, 0.99


def floor_of(inflation_m: float) -> Floor:
    """The office of the thesis, with walls that are inflated by this much."""
    return Floor.drawn(office(), CELL_M, RADIUS_M, inflation_m)


def pairs(seed: int, floor: Floor) -> tuple[list[Point], list[Point]]:
    """Starts and goals on free cells of the widest inflation, so that all inflations have them."""
    rng = Random(f"{seed}/pairs")
    rows, columns = np.nonzero(~floor.inflated)
    west, south = floor.origin
    free = [
        (west + (c + 0.5) * floor.fine_m, south + (r + 0.5) * floor.fine_m)
        for r, c in zip(rows.tolist(), columns.tolist(), strict=True)
    ]

    def draw(others: list[Point], far_from: Point | None = None) -> Point:
        while True:
            spot = rng.choice(free)
            clear = all(hypot(spot[0] - x, spot[1] - y) >= APART_M for x, y in others)
            if clear and (
                far_from is None or hypot(spot[0] - far_from[0], spot[1] - far_from[1]) >= FAR_M
            ):
                return spot

    starts: list[Point] = []
    goals: list[Point] = []
    for _ in range(ROBOTS):
        starts.append(draw(starts))
    for start in starts:
        goals.append(draw(goals, start))
    return starts, goals


class Batch(NamedTuple):
    """All runs at one inflation."""

    legs: int
    arrived: int
    contacts: int
    rmse_m: float  # mean over the ways of the root mean square along each, as the thesis has it
    worst_rmse_m: float
    replans: int
    joint_plans: int
    plan_ms: float  # the slowest search


def batch(inflation_m: float, count: int, out: Path | None) -> Batch:
    """So many seeds of the experiment at one inflation: errors, arrivals, contacts and times of
    planning."""
    floor, places = floor_of(inflation_m), floor_of(max(INFLATIONS_M))
    errors_m: list[float] = []
    legs = arrived = contacts = replans = joint = 0
    plan_ms = 0.0
    for seed in range(count):
        starts, goals = pairs(seed, places)
        setting = NavigationSetup.made(
            "thesis", floor, starts, [[goal] for goal in goals], seed=seed, time_limit_s=LIMIT_S
        )
        outing = NavigationRun(setting)
        outcome = outing.run()
        legs, contacts = legs + len(outcome.legs), contacts + outcome.contacts
        arrived += sum(leg.arrived_s < LIMIT_S for leg in outcome.legs)
        replans += sum(leg.replans for leg in outcome.legs)
        joint += outcome.rounds
        errors_m += [leg.rmse_m for leg in outcome.legs if not isnan(leg.rmse_m)]
        plan_ms = max(plan_ms, slowest_ms(floor, outing, outcome))
        if out is not None and seed == 0:
            draw_paths(outing, outcome, out / f"motion_{inflation_m:.2f}")
    return Batch(legs, arrived, contacts, fmean(errors_m), max(errors_m), replans, joint, plan_ms)


def slowest_ms(floor: Floor, outing: NavigationRun, outcome: NavigationOutcome) -> float:
    """Every search of the run once more, with a new grid as after a first box, by the clock."""
    worst_s = 0.0
    for followed in outing.followed.values():
        for path in followed:
            if path.why == "plan" or len(path.points) < 2:
                continue
            begun_s = perf_counter()
            ObstacleMap(floor, None).grid.plan(path.points[0], path.points[-1])
            worst_s = max(worst_s, perf_counter() - begun_s)
    return worst_s * 1000.0


def figures(quick: bool, seed: int = 1, out: Path | None = None) -> Iterator[Figure]:
    """`out`: where pictures of the first run at each inflation go; none without it."""
    yield from whole_robots.figures(quick, seed)
    count = QUICK_PAIRS if quick else PAIRS
    floor_of(0.1).route.path((1.0, 1.0), (13.0, 1.0))  # compiled
    for inflation_m in INFLATIONS_M:
        b = batch(inflation_m, count, out)
        name = f"inflation {inflation_m:.2f} m"
        scope = f"{count} runs of {ROBOTS} robots, {b.legs} ways, {b.joint_plans} joint plans"
        thesis = f"thesis: {THESIS[inflation_m]}"
        share = b.arrived / b.legs
        yield Figure(f"{name}: success", share, "share", f">= {SUCCESS:g}", share >= SUCCESS,
                     thesis, scope)  # fmt: skip
        yield Figure(f"{name}: contacts", b.contacts, "", "= 0", not b.contacts, "", scope)
        yield Figure(f"{name}: RMSE", b.rmse_m, "m", f"<= {RMSE_M:g}", b.rmse_m <= RMSE_M, thesis,
                     f"to the polyline; worst single way {b.worst_rmse_m:.3f} m")  # fmt: skip
        yield Figure(f"{name}: replans a run", b.replans / b.legs, "", "", None, "", scope)
        yield Figure(f"{name}: slowest search", b.plan_ms, "ms", f"<= {REPLAN_MS:g}",
                     b.plan_ms <= REPLAN_MS, "", "with a new grid, wall clock")  # fmt: skip
