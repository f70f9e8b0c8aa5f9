"""Grid maps and coverage instances: the Moving-AI `.map` and LS-MCPP's `.mcpp`, and random maps.

A cell is (row, column) from the upper left, one step apart from its four neighbours. A `.map` has a
header of four lines and one character a cell; passable are `.`, `G` and `S` (Sturtevant, Benchmarks
for Grid-Based Pathfinding, 2012). A `.mcpp` is YAML that names a map beside it and the robots' start
cells as [column, row] or as one number, column * height + row. What is wrong with a file is one
`GridFileError` with one line, also a start cell in a wall or two robots on one cell: published
instances have both.
"""

import json
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Cell
from agent.runtime.files.given_file import GivenFileError, parse_json, read_text
from sim.files.whole_file import write_whole

Walls = NDArray[np.bool_]  # (rows, columns), True for cells that no robot can enter
PASSABLE = ".GS"
CELLS_MAX = 4 << 20  # 2048 x 2048: twice the side of the largest published benchmark map
FREE_CELLS_MAX = 1 << 18  # of a map that is planned: 512 x 512 takes 10 s and 300 MB
DIGITS_MAX = 9  # of a height or width
FILE_BYTES_MAX = 2 * CELLS_MAX


class GridFileError(Exception):
    """One line for the user who named the file."""


class Instance(NamedTuple):
    """A map and the starts of the robots."""

    name: str
    walls: Walls
    starts: list[Cell]


def _text(path: Path) -> str:
    try:
        return read_text(path, FILE_BYTES_MAX)
    except GivenFileError as problem:
        raise GridFileError(f"{path}: {problem}") from None


def parse_map(text: str, name: str = "map") -> Walls:
    """The walls of a Moving-AI map, booleans of shape (rows, columns). Raises GridFileError.

    >>> parse_map("type octile\\nheight 2\\nwidth 3\\nmap\\n..@\\nT..\\n").astype(int).tolist()
    [[0, 0, 1], [1, 0, 0]]
    """
    lines = text.splitlines()
    head = [line.split() for line in lines[:4]]
    sizes = {words[0]: words[1] for words in head if len(words) == 2}
    height, width = sizes.get("height", ""), sizes.get("width", "")
    decimal = all(n.isdecimal() and len(n) <= DIGITS_MAX for n in (height, width))
    if not decimal or head[-1:] != [["map"]]:
        raise GridFileError(f"{name}: not a Moving-AI map (type, height, width, map, then rows)")
    rows, columns = int(height), int(width)
    if not 0 < rows * columns <= CELLS_MAX:
        raise GridFileError(f"{name}: {rows} x {columns} cells; 1 to {CELLS_MAX} can be planned")
    body = lines[4 : 4 + rows]
    for number, line in enumerate(body):
        if len(line) != columns:
            raise GridFileError(f"{name}: row {number} has {len(line)} cells, not {columns}")
    if len(body) != rows:
        raise GridFileError(f"{name}: {len(body)} rows, not {rows}")
    return np.array([[mark not in PASSABLE for mark in line] for line in body], dtype=np.bool_)


def map_text(walls: Walls) -> str:
    """A Moving-AI map of walls with shape (rows, columns): `@` for each wall, `.` for each free
    cell."""
    rows, columns = walls.shape
    body = ["".join("@" if wall else "." for wall in row) for row in walls.tolist()]
    return "\n".join(["type octile", f"height {rows}", f"width {columns}", "map", *body, ""])


