"""`headland export`: what a run has worked, for farm software."""

import sys
from pathlib import Path

from sim.field_error import FieldFileError
from sim.work_geojson import read_work_geojson, write_geojson
from sim.work_isoxml import write_isoxml
from sim.work_record import WorkRecord

RECORD = "work.geojson"  # what `headland run` leaves


def export(folder: Path, isoxml: Path | None, geojson: Path | None) -> int:
    if isoxml is None and geojson is None:
        print("headland: export: name --isoxml or --geojson", file=sys.stderr)
        return 2
    try:
        record = read_work_geojson(folder / RECORD)
        if isoxml is not None:
            write_isoxml(record, isoxml)
            print(f"{isoxml}: ISO 11783-10 task data, {_told(record)}")
        if geojson is not None:
            write_geojson(record, geojson)
            print(f"{geojson}: GeoJSON, {_told(record)}")
    except FieldFileError as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return 2
    except OSError as problem:
        print(f"headland: {problem.filename}: {problem.strerror}", file=sys.stderr)
        return 2
    return 0


def _told(record: WorkRecord) -> str:
    points = sum(len(log) for log in record.logs.values())
    state = "finished" if record.finished else "not finished"
    return (
        f"{record.name}, {state}: {len(record.swaths)} swaths, {len(record.logs)} robots, "
        f"{points} log records"
    )
