"""Boxes that come and go in front of a robot: when it looks for another path, and when it does not."""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from math import hypot, inf
from random import Random

import pytest

from agent.mapping.building import Floor
from sim.runs.navigation_run import NavigationOutcome, NavigationRun
from sim.scenarios.navigation_setup import NavigationSetup
from sim.world.world import World

OPEN = "\n".join(["." * 24] * 7)
HALL = Floor.drawn(OPEN, 1.0, 0.35)
START, GOAL = (1.5, 3.5), (22.5, 3.5)
ALONE = "." * 24
BOX_M = 0.8
AISLES = 5  # in parallel, of one cell each, joined at both ends


def outing(
    boxes: list[tuple[float, float, float, float]], floor: Floor = HALL
) -> tuple[NavigationRun, NavigationOutcome]:
    """One robot from west to east at 1 m/s; boxes of 0.8 m: from, until (seconds), x, y."""
    y_m = START[1] if floor is HALL else 0.5
    setting = NavigationSetup.made(
        "boxes", floor, [(START[0], y_m)], [[(GOAL[0], y_m)]], time_limit_s=120.0
    )

    return _boxed(setting, boxes, BOX_M)


def _boxed(
    setting: NavigationSetup, boxes: Sequence[tuple[float, float, float, float]], size_m: float
) -> tuple[NavigationRun, NavigationOutcome]:
    def put(world: World, until_s: float, x_m: float, box_y_m: float) -> None:
        number = world.add_box(x_m, box_y_m, size_m)
        if until_s < inf:
            world.at(round(until_s * 1e6), partial(world.remove_box, number))

    class Boxed(NavigationSetup):
        def world(self) -> World:
            world = super().world()
            for from_s, until_s, x_m, box_y_m in boxes:
                world.at(round(from_s * 1e6), partial(put, world, until_s, x_m, box_y_m))
            return world

    starts, goals = setting.starts, list(setting.goals.values())
    run = NavigationRun(Boxed(setting.scenario, setting.floor, starts, goals))
    return run, run.run()


def why(run: NavigationRun) -> list[str]:
    return [path.why for path in run.followed[0]]


def at_s(x_m: float) -> float:
    """About when the robot is there, if nothing holds it up."""
    run, _ = FREE
    track = run.tracks[0]
    return float(track[(track[:, 1] > x_m).argmax(), 0]) / 1e6


FREE = outing([])


def test_nothing_there_one_path() -> None:
    run, outcome = FREE
    assert outcome.finished and why(run) == ["goal"]


def test_a_box_far_away_that_leaves_costs_nothing() -> None:
    run, outcome = outing([(3.0, at_s(12.0), 18.0, 3.5)])
    assert outcome.finished and why(run) == ["goal"] and not outcome.contacts


def test_a_box_that_flickers_costs_nothing() -> None:
    """Two control periods at a time, right inside the horizon."""
    boxes = [(at_s(x) + 0.02, at_s(x) + 0.11, x + 2.0, 3.5) for x in (6.0, 9.0, 12.0, 15.0)]
    run, outcome = outing(boxes)
    assert outcome.finished and why(run) == ["goal"] and not outcome.contacts


def test_a_box_that_stays_costs_one_replanning() -> None:
    run, outcome = outing([(2.0, inf, 12.0, 3.5)])
    assert outcome.finished and not outcome.contacts
    assert why(run).count("blocked") == 1 and "lost" not in why(run)


def test_the_path_is_taken_up_again_when_the_box_has_gone() -> None:
    run, outcome = outing([(at_s(8.0), at_s(8.0) + 0.6, 10.2, 3.5)])
    assert outcome.finished and not outcome.contacts
    assert why(run) == ["goal", "blocked", "restored"]


def test_where_there_is_no_way_round_it_waits() -> None:
    run, outcome = outing([(3.0, 40.0, 12.0, 0.5)], Floor.drawn(ALONE, 1.0, 0.35))
    assert outcome.finished and not outcome.contacts
    assert outcome.simulated_s > 40.0 and why(run) == ["goal"]


@pytest.mark.parametrize("from_s", [0.0, 3.0])
def test_m15_a_box_that_stays_in_an_aisle_is_driven_round_by_the_next_one(from_s: float) -> None:
    """Its detour begins backwards: what stands behind a robot is not gone because no ray meets it."""
    wall, free = f".{'#' * 22}.", "." * 24
    floor = Floor.drawn("\n".join([free, wall, free, wall, free]), 1.0, 0.3)
    setting = NavigationSetup.made("loop", floor, [(0.5, 2.5)], [[(23.5, 2.5)]], time_limit_s=400.0)
    run, outcome = _boxed(setting, [(from_s, inf, 12.5, 2.5)], BOX_M)
    assert outcome.finished and not outcome.contacts
    assert why(run) == ["goal", "blocked"]
    # 10 m in, 10 m back, 2 m to the next aisle and 23 m along it, 2 m back to the goal.
    assert outcome.simulated_s < 1.5 * (10 + 10 + 2 + 23 + 2)


@pytest.mark.parametrize("seed", range(6))
def test_m15_drawn_aisles_with_boxes_that_stay_are_got_through(seed: int) -> None:
    """All aisles but one are blocked, each somewhere, from some time on."""
    print(f"seed {seed}")
    rng = Random(seed)
    length = rng.randint(10, 16)
    wall, free = f".{'#' * (length - 2)}.", "." * length
    floor = Floor.drawn("\n".join([free, *[wall, free] * (AISLES - 1)]), 1.0, 0.3)
    open_aisle = rng.randrange(AISLES)
    boxes = [
        (rng.uniform(0.0, 6.0), inf, rng.uniform(3.0, length - 3.0), 2 * aisle + 0.5)
        for aisle in range(AISLES)
        if aisle != open_aisle
    ]
    start, goal = (
        (0.5, 2 * rng.randrange(AISLES) + 0.5),
        (length - 0.5, 2 * rng.randrange(AISLES) + 0.5),
    )
    setting = NavigationSetup.made("aisles", floor, [start], [[goal]], time_limit_s=1200.0)
    run, outcome = _boxed(setting, boxes, BOX_M)
    assert outcome.finished and not outcome.contacts, (seed, boxes, why(run))
    track = run.tracks[0]
    driven_m = sum(hypot(b[1] - a[1], b[2] - a[2]) for a, b in pairwise(track))
    # Into every blocked aisle and back, between all of them, and through the free one.
    assert driven_m < 1.5 * (AISLES * 2 * length + 4 * AISLES), (seed, driven_m)
