"""The static objects of a run as plain values: a map draws them first, and recordings store them.

`sim.record.scene_builder` makes one of a scenario. A tool that only shows a scene needs no simulator.
"""

from base64 import b64decode
from math import isfinite
from pathlib import Path
from typing import Any

from crdt.progress import UNITS_MAX
from crdt.sighting import MergeOrder

Scene = dict[str, Any]
SIDE_MAX = (
    960  # cells each way, as in `crdt.occupancy`, which needs numpy; a tool that listens has none
)
FILE = "scene.json"  # in the folder of a run


def in_folder(source: Path) -> Path:
    """The path of a run's scene: in its folder, or beside its log."""
    return (source if source.is_dir() else source.parent) / FILE


def drawable(told: object) -> Scene | None:
    """A scene that was read from a file; None for plain values that cannot be drawn."""
    if not isinstance(told, dict):
        return None
    try:
        sound = _is_sound(told)
    except (
        IndexError,
        KeyError,
        OverflowError,
        TypeError,
        ValueError,
    ):  # what is damaged has any type
        return None
    return told if sound else None


def _is_sound(told: Scene) -> bool:
    """Whether all parts that a map needs are there and have their form. May raise what arithmetic with
    values of another type raises."""
    sections, grid, cells, gate = (
        told["sections"],
        told.get("grid"),
        told.get("cells"),
        told.get("gate"),
    )
    figures = [told["robots"], told["radius_m"], told["bitrate"], told["width_m"]]
    return (
        all(isinstance(told[name], str) for name in ("name", "kind"))
        and all(isfinite(figure) and figure >= 0 for figure in figures)
        and all(ring and all(map(_is_point, ring)) for ring in told["rings"])
        and all(map(_is_section, sections))
        and (gate is None or _is_point(gate))
        and all(map(_is_point, told.get("bays", ())))
        and (not told.get("bays") or grid is not None)  # parcels lie on its cells
        and all(_is_point(at) and isfinite(slot) for slot, *at in told.get("goals", ()))
        and all(len(row) == 3 and all(map(isfinite, row)) for row in told.get("transports", ()))
        and (told.get("earth") is None or _is_point(told["earth"]))
        and (cells is None or (_is_raster(cells) and _is_map(cells)))
        and (
            grid is None or (_is_raster(grid) and 8 * len(b64decode(grid["walls"])) >= _count(grid))
        )
    )


def _is_point(at: Any) -> bool:
    x_m, y_m = at
    return isfinite(x_m) and isfinite(y_m)


def _is_section(told: Scene) -> bool:
    swaths, units = told["swaths"], told["units"]
    lines = all(len(swath) > 1 and all(map(_is_point, swath)) for swath in swaths)
    counts = all(isinstance(count, int) and count > 0 for count in units)
    whole = len(swaths) == len(units) and sum(units) <= UNITS_MAX  # each is drawn
    return isinstance(told["id"], int) and lines and counts and whole


def _is_raster(told: Scene) -> bool:
    whole = all(isinstance(told[name], int) and told[name] > 0 for name in ("rows", "columns"))
    return whole and _is_point(told["origin"]) and isfinite(told["cell_m"]) and told["cell_m"] > 0


def _is_map(told: Scene) -> bool:
    """Whether these cells are no more than a shared map has: memory is taken for all of them."""
    return max(told["rows"], told["columns"]) <= SIDE_MAX and bool(MergeOrder(told["order"]))


def _count(told: Scene) -> int:
    return int(told["rows"] * told["columns"])
