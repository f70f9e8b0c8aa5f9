"""The folder of a launched fleet: its journals, the logs of its launches, and whether it goes on.

A launch that was ended or killed before its work was done is continued by the next launch of the same
fleet: journals and the truth of the world stay, a latched robot stays latched, and the logs of the
earlier launch move into `launch-N`.
"""

import contextlib
import json
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path
from typing import IO, Any, NamedTuple

from sim.files.whole_file import write_whole
from sim.scenarios.field_setup import FieldSetup
from tools.common.run_folder import (
    LATEST,
    LAUNCH,
    LOCK,
    QUEUE,
    RUNS,
    WRITTEN,
    FolderError,
    folders,
    link,
    locked,
    numbered,
)
from tools.run.launch_setup import AnySetting
from tools.run.robot_lock import until_left

FLEET = "fleet.json"
TRUTH = "truth.jsonl"
BOOK = "vda5050.jsonl"  # of the orders of a VDA 5050 master
JOURNALS = "robot*.sqlite*"
LOGS = (*WRITTEN, "robot*.log", "bus.json", "places.toml")
FLEET_BYTES_MAX = 64 * 1024


class FleetFolder(NamedTuple):
    """A folder that this launch holds alone, with what earlier launches of the fleet left."""

    folder: Path
    launches: int  # this one included
    continues: bool
    said: str  # one line for the person; empty for a new fleet
    locks: tuple[IO[str], ...]


def identity_of(setting: AnySetting) -> str:
    """Two launches with the same identity are launches of the same fleet. Keys are not in it: a fleet
    that was given keys is still latched. A seed is in it only where it makes the tasks."""
    plain: dict[str, Any] = setting.scenario.model_dump(mode="json", exclude={"run", "folder"})
    plain.get("fleet", {}).pop("keys", None)
    seed = setting.scenario.run.seed
    ground = setting.field.config_hash if isinstance(setting, FieldSetup) else seed
    text = json.dumps([plain, ground], sort_keys=True)
    return blake2b(text.encode(), digest_size=8).hexdigest()


def fleet_folder(
    out: Path | None, setting: AnySetting, fresh: bool, told: Callable[[str], object] = print
) -> FleetFolder:
    """Where this fleet is launched. `told`: gets a line if that has to be waited for.

    Raises FolderError and OSError."""
    identity = identity_of(setting)
    locks: list[IO[str]] = []
    try:
        if out is None:
            RUNS.mkdir(parents=True, exist_ok=True)
            locks.append(locked(RUNS / ".launch.lock", RUNS / LAUNCH))
            folder, said = _of_name(setting.scenario.name, identity, fresh)
        else:
            out.mkdir(parents=True, exist_ok=True)
            folder, said = out, ""
        locks.append(locked(folder / LOCK, folder))
        until_left(folder, told)
        known = _known(folder)
        same = known is not None and known["fleet"] == identity
        remembers = any(folder.glob(JOURNALS))
        begun = known is not None and (known["begun"] or remembers)
        going_on = known is not None and same and begun and not known["over"] and not fresh
        if remembers and not fresh and not going_on and not _over(known):
            raise FolderError(
                f"{folder} holds another fleet that is not done; begin a new one there with --fresh, "
                "or choose another folder with --out"
            )
        launches = _put_away(folder, journals=not going_on)
        if going_on:
            said = (
                f"continuing the fleet in {folder}: its robots remember their work and their stops; "
                "--fresh begins a new one"
            )
        if out is None:
            link(RUNS / LAUNCH, folder)
            link(RUNS / LATEST, folder)
        _write(folder, identity, over=False, begun=going_on)
    except BaseException:
        for lock in locks:
            lock.close()
        raise
    return FleetFolder(folder, launches, going_on, said, tuple(locks))


def begin_fleet(fleet: FleetFolder, setting: AnySetting) -> None:
    """Its robots are about to start. A launch that is refused before, as where its port is taken, leaves
    no fleet that could be continued."""
    _write(fleet.folder, identity_of(setting), over=False)


def end_fleet(fleet: FleetFolder, setting: AnySetting) -> None:
    """Its work is done and no robot is latched, so the next launch is a new fleet."""
    _write(fleet.folder, identity_of(setting), over=True)


def _of_name(name: str, identity: str, fresh: bool) -> tuple[Path, str]:
    """The newest folder of that name if its fleet goes on, or a new one; and what to say of it.

    Raises FolderError where that fleet is unknown, as after a power cut: it may be latched."""
    said = ""
    with_fleet = [
        path
        for _, path in folders(RUNS, name)
        if (path / FLEET).is_file() or any(path.glob(JOURNALS))
    ]
    if with_fleet and not fresh:
        newest = with_fleet[-1]
        known = _known(newest)
        if known is None and any(newest.glob(JOURNALS)):
            raise FolderError(
                f"{newest} holds the journals of a fleet, but its {FLEET} is lost or unreadable, so "
                "nobody knows whether it is done; begin a new fleet with --fresh"
            )
        if known is not None and not known["over"]:
            if known["fleet"] == identity:
                return newest, ""
            said = f"{newest} holds another fleet of {name}, not done: this one is new"
    return numbered(RUNS, name), said


def _known(folder: Path) -> dict[str, Any] | None:
    """What a launch wrote of its fleet; none where there is none, or it cannot be read."""
    with contextlib.suppress(OSError, ValueError, RecursionError, KeyError, TypeError):
        with (folder / FLEET).open("rb") as file:
            said = json.loads(file.read(FLEET_BYTES_MAX))
        begun = said.get("begun") is not False  # older launches do not say it
        return {"fleet": str(said["fleet"]), "over": said["over"] is True, "begun": begun}
    return None


def _over(known: dict[str, Any] | None) -> bool:
    return known is not None and bool(known["over"])


def _write(folder: Path, identity: str, over: bool, begun: bool = True) -> None:
    told = {"fleet": identity, "over": over, "begun": begun}
    write_whole(folder / FLEET, json.dumps(told) + "\n")


def _put_away(folder: Path, journals: bool) -> int:
    """Move what an earlier launch left into `launch-N`; returns the number of this launch."""
    names = (*LOGS, JOURNALS, TRUTH, QUEUE, BOOK) if journals else LOGS
    old = sorted({path for name in names for path in folder.glob(name)})
    number = max((n for n, _ in folders(folder, "launch")), default=0)
    if old:
        aside = numbered(folder, "launch")
        for path in old:
            place = aside / path.relative_to(folder)
            place.parent.mkdir(exist_ok=True)
            path.rename(place)
        number += 1
    return number + 1
