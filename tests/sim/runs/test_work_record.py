"""Finished work leaves as task data and as GeoJSON, and reads back equal, by us and by `isoxml`."""

import itertools
import json
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from math import cos, sin
from pathlib import Path
from shutil import rmtree
from zipfile import ZipFile

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from isoxml.converter.shapely_geom import ShapelyConverterV4
from isoxml.util.isoxml_io import isoxml_from_path, isoxml_from_zip
from shapely.geometry import LinearRing, Polygon

from agent.field.field_division import divide
from agent.field.field_map import Field
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import read_boundary
from sim.runs.isoxml_time_log import pack
from sim.runs.isoxml_writer import write_isoxml
from sim.runs.work_geojson import read_work_geojson, write_geojson
from sim.runs.work_plan_files import write_plan_isoxml
from sim.runs.work_record import LogPoint, WorkRecord, covered_area, record_of
from sim.world.coverage_truth import coverage, sample_points
from sim.world.ground_truth import TrackPoint
from tests.examples import examples
from tests.sim.runs.work_isoxml import BadTimeLog, read_work_isoxml, unpack

STARTED = datetime(2026, 3, 4, 23, 59, 30, tzinfo=UTC)  # midnight comes during the work


def field() -> Field:
    square = [(-60, -40), (60, -40), (60, 40), (-60, 40)]
    hole = [(-10, -10), (10, -10), (10, 10), (-10, 10)]
    return divide("Oxted", Polygon(square, [hole]), (51.2, 0.0), (-60, -40), 4.0)


