"""`headland plan`: its files are read by programs that we did not write, and say what robots plan."""

import json
from collections import defaultdict
from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from isoxml.converter.shapely_geom import ShapelyConverterV4
from isoxml.util.isoxml_io import isoxml_from_path
from pyproj import Geod, Transformer
from shapely.geometry import LineString, Polygon, shape
from typer.testing import CliRunner, Result

from agent.field.fleet_plan import FleetPlan, FreedRobot, Rows, solve
from agent.field.plan_kernels import finish
from agent.field.plan_schedule import visits
from agent.field.travel_times import Remainder
from agent.runtime.files.field_file import plane, read_boundary
from sim.files.palette import colour_of
from sim.runs.field_run import FieldRun
from sim.runs.work_geojson import write_geojson
from sim.runs.work_plan import EQUAL_RUNS, FLEET_PLAN, covered_units, left_of, plan_work
from sim.runs.work_record import record_of
from sim.scenarios.drawn_field import drawn_boundary
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tests.agent.field.test_fleet_plan import drawn_problem
from tests.sim.runs.test_work_record import STARTED, tracks
from tests.sim.runs.test_work_record import field as worked_field
from tools.cli.headland import app

FIELDS = Path(__file__).parents[4] / "shared" / "data" / "fields"
KML = "{http://www.opengis.net/kml/2.2}"


def call(*words: object) -> Result:
    return CliRunner().invoke(app, ["plan", *(str(word) for word in words)])


