"""`headland export`: what a run has worked, for farm software, for ROS 2, and as a film."""

from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import load_json
from sim.files.strict_json import dumps
from sim.record.mcap_log import MCAP, McapMissing, read_recording
from sim.record.ros_bag import BagError, Storage, check_package, write_bag
from sim.runs.isoxml_writer import write_isoxml
from sim.runs.work_geojson import read_work_geojson, run_of, write_geojson
from sim.runs.work_record import WorkRecord
from tools.common.counted import counted
from tools.common.exit_codes import code_of, wrong
from tools.inspect.log_frames import SourceError
from tools.livemap.command import recorded
from tools.report.run_data import REPORT
from tools.run.film import FILM_S, FilmError, write_told_film

Say = Callable[[str], object]  # of a line for people
RECORD = "work.geojson"  # what `headland run` of a field leaves


def export(
    folder: Path, isoxml: Path | None, geojson: Path | None, bag: Path | None = None,
    storage: Storage = "mcap", film: Path | None = None, as_json: bool = False,
) -> int:  # fmt: skip
    """Write the work of a run as task data, GeoJSON, a ROS 2 bag, a film, or several of them. The exit
    code is 2 where the folder has none, 2 or 75 where nothing can be written. A FieldFileError becomes
    a line.

    `as_json`: an object with the path of each that was written, also where a later one failed, instead
    of lines."""
    if isoxml is None and geojson is None and bag is None and film is None:
        return wrong("export: name --isoxml, --geojson, --bag or --film")
    say: Say = (lambda line: None) if as_json else print
    written: dict[str, str] = {}  # of each form, where it is
    code = 0
    if bag is not None:
        code = _bag(folder, bag, storage, say)
        written |= {"bag": str(bag)} if not code else {}
    if film is not None and not code:
        code = _film(folder, film, say)
        written |= {"film": str(film)} if not code else {}
    if (isoxml is not None or geojson is not None) and not code:
        code = _work(folder, isoxml, geojson, say, written)
    if as_json:
        print(dumps(written))
    return code


def _work(
    folder: Path, isoxml: Path | None, geojson: Path | None, say: Say, written: dict[str, str]
) -> int:
    """Write what was worked, and into `written` where; the exit code."""
    place = isoxml or geojson
    if isoxml is not None and isoxml.suffix.lower() != ".zip" and isoxml.is_file():
        return wrong(f"--isoxml {isoxml}: is a file; name a folder, or one that is to be made")
    try:
        if not (folder / RECORD).exists() and (folder / REPORT).exists():
            raise FieldFileError(
                f"{folder}: no {RECORD}; only a headland run of a field leaves one"
            )
        record = read_work_geojson(folder / RECORD)
        _check(folder)
        if isoxml is not None:
            write_isoxml(record, isoxml)
            written["isoxml"] = str(isoxml)
            say(f"{isoxml}: ISO 11783-10 task data, {_told(record)}")
        if geojson is not None:
            place = geojson
            write_geojson(record, geojson)
            written["geojson"] = str(geojson)
            say(f"{geojson}: GeoJSON, {_told(record)}")
    except FieldFileError as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"{problem.filename or place}: {problem.strerror}", code_of(problem))
    return 0


def _bag(folder: Path, bag: Path, storage: Storage, say: Say) -> int:
    """Write a bag; the exit code."""
    log = folder / MCAP
    try:
        check_package()
        if not log.exists():
            raise BagError(f"{folder}: no {MCAP}; headland run and headland launch leave one")
        counts = write_bag(read_recording(log), bag, storage)
    except (BagError, McapMissing, ValueError) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"{bag}: {problem.strerror or problem}", code_of(problem))
    say(f"{bag}: ROS 2 bag, {counts.total()} messages in {len(counts)} topics")
    return 0


def _film(folder: Path, film: Path, say: Say) -> int:
    """Write a film; the exit code."""
    if film.is_dir():
        return wrong(f"--film {film}: is a folder; give the name of a file")
    if not film.absolute().parent.is_dir():  # said before a minute of drawing
        return wrong(f"--film {film}: {film.parent} is not a folder")
    try:
        recording = recorded(folder, None)
        count = write_told_film(Console(stderr=True), recording, film)
    except (FilmError, SourceError, McapMissing) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"{film}: {problem.strerror or problem}", code_of(problem))
    size_kb = film.stat().st_size // 1000
    say(f"{film}: {count} pictures, {FILM_S:.0f} s, {size_kb} kB")
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
    swaths, robots = (
        counted(len(record.swaths), "{} swath{s}"),
        counted(len(record.logs), "{} robot{s}"),
    )
    return f"{record.name}, {state}: {swaths}, {robots}, {points} log records"
