"""What a map draws first: fields, arenas and floors."""

import json
from base64 import b64decode
from typing import Any

import numpy as np
import pytest

from agent.mapping.building import Floor
from crdt.occupancy import SIDE_MAX
from crdt.progress import UNITS_MAX
from sim.files.grid_map import Instance
from sim.record import scene as scenes
from sim.record.scene import drawable
from sim.record.scene_builder import scene_named, scene_of
from sim.scenarios.coverage_setup import CoverageSetup
from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_setup import NavigationSetup
from sim.scenarios.scenario import ScenarioError, load


def test_a_field_with_its_sections() -> None:
    setting = FieldSetup(load("small"))
    scene = scene_of(setting)
    assert scene["kind"] == "field" and len(scene["rings"]) == 1 + len(setting.field.holes)
    for section, told in zip(setting.field.sections, scene["sections"], strict=True):
        assert told["id"] == section.id and sum(told["units"]) == section.units
        assert np.allclose(told["swaths"][0], section.swaths[0], atol=0.006)


def test_an_arena_with_its_cells() -> None:
    setting = ExplorationSetup(load_arena("arena"))
    scene = scene_of(setting)
    assert scene["kind"] == "arena"
    assert len(scene["rings"]) == 1 + len(setting.scenario.arena.solid)
    assert scene["cells"]["rows"] == setting.geometry.rows


def test_a_floor_with_its_walls() -> None:
    blocked = np.zeros((7, 13), dtype=np.bool_)
    blocked[3, 2:9] = True
    floor = Floor(blocked, 0.5, 0.2)
    setting = NavigationSetup.made("floor", floor, [(0.5, 0.5)], [[(5.5, 3.0)]])
    grid = scene_of(setting)["grid"]
    shape = grid["rows"], grid["columns"]
    bits = np.unpackbits(np.frombuffer(b64decode(grid["walls"]), dtype=np.uint8))
    assert np.array_equal(bits[: shape[0] * shape[1]].reshape(shape), floor.walls)
    assert scene_of(setting)["goals"] == [[0, 5.5, 3.0]]


def test_a_map_of_cells_has_its_walls_and_a_unit_for_each_free_cell() -> None:
    walls = np.zeros((4, 30), dtype=np.bool_)
    walls[0, 3:7] = True  # in the north
    setting = CoverageSetup.made(Instance("cells", walls, [(1, 0)]))
    scene = scene_of(setting)
    grid = scene["grid"]
    bits = np.unpackbits(np.frombuffer(b64decode(grid["walls"]), dtype=np.uint8))
    assert np.array_equal(bits[: walls.size].reshape(walls.shape), walls[::-1])
    assert grid["origin"] == [-60.0, -8.0] and scene["kind"] == "grid"
    cells = [swath for section in scene["sections"] for swath in section["swaths"]]
    assert len(cells) == np.count_nonzero(~walls)
    (x_m, y_m), (east_m, _) = cells[setting.ground.number((1, 0))]
    assert (x_m, east_m, y_m) == (-60.0, -56.0, 2.0)


def test_the_title_is_that_of_the_scenario_and_the_field_s_own_name_stays() -> None:
    """The map of the demo was called NM_Oxted_NullMeridian_Hole."""
    scene = scene_of(FieldSetup(load("oxted")))
    assert scene["name"] == "oxted" and scene["field"].startswith("NM_Oxted")


def test_by_name() -> None:
    assert scene_named("small")["kind"] == "field"
    assert scene_named("arena")["kind"] == "arena"
    with pytest.raises(ScenarioError):
        scene_named("nowhere")


SCENES = {
    "field": scene_of(FieldSetup(load("small"))),
    "arena": scene_of(ExplorationSetup(load_arena("arena"))),
}


@pytest.mark.parametrize("kind", list(SCENES))
def test_what_a_run_writes_can_be_drawn(kind: str) -> None:
    assert drawable(json.loads(json.dumps(SCENES[kind]))) == SCENES[kind]


@pytest.mark.parametrize("value", [None, "x", [[]], {"a": 1}, -1.5, float("nan"), 10**400])
@pytest.mark.parametrize("kind", list(SCENES))
def test_a_damaged_scene_is_none(kind: str, value: Any) -> None:
    """Found: `"bitrate": null` and `"cells": 7` were tracebacks of `headland map` and of films."""
    scene = SCENES[kind]
    assert drawable(value) is None and drawable({}) is None and drawable([]) is None
    for name in ("robots", "bitrate", "rings", "sections"):
        assert drawable({**scene, name: value}) is None, name
    assert drawable({**scene, "cells": 7}) is None
    assert drawable({**scene, "cells": value} if value is not None else {}) is None
    assert drawable({key: part for key, part in scene.items() if key != "width_m"}) is None


@pytest.mark.parametrize(
    "change",
    [{"swaths": [[[0.0, 0.0]]], "units": [1]}, {"units": [UNITS_MAX + 1]}],
    ids=["point", "units"],
)  # fmt: skip
def test_a_section_that_no_page_can_draw_is_none(change: dict[str, Any]) -> None:
    """The page stopped at a swath of one point, and cut one in 10^12 units without an end."""
    section = {"id": 1, "swaths": [[[0.0, 0.0], [9.0, 0.0]]], "units": [2]}
    scene = {**SCENES["field"], "sections": [section]}
    assert drawable(scene) == scene
    assert drawable({**scene, "sections": [{**section, **change}]}) is None


def test_bays_without_a_floor_are_none() -> None:
    assert drawable({**SCENES["field"], "bays": [[1.0, 2.0]]}) is None


@pytest.mark.parametrize("side", ["rows", "columns"])
def test_a_scene_with_more_cells_than_a_map_has_is_none(side: str) -> None:
    """Memory was taken for a thousand million rows before anything was drawn."""
    assert scenes.SIDE_MAX == SIDE_MAX
    scene = SCENES["arena"]
    for count, known in ((SIDE_MAX, True), (SIDE_MAX + 1, False), (10**9, False)):
        told = {**scene, "cells": {**scene["cells"], side: count}}
        assert (drawable(told) is not None) is known, count
