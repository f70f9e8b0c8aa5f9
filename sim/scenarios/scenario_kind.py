"""Which kind of run a name stands for: the scenario says so by its `mission`, a file by its suffix."""

from enum import Enum
from pathlib import Path
from typing import NamedTuple

from agent.runtime.files.given_file import SCENARIO_BYTES_MAX, GivenFileError, read_toml
from sim.scenarios.scenario import ARENAS, SHIPPED, WAREHOUSES, is_field_source, shipped

GRID_FILES = (".map", ".mcpp")
FOLDERS = {"arenas": ARENAS, "warehouses": WAREHOUSES}  # of names that two kinds share


class Kind(Enum):
    """The words by which people call the kinds."""

    FIELD = "field"
    ERRANDS = "errands"
    DELIVERY = "delivery"
    EXPLORATION = "exploration"
    GRID = "grid"
    PROTOCOL = "protocol"


MISSIONS = {
    "field": Kind.FIELD, "errands": Kind.ERRANDS, "delivery": Kind.DELIVERY,
    "exploration": Kind.EXPLORATION, "drill": Kind.PROTOCOL, "sprint": Kind.PROTOCOL,
}  # fmt: skip


class Named(NamedTuple):
    """A scenario's kind, and the name or path by which its kind is loaded."""

    kind: Kind
    name: str


def named(name: str) -> Named:
    """The kind of a name. What cannot be read counts as a field, whose loader then says why."""
    path = Path(name)
    if path.suffix.lower() in GRID_FILES:
        return Named(Kind.GRID, name)
    if is_field_source(name):
        return Named(Kind.FIELD, name)
    if not path.suffix and not path.is_file():
        path = _shipped_path(name)
    try:
        mission = read_toml(path, SCENARIO_BYTES_MAX).get("mission", "field")
    except GivenFileError:
        return Named(Kind.FIELD, name)
    kind = MISSIONS.get(mission, Kind.FIELD) if isinstance(mission, str) else Kind.FIELD
    return Named(kind, str(path) if "/" in name else name)


def all_shipped() -> dict[str, Path]:
    """Every shipped scenario by the name that `headland run` takes; an arena that shares its name
    with another kind is `arenas/NAME`."""
    found = {name: SHIPPED / f"{name}.toml" for name in shipped()}
    for title, folder in sorted(FOLDERS.items(), reverse=True):
        for name in shipped(folder):
            key = f"{title}/{name}" if name in found else name
            found[key] = folder / f"{name}.toml"
    return found


def _shipped_path(name: str) -> Path:
    folder, _, rest = name.partition("/")
    if rest and folder in FOLDERS:
        return FOLDERS[folder] / f"{rest}.toml"
    return all_shipped().get(name, SHIPPED / f"{name}.toml")
