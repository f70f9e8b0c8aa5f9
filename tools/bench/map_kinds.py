"""Maps of many kinds to plan on: public benchmark maps where they are at hand, generated ones else.

The files are those of the Moving AI Lab's grid-map benchmarks (Sturtevant 2012), in a folder `maps`
of `HEADLAND_DATA`, which is `../shared/data` beside the project unless set.
"""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, gaussian_filter

Grid = NDArray[np.bool_]
Rng = np.random.Generator
PASSABLE = ".GS"  # ground, ground, shallow water; the rest is out of bounds, tree, water, wall


class Map(NamedTuple):
    """A grid to plan on, with its kind and where it came from."""

    kind: str
    name: str  # of the file, or "generated"
    blocked: Grid


def data_folder() -> Path:
    """Folder of public maps: HEADLAND_DATA, else beside the repository. It need not exist."""
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    return Path(os.environ.get("HEADLAND_DATA", beside))


def read(path: Path) -> Grid:
    """A map file: four lines of head, then a character a cell."""
    head, rows = path.read_text().split("\nmap\n")
    size = dict(line.split() for line in head.splitlines())
    passable = [[sign in PASSABLE for sign in row] for row in rows.splitlines()]
    blocked = ~np.array(passable)
    assert blocked.shape == (int(size["height"]), int(size["width"])), path
    return blocked


def rooms(rng: Rng, rows: int, columns: int, side: int, door: int) -> Grid:
    """A grid (rows, columns) of rooms of `side` cells: each wall between two has a door, one in
    five is shut."""
    blocked = np.zeros((rows, columns), dtype=np.bool_)
    blocked[::side], blocked[:, ::side] = True, True
    for i in range(0, rows, side):
        for j in range(0, columns, side):
            if rng.random() < 0.8:
                at = i + 1 + int(rng.integers(side - door))
                blocked[at : at + door, j] = False
            if rng.random() < 0.8:
                at = j + 1 + int(rng.integers(side - door))
                blocked[i, at : at + door] = False
    return blocked


def maze(rng: Rng, rows: int, columns: int, wide: int) -> Grid:
    """Corridors of `wide` cells by depth-first search, walls of one cell: one way only. A grid
    (rows, columns)."""
    high, across = rows // (wide + 1), columns // (wide + 1)
    blocked = np.ones((rows, columns), dtype=np.bool_)
    met = np.zeros((high, across), dtype=np.bool_)
    stack = [(0, 0)]
    while stack:
        i, j = stack[-1]
        y, x = i * (wide + 1), j * (wide + 1)
        met[i, j] = True
        blocked[y : y + wide, x : x + wide] = False
        near = [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
        near = [(k, m) for k, m in near if 0 <= k < high and 0 <= m < across and not met[k, m]]
        if not near:
            stack.pop()
            continue
        k, m = near[int(rng.integers(len(near)))]
        top, left = min(i, k) * (wide + 1), min(j, m) * (wide + 1)
        blocked[top : top + wide + (k != i) * wide, left : left + wide + (m != j) * wide] = False
        stack.append((k, m))
    return blocked


def warehouse(rng: Rng, rows: int, columns: int) -> Grid:
    """A grid (rows, columns) with shelves of 2 x 10, aisles of one cell, and a hall on either side."""
    del rng
    blocked = np.zeros((rows, columns), dtype=np.bool_)
    for i in range(2, rows - 2, 3):
        for j in range(8, columns - 18, 11):
            blocked[i : i + 2, j : j + 10] = True
    return blocked


def city(rng: Rng, rows: int, columns: int) -> Grid:
    """A grid (rows, columns) with buildings as rectangles in a few directions, in the blocks
    between streets."""
    y, x = np.mgrid[:rows, :columns]
    blocked = np.zeros((rows, columns), dtype=np.bool_)
    turned = rng.uniform(0, np.pi / 2, 4)
    for _ in range(rows * columns // 600):
        at = rng.uniform(0, rows), rng.uniform(0, columns)
        half = rng.uniform(3, 14, 2)
        angle = turned[int(2 * at[0] / rows) * 2 + int(2 * at[1] / columns)]
        reach = int(half.sum()) + 1
        part = (
            slice(max(int(at[0]) - reach, 0), int(at[0]) + reach),
            slice(max(int(at[1]) - reach, 0), int(at[1]) + reach),
        )
        dy, dx = y[part] - at[0], x[part] - at[1]
        along, aside = (
            dx * np.cos(angle) + dy * np.sin(angle),
            dy * np.cos(angle) - dx * np.sin(angle),
        )
        blocked[part] |= (np.abs(along) < half[0]) & (np.abs(aside) < half[1])
    return blocked


def cave(rng: Rng, rows: int, columns: int) -> Grid:
    """A grid (rows, columns) by a cellular automaton: a cell is what most of its neighbours are."""
    blocked: Grid = rng.random((rows, columns)) < 0.45
    around = np.ones((3, 3), dtype=np.int64)
    for _ in range(5):
        blocked = convolve(blocked.astype(np.int64), around, mode="constant", cval=1) >= 5
    return blocked


def landscape(rng: Rng, rows: int, columns: int) -> Grid:
    """A grid (rows, columns) with lakes and cliffs: the heights and depths of smooth noise."""
    height = gaussian_filter(rng.standard_normal((rows, columns)), 12.0, mode="reflect")
    blocked: Grid = height > np.quantile(height, 0.75)
    return blocked


def scattered(rng: Rng, rows: int, columns: int) -> Grid:
    """A grid (rows, columns) in which a fifth of all cells is blocked."""
    blocked: Grid = rng.random((rows, columns)) < 0.2
    return blocked


KINDS: tuple[tuple[str, str, Callable[[Rng, int, int], Grid], int, int], ...] = (
    ("rooms", "room-64-64-8", partial(rooms, side=8, door=1), 64, 64),
    ("warehouse", "warehouse-10-20-10-2-1", warehouse, 63, 161),
    ("small cave", "den312d", cave, 81, 65),
    ("city", "Berlin_1_256", city, 256, 256),
    ("cave", "brc202d", cave, 530, 481),
    ("large rooms", "16room_000", partial(rooms, side=17, door=2), 512, 512),
    ("maze", "maze512-32-0", partial(maze, wide=31), 512, 512),
    ("random", "random512-20-0", scattered, 512, 512),
    ("landscape", "AcrosstheCape", landscape, 768, 768),
)


def maps(seed: int) -> list[Map]:
    """One map of every kind: the public one if its file is there, else one generated from the seed."""
    found = []
    for number, (kind, name, generate, rows, columns) in enumerate(KINDS):
        path = data_folder() / "maps" / f"{name}.map"
        if path.is_file():
            found.append(Map(kind, name, read(path)))
        else:
            rng = np.random.default_rng((seed, number))
            found.append(Map(kind, "generated", generate(rng, rows, columns)))
    return found


def small_maps(seed: int, side: int) -> list[Map]:
    """Every kind again, generated, cut to `side` by `side` cells, so small that all pairs of
    corners can be looked at."""
    found = []
    for number, (kind, _, generate, _, _) in enumerate(KINDS):
        rng = np.random.default_rng((seed, number))
        whole = maze(rng, 64, 64, wide=3) if kind == "maze" else generate(rng, 64, 64)
        found.append(Map(kind, "generated", np.ascontiguousarray(whole[:side, :side])))
    return found
