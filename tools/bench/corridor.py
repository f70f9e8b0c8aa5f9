"""Robots that meet where only one fits: which of them get through, and what ORCA alone would do.

All by real peers on the simulated wire in virtual time: `sim/runs/navigation_run.py`. A run
succeeds when every robot reaches its goal within the time limit; contacts are judged from true positions.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from random import Random
from statistics import median
from typing import NamedTuple

from agent.interface.geometry import Point
from agent.mapping.building import Floor
from sim.runs.navigation_run import NavigationRun
from sim.scenarios.building_generator import CORRIDOR, DEAD_END, JUNCTION
from sim.scenarios.navigation_setup import NavigationSetup
from tools.bench import crowd
from tools.bench.figure import Figure

CELL_M, RADIUS_M = 1.0, 0.35
LIMIT_S = 400.0  # a 5:5 swap takes 70 to 120 s; a run that is not over by now never will be
# Robots that stand face to face never move again; others are past each other after 30 s.
PLAIN_LIMIT_S = 60.0
SEEDS, QUICK_SEEDS = 200, 1
PLAIN_SEEDS, QUICK_PLAIN_SEEDS = 20, 1  # ORCA by itself: its failures take the whole time limit
DEAR = "swap 5:5"  # in a quick run not by ORCA alone
LOSS = 0.3


class CrossingResult(NamedTuple):
    """How one crossing ended, and after how many simulated seconds."""

    finished: bool
    contacts: int
    seconds: float


def places(*cells: tuple[int, int]) -> list[Point]:
    """The centres of cells (column, row), as metres (x, y)."""
    return [((c + 0.5) * CELL_M, (r + 0.5) * CELL_M) for c, r in cells]


def swap(count: int, seed: int) -> tuple[str, list[Point], list[Point]]:
    """`count` robots in each of two rooms, each to a place of its own in the other one. Drawing,
    starts and goals in metres."""
    rng = Random(f"{seed}/swap/{count}")
    left = places(*((c, r) for c in range(4) for r in range(4)))
    right = places(*((c, r) for c in range(11, 15) for r in range(4)))
    starts = rng.sample(left, count) + rng.sample(right, count)
    return CORRIDOR, starts, rng.sample(right, count) + rng.sample(left, count)


def junction(seed: int) -> tuple[str, list[Point], list[Point]]:
    """Two robots from end to end of the bar of a T, at places drawn by the seed. Drawing, starts
    and goals in metres."""
    rng = Random(f"{seed}/junction")
    a, b = places((rng.randrange(4), 2), (10 - rng.randrange(4), 2))
    return JUNCTION, [a, b], [b, a]


def dead_end(seed: int) -> tuple[str, list[Point], list[Point]]:
    """One wants out of the blind end of a corridor, and another in. Drawing, starts and goals in
    metres."""
    rng = Random(f"{seed}/dead end")
    (end,) = places((10, 2))
    room = places(*((c, r) for c in range(4) for r in range(4)))
    return DEAD_END, [end, rng.choice(room)], [rng.choice(room), end]


LAYOUTS: dict[str, Callable[[int], tuple[str, list[Point], list[Point]]]] = {
    "swap 1:1": partial(swap, 1),
    "swap 3:3": partial(swap, 3),
    "swap 5:5": partial(swap, 5),
    "T-junction": junction,
    "dead end": dead_end,
}


def trial(layout: str, loss: float, agrees: bool, seed: int) -> CrossingResult:
    """One crossing with `loss`, a share of all frames from 0 to 1; without `agrees` robots have
    avoidance alone."""
    drawing, starts, goals = LAYOUTS[layout](seed)
    floor = Floor.drawn(drawing, CELL_M, RADIUS_M)
    setting = NavigationSetup.made(
        layout, floor, starts, [[goal] for goal in goals], seed=seed, loss=loss, agrees=agrees,
        time_limit_s=LIMIT_S if agrees else PLAIN_LIMIT_S,
    )  # fmt: skip
    outcome = NavigationRun(setting).run()
    return CrossingResult(outcome.finished, outcome.contacts, outcome.simulated_s)


def figures(quick: bool) -> Iterator[Figure]:
    """How many crossings end, without and with loss, and how long they take; then the crowd in
    rooms."""
    seeds = range(QUICK_SEEDS if quick else SEEDS)
    plain_seeds = range(QUICK_PLAIN_SEEDS if quick else PLAIN_SEEDS)
    losses = (LOSS,) if quick else (0.0, LOSS)  # what is harder
    alone: dict[str, Iterable[int]] = {
        layout: () if quick and layout == DEAR else plain_seeds for layout in LAYOUTS
    }
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        runs = [
            (layout, loss, pool.map(partial(trial, layout, loss, True), seeds),
             pool.map(partial(trial, layout, loss, False), alone[layout]))
            for layout in LAYOUTS for loss in losses
        ]  # fmt: skip
        for layout, loss, ours, plain in runs:
            yield from _shares(layout, loss, list(ours), list(plain))
    yield from crowd.figures(quick)


def _shares(
    layout: str, loss: float, ours: list[CrossingResult], plain: list[CrossingResult]
) -> Iterator[Figure]:
    name = layout + (f", {loss:.0%} of messages lost" if loss else "")
    good = sum(r.finished and not r.contacts for r in ours) / len(ours)
    done = sum(r.finished and not r.contacts for r in plain)
    share = f"{done / len(plain):.2f}" if plain else "not asked"
    yield Figure(
        f"{name}: done without contact", good, "share", "= 1", good == 1.0,
        f"ORCA by itself: {share} of {len(plain)} seeds",
        f"{len(ours)} seeds; {sum(r.contacts for r in ours)} contacts; median "
        f"{median(r.seconds for r in ours):.0f} s, worst {max(r.seconds for r in ours):.0f} s",
    )  # fmt: skip
