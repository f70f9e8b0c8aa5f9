"""Reads field boundaries: GeoJSON or ISO 11783-10 task data, projected to metres.

Latitude and longitude end here. Every bad file is one `FieldFileError` with one line that names the
file, what is wrong with it, and what to do.
"""

from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from pyproj import CRS, Proj
from shapely.geometry import Polygon
from shapely.validation import explain_validity

from agent.interface.config import EXTENT_MAX_M
from agent.runtime.files.field_error import (
    FILE_BYTES_MAX,
    NOT_READ,
    POINTS_MAX,
    FieldFileError,
    LonLat,
)
from agent.runtime.files.given_file import GivenFileError, read_json
from agent.runtime.files.isoxml_reader import read_isoxml

TASK_DATA = (".xml", ".zip")
OUTLINE = "boundary"  # `kind` of the field itself in our own work.geojson and plan.geojson
GEOJSON_BYTES_MAX = 8 << 20  # 200 fields of 1,000 points
NAMES_SHOWN = 6  # most names of fields in a message
NAME_MAX = 200  # characters of a field's name
# An outline further across is no field: a degree of latitude is 111 km.
ACROSS_MAX_DEG = 1.0


class Boundary(NamedTuple):
    """One field outline in metres, and its position."""

    name: str
    polygon: Polygon
    origin: tuple[float, float]  # latitude, longitude of (0, 0) in degrees


def read_boundary(path: Path, feature: str | None = None) -> Boundary:
    """The named field of a file, or its only one. Only that field is validated.

    Raises FieldFileError if the file cannot be read, if the field is missing or bad, or if there
    are several fields and none is named.
    """
    outlines, broken = fields_of(path)
    names = sorted({*outlines, *broken})
    if not names:
        raise FieldFileError(f"{path}: no polygon in it")
    few = ", ".join(names[:NAMES_SHOWN])
    if len(names) > NAMES_SHOWN:
        few += f", ...; 'headland fields {path}' lists all {len(names)}"
    if feature is None:
        if len(names) > 1:
            raise FieldFileError(f"{path}: {len(names)} fields; say which with 'feature' ({few})")
        feature = names[0]
    if feature in broken:
        raise broken[feature]
    if feature not in outlines:
        raise FieldFileError(f"{path}: no field named {feature!r}; there is {few}")
    return project(path, feature, outlines[feature])


def fields_of(path: Path) -> tuple[dict[str, list[list[LonLat]]], dict[str, FieldFileError]]:
    """Every field of a file: name -> rings of (longitude, latitude) in degrees; and name -> its
    error.

    Raises FieldFileError if the file as a whole cannot be read.
    """
    if path.suffix.lower() in NOT_READ:
        raise FieldFileError(
            f"{path}: {NOT_READ[path.suffix.lower()]} is not read; convert it to GeoJSON"
        )
    task_data = path.is_dir() or path.suffix.lower() in TASK_DATA
    broken: dict[str, FieldFileError] = {}
    outlines = read_isoxml(path, broken) if task_data else read_geojson(path, broken)
    for name, rings in list(outlines.items()):
        count = sum(map(len, rings))
        if count > POINTS_MAX:
            del outlines[name]
            broken[name] = FieldFileError(
                f"{path}: {name}: {count} points; thin it out to {POINTS_MAX} at most"
            )
    return outlines, broken


def read_geojson(
    path: Path, broken: dict[str, FieldFileError] | None = None
) -> dict[str, list[list[LonLat]]]:
    """Name -> rings of (longitude, latitude) in degrees (RFC 7946), the exterior first.

    A name that was there before is followed by the number of its feature. If any
    polygon is of the `kind` boundary, only such are read: our own records also have what was worked.
    Raises FieldFileError if the file cannot be read. An error of one field is raised as well, or
    put into `broken` by its name.
    """
    document = load_json(path, GEOJSON_BYTES_MAX)
    if document.get("type") == "FeatureCollection":
        features = document.get("features")
        if not isinstance(features, list):
            raise FieldFileError(f"{path}: a FeatureCollection without a list of features")
    else:
        features = [document]
    found = [
        (k, each, _polygons(each.get("geometry", each)))
        for k, each in enumerate(features)
        if isinstance(each, dict)
    ]
    boundaries = [each for each in found if each[2] and _properties(each[1]).get("kind") == OUTLINE]
    outlines: dict[str, list[list[LonLat]]] = {}
    known: set[str] = set()  # what the next one may not be called
    for number, feature, parts in boundaries or found:
        said = _properties(feature).get("name")
        name = str(said)[:NAME_MAX] if isinstance(said, str | int) else ""
        if not name.strip():
            name = f"field {number}"
        while any(label in known for label in _labels(name, len(parts))):
            name = f"{name} ({number})"
        for label, rings in zip(_labels(name, len(parts)), parts, strict=True):
            known.add(label)
            try:
                outlines[label] = _rings(path, label, rings)
            except FieldFileError as problem:
                if broken is None:
                    raise
                broken[label] = problem
    return outlines


