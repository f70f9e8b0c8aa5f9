"""Whole peers on MAPF instances: success, sum of costs and collisions, by lost frames and crashes.

The sum of costs is compared with that of the shortest paths, which no solver can beat. A hundred peers on
one instance take three minutes of CPU, so the whole bench takes hours; `--quick` has smaller maps.
"""

from collections.abc import Iterator
from typing import NamedTuple

from sim.files.grid_map import Walls, random_walls, read_map
from sim.files.mapf_scenario import drawn_scenario
from sim.runs.mapf_run import MapfRun
from tools.bench.figure import Figure
from tools.bench.map_kinds import data_folder
from tools.run.mapf import judged, setting_of

PUBLIC = ("room-64-64-8", "warehouse-10-20-10-2-1")
ROBOTS, INSTANCES, SIDE = 100, 25, 64
QUICK_ROBOTS, QUICK_INSTANCES, QUICK_SIDE = 6, 1, 10
WALL_SHARE = 0.1
RATIO_MAX = 1.35


class Trouble(NamedTuple):
    """What the fleet has to bear."""

    name: str
    loss: float  # share of frames
    crashes: int


TROUBLES = (
    Trouble("without loss", 0.0, 0), Trouble("2 % loss", 0.02, 0), Trouble("2 crashes", 0.0, 2),
)  # fmt: skip


def maps(quick: bool) -> Iterator[tuple[str, Walls]]:
    """The maps that are here, and a drawn one."""
    side = QUICK_SIDE if quick else SIDE
    yield f"random {side} x {side}", random_walls(side, side, WALL_SHARE, 1)
    for name in () if quick else PUBLIC:
        path = data_folder() / "maps" / f"{name}.map"
        if path.is_file():
            yield name, read_map(path)


def figures(quick: bool) -> Iterator[Figure]:
    """Three figures for each map and each kind of trouble."""
    robots, count = (QUICK_ROBOTS, QUICK_INSTANCES) if quick else (ROBOTS, INSTANCES)
    for name, walls in maps(quick):
        for trouble in TROUBLES:
            done = arrived = solvable = collisions = 0
            ratios = []
            for seed in range(1, count + 1):
                mapf = drawn_scenario(name, walls, robots, seed)
                run = MapfRun(setting_of(mapf, seed, trouble.loss, trouble.crashes))
                outcome = run.run()
                verdict = judged(run, outcome, walls)
                done += outcome.success and not verdict.faults
                arrived, solvable = arrived + outcome.arrived, solvable + outcome.solvable
                collisions += outcome.collisions + len(verdict.faults)
                ratios.append(outcome.ratio)
            what = f"MAPF, {name}, {robots} peers, {trouble.name}"
            scope = f"{count} instances drawn by seed; {arrived} of {solvable} robots arrived"
            yield Figure(f"{what}: success", done / count, "share", "= 1", done == count, "", scope)
            mean = sum(ratios) / count
            yield Figure(
                f"{what}: sum of costs", mean, "of the shortest paths", f"<= {RATIO_MAX:g}",
                mean <= RATIO_MAX, "sum of shortest paths: LaCAM* cannot be below it",
                "mean of instances; from the first motion on, whole peers over the wire",
            )  # fmt: skip
            yield Figure(
                f"{what}: collisions", collisions, "", "= 0", not collisions,
                "true positions, and a judge of path files", scope,
            )  # fmt: skip
