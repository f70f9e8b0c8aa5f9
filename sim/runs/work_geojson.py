"""A work record as GeoJSON (RFC 7946): the file work.geojson in the folder of `headland run`."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from agent.interface.config import PEERS_MAX
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import load_json
from agent.runtime.files.printable_text import printable
from protocol.device_pool import SECTION_WIDTH_MAX_MM
from sim.files.whole_file import write_whole
from sim.runs.work_record import LogPoint, Rings, Swath, WorkRecord

RING_MIN = 4  # places of a closed ring of three corners


def write_geojson(record: WorkRecord, path: Path, run: str | None = None) -> None:
    """`run`: the hash of the run's frames, `log_hash` in its report.json."""
    features = [
        feature(
            "Polygon", record.boundary, kind="boundary", name=record.name,
            started=record.started.isoformat(), finished=record.finished, width_mm=record.width_mm,
        )
    ]  # fmt: skip
    features += [
        feature("LineString", s.points, kind="swath", section=s.section) for s in record.swaths
    ]
    features += [
        feature("Polygon", rings, kind="covered", name="covered") for rings in record.covered
    ]
    for robot, log in sorted(record.logs.items()):
        shape = "LineString" if len(log) > 1 else "MultiPoint"  # a line has two places
        features.append(
            feature(
                shape, [(p.lon, p.lat) for p in log], kind="log", robot=robot,
                t_ms=[p.t_ms for p in log], working=[int(p.working) for p in log],
            )
        )  # fmt: skip
    document: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if run is not None:
        document["run"] = run
    write_whole(path, json.dumps(document, ensure_ascii=False) + "\n")


def feature(kind_of: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    """A GeoJSON feature: `kind_of` is the type of its geometry. Places are (longitude, latitude)."""
    geometry = {"type": kind_of, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read_work_geojson(path: Path) -> WorkRecord:
    """Read a work record. FieldFileError if `write_geojson` did not write it."""
    document = load_json(path)
    try:
        return _record(document)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as problem:
        said = problem if isinstance(problem, ValueError) else repr(problem)
        raise FieldFileError(f"{path}: not a work record: {said}") from None


def run_of(path: Path) -> str | None:
    """The run that a work record names as its origin. FieldFileError if it is not JSON."""
    said = load_json(path).get("run")
    return said if isinstance(said, str) else None


def _record(document: dict[str, Any]) -> WorkRecord:
    swaths: list[Swath] = []
    covered: list[Rings] = []
    logs: dict[int, tuple[LogPoint, ...]] = {}
    head: dict[str, Any] = {}
    for each in document["features"]:
        said, coordinates = each["properties"], each["geometry"]["coordinates"]
        match said["kind"]:
            case "boundary":
                head = {**said, "rings": _rings(coordinates)}
            case "swath":
                swaths.append(Swath(int(said["section"]), _points(coordinates)))
            case "covered":
                covered.append(_rings(coordinates))
            case "log":
                logs[_slot(said["robot"])] = tuple(
                    LogPoint(int(t_ms), lon, lat, bool(working))
                    for t_ms, (lon, lat), working in zip(
                        said["t_ms"], _points(coordinates), said["working"], strict=True
                    )
                )
    if "started" not in head:
        raise ValueError("no boundary of it says when the work began; a plan does not")
    started = datetime.fromisoformat(head["started"]).astimezone(UTC)
    record = WorkRecord(
        printable(str(head["name"])), started, bool(head["finished"]), _width_mm(head["width_mm"]),
        head["rings"], tuple(swaths), tuple(covered), logs,
    )  # fmt: skip
    if any(point.t_ms < 0 for log in logs.values() for point in log) or record.stopped < started:
        raise ValueError("a time before the work began")
    return record


def _width_mm(told: Any) -> int:
    """Raises ValueError for what is no width of an implement."""
    width_mm = int(told)
    if not 0 < width_mm <= SECTION_WIDTH_MAX_MM:
        raise ValueError(f"no implement is {told!s:.20} mm wide")
    return width_mm


def _slot(told: Any) -> int:
    """Raises ValueError for what is no robot of a fleet."""
    slot = int(told)
    if not 0 <= slot < PEERS_MAX:
        raise ValueError(f"there is no robot {slot}")
    return slot


def _points(coordinates: Any) -> tuple[tuple[float, float], ...]:
    """Raises ValueError for what is no place on the Earth."""
    points = tuple((float(p[0]), float(p[1])) for p in coordinates)
    for lon, lat in points:
        if not (abs(lon) <= 180.0 and abs(lat) <= 90.0):
            raise ValueError(f"{lon:g}, {lat:g} is no longitude and latitude")
    return points


def _rings(coordinates: Any) -> Rings:
    """Raises ValueError for what is no outline."""
    rings = tuple(_points(ring) for ring in coordinates)
    if min((len(ring) for ring in rings), default=0) < RING_MIN:
        raise ValueError("an outline with fewer than three corners")
    return rings