@cache
def setup(robots: int = 3) -> FieldSetup:
    return FieldSetup(load("small").changed(robots, 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plan")
    done = call("small", "--robots", 3, "--out", out, "--json")
    assert done.exit_code == 0, done.output
    (out / "said.json").write_text(done.stdout)
    return out


def features(folder: Path, kind: str) -> list[dict[str, Any]]:
    document = json.loads((folder / "plan.geojson").read_text())
    return [f for f in document["features"] if f["properties"]["kind"] == kind]


@pytest.mark.parametrize("seed", range(8))
def test_a_schedule_ends_when_its_plan_does(seed: int) -> None:
    problem = drawn_problem(seed, 4, 20)
    found = solve(problem, None)
    for robot, row in enumerate(found.rows):
        walked = visits(problem, robot, row)
        assert walked[-1].ends_at_ms == finish(robot, np.array(row), len(row), *problem)
        assert [v.job for v in walked] == row
        for before, after in pairwise(walked):
            way = problem.link[2 * before.job + 1 - before.entry, 2 * after.job + after.entry]
            assert after.begins_at_ms == before.ends_at_ms + way == after.leaves_at_ms + way
        assert walked[0].entry == found.entries[robot]


def test_the_plan_is_what_robots_plan_in_the_first_second(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Rows, int]] = []
    plain = FleetPlan.plan

    def noted(
        self: FleetPlan, left: Mapping[int, Remainder | None], robots: Mapping[int, FreedRobot]
    ) -> Rows:
        rows = plain(self, left, robots)
        if len(robots) == 3:
            made.append((dict(rows), self.last_finish_at_ms))
        return rows

    monkeypatch.setattr(FleetPlan, "plan", noted)
    driven = FieldSetup(load("small").changed(3, 1, time_limit_s=3.0))
    FieldRun(driven).run()
    monkeypatch.undo()
    planned = plan_work(setup())
    rows, last_at_ms = made[0]
    assert {r.robot: [s.section for s in r.sections] for r in planned.robots} == rows
    assert abs(planned.ends_at_s * 1000 - last_at_ms) <= 1, (planned.ends_at_s, last_at_ms)


def test_geojson_is_all_the_work_and_the_ways_to_it(folder: Path) -> None:
    field = setup().field
    to_metres = Transformer.from_crs("EPSG:4326", plane(field.origin), always_xy=True).transform

    def metres(feature: dict[str, Any]) -> Any:
        return shapely.transform(shape(feature["geometry"]), to_metres, interleaved=False)

    swaths, ways = features(folder, "swath"), features(folder, "way")
    lines = [metres(f) for f in swaths]
    assert all(line.length > 0 for line in [*lines, *map(metres, ways)])
    assert abs(sum(line.length for line in lines) - field.work_m) < 0.01 * len(lines)
    ground = shapely.unary_union([metres(f) for f in features(folder, "section")])
    assert ground.difference(field.polygon.buffer(0.001)).area < 0.01
    assert ground.area > 0.99 * field.polygon.area
    inside = field.polygon.buffer(-field.overlap_m)
    assert all(inside.covers(metres(f)) for f in ways)
    geod = Geod(ellps="WGS84")
    by_robot: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for f in [*swaths, *ways]:
        by_robot[f["properties"]["robot"]].append(f)
        said = f["properties"]
        took_s = said["ends_at_s"] - said["starts_at_s"]
        places = f["geometry"]["coordinates"]
        length_m = geod.line_length([p[0] for p in places], [p[1] for p in places])
        # No leg is faster than the body; ways over other ends are longer than straight ones.
        assert took_s + 1.0 >= length_m / setup().vehicle.speed_m_s, said
    for legs in by_robot.values():
        legs.sort(key=lambda f: (f["properties"]["starts_at_s"], f["properties"]["ends_at_s"]))
        for before, after in pairwise(legs):
            assert before["properties"]["ends_at_s"] <= after["properties"]["starts_at_s"] + 0.002
            if "way" in (before["properties"]["kind"], after["properties"]["kind"]):
                end, begin = before["geometry"]["coordinates"], after["geometry"]["coordinates"]
                assert geod.inv(*end[-1], *begin[0])[2] < 0.02
    (outline,) = features(folder, "boundary")
    said = json.loads((folder / "said.json").read_text())["fields"][0]
    assert said["ends_at_s"] == pytest.approx(outline["properties"]["ends_at_s"], abs=0.06)
    assert shape(outline["geometry"]).exterior.is_ccw, "RFC 7946"


def test_the_package_reads_the_guidance_lines_of_each_robot(folder: Path) -> None:
    data, _ = isoxml_from_path(folder / "TASKDATA")
    (field,) = data.partfields
    convert = ShapelyConverterV4()
    of_group = {group.id: group for group in field.guidance_groups}
    assert [device.designator for device in data.devices] == ["robot 0", "robot 1", "robot 2"]
    for task, device in zip(data.tasks, data.devices, strict=True):
        (allocated,) = task.guidance_allocations
        group = of_group[allocated.guidance_group_id_ref]
        assert task.device_allocations[0].device_id_ref == device.id and task.status.value == "1"
        robot = int(str(group.designator).split()[-1])
        mine = [f for f in features(folder, "swath") if f["properties"]["robot"] == robot]
        lines = [convert.to_shapely_line_string(p.line_strings[0]) for p in group.guidance_patterns]
        assert lines == [LineString(f["geometry"]["coordinates"]) for f in mine]
    boundary = read_boundary(folder / "TASKDATA").polygon  # it is a field file again
    assert boundary.symmetric_difference(setup().field.polygon).area < 0.1


def test_kml_has_the_same_lines(folder: Path) -> None:
    root = ElementTree.parse(folder / "plan.kml").getroot()
    assert root.tag == f"{KML}kml"
    styles = {f"#{style.get('id')}" for style in root.iter(f"{KML}Style")}
    blue_green_red = next(root.iter(f"{KML}color")).text
    assert blue_green_red == "ffde8e3b" and colour_of(0) == "#3b8ede", "that of the map"
    lines = []
    for mark in root.iter(f"{KML}Placemark"):
        line = mark.find(f"{KML}LineString/{KML}coordinates")
        if line is not None and line.text:
            assert mark.findtext(f"{KML}styleUrl") in styles
            lines.append([tuple(map(float, p.split(","))) for p in line.text.split()])
    assert sorted(lines) == sorted(
        [tuple(p) for p in f["geometry"]["coordinates"]]
        for kind in ("swath", "way")
        for f in features(folder, kind)
    )
    rings = next(e.text for e in root.iter(f"{KML}coordinates") if e.text)
    outer = Polygon([tuple(map(float, p.split(","))) for p in rings.split()])
    assert outer.is_valid and outer.exterior.is_ccw


def test_the_work_of_another_field_is_refused(tmp_path: Path) -> None:
    """All of the field was planned again, as if nothing was done, and nobody said why."""
    path = tmp_path / "work.geojson"
    write_geojson(record_of(worked_field(), tracks(worked_field()), True, STARTED), path)
    done = call("small", "--done", path, "--out", tmp_path / "plan")
    assert done.exit_code == 2 and not list((tmp_path / "plan").iterdir()), done.output
    assert "is the work of 'Oxted', which is elsewhere than small" in done.stderr


def test_what_is_done_is_not_planned(tmp_path: Path) -> None:
    of = setup().field
    half = {robot: track[: len(track) // 2] for robot, track in tracks(of).items()}
    write_geojson(record_of(of, half, False, STARTED), tmp_path / "work.geojson")
    done = call("small", "--robots", 3, "--done", tmp_path / "work.geojson", "--json",
                "--out", tmp_path / "rest")  # fmt: skip
    assert done.exit_code == 0, done.output
    (said,) = json.loads(done.stdout)["fields"]
    whole = plan_work(setup())
    assert 0.3 * said["sections"] < said["done"] < 0.7 * said["sections"]
    assert said["ends_at_s"] < 0.75 * whole.ends_at_s
    # The ground that neither the work nor the plan covers is none, apart from the outline's 2 cm.
    left = shapely.unary_union(
        [shape(f["geometry"]) for f in features(tmp_path / "rest", "section")]
    )
    record = json.loads((tmp_path / "work.geojson").read_text())["features"]
    worked = [shape(f["geometry"]) for f in record if f["properties"]["kind"] == "covered"]
    (outline,) = features(tmp_path / "rest", "boundary")
    missing = shape(outline["geometry"]).difference(shapely.unary_union([left, *worked]))
    assert missing.area < 0.01 * shape(outline["geometry"]).area
    write_geojson(record_of(of, tracks(of), True, STARTED), tmp_path / "work.geojson")
    done = call("small", "--done", tmp_path / "work.geojson", "--json", "--out", tmp_path / "none")
    (said,) = json.loads(done.stdout)["fields"]
    assert said["done"] == said["sections"] and said["ends_at_s"] == 0


@pytest.mark.parametrize("drive", ["mecanum", "differential"])
def test_a_run_that_has_worked_everything_leaves_nothing_to_plan(drive: str) -> None:
    """At corners, ground is worked by the swing of the bar alone, or nobody can work it."""
    run = FieldRun(FieldSetup(load("small").changed(3, 1, drive=drive)))
    outcome = run.run()
    assert outcome.finished and outcome.reached == 1.0
    field = run.setting.field
    units = covered_units(field, record_of(field, run.tracks, True, STARTED))
    assert left_of(field, run.setting.plan.travel, units) == {}


def test_a_begun_section_keeps_its_rest() -> None:
    field, travel = setup().field, setup().plan.travel
    units = {0: frozenset(range(field.section(0).units)), 1: frozenset({0})}
    left = left_of(field, travel, units)
    assert 0 not in left and left[1] is not None and left[2] is None


def test_equal_seeds_give_equal_files(tmp_path: Path, folder: Path) -> None:
    assert call("small", "--robots", 3, "--out", tmp_path / "a", "--seed", 0).exit_code == 0
    for name in ("plan.geojson", "plan.kml", "TASKDATA/TASKDATA.XML"):
        assert (tmp_path / "a" / name).read_bytes() == (folder / name).read_bytes()


def test_two_fields_of_a_file_are_planned_and_a_bad_one_is_said(tmp_path: Path) -> None:
    square = [(0.0, 50.0), (0.001, 50.0), (0.001, 50.0005), (0.0, 50.0005), (0.0, 50.0)]
    bow = [(0.1, 50.0), (0.101, 50.0005), (0.101, 50.0), (0.1, 50.0005), (0.1, 50.0)]
    east = [(x + 0.01, y) for x, y in square]
    document = {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "properties": {"name": name},
             "geometry": {"type": "Polygon", "coordinates": [ring]}}
            for name, ring in (("east & west", square), ("bow", bow), ("[b]far[/b]", east))
        ],
    }  # fmt: skip
    (tmp_path / "two.geojson").write_text(json.dumps(document))
    done = call(tmp_path / "two.geojson", "--robots", 2, "--out", tmp_path / "out", "--json")
    assert done.exit_code == 1 and done.stderr.count("\n") == 1 and "bow" in done.stderr
    said = json.loads(done.stdout)["fields"]
    assert [f["name"] for f in said] == ["[b]far[/b]", "east & west"]
    data, _ = isoxml_from_path(tmp_path / "out" / "TASKDATA")
    assert [p.designator for p in data.partfields] == ["[b]far[/b]", "east & west"]
    ids = [p.id for f in data.partfields for g in f.guidance_groups for p in g.guidance_patterns]
    assert len(data.tasks) == 4 and len(set(ids)) == len(ids)
    ElementTree.parse(tmp_path / "out" / "plan.kml")
    table = call(tmp_path / "two.geojson", "--robots", 2, "--feature", "[b]far[/b]")
    assert table.exit_code == 0 and "[b]far[/b]" in table.stdout and "work, s" in table.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere",), "no such file"),
        (("warehouse",), "only fields"),
        (("rooms",), "only fields"),
        (("small", "--robots", 0), "robots"),
        (("small", "--drive", "ackermann"), "mecanum"),
        (("small", "--feature", "none"), "no field named"),
        (("small", "--done", "nowhere.geojson"), "nowhere.geojson"),
        (("small", "--out", "/dev/null/x"), "/dev/null"),
    ],
)
def test_a_wrong_word_is_one_line(words: tuple[object, ...], said: str) -> None:
    done = call(*words)
    assert done.exit_code == 2 and said in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["isoxml-dotnet/Partfields", "isoxml-py/v4_deutz_export",
                                  "isoxml-py/v4_cnh_export", "isoxml-py/v4_full_task"])  # fmt: skip
