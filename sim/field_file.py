"""Reading field boundaries: GeoJSON or ISO 11783-10 task data, projected to metres.

Latitude and longitude end here. Every bad file is one `FieldFileError` with one line that names the
file, what is wrong with it, and what to do.
"""

import json
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from pyproj import CRS, Transformer
from shapely.geometry import Polygon
from shapely.validation import explain_validity

from agent.config import EXTENT_MAX_M
from sim.field_error import FILE_BYTES_MAX, FieldFileError, LonLat
from sim.isoxml_file import read_isoxml

TASK_DATA = (".xml", ".zip")


class Boundary(NamedTuple):
    """One field outline in metres, and where it lies."""

    name: str
    polygon: Polygon
    origin: tuple[float, float]  # latitude, longitude of (0, 0)


def read_boundary(path: Path, feature: str | None = None) -> Boundary:
    """The named field of a file, or its only one."""
    task_data = path.is_dir() or path.suffix.lower() in TASK_DATA
    outlines = read_isoxml(path) if task_data else read_geojson(path)
    if not outlines:
        raise FieldFileError(f"{path}: no polygon in it")
    if feature is None:
        if len(outlines) > 1:
            names = ", ".join(sorted(outlines)[:6])
            raise FieldFileError(
                f"{path}: {len(outlines)} fields; say which with 'feature' ({names})"
            )
        feature = next(iter(outlines))
    if feature not in outlines:
        names = ", ".join(sorted(outlines)[:6])
        raise FieldFileError(f"{path}: no field named {feature!r}; there is {names}")
    return project(path, feature, outlines[feature])


def read_geojson(path: Path) -> dict[str, list[list[LonLat]]]:
    """Name -> rings of longitude and latitude, the exterior first."""
    document = load_json(path)
    if document.get("type") == "FeatureCollection":
        features = document.get("features")
        if not isinstance(features, list):
            raise FieldFileError(f"{path}: a FeatureCollection without a list of features")
    else:
        features = [document]
    outlines: dict[str, list[list[LonLat]]] = {}
    for number, feature in enumerate(features):
        geometry = feature.get("geometry", feature) if isinstance(feature, dict) else None
        if not isinstance(geometry, dict) or geometry.get("type") not in (
            "Polygon",
            "MultiPolygon",
        ):
            continue
        properties = feature.get("properties") or {}
        name = str(properties.get("name", f"field {number}"))
        coordinates = geometry.get("coordinates")
        parts = [coordinates] if geometry["type"] == "Polygon" else coordinates or []
        for k, rings in enumerate(parts if isinstance(parts, list) else [None]):
            label = name if len(parts) == 1 else f"{name} {k}"
            outlines[label] = _rings(path, label, rings)
    return outlines


def load_json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise FieldFileError(f"{path}: larger than {FILE_BYTES_MAX >> 20} MiB")
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise FieldFileError(f"{path}: cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise FieldFileError(f"{path}: not a text file") from None
    except (ValueError, RecursionError) as problem:
        raise FieldFileError(f"{path}: not JSON: {problem}") from None
    if not isinstance(document, dict):
        raise FieldFileError(f"{path}: not a GeoJSON object")
    return document


def _rings(path: Path, name: str, rings: object) -> list[list[LonLat]]:
    result: list[list[LonLat]] = []
    if not isinstance(rings, list) or not rings:
        raise FieldFileError(f"{path}: {name}: a polygon without rings")
    for ring in rings:
        try:
            points = [(float(p[0]), float(p[1])) for p in ring]
        except (TypeError, ValueError, IndexError, KeyError):
            raise FieldFileError(f"{path}: {name}: a point that is not two numbers") from None
        if len(points) < 4:
            raise FieldFileError(f"{path}: {name}: a ring of {len(points)} points; it needs 4")
        if not all(-180 <= x <= 180 and -90 <= y <= 90 for x, y in points):
            raise FieldFileError(
                f"{path}: {name}: a point that is not longitude and latitude in degrees"
            )
        result.append(points)
    return result


def plane(origin: tuple[float, float]) -> CRS:
    """Metres east and north of a latitude and longitude."""
    return CRS.from_proj4(f"+proj=aeqd +lat_0={origin[0]} +lon_0={origin[1]} +datum=WGS84 +units=m")


def project(path: Path, name: str, rings: list[list[LonLat]]) -> Boundary:
    """Metres east and north of the middle of the outline (azimuthal equidistant, WGS 84)."""
    xs, ys = [p[0] for p in rings[0]], [p[1] for p in rings[0]]
    origin = ((min(ys) + max(ys)) / 2, (min(xs) + max(xs)) / 2)
    to_metres = Transformer.from_crs("EPSG:4326", plane(origin), always_xy=True).transform
    outline = []
    for ring in rings:
        east, north = to_metres([p[0] for p in ring], [p[1] for p in ring])
        outline.append(list(zip(east, north, strict=True)))
    polygon = Polygon(outline[0], outline[1:])
    if not isfinite(polygon.area):
        raise FieldFileError(f"{path}: {name}: too far across to be projected; divide it")
    if not polygon.is_valid:
        raise FieldFileError(f"{path}: {name}: {explain_validity(polygon)}; repair the outline")
    if max(map(abs, polygon.bounds)) > EXTENT_MAX_M:
        raise FieldFileError(f"{path}: {name}: larger than {2 * EXTENT_MAX_M:.0f} m; divide it")
    return Boundary(name, polygon, origin)
