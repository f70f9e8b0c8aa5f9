"""Instances of multi-agent path finding: MovingAI's `.scen` files, and drawn ones of the same format.

A `.scen` has a version line and one line for each agent: bucket, map, width, height, start column,
start row, goal column, goal row, length of the shortest path (Sturtevant, Benchmarks for Grid-Based
Pathfinding, 2012; Stern et al., SoCS 2019). The first K lines are an instance of K agents.
"""

from math import isfinite
from pathlib import Path
from random import Random
from typing import NamedTuple

from agent.interface.geometry import Cell
from agent.runtime.files.given_file import GivenFileError, read_text
from sim.files.grid_map import FILE_BYTES_MAX, GridFileError, Walls, check_starts, largest_room

FIELDS = 9  # of a line


class MapfInstance(NamedTuple):
    """A map, and a start and a goal for each agent."""

    name: str
    walls: Walls
    starts: list[Cell]
    goals: list[Cell]


def parse_scenario(
    text: str, name: str, agents: int, shape: tuple[int, ...] | None = None
) -> tuple[list[Cell], list[Cell]]:
    """Starts and goals of the first `agents` lines of a `.scen`. `shape`: rows and columns of the map,
    which each line has to name; None: any. Raises GridFileError.

    >>> parse_scenario("version 1\\n0\\tm.map\\t9\\t9\\t1\\t2\\t3\\t4\\t4.8\\n", "m.scen", 1)
    ([(2, 1)], [(4, 3)])
    """
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines or not lines[0].startswith("version"):
        raise GridFileError(f"{name}: not a MovingAI scenario (its first line is 'version 1')")
    if len(lines) - 1 < agents:
        raise GridFileError(f"{name}: has {len(lines) - 1} agents, not {agents}")
    starts, goals = [], []
    for number, line in enumerate(lines[1 : agents + 1]):
        # Tabs divide the fields, because a name may have spaces. Some files have spaces only.
        words = line.split("\t") if "\t" in line.strip() else line.split()
        try:
            if len(words) != FIELDS or not isfinite(float(words[8])):
                raise ValueError
            columns, rows, column, row, to_column, to_row = (int(word) for word in words[2:8])
        except ValueError:
            raise GridFileError(f"{name}: line {number + 2} is not that of an agent") from None
        if shape not in (None, (rows, columns)):
            raise GridFileError(
                f"{name}: line {number + 2} is of {words[1]} with {rows} x {columns} cells; this map has "
                + " x ".join(map(str, shape or ()))
            )
        starts.append((row, column))
        goals.append((to_row, to_column))
    return starts, goals


def read_scenario(path: Path, walls: Walls, agents: int) -> MapfInstance:
    """The first `agents` of a `.scen` on a map that was read. Raises GridFileError, also if two
    have one start or one goal, one of them is in a wall, or it is of a map of another size."""
    try:
        text = read_text(path, FILE_BYTES_MAX)
    except GivenFileError as problem:
        raise GridFileError(f"{path}: {problem}") from None
    starts, goals = parse_scenario(text, str(path), agents, walls.shape)
    check_starts(str(path), walls, starts)
    check_starts(f"{path}, goals", walls, goals)
    return MapfInstance(path.stem, walls, starts, goals)


def drawn_scenario(name: str, walls: Walls, agents: int, seed: int) -> MapfInstance:
    """Starts and goals drawn from the largest connected part of a map, as the benchmark's `random`
    scenarios are. Raises GridFileError if there are too few free cells."""
    part = largest_room(walls)
    if len(part) < agents:
        raise GridFileError(f"{name}: {len(part)} connected free cells for {agents} agents")
    rng = Random(f"{seed}/mapf/{name}")
    return MapfInstance(
        f"{name}-seed-{seed}", walls, rng.sample(part, agents), rng.sample(part, agents)
    )
