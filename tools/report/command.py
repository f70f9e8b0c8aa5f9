"""`headland report`: a run as one HTML page with its pictures, and SVG and CSV beside it.

numpy and matplotlib are imported behind the start of the second process, which needs them, too.
"""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.record.mcap_log import McapMissing
from tools.common.exit_codes import code_of, wrong
from tools.common.gc_collector import uncollected
from tools.inspect.log_frames import SourceError
from tools.report.planned_aside import planned_aside

if TYPE_CHECKING:
    from tools.report.chapter import Chapter
    from tools.report.run_data import RunEvidence

PAGE = "report.html"


def report(source: Path, out: Path | None, as_json: bool) -> int:
    """The exit code of `headland report`: 0, or 2 where the source cannot be read or the page
    cannot be written. A SourceError becomes a line."""
    out = _place(source) if out is None else out
    try:
        if out.suffix not in (".html", ".htm"):
            raise SourceError(
                f"-o {out}: a page ends in .html; its pictures go into a folder beside"
            )
        with uncollected():
            evidence, found = _read(source)
            write(out, evidence, found)
    except (SourceError, McapMissing) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(
            f"{problem.filename or out}: {problem.strerror}; choose another place with -o",
            code_of(problem),
        )
    without = [chapter.name for chapter in found if chapter.missing]
    if as_json:
        names = [chapter.name for chapter in found if not chapter.missing]
        told = {"page": str(out), "files": str(out.with_suffix(""))}
        print(dumps({**told, "chapters": names, "without": without}))
        return 0
    for chapter in found:
        if chapter.missing:
            print(f"{chapter.title}: {chapter.missing}")
    print(f"{out}; its pictures and values are in {out.with_suffix('')}")
    return 0


def _read(source: Path) -> "tuple[RunEvidence, list[Chapter]]":
    """Raises SourceError and McapMissing."""
    with planned_aside(source) as planned:
        from rich.console import Console
        from rich.markup import escape

        from tools.report.chapter import chapters
        from tools.report.run_data import gather

        with Console(stderr=True).status(escape(f"reading {source}")) as status:
            evidence = gather(source, intents=planned is None)
            found = []
            for chapter in chapters(evidence, planned):
                status.update(escape(f"{source}: {chapter.title.lower()}"))
                found.append(chapter)
    return evidence, found


def _place(source: Path) -> Path:
    """In the run's folder; beside a log, with its name, so that two logs have two pages."""
    return source / PAGE if source.is_dir() else source.with_suffix(".html")


def write(out: Path, evidence: "RunEvidence", found: "Sequence[Chapter]") -> None:
    """The page, and the folder of its name beside it. OSError.

    Files of chapters that only an earlier report at this place had are removed."""
    from tools.report.page import page

    folder = out.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    again = out.is_file()
    for chapter in found:
        if again:
            for suffix in (".svg", ".csv"):
                (folder / f"{chapter.name}{suffix}").unlink(missing_ok=True)
        if chapter.picture is not None:
            write_whole(folder / f"{chapter.name}.svg", chapter.picture.svg)
        if chapter.values is not None:
            table = StringIO()
            writer = csv.writer(table, lineterminator="\n")
            writer.writerow(chapter.values[0])
            writer.writerows(chapter.values[1])
            write_whole(folder / f"{chapter.name}.csv", table.getvalue())
    told = page(evidence.name, evidence.figures, found, quote(folder.name), evidence.about)
    write_whole(out, told)