def tracks(of: Field, speed_m_s: float = 2.0) -> dict[int, list[TrackPoint]]:
    """Two robots that follow every other section, driven exactly, ten points a second."""
    ways: dict[int, list[TrackPoint]] = {0: [], 1: []}
    for section in of.sections:
        way = ways[section.id % 2]
        t_us = way[-1][0] if way else 0
        for swath in section.swaths:
            for a, b in itertools.pairwise(swath):
                length_m = ((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) ** 0.5
                steps = max(1, round(length_m / speed_m_s * 10))
                for k in range(steps + 1):
                    t_us += 100_000
                    x, y = (a[i] + (b[i] - a[i]) * k / steps for i in (0, 1))
                    way.append((t_us, x, y, True))
            way.append((t_us + 100_000, *swath[-1], False))
            t_us += 1_000_000
    return ways


@pytest.fixture(scope="module")
def record() -> WorkRecord:
    return record_of(field(), tracks(field()), True, STARTED)


def test_what_was_covered_is_what_was_worked() -> None:
    """Everything but the corners: the simulated bar cannot reach into them."""
    parts = covered_area(field(), tracks(field()))
    area_m2 = sum(part.area for part in parts)
    assert 0.995 * field().polygon.area < area_m2 <= field().polygon.area


def test_the_covered_area_has_the_swing_of_the_bar_as_the_judge_counts_it() -> None:
    """A bar of 4 m that is lowered as the robot slips aside, and then follows a tight bend."""
    places = [(-50.0, 0.0), (-50.0, 0.06), (-49.0, 0.06)]
    places += [(-49.0 + 0.4 * sin(k / 10), 0.46 - 0.4 * cos(k / 10)) for k in range(32)]
    track = [(k * 100_000, *place, True) for k, place in enumerate(places)]
    raster = sample_points(field().polygon, 4.0, 0.0, 0.1)
    judged = coverage(raster, {0: track}, 4.0).worked_m2[0]
    parts = covered_area(field(), {0: track})
    assert sum(part.area for part in parts) == pytest.approx(judged, rel=0.01)


@pytest.mark.parametrize("name", ["TASKDATA", "work.zip", "work.geojson"])
def test_reads_back_equal(tmp_path: Path, record: WorkRecord, name: str) -> None:
    path = tmp_path / name
    if name.endswith("json"):
        write_geojson(record, path)
        assert read_work_geojson(path) == record
    else:
        write_isoxml(record, path)
        assert read_work_isoxml(path) == record
    boundary = read_boundary(path, record.name)  # and is a field file again
    assert boundary.polygon.symmetric_difference(field().polygon).area < 1.0


def test_the_package_reads_it_too(tmp_path: Path, record: WorkRecord) -> None:
    write_isoxml(record, tmp_path / "TASKDATA")
    write_isoxml(record, tmp_path / "work.zip")
    data, binaries = isoxml_from_path(tmp_path / "TASKDATA")
    zipped, _ = isoxml_from_zip(tmp_path / "work.zip")
    assert len(zipped.tasks) == 1 and data.task_controller_version == version("headland")
    convert = ShapelyConverterV4()
    (boundary,) = data.partfields[0].polygons
    assert convert.to_shapely_polygon(boundary).equals(
        Polygon(record.boundary[0], record.boundary[1:])
    )
    (task,) = data.tasks
    (zone,) = task.treatment_zones
    shapes = [convert.to_shapely_polygon(p) for p in zone.polygons]
    assert all(shape.is_valid for shape in shapes) and len(shapes) == len(record.covered)
    patterns = data.partfields[0].guidance_groups[0].guidance_patterns
    lines = [tuple(convert.to_shapely_line_string(p.line_strings[0]).coords) for p in patterns]
    assert lines == [swath.points for swath in record.swaths]
    assert {p.type.value for p in patterns} == {"1", "3"}, "AB lines and rings"
    assert task.status.value == "4" and task.partfield_id_ref == data.partfields[0].id
    logs = [unpack(binaries[log.filename], record.started) for log in task.time_logs]
    assert logs == list(record.logs.values())


FARMS = b'<ISO11783_TaskData ManagementSoftwareManufacturer="%b" TaskControllerManufacturer="%b"/>'


@pytest.mark.parametrize("makers", [(b"Farm", b"Headland"), (b"Headland", b"Terminal")])
@pytest.mark.parametrize(
    "name", ["TASKDATA/TASKDATA.XML", "TASKDATA/TaskData.xml", "farm.zip", "a.zip"]
)
def test_task_data_of_others_is_never_replaced(
    name: str, makers: tuple[bytes, bytes], tmp_path: Path, record: WorkRecord
) -> None:
    """`headland run TASKDATA/` named `export --isoxml TASKDATA` as the next command, which replaced the
    fields, customers and tasks of the farm."""
    path, text = tmp_path / name, FARMS % makers
    path.parent.mkdir(exist_ok=True)
    if name == "farm.zip":
        with ZipFile(path, "w") as archive:
            archive.writestr("TASKDATA.XML", text)
    else:
        path.write_bytes(text)
    kept = path.read_bytes()
    out = path if path.suffix == ".zip" else path.parent
    with pytest.raises(FieldFileError, match="task data that not Headland has written"):
        write_isoxml(record, out)
    assert path.read_bytes() == kept
    if out.is_dir():
        with pytest.raises(FieldFileError, match="task data that not Headland has written"):
            write_plan_isoxml([], out)
        assert [each.name for each in out.iterdir()] == [path.name]
    path.unlink()
    for _ in range(2):  # its own are replaced
        write_isoxml(record, out)


def test_rings_and_lines_are_as_geojson_wants_them(tmp_path: Path, record: WorkRecord) -> None:
    """RFC 7946, 3.1.4 and 3.1.6: a line has two places, an exterior ring turns left, a hole turns right.
    The ground that was covered turned right, and what a ring encloses was for some programs all else."""
    short = {9: record.logs[0][:1]}
    path = tmp_path / "work.geojson"
    write_geojson(record._replace(logs={**record.logs, **short}), path)
    shapes = [each["geometry"] for each in json.loads(path.read_text())["features"]]
    rings = [
        (k, ring)
        for s in shapes
        if s["type"] == "Polygon"
        for k, ring in enumerate(s["coordinates"])
    ]
    assert len(rings) > 2 and any(k for k, _ in rings)
    assert all(LinearRing(ring).is_ccw == (k == 0) for k, ring in rings)
    assert all(len(s["coordinates"]) > 1 for s in shapes if s["type"] == "LineString")
    assert read_work_geojson(path).logs[9] == short[9]


def test_a_name_with_control_characters_makes_no_broken_task_data(tmp_path: Path) -> None:
    """The name of a field is that of somebody's file: an escape or a bell made a TASKDATA.XML that no
    program reads, and `headland export` wrote it to the terminal as it was."""
    odd = replace(field(), name="x\x1b[31m\x07\n <&> ü")
    record = record_of(odd, tracks(odd), True, STARTED)
    assert record.name == "x [31m   <&> ü"
    write_isoxml(record, tmp_path / "TASKDATA")
    assert read_work_isoxml(tmp_path / "TASKDATA") == record
    path = tmp_path / "work.geojson"
    write_geojson(record, path)
    document = json.loads(path.read_text())
    document["features"][0]["properties"]["name"] = odd.name  # of an earlier version
    path.write_text(json.dumps(document))
    assert read_work_geojson(path) == record


@pytest.mark.parametrize("place", [[0.0, 1e308], [181.0, 51.0], [0.0, -90.5]])
@pytest.mark.parametrize("kind", ["boundary", "swath", "covered", "log"])
def test_a_place_that_is_not_on_the_earth_is_one_line(
    place: list[float], kind: str, tmp_path: Path, record: WorkRecord
) -> None:
    """A damaged work.geojson ended `headland export` with "cannot convert float NaN to integer"."""
    path = tmp_path / "work.geojson"
    write_geojson(record, path)
    document = json.loads(path.read_text())
    shape = next(
        each["geometry"] for each in document["features"] if each["properties"]["kind"] == kind
    )
    line = shape["coordinates"][0] if shape["type"] == "Polygon" else shape["coordinates"]
    line[1] = place
    path.write_text(json.dumps(document))
    with pytest.raises(FieldFileError, match=r"not a work record: .*no longitude and latitude"):
        read_work_geojson(path)


@pytest.mark.parametrize("rings", [[], [[]], [[[0.0, 51.0], [0.0, 51.1]]]])
def test_an_outline_without_corners_is_one_line(
    rings: list[list[list[float]]], tmp_path: Path, record: WorkRecord
) -> None:
    path = tmp_path / "work.geojson"
    write_geojson(record, path)
    document = json.loads(path.read_text())
    document["features"][0]["geometry"]["coordinates"] = rings
    path.write_text(json.dumps(document))
    with pytest.raises(FieldFileError, match=r"not a work record: .*three corners"):
        read_work_geojson(path)


def test_unfinished_work_is_paused(tmp_path: Path, record: WorkRecord) -> None:
    write_isoxml(record._replace(finished=False), tmp_path)
    assert not read_work_isoxml(tmp_path).finished
    assert isoxml_from_path(tmp_path)[0].tasks[0].status.value == "3"


def test_nothing_worked_is_a_record(tmp_path: Path) -> None:
    empty = record_of(field(), {0: [(0, 0.0, 0.0, False)], 1: []}, False, STARTED)
    write_isoxml(empty, tmp_path)
    assert read_work_isoxml(tmp_path) == empty
    assert empty.covered == () and list(empty.logs) == [0]


log_points = st.lists(
    st.tuples(
        st.integers(0, 90_000_000),
        st.integers(-1_800_000_000, 1_800_000_000),
        st.integers(-900_000_000, 900_000_000),
        st.booleans(),
    )
).map(lambda rows: tuple(LogPoint(t, x / 1e7, y / 1e7, w) for t, x, y, w in rows))


@given(log_points)
def test_time_logs_read_back_equal(log: tuple[LogPoint, ...]) -> None:
    assert unpack(pack(log, STARTED), STARTED) == log


@given(st.binary(max_size=200))
def test_bad_time_logs_are_said_to_be(records: bytes) -> None:
    try:
        unpack(records, STARTED)
    except BadTimeLog as problem:
        assert "\n" not in str(problem)


@pytest.mark.parametrize("lon", (1e308, 180.5))
def test_a_covered_place_that_is_not_in_degrees_is_told(
    tmp_path: Path, record: WorkRecord, lon: float
) -> None:
    """`headland plan --done` ended in a traceback where such a place was projected."""
    (first, *ring), *holes = record.covered[0]
    part = (((lon, first[1]), *ring), *holes)
    write_geojson(record._replace(covered=(part,)), tmp_path / "work.geojson")
    with pytest.raises(FieldFileError, match=r"not a work record: .* is no longitude and latitude"):
        read_work_geojson(tmp_path / "work.geojson")


@pytest.mark.parametrize("year", [1970, 2200])
def test_work_of_a_clock_that_was_not_set_is_one_line(
    tmp_path: Path, record: WorkRecord, year: int
) -> None:
    """A computer without a clock of its own begins in 1970, and time logs in 1980: `headland export`
    ended in a traceback."""
    odd = record._replace(started=STARTED.replace(year=year))
    write_geojson(odd, tmp_path / "work.geojson")
    assert read_work_geojson(tmp_path / "work.geojson") == odd
    with pytest.raises(
        FieldFileError, match=rf"began on {year}-03-04; task data has times from 1980"
    ):
        write_isoxml(odd, tmp_path / "T")
    assert not (tmp_path / "T").exists()


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("boundary", "started", "0001-01-01T00:00:00+14:00"),
        ("log", "t_ms", 10**15),
        ("log", "t_ms", 10**30),
        ("log", "t_ms", -1),
        ("log", "robot", -1),
        ("log", "robot", 5000),
        ("boundary", "width_mm", -5),
        ("boundary", "width_mm", 10**400),
    ],
)
def test_a_time_or_a_robot_that_cannot_be_is_one_line(
    tmp_path: Path, record: WorkRecord, kind: str, key: str, value: object
) -> None:
    """Each of these ended `headland export` in a traceback."""
    path = tmp_path / "work.geojson"
    write_geojson(record, path)
    document = json.loads(path.read_text())
    said = next(f["properties"] for f in document["features"] if f["properties"]["kind"] == kind)
    if key == "t_ms":
        said[key][-1] = value
    else:
        said[key] = value
    path.write_text(json.dumps(document))
    with pytest.raises(FieldFileError, match=r"not a work record: "):
        read_work_geojson(path)


@given(data=st.data())
@settings(
    max_examples=examples(100),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_damaged_records_never_raise_anything_else(
    tmp_path: Path, record: WorkRecord, data: st.DataObject
) -> None:
    short = record._replace(swaths=record.swaths[:2], covered=(), logs={0: record.logs[0][:5]})
    folder, file = tmp_path / "T", tmp_path / "work.geojson"
    rmtree(folder, ignore_errors=True)  # damaged task data is no longer ours to replace
    write_isoxml(short, folder)
    write_geojson(short, file)
    damaged = data.draw(st.sampled_from(["TASKDATA.XML", "TLG00001.bin", "work.geojson"]))
    path = file if damaged == "work.geojson" else folder / damaged
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at : at + data.draw(st.integers(0, 30))] = data.draw(st.binary(max_size=8))
    path.write_bytes(bytes(content))
    for read, what in ((read_work_geojson, file), (read_work_isoxml, folder)):
        try:
            assert isinstance(read(what), WorkRecord)
        except FieldFileError as problem:
            assert "\n" not in str(problem)
