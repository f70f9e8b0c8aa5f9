"""Reads back the task data that `sim/runs/isoxml_writer.py` has written, to compare it."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zipfile import ZipFile

from agent.runtime.files.field_error import FieldFileError, LonLat
from agent.runtime.files.isoxml_reader import code, load_task_data, position
from sim.runs.isoxml_time_log import DAY_MS, DEGREE, EPOCH, FIXED, MILLISECOND, VALUE
from sim.runs.work_record import LogPoint, Rings, Swath, WorkRecord


class BadTimeLog(Exception):
    """Records that do not match the header."""


def read_work_isoxml(path: Path) -> WorkRecord:
    """Read a work record. FieldFileError if `write_isoxml` did not write it."""
    data = load_task_data(path)
    try:
        field, task = data.partfields[0], data.tasks[0]
        started = task.times[0].start.to_datetime().astimezone(UTC)
        names = [log.filename for log in task.time_logs]
        robots = [int(d.device_id_ref.removeprefix("DVC-")) - 1 for d in task.device_allocations]
        width_mm = int(data.devices[0].properties[0].value)
        swaths = tuple(
            Swath(int(g.designator.removeprefix("S")), _places(path, g.line_strings[0].points))
            for g in field.guidance_groups[0].guidance_patterns
        )
        zones = [polygon for zone in task.treatment_zones for polygon in zone.polygons]
        logs = {robot: _log(path, name, started) for robot, name in zip(robots, names, strict=True)}
        return WorkRecord(
            str(field.designator), started, code(task.status) == "4", width_mm,
            _rings(path, field.polygons[0]), swaths,
            tuple(_rings(path, zone) for zone in zones), logs,
        )  # fmt: skip
    except (AttributeError, IndexError, TypeError, ValueError) as problem:
        raise FieldFileError(f"{path}: not a work record: {problem!r}") from None


def _log(path: Path, name: Any, started: Any) -> tuple[LogPoint, ...]:
    records = _beside(path, f"{name}.BIN")
    if records is None:
        raise FieldFileError(f"{path}: no {name}.BIN there")
    try:
        return unpack(records, started)
    except BadTimeLog as problem:
        raise FieldFileError(f"{path}: {name}.BIN: {problem}") from None


def _beside(path: Path, name: str) -> bytes | None:
    """A file beside the task data, in the same folder or zip; None if it does not exist."""
    if path.suffix == ".zip":
        with ZipFile(path) as archive:
            parts = {Path(part).name.upper(): archive.read(part) for part in archive.namelist()}
    else:
        parts = {part.name.upper(): part.read_bytes() for part in path.iterdir()}
    return parts.get(name.upper())


def _places(path: Path, points: list[Any]) -> tuple[LonLat, ...]:
    return tuple(position(path, "a line", point) for point in points)


def _rings(path: Path, polygon: Any) -> Rings:
    return tuple(_places(path, line.points) for line in polygon.line_strings)


def unpack(records: bytes, started: datetime) -> tuple[LogPoint, ...]:
    """The inverse of `pack`. BadTimeLog if `pack` did not write it."""
    start_at_ms = (started - EPOCH) // MILLISECOND
    at, working, log = 0, False, []
    while at < len(records):
        if at + FIXED.size > len(records):
            raise BadTimeLog(f"{len(records) - at} bytes at the end are no record")
        day_at_ms, days, lat, lon, _, values = FIXED.unpack_from(records, at)
        at += FIXED.size
        if at + values * VALUE.size > len(records):
            raise BadTimeLog("the last record is cut off")
        for _ in range(values):
            index, value = VALUE.unpack_from(records, at)
            at += VALUE.size
            if index == 0:
                working = value == 1
        if abs(lat) > 90 * DEGREE or abs(lon) > 180 * DEGREE or day_at_ms >= DAY_MS:
            raise BadTimeLog("a record that is nowhere or at no time")
        t_ms = days * DAY_MS + day_at_ms - start_at_ms
        log.append(LogPoint(t_ms, round(lon / DEGREE, 7), round(lat / DEGREE, 7), working))
    return tuple(log)
