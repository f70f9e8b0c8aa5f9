"""`headland export`: what a run has worked, for farm software."""

import sys
from pathlib import Path

from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import load_json
from sim.runs.isoxml_writer import write_isoxml
from sim.runs.work_geojson import read_work_geojson, run_of, write_geojson
from sim.runs.work_record import WorkRecord

RECORD, REPORT = "work.geojson", "report.json"  # what `headland run` of a field leaves


def export(folder: Path, isoxml: Path | None, geojson: Path | None) -> int:
    """Write the work of a run as task data, GeoJSON, or both. The exit code is 2 where the folder
    has none, or nothing can be written; a FieldFileError becomes a line."""
    if isoxml is None and geojson is None:
        print("headland: export: name --isoxml or --geojson", file=sys.stderr)
        return 2
    try:
        if not (folder / RECORD).exists() and (folder / REPORT).exists():
            raise FieldFileError(
                f"{folder}: no {RECORD}; only a headland run of a field leaves one"
            )
        record = read_work_geojson(folder / RECORD)
        _check(folder)
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


def _check(folder: Path) -> None:
    """Farm software must never get the work of another run. FieldFileError."""
    run = run_of(folder / RECORD)
    if run is None or load_json(folder / REPORT).get("log_hash") != run:
        raise FieldFileError(
            f"{folder}: {RECORD} and {REPORT} are not of one run; run the scenario again"
        )


def _told(record: WorkRecord) -> str:
    points = sum(len(log) for log in record.logs.values())
    state = "finished" if record.finished else "not finished"
    return (
        f"{record.name}, {state}: {len(record.swaths)} swaths, {len(record.logs)} robots, "
        f"{points} log records"
    )
