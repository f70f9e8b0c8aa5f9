"""The scene of a scenario: field, arena or floor as plain values, metres in the field frame."""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_map import CellMap
from agent.mapping.building import Floor
from crdt.progress import BLOCK_UNITS
from sim.record.mcap_schema import THING
from sim.record.scene import Scene
from sim.scenarios.coverage_setup import CoverageSetup
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import ScenarioError, load
from sim.world.walls import OBSTACLE_COLUMNS

POINT_DIGITS = 2  # centimetres
assert len(THING) == OBSTACLE_COLUMNS, "the names of what `sim.world.walls` has in a row"


def scene_of(setting: FleetSetup) -> Scene:
    """Field, arena or floor; metres in the field frame, x east, y north."""
    fleet = setting.scenario.fleet
    scene: Scene = {
        "name": setting.scenario.name, "kind": "field", "robots": fleet.robots,
        "radius_m": fleet.radius_m, "bitrate": setting.scenario.bus.bitrate,
        "rings": [], "sections": [], "width_m": 0.0, "gate": None, "grid": None, "cells": None,
        "goals": [], "front": getattr(fleet, "drive", "mecanum") != "mecanum",
    }  # fmt: skip
    floor: Floor | None = getattr(setting, "floor", None)  # for any mission in a building
    if floor is not None:
        scene["grid"] = _grid(floor.walls, floor.origin, floor.cell_m)
        goals: Mapping[int, Sequence[Sequence[float]]] = getattr(setting, "goals", {})
        scene["goals"] = [[slot, *_point(at)] for slot, own in goals.items() for at in own]
        scene["kind"] = "floor"
        if isinstance(setting, DeliverySetup):
            scene["kind"] = "warehouse"
            scene["bays"] = [_point(bay) for bay in setting.scenario.warehouse.bays]
            known = setting.house.tasks
            scene["transports"] = [[n, task.pickup, task.dropoff] for n, task in known.items()]
    elif isinstance(setting, ExplorationSetup):
        geometry = setting.geometry
        west, south = geometry.origin_m
        scene["rings"] = [
            _box(west, south, -west, -south),
            *map(_box_of, setting.scenario.arena.solid),
        ]
        scene["cells"] = {
            "origin": [west, south], "cell_m": geometry.cell_m, "rows": geometry.rows,
            "columns": geometry.columns, "order": setting.order.value,
        }  # fmt: skip
        scene["kind"] = "arena"
    elif isinstance(setting, FieldSetup):
        field = setting.field
        scene["field"] = field.name  # as its file calls it
        scene["rings"] = [_line(ring) for ring in (field.exterior, *field.holes)]
        scene["gate"], scene["width_m"] = _point(field.gate), field.implement_width_m
        scene["earth"] = list(field.origin)  # latitude and longitude of (0, 0), degrees
        scene["sections"] = [
            {"id": s.id, "swaths": [_line(swath) for swath in s.swaths], "units": list(s.units_of)}
            for s in field.sections
        ]
    elif isinstance(setting, CoverageSetup):
        ground = setting.ground
        west, south = -ground.columns * ground.cell_m / 2, -ground.rows * ground.cell_m / 2
        scene["grid"] = _grid(ground.walls[::-1], (west, south), ground.cell_m)  # row 0 is north
        scene["width_m"], scene["kind"] = ground.cell_m, "grid"
        scene["sections"] = [
            {
                "id": section, "units": [1] * units,
                "swaths": [_cell(ground, section * BLOCK_UNITS + k) for k in range(units)],
            }
            for section, units in ground.section_units.items()
        ]  # fmt: skip
    return scene


def scene_named(name: str, robots: int | None = None) -> Scene:
    """The scene of a scenario or an arena, by file or by name. Raises ScenarioError."""
    try:
        return scene_of(FieldSetup(_with(load(name), robots)))
    except ScenarioError as problem:
        try:
            return scene_of(ExplorationSetup(_with(load_arena(name), robots)))
        except ScenarioError:
            raise problem from None


def _with(scenario: Any, robots: int | None) -> Any:
    return scenario if robots is None else scenario.changed(robots)


def _point(at: Sequence[float]) -> list[float]:
    return [round(float(v), POINT_DIGITS) for v in at]


def _line(points: Iterable[Sequence[float]]) -> list[list[float]]:
    return [_point(at) for at in points]


def _cell(ground: CellMap, number: int) -> list[list[float]]:
    """From the west side of a cell to its east side."""
    x_m, y_m = ground.centre(number)
    return _line(((x_m - ground.cell_m / 2, y_m), (x_m + ground.cell_m / 2, y_m)))


def _box(west: float, south: float, east: float, north: float) -> list[list[float]]:
    return _line(((west, south), (east, south), (east, north), (west, north)))


def _box_of(box: tuple[float, float, float, float]) -> list[list[float]]:
    return _box(*box)


def _grid(walls: NDArray[np.bool_], origin: Sequence[float], cell_m: float) -> dict[str, Any]:
    """`walls`: bits by row from the south, most significant first, base64."""
    return {
        "origin": _point(origin), "cell_m": cell_m, "rows": walls.shape[0],
        "columns": walls.shape[1], "walls": b64encode(np.packbits(walls).tobytes()).decode(),
    }  # fmt: skip
