"""A hundred robots in the rooms of `room-64-64-8`, each from somewhere to somewhere else.

Two scopes. *Joint plans alone*: the plan that every robot of such a jam computes, driven in its order
with one unit of time for each move; cheap, so there are many seeds. *Whole peers*: the same crowd on
the simulated wire with its agreement, bodies and range sensors, to the end; one seed takes an hour.
What a robot waits is when it is first at its goal less what the way takes with nobody else there.
"""

from collections.abc import Iterator
from math import isfinite
from random import Random
from statistics import median
from time import process_time
from typing import NamedTuple

import numpy as np

from agent.interface.geometry import Point
from agent.mapf.joint_plan_agreement import seats
from agent.mapf.lacam import planned
from agent.mapf.pibt import ways
from agent.mapping.building import Floor
from sim.runs.navigation_run import NavigationRun
from sim.scenarios.building_generator import rooms
from sim.scenarios.navigation_setup import NavigationSetup, scattered
from tools.bench.figure import Figure
from tools.bench.map_kinds import data_folder

CELL_M, RADIUS_M = 1.0, 0.35
ROBOTS, SIDE, LIMIT_S = 100, 64, 900.0
QUICK_ROBOTS, QUICK_SIDE = 8, 16  # of whole peers
SEEDS, QUICK_SEEDS = 100, 5  # of joint plans
WAIT_SHARE = 3.0


class RoomsScenario(NamedTuple):
    """A floor, and a start and a goal on it for each robot."""

    floor: Floor
    name: str
    starts: list[Point]
    goals: list[Point]


def crowd_of(seed: int, robots: int = ROBOTS, side: int = SIDE) -> RoomsScenario:
    """`side`: other than that of the public map, or without its file, rooms like it are drawn."""
    path = data_folder() / "maps" / "room-64-64-8.map"
    public = side == SIDE and path.exists()
    drawing = path.read_text() if public else rooms(seed, side)
    floor, rng = Floor.drawn(drawing, CELL_M, RADIUS_M), Random(f"{seed}/crowd/{robots}")
    starts, goals = (scattered(floor, robots, rng, CELL_M) for _ in range(2))
    return RoomsScenario(
        floor, path.stem if public else f"{side} x {side} cells of rooms", starts, goals
    )


def unfairness(waits: list[float]) -> float:
    """The longest wait over the median. A median below a second counts as a second."""
    return max(waits) / max(median(waits), 1.0)


def figures(quick: bool) -> Iterator[Figure]:
    """Joint plans over many seeds, and one run of whole peers; with `quick` smaller ones."""
    yield from joint(range(QUICK_SEEDS if quick else SEEDS))
    yield from whole(0, QUICK_ROBOTS, QUICK_SIDE) if quick else whole(0, ROBOTS, SIDE)


def joint(seeds: range) -> Iterator[Figure]:
    """The quality of the joint plan alone, without robots that drive it."""
    found, worst, medians, name = 0, [], [], ""
    begun_s = process_time()
    for seed in seeds:
        floor, name, starts, goals = crowd_of(seed)
        everybody = [1] * len(starts)
        nodes = seats(floor.lattice, starts, everybody, ())
        ends = seats(floor.lattice, goals, everybody, ())
        assert nodes is not None and ends is not None, "there are more nodes than robots"
        plan = planned(floor.lattice.near, nodes, ends, seed)
        if plan is None:
            continue
        found += 1
        free = ways(floor.lattice.near, np.array(ends, dtype=np.int32))
        waits = plan.arrivals(ends) - free[np.arange(len(nodes)), nodes]
        worst.append(unfairness(waits.tolist()))
        medians.append(median(waits.tolist()))
    scope = f"{name}, {len(seeds)} seeds; joint plans alone, a unit of time for each move"
    spent_s = (process_time() - begun_s) / len(seeds)
    yield Figure(
        f"joint plans of {ROBOTS} robots: all arrive", found / len(seeds), "share of seeds", "= 1",
        found == len(seeds), "", f"{scope}; {spent_s:.1f} s CPU each",
    )  # fmt: skip
    if worst:
        fair = sum(ratio <= WAIT_SHARE for ratio in worst)  # the target is that of robots, below
        yield Figure(
            f"joint plans of {ROBOTS} robots: longest wait, of the median", median(worst), "ratio",
            "", None, "",
            f"{scope}; median of seeds, worst {max(worst):.1f}, {fair} of {len(seeds)} within "
            f"{WAIT_SHARE:g}; "
            f"median wait {median(medians):.0f} moves",
        )  # fmt: skip


def whole(seed: int, robots: int, side: int, loss: float = 0.0) -> Iterator[Figure]:
    """Whole peers in a square of `side` cells of the map. `loss` is a share of all frames from 0 to
    1."""
    crowd = crowd_of(seed, robots, side)
    setting = NavigationSetup.made(
        "crowd", crowd.floor, crowd.starts, [[goal] for goal in crowd.goals], seed=seed, loss=loss,
        time_limit_s=LIMIT_S,
    )  # fmt: skip
    outcome = NavigationRun(setting).run()
    arrived = sum(map(isfinite, outcome.arrived_s)) / robots
    yield Figure(
        f"{robots} whole peers in rooms: arrived", arrived, "share", "= 1", arrived == 1.0, "",
        f"{crowd.name}, seed {seed}; {outcome.rounds} rounds, {outcome.simulated_s:.0f} s",
    )  # fmt: skip
    yield Figure(
        f"{robots} whole peers in rooms: contacts", outcome.contacts, "", "= 0",
        not outcome.contacts, "", f"smallest gap {outcome.closest_m:.2f} m",
    )  # fmt: skip
    speed_m_s = setting.scenario.fleet.speed_m_s
    waits_s = [
        at_s - crowd.floor.route.length_m(start, goal) / speed_m_s
        for at_s, start, goal in zip(outcome.arrived_s, crowd.starts, crowd.goals, strict=True)
    ]
    ratio = unfairness(waits_s)
    yield Figure(
        f"{robots} whole peers in rooms: longest wait, of the median", ratio, "ratio",
        f"<= {WAIT_SHARE:g}", ratio <= WAIT_SHARE, "",
        f"arrival less the way at full speed; median {median(waits_s):.0f} s",
    )  # fmt: skip