def test_every_field_of_farm_software_is_planned(tmp_path: Path, name: str) -> None:
    if not (FIELDS / name).exists():
        pytest.skip("the fields of farm software are not here")
    done = call(FIELDS / name, "--robots", 4, "--out", tmp_path, "--json")
    assert done.exit_code == 0, done.output
    for said in json.loads(done.stdout)["fields"]:
        rows = [s for robot in said["robots"] for s in robot["sections"]]
        assert sorted(rows) == list(range(said["sections"])), said["name"]
        assert said["method"] == (FLEET_PLAN if said["sections"] <= 256 else EQUAL_RUNS)
    data, _ = isoxml_from_path(tmp_path / "TASKDATA")
    assert len(data.partfields) == len(json.loads(done.stdout)["fields"])
    ElementTree.parse(tmp_path / "plan.kml")


def test_ground_that_no_robot_can_reach_is_told(tmp_path: Path) -> None:
    """Found: the far half of a field with a neck 1 m wide was planned without a word."""
    corners = [(0, 0), (40, 0), (20.5, 30), (40, 60), (0, 60), (19.5, 30), (0, 0)]
    ring = [(5.0 + x_m / 68_500, 52.0 + y_m / 111_300) for x_m, y_m in corners]
    outline = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    (tmp_path / "neck.geojson").write_text(json.dumps(outline))
    (tmp_path / "neck.toml").write_text(
        'name = "neck"\n[fleet]\nrobots = 2\n[field]\nfile = "neck.geojson"\nimplement_width_m = 3.0\n'
    )
    (told,) = json.loads(call(tmp_path / "neck.toml", "--json").stdout)["fields"]
    (apart_m2,) = [part["area_m2"] for part in told["unreached"] if "passages" in part["why"]]
    assert 400.0 < apart_m2 < 650.0
    assert "m2 behind passages that are too narrow" in call(tmp_path / "neck.toml").stdout


def test_a_drawn_field_is_planned_and_not_launched(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["plan", "drawn:7", "--robots", "2", "--out", str(tmp_path)])
    assert said.exit_code == 0 and " 7: 0.09 ha" in said.stdout, said.output
    boundary = read_boundary(tmp_path / "plan.geojson")
    assert boundary.polygon.area == pytest.approx(drawn_boundary("drawn:7").polygon.area, rel=1e-3)
    refused = CliRunner().invoke(app, ["launch", "drawn:7", "--out", str(tmp_path / "launch")])
    assert refused.exit_code == 2 and "a drawn field has no file" in refused.stderr, refused.output
    assert not (tmp_path / "launch").exists()
