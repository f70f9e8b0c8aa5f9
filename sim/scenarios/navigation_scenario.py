"""Scenario files of fleets with navigation goals in a building: `mission = "errands"`.

    [floor]                       a Moving AI map, or a drawing of the same characters
    map = "rooms.map"
    [errands]                     goals that the seed draws, or starts and goals written down
    each = 2

`headland run` accepts these as well as the scenarios of fields.
"""

from math import dist
from random import Random
from typing import Literal

import numpy as np
from pydantic import Field
from shapely.geometry import box
from shapely.ops import unary_union

from agent.interface.geometry import Point
from agent.mapping.building import Floor, FloorError
from agent.runtime.declared_values import FieldTable, FloorTable, Table
from agent.runtime.files.given_file import DRAWING_BYTES_MAX, GivenFileError, read_text
from sim.scenarios.navigation_setup import NavigationSetup, scattered
from sim.scenarios.scenario import (
    SHIPPED,
    Scenario,
    ScenarioError,
    is_field_source,
    load,
    load_kind,
    read_document,
)  # fmt: skip
from sim.world.temporary_obstacles import TemporaryObstacle, random_temporary_obstacle_generator

CELLS_MAX = 1 << 20  # of a map at its finest; with more cells, paths take too long to prepare
APART_RADII = 2.5  # minimum distance of drawn starts


class ErrandTable(Table):
    """Where robots start, and where each has to go; both may be drawn."""

    each: int = Field(default=1, ge=1, le=64)  # goals per robot, drawn by the seed
    starts: list[Point] | None = None
    goals: list[list[Point]] | None = None


class ObstacleTable(Table):
    """Boxes that appear and vanish again, drawn by the seed."""

    every_s: float = Field(default=20.0, gt=0.1)
    lasting_s: tuple[float, float] = (5.0, 40.0)
    size_m: tuple[float, float] = (0.3, 0.6)
    until_s: float = Field(default=600.0, gt=0.0)


class NavigationScenario(Scenario):
    """A scenario file with `mission = "errands"`."""

    mission: Literal["errands"] = "errands"  # type: ignore[assignment]
    field: FieldTable = FieldTable(file="")  # there is no field
    floor: FloorTable
    errands: ErrandTable = ErrandTable()
    obstacles: ObstacleTable | None = None


def load_mission(name: str) -> Scenario:
    """Load any scenario that `headland run` accepts; its `mission` selects the kind."""
    if is_field_source(name):
        return load(name)
    document, _ = read_document(name, SHIPPED)
    kind = NavigationScenario if document.get("mission") == "errands" else Scenario
    return load_kind(name, kind, SHIPPED)


def setting_of(scenario: NavigationScenario) -> NavigationSetup:
    """Raises ScenarioError if the map or the places cannot be used."""
    name, fleet, table = scenario.name, scenario.fleet, scenario.floor
    if fleet.drive != "mecanum":
        raise ScenarioError(
            f"{name}: fleet.drive: errands need a body that drives in any direction"
        )
    try:
        drawn = "\n" in table.map
        text = table.map if drawn else read_text(scenario.path_of(table.map), DRAWING_BYTES_MAX)
        floor = Floor.drawn(text, table.cell_m, fleet.radius_m, table.margin_m)
    except (GivenFileError, FloorError) as problem:
        raise ScenarioError(f"{name}: floor.map: {problem}") from None
    if floor.inflated.size > CELLS_MAX:
        raise ScenarioError(f"{name}: floor.map: more than {CELLS_MAX} cells of {floor.fine_m:g} m")
    if len(floor.lattice) == 0:
        raise ScenarioError(f"{name}: floor.map: no place for a body of {fleet.radius_m} m radius")
    return NavigationSetup(
        scenario,
        floor,
        *_places(scenario, floor),
        dropped=_dropped(scenario, floor),
    )


def _dropped(scenario: NavigationScenario, floor: Floor) -> list[TemporaryObstacle]:
    table = scenario.obstacles
    if table is None:
        return []
    cell_m, (west, south) = floor.cell_m, floor.origin
    rows, columns = np.nonzero(~floor.walls)
    corners = zip((west + columns * cell_m).tolist(), (south + rows * cell_m).tolist(), strict=True)
    area = unary_union([box(x, y, x + cell_m, y + cell_m) for x, y in corners])
    try:
        return list(
            random_temporary_obstacle_generator(
                scenario.run.seed, area, table.every_s, table.lasting_s, table.size_m,
                end_at_s=min(table.until_s, scenario.run.time_limit_s),
            )
        )  # fmt: skip
    except ValueError as problem:
        raise ScenarioError(f"{scenario.name}: obstacles.size_m: {problem}") from None


def _part(floor: Floor, at: Point) -> int:
    """The region of the floor in which a place lies; no path joins two of them."""
    west, south = floor.origin
    return int(
        floor.parts[int((at[1] - south) // floor.fine_m), int((at[0] - west) // floor.fine_m)]
    )


def _check_together(name: str, floor: Floor, starts: list[Point], goals: list[list[Point]]) -> None:
    """Raises ScenarioError where robots have no room beside each other, or no way to a goal."""
    ends = [own[-1] if own else start for start, own in zip(starts, goals, strict=True)]
    for what, places in (("starts", starts), ("goals", ends)):
        for number, (x_m, y_m) in enumerate(places):
            for other in range(number):
                if dist(places[other], (x_m, y_m)) < 2 * floor.radius_m:
                    raise ScenarioError(
                        f"{name}: errands.{what}: robot {number} at {x_m:g}, {y_m:g} would touch "
                        f"robot {other}; both have a radius of {floor.radius_m:g} m"
                    )
    for number, (start, own) in enumerate(zip(starts, goals, strict=True)):
        for x_m, y_m in own:
            if _part(floor, (x_m, y_m)) != _part(floor, start):
                raise ScenarioError(
                    f"{name}: errands.goals: no way leads robot {number} to {x_m:g}, {y_m:g}"
                )


def _places(scenario: NavigationScenario, floor: Floor) -> tuple[list[Point], list[list[Point]]]:
    name, table, robots = scenario.name, scenario.errands, scenario.fleet.robots
    if (table.starts is None) != (table.goals is None):
        raise ScenarioError(f"{name}: errands: write down both starts and goals, or neither")
    if table.starts is not None and table.goals is not None:
        if min(len(table.starts), len(table.goals)) < robots:
            raise ScenarioError(
                f"{name}: errands.starts: {len(table.starts)} starts and goals of {len(table.goals)} "
                f"for {robots} robots"
            )
        starts, goals = table.starts[:robots], table.goals[:robots]
        for x_m, y_m in [*starts, *(goal for own in goals for goal in own)]:
            if not floor.route.admits((x_m, y_m)):
                raise ScenarioError(f"{name}: errands: no robot can stand at {x_m:g}, {y_m:g}")
        _check_together(name, floor, starts, goals)
        return starts, goals
    rng = Random(f"{scenario.run.seed}/errands")
    apart_m = APART_RADII * floor.radius_m
    try:
        starts = scattered(floor, robots, rng, apart_m)
        # All robots can be at their last goals at the same time.
        ends = scattered(floor, robots, rng, apart_m)
        before = table.each - 1
        ways = [[*(scattered(floor, before, rng, 0.0) if before else ()), end] for end in ends]
    except ValueError as problem:
        raise ScenarioError(f"{name}: fleet.robots: {problem}") from None
    return starts, ways