def _properties(feature: dict[str, Any]) -> dict[str, Any]:
    properties = feature.get("properties")
    return properties if isinstance(properties, dict) else {}


def _labels(name: str, parts: int) -> list[str]:
    """The names of the parts of a field."""
    return [name] if parts == 1 else [f"{name} {k}" for k in range(parts)]


def _polygons(geometry: object) -> list[object]:
    """The coordinates of each polygon of a geometry, unchecked; those of a collection in its order."""
    found: list[object] = []
    waiting = [geometry]
    while waiting:
        each = waiting.pop()
        if not isinstance(each, dict):
            continue
        coordinates, members = each.get("coordinates"), each.get("geometries")
        if each.get("type") == "Polygon":
            found.append(coordinates)
        elif each.get("type") == "MultiPolygon":
            several = coordinates or []
            found += several if isinstance(several, list) else [None]
        elif each.get("type") == "GeometryCollection" and isinstance(members, list):
            waiting += reversed(members)
    return found


def load_json(path: Path, bytes_max: int = FILE_BYTES_MAX) -> dict[str, Any]:
    """A JSON object from a file. Raises FieldFileError."""
    try:
        document = read_json(path, bytes_max)
    except GivenFileError as problem:
        raise FieldFileError(f"{path}: {problem}") from None
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
        except (TypeError, ValueError, OverflowError, IndexError, KeyError):
            raise FieldFileError(f"{path}: {name}: a point that is not two numbers") from None
        if len(points) < 4:
            raise FieldFileError(f"{path}: {name}: a ring of {len(points)} points; it needs 4")
        if not all(-180 <= x <= 180 and -90 <= y <= 90 for x, y in points):
            raise FieldFileError(
                f"{path}: {name}: a point that is not longitude and latitude in degrees; "
                "are these metres?"
            )
        result.append(points)
    return result


def plane(origin: tuple[float, float]) -> CRS:
    """The projection to metres east and north of an origin (latitude, longitude) in degrees."""
    return CRS.from_proj4(f"+proj=aeqd +lat_0={origin[0]} +lon_0={origin[1]} +datum=WGS84 +units=m")


def project(path: Path, name: str, rings: list[list[LonLat]]) -> Boundary:
    """A boundary in metres east and north of the middle of the outline (azimuthal equidistant, WGS
    84).

    `rings`: of (longitude, latitude) in degrees, the exterior first. Raises FieldFileError if the
    outline is invalid or too large. `path` and `name` are for its message.
    """
    rings = _past_180(rings)
    xs, ys = [p[0] for p in rings[0]], [p[1] for p in rings[0]]
    middle_deg = (min(xs) + max(xs)) / 2
    origin = ((min(ys) + max(ys)) / 2, middle_deg - 360.0 if middle_deg > 180.0 else middle_deg)
    across_deg = max(max(xs) - min(xs), max(ys) - min(ys))
    advice = "are these metres?" if across_deg > ACROSS_MAX_DEG else "divide it"
    to_metres = Proj(plane(origin))  # made in 0.3 ms; a transformer between two systems takes 10
    outline = []
    for ring in rings:
        east, north = to_metres([p[0] for p in ring], [p[1] for p in ring])
        outline.append(list(zip(east, north, strict=True)))
    polygon = Polygon(outline[0], outline[1:])
    if not isfinite(polygon.area):
        raise FieldFileError(f"{path}: {name}: too far across to be projected; {advice}")
    if not polygon.is_valid:
        raise FieldFileError(f"{path}: {name}: {explain_validity(polygon)}; repair the outline")
    if max(map(abs, polygon.bounds)) > EXTENT_MAX_M:
        raise FieldFileError(f"{path}: {name}: larger than {2 * EXTENT_MAX_M:.0f} m; {advice}")
    return Boundary(name, polygon, origin)


def _past_180(rings: list[list[LonLat]]) -> list[list[LonLat]]:
    """Rings whose longitudes go on past 180 degrees where the field lies across that meridian."""
    xs = [p[0] for p in rings[0]]
    if max(xs) - min(xs) <= 360.0 - ACROSS_MAX_DEG:
        return rings
    return [[(x + 360.0 if x < 0.0 else x, y) for x, y in ring] for ring in rings]
