"""What a map draws first: fields, arenas and floors."""

from base64 import b64decode

import numpy as np
import pytest

from agent.mapping.building import Floor
from sim.record.scene_builder import scene_named, scene_of
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


def test_by_name() -> None:
    assert scene_named("small")["kind"] == "field"
    assert scene_named("arena")["kind"] == "arena"
    with pytest.raises(ScenarioError):
        scene_named("nowhere")