def parse_roots(text: str, rows: int, name: str = "instance") -> tuple[str, list[Cell]]:
    """The map's name and the start cells (row, column) of an `.mcpp`. Raises GridFileError.

    >>> parse_roots("map: floor\\nroot: [[2, 5],\\n  [0, 1]]\\nweighted: False\\n", rows=9)
    ('floor', [(5, 2), (1, 0)])
    """
    values: dict[str, str] = {}
    key = ""
    for line in text.splitlines():
        if line[:1].strip() and ":" in line:
            key, _, rest = line.partition(":")
            values[key] = rest
        elif key:
            values[key] += line  # continuation of a list
    try:
        roots = parse_json(values["root"])
        if not isinstance(roots, list) or not roots:
            raise GridFileError(f"{name}: root: no robot starts anywhere")
        cells = [
            (root % rows, root // rows) if isinstance(root, int) else (int(root[1]), int(root[0]))
            for root in roots
        ]
        return values["map"].strip(), cells
    except (GivenFileError, KeyError, ValueError, OverflowError, TypeError, IndexError) as error:
        raise GridFileError(
            f"{name}: needs 'map: NAME' and 'root: [[column, row], ...]'"
        ) from error


def mcpp_text(map_name: str, starts: list[Cell]) -> str:
    """An LS-MCPP instance: the map's name, and the starts, which the format writes as [column,
    row]."""
    roots = json.dumps([[column, row] for row, column in starts])
    return f"map: {map_name}\nroot: {roots}\nweighted: False\nincomplete: False\n"


def check_starts(name: str, walls: Walls, starts: list[Cell]) -> None:
    """GridFileError if a robot would start outside, in a wall, or in the cell of another."""
    rows, columns = walls.shape
    seen: dict[Cell, int] = {}
    for robot, (row, column) in enumerate(starts):
        where = f"{name}: robot {robot} starts at row {row}, column {column}"
        if not (0 <= row < rows and 0 <= column < columns):
            raise GridFileError(f"{where}, outside of {rows} x {columns}")
        if walls[row, column]:
            raise GridFileError(f"{where}, in a wall")
        if (row, column) in seen:
            raise GridFileError(f"{where}, on robot {seen[row, column]}")
        seen[row, column] = robot


def read_map(path: Path) -> Walls:
    """Read a Moving-AI map: booleans of shape (rows, columns), True for walls. Raises
    GridFileError."""
    return parse_map(_text(path), str(path))


def read_instance(path: Path) -> Instance:
    """Read an `.mcpp` with its map: beside it, or in `../gridmaps` as in LS-MCPP. Raises
    GridFileError if the map is at neither place, or a start is no free cell."""
    text = _text(path)
    map_name, _ = parse_roots(text, 1, str(path))
    places = [path.parent / f"{map_name}.map", path.parent.parent / "gridmaps" / f"{map_name}.map"]
    found = [place for place in places if place.is_file()]
    if not found:
        raise GridFileError(f"{path}: its map is not at {places[0]} nor at {places[1]}")
    walls = read_map(found[0])
    _, starts = parse_roots(text, walls.shape[0], str(path))
    check_starts(str(path), walls, starts)
    return Instance(path.stem, walls, starts)


def write_instance(path: Path, instance: Instance) -> list[Path]:
    """`path` ends in .map or .mcpp; an .mcpp gets its map beside it."""
    map_path = path.with_suffix(".map")
    write_whole(map_path, map_text(instance.walls))
    if path.suffix != ".mcpp":
        return [map_path]
    write_whole(path, mcpp_text(path.stem, instance.starts))
    return [map_path, path]


def random_walls(rows: int, columns: int, wall_probability: float, seed: int) -> Walls:
    """Each cell is a wall with this probability; a seed gives the same map on every machine."""
    rng = Random(f"{seed}/walls/{rows}/{columns}")
    return np.array(
        [[rng.random() < wall_probability for _ in range(columns)] for _ in range(rows)],
        dtype=np.bool_,
    )


def room_walls(rows: int, columns: int, room: int, seed: int) -> Walls:
    """Square rooms of `room` cells, each with a door of one cell to each neighbour."""
    rng = Random(f"{seed}/rooms/{rows}/{columns}/{room}")
    walls = np.zeros((rows, columns), dtype=np.bool_)
    walls[room :: room + 1, :] = True
    walls[:, room :: room + 1] = True
    for top in range(0, rows, room + 1):
        for left in range(0, columns, room + 1):
            high, wide = min(room, rows - top), min(room, columns - left)
            if left + room < columns:
                walls[top + rng.randrange(high), left + room] = False
            if top + room < rows:
                walls[top + room, left + rng.randrange(wide)] = False
    return walls


def rack_walls(rows: int, columns: int) -> Walls:
    """A warehouse: racks of 2 x 6 cells, aisles of one cell between them, two cells all round."""
    walls = np.zeros((rows, columns), dtype=np.bool_)
    for top in range(2, rows - 3, 3):
        for left in range(2, columns - 7, 7):
            walls[top : top + 2, left : left + 6] = True
    return walls


def largest_room(walls: Walls) -> list[Cell]:
    """The cells of the largest 4-connected free region, row by row; of several, the one with the first
    cell."""
    free = [(int(r), int(c)) for r, c in np.argwhere(~walls)]  # row by row
    unseen, best = set(free), list[Cell]()
    for first in free:
        if first not in unseen:
            continue
        if len(unseen) <= len(best):
            break  # no region of those that are left is larger
        unseen.remove(first)
        room = [first]
        for r, c in room:
            for cell in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                if cell in unseen:
                    unseen.remove(cell)
                    room.append(cell)
        best = max(best, room, key=len)
    return sorted(best)


def random_starts(walls: Walls, robots: int, seed: int) -> list[Cell]:
    """Distinct cells of the largest room; ValueError if it is too small."""
    room = largest_room(walls)
    if robots > len(room):
        raise ValueError(f"{robots} robots do not fit into {len(room)} connected free cells")
    return Random(f"{seed}/starts").sample(room, robots)


def gate_starts(walls: Walls, robots: int) -> list[Cell]:
    """The cells nearest to one corner of the largest room, as if machines entered a field there.
    Raises ValueError if there are fewer connected free cells than robots."""
    room = largest_room(walls)
    if robots > len(room):
        raise ValueError(f"{robots} robots do not fit into {len(room)} connected free cells")
    corner = min(room, key=lambda cell: (cell[0] + cell[1], cell))
    inside, order, distance = set(room), [corner], {corner: 0}
    for r, c in order:
        for cell in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            if cell in inside and cell not in distance:
                distance[cell] = distance[r, c] + 1
                order.append(cell)
    return order[:robots]
