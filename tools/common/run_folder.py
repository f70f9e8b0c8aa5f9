"""Folders of runs: one for each run, `runs/NAME-N`, and links to the newest.

`runs/latest` is the newest run of any kind, `runs/launch` the newest launch. A folder that a person names
with `--out` is emptied of what an earlier run wrote, so that no folder holds parts of two runs. A run
and a launch hold the same lock on their folder while they write into it.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from agent.runtime.files.file_lock import lock as take_lock

RUNS = Path("runs")
LATEST, LAUNCH = "latest", "launch"
# What runs, launches, explorations and their reports write into their folder.
WRITTEN = (
    "report.json", "report.html", "report/*.png", "report/*.svg", "report/*.csv", "can.log",
    "can.[1-9]*.log", "run.mcap", "run.[1-9]*.mcap", "trace.jsonl", "field.png", "work.geojson",
    "warehouse.png", "maps.png", "maps.gif", "film.gif", "fleet.md", "robot_*.png", "scene.json",
)  # fmt: skip
QUEUE = "queue.json"  # in the folder of a launch: goals of `headland say` that wait for a robot
LOCK = (
    "lock"  # stays in the folder: deleting it would let two processes hold two files of this name
)
MARK = "scene.json"  # every run writes it first; a folder without it holds other files
NAME_MAX = 64  # longest part of a scenario's name in a folder's name, characters


class FolderError(Exception):
    """One line for the person."""


@contextmanager
def folder_for(out: Path | None, name: str) -> Iterator[Path]:
    """The empty folder of a run, held until the end of `with`: `out`, or a new one that is named after
    the scenario.

    Raises FolderError where `out` is a file, holds a fleet that is not done or is held by another run
    or launch, OSError where it cannot be used.
    """
    folder = numbered(RUNS, name) if out is None else _named(out)
    with locked(folder / LOCK, folder):
        if out is None:
            link(RUNS / LATEST, folder)
        elif any(folder.glob("robot*.sqlite")):
            raise FolderError(
                f"{folder} holds the journals of a launch; choose another folder with --out"
            )
        elif (folder / MARK).is_file():
            for written in WRITTEN:
                for path in folder.glob(written):
                    path.unlink()
        yield folder


def _named(out: Path) -> Path:
    """The folder that a person names, made if it is not there."""
    if out.exists() and not out.is_dir():
        raise FolderError(f"--out {out}: is a file; name a folder, or one that is to be made")
    out.mkdir(parents=True, exist_ok=True)
    return out


def locked(path: Path, folder: Path) -> IO[str]:
    """The lock of a folder, held until the file is closed or the process has ended.

    Raises FolderError where another process holds it, OSError where the file cannot be written."""
    lock = path.open("w")
    if not take_lock(lock, wait=False):
        lock.close()
        raise FolderError(
            f"another run or launch writes into {folder}: end it, or choose another folder with --out"
        )
    return lock


def numbered(parent: Path, name: str) -> Path:
    """A new folder `NAME-N`; N is above every N that is there. Raises OSError."""
    parent.mkdir(parents=True, exist_ok=True)
    stem = plain(name)
    number = max((n for n, _ in folders(parent, stem)), default=0)
    while True:
        number += 1
        try:
            (parent / f"{stem}-{number}").mkdir()
        except FileExistsError:
            continue  # another run was quicker
        return parent / f"{stem}-{number}"


def folders(parent: Path, name: str) -> list[tuple[int, Path]]:
    """Number and path of every folder `NAME-N`, in order of N."""
    pattern = re.compile(re.escape(plain(name)) + r"-(\d{1,9})")
    found = [(pattern.fullmatch(path.name), path) for path in parent.glob(f"{plain(name)}-*")]
    return sorted((int(match[1]), path) for match, path in found if match)


def plain(name: str) -> str:
    """A scenario's name as a file's."""
    return re.sub(r"[^\w.-]+", "_", name)[:NAME_MAX].strip("._-") or "run"


def link(place: Path, folder: Path) -> None:
    """Make `place` a link to a folder. A real folder that is in the way keeps its contents
    under a name with a number."""
    if place.is_dir() and not place.is_symlink():
        aside = numbered(place.parent, place.name)
        aside.rmdir()
        place.rename(aside)
    new = place.with_name(f".{place.name}.{os.getpid()}")
    new.unlink(missing_ok=True)
    new.symlink_to(os.path.relpath(folder, place.parent), target_is_directory=True)
    new.replace(place)
