"""Fields that the seed draws: the same faults on other shapes than those of the scenarios that ship."""

from pathlib import Path

import pytest
from shapely.geometry import Point

from sim.chaos.fault_profiles import (
    DRAWN_LIMIT_S,
    DRAWN_SHAPE,
    FORGER,
    PROFILES,
    draw,
    is_profile,
    span_of,
)
from sim.chaos.verdict import judge
from sim.scenarios.drawn_field import AREA_M2, ROOM_M, ROOM_SHARE, SHAPES, drawn_boundary
from sim.scenarios.field_setup import FieldSetup, is_met_within
from sim.scenarios.scenario import Box, Pushed, ScenarioError, load
from sim.scenarios.toml_writer import to_toml

FIELDS = [name for name, profile in PROFILES.items() if profile.mission == "field"]


def test_a_drawn_field_follows_from_its_seed_and_every_shape_is_drawn() -> None:
    seen = set()
    for seed in range(120):
        name, field, _ = boundary = drawn_boundary(f"drawn:{seed}")
        assert drawn_boundary(f"drawn:{seed}") == boundary
        assert field.is_valid and AREA_M2[0] * 0.99 < field.area < AREA_M2[1] * 1.01, name
        west, south, east, north = field.bounds
        assert abs(west + east) < 1e-6 and abs(south + north) < 1e-6, name
        assert field.buffer(-ROOM_M).area >= ROOM_SHARE * field.area, f"{name}: no room for bodies"
        seen.add(name.split()[0])
    assert seen == {shape.__name__ for shape in SHAPES}


@pytest.mark.parametrize(
    "name", ["drawn:", "drawn:x", "drawn:-1", "drawn:7.5", "drawn:" + "9" * 99]
)
def test_a_drawn_field_without_a_seed_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(ScenarioError, match=r"has no seed; a drawn field is drawn:7$"):
        FieldSetup(load(name))


@pytest.mark.parametrize("profile", FIELDS)
def test_faults_stay_what_they_were_on_a_drawn_field(profile: str, tmp_path: Path) -> None:
    for seed in range(8):
        plain, drawn = draw(seed, profile), draw(seed, profile + DRAWN_SHAPE)
        bounds = FieldSetup(drawn).field.polygon.bounds
        assert drawn.fault == [fault for fault in plain.fault if is_met_within(fault, bounds)]
        assert drawn.fleet == plain.fleet and drawn.field.file == f"drawn:{seed}"
        assert span_of(drawn) == span_of(plain)._replace(limit_at_s=DRAWN_LIMIT_S)
        path = tmp_path / "again.toml"
        path.write_text(to_toml(drawn))
        again = FieldSetup(load(str(path)))
        assert again.field == FieldSetup(drawn).field and again.scenario.fault == drawn.fault


def test_a_box_that_lies_beside_a_drawn_field_is_left_out() -> None:
    """It ended a run of chaos before its begin."""
    left = 0
    for seed in range(60):
        plain, drawn = draw(seed, "body"), draw(seed, "body" + DRAWN_SHAPE)
        field = drawn_boundary(drawn.field.file).polygon
        for fault in plain.fault:
            if isinstance(fault, Box) and fault not in drawn.fault:
                assert field.distance(Point(fault.x_m, fault.y_m)) > fault.size_m / 2
                left += 1
        pushes = [fault for fault in plain.fault if isinstance(fault, Pushed)]
        assert all(push in drawn.fault for push in pushes)
    assert left


def test_only_profiles_with_bodies_have_drawn_fields() -> None:
    for name, profile in PROFILES.items():
        assert is_profile(name) and is_profile(name + FORGER)
        for drawn in (name + DRAWN_SHAPE, name + DRAWN_SHAPE + FORGER):
            assert is_profile(drawn) == (profile.mission == "field")
    for wrong in ("nope", "nope" + DRAWN_SHAPE, "body" + FORGER + DRAWN_SHAPE, DRAWN_SHAPE, ""):
        assert not is_profile(wrong)
        with pytest.raises(KeyError):
            draw(1, wrong)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("profile", ["body", "stop", "steered", "apart"])
def test_trouble_on_a_drawn_field_breaks_no_rule(profile: str) -> None:
    verdict = judge(draw(3, profile + DRAWN_SHAPE))
    assert verdict.ok, verdict
