"""GeoJSON of other programs is read as it stands: no polygon of it is dropped or taken for another."""

import json
from pathlib import Path
from typing import Any

import pytest

from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import fields_of, read_boundary, read_geojson


def square(at_deg: float = 0.0, side_deg: float = 0.001) -> list[list[list[float]]]:
    low, high = at_deg, at_deg + side_deg
    return [[[low, low], [high, low], [high, high], [low, high], [low, low]]]


def polygon(at_deg: float = 0.0, side_deg: float = 0.001) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": square(at_deg, side_deg)}


def feature(geometry: dict[str, Any], **properties: object) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def file_of(folder: Path, *features: object) -> Path:
    path = folder / "f.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_two_features_of_one_name_are_two_fields(tmp_path: Path) -> None:
    path = file_of(
        tmp_path, *(feature(polygon(at), name="acre") for at in (0.0, 0.1, 0.2)),
        feature(polygon(0.3), name="acre (1)"),
    )  # fmt: skip
    found = read_geojson(path)
    west = {name: rings[0][0][0] for name, rings in found.items()}
    assert west == {"acre": 0.0, "acre (1)": 0.1, "acre (2)": 0.2, "acre (1) (3)": 0.3}
    with pytest.raises(FieldFileError, match="4 fields"):
        read_boundary(path)


def test_a_bad_field_keeps_its_name_from_the_next_one(tmp_path: Path) -> None:
    bad = {"type": "Polygon", "coordinates": [[[0, "a"]]]}
    path = file_of(tmp_path, feature(bad, name="acre"), feature(polygon(), name="acre"))
    outlines, broken = fields_of(path)
    assert (set(outlines), set(broken)) == ({"acre (1)"}, {"acre"})


def test_names_of_parts_are_not_taken_twice(tmp_path: Path) -> None:
    parts = {"type": "MultiPolygon", "coordinates": [square(0.0), square(0.1)]}
    path = file_of(tmp_path, feature(polygon(0.2), name="acre 1"), feature(parts, name="acre"))
    assert set(read_geojson(path)) == {"acre 1", "acre (1) 0", "acre (1) 1"}


@pytest.mark.parametrize("name", ["", "  ", None, 2.5])
def test_a_field_without_a_name_has_the_number_of_its_feature(tmp_path: Path, name: object) -> None:
    assert set(read_geojson(file_of(tmp_path, feature(polygon(), name=name)))) == {"field 0"}


def test_polygons_of_a_collection_are_read_in_their_order(tmp_path: Path) -> None:
    several = {"type": "MultiPolygon", "coordinates": [square(0.1), square(0.2)]}
    inner = {"type": "GeometryCollection", "geometries": [several, {"type": "Point"}, 7]}
    outer = {"type": "GeometryCollection", "geometries": [polygon(0.0), inner, polygon(0.3)]}
    found = read_geojson(file_of(tmp_path, feature(outer, name="acre")))
    assert [rings[0][0][0] for rings in found.values()] == [0.0, 0.1, 0.2, 0.3]
    assert list(found) == ["acre 0", "acre 1", "acre 2", "acre 3"]


def test_only_the_boundary_of_our_own_records_is_a_field(tmp_path: Path) -> None:
    line = {"type": "LineString", "coordinates": [[0, 0], [1, 1]]}
    worked = feature(polygon(0.0002, 0.0001), kind="covered", name="covered")
    path = file_of(tmp_path, feature(polygon(), kind="boundary", name="acre"), worked)
    assert read_boundary(path).name == "acre"
    # Of another program: a line that is called a boundary hides no field.
    path = file_of(tmp_path, feature(line, kind="boundary"), feature(polygon(), name="acre"))
    assert read_boundary(path).name == "acre"


@pytest.mark.parametrize("side", [50.0, 5_760_000.0])
def test_metres_are_asked_about(tmp_path: Path, side: float) -> None:
    with pytest.raises(FieldFileError, match=r"are these metres\?"):
        read_boundary(file_of(tmp_path, feature(polygon(0.0, side))))


def test_a_large_field_in_degrees_is_to_be_divided(tmp_path: Path) -> None:
    with pytest.raises(FieldFileError, match="divide it"):
        read_boundary(file_of(tmp_path, feature(polygon(0.0, 0.1))))


@pytest.mark.parametrize("name", ["f.kml", "F.KMZ", "f.gpx", "f.shp"])
def test_formats_that_are_not_read_are_named(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"\x00<kml/>")
    with pytest.raises(FieldFileError, match="is not read; convert it to GeoJSON"):
        fields_of(path)


@pytest.mark.parametrize("east_deg", [0.0001, 0.0005, 0.0009])
def test_a_field_across_the_180th_meridian_is_a_field(tmp_path: Path, east_deg: float) -> None:
    """It was refused as larger than 6552 m, on Taveuni in Fiji as in Chukotka."""
    west, east = 180.0 + east_deg - 0.001, east_deg - 180.0
    ring = [[west, -17.0], [east, -17.0], [east, -16.999], [west, -16.999], [west, -17.0]]
    here = read_boundary(file_of(tmp_path, feature({"type": "Polygon", "coordinates": [ring]})))
    there = [[x - 10.0 if x > 0.0 else x + 350.0, y] for x, y in ring]
    (tmp_path / "there").mkdir()
    like = read_boundary(
        file_of(tmp_path / "there", feature({"type": "Polygon", "coordinates": [there]}))
    )
    assert here.polygon.equals_exact(like.polygon, 1e-6)
    assert -180.0 <= here.origin[1] <= 180.0
    assert (here.origin[1] - like.origin[1]) % 360.0 == pytest.approx(10.0)
