"""Whole peers on MAPF instances: success, sum of costs and collisions, by lost frames and crashes.

The sum of costs is compared with that of the shortest paths, which no solver can beat. A hundred peers on
one instance take minutes of CPU, so the whole bench takes hours; `--quick` has smaller maps. A part of
it, with a line for each instance, on the compiled core (`headland compile`) if there is one:

    python -m tools.bench.mapf random --trouble "2 % loss" --instances 1:5
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sim.files.grid_map import Walls, random_walls, read_map
from sim.files.mapf_scenario import drawn_scenario, read_scenario
from sim.files.strict_json import dumps
from tools.bench.figure import Figure
from tools.bench.map_kinds import data_folder
from tools.build.compiled_core import use
from tools.common.child_process import ROOT

if TYPE_CHECKING:
    from sim.runs.mapf_run import MapfRun

PUBLIC = ("room-64-64-8", "warehouse-10-20-10-2-1")
ROBOTS, INSTANCES, SIDE = 100, 25, 64
PUBLISHED = 0  # its number; the drawn ones count from 1
QUICK_ROBOTS, QUICK_INSTANCES, QUICK_SIDE = 6, 1, 10
WALL_SHARE = 0.1
RATIO_MAX = 1.35
JUDGES = ("true positions", "a judge of path files", "pymapf")


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


class Driven(NamedTuple):
    """What came of one instance."""

    map: str
    robots: int
    trouble: str
    instance: int
    success: bool  # all that could arrive did, nothing touched, and the judge has no remark
    arrived: int
    solvable: int
    collisions: int  # by true positions, remarks of the judge of path files, conflicts by pymapf
    judges: int  # 3, or 2 where pymapf is not installed
    ratio: float  # the sum of costs by that of the shortest paths
    before_for_s: float  # until the first robot set out
    simulated_s: float
    cpu_s: float


def published(name: str) -> Path:
    """The file of starts and goals that the benchmark itself has for a map."""
    return data_folder() / "maps" / f"{name}-random-1.scen"


def driven(name: str, walls: Walls, robots: int, trouble: Trouble, instance: int) -> Driven:
    """One instance, whose starts, goals, lost frames and crashes are drawn by its number.

    `PUBLISHED` has the starts and goals of the benchmark.
    """
    from sim.runs.mapf_run import MapfRun
    from tools.run.mapf import judged, setting_of

    if instance == PUBLISHED:
        mapf = read_scenario(published(name), walls, robots)
    else:
        mapf = drawn_scenario(name, walls, robots, instance)
    run = MapfRun(setting_of(mapf, instance, trouble.loss, trouble.crashes))
    outcome = run.run()
    conflicts = _by_pymapf(run)
    faults = len(judged(run, outcome, walls).faults) + (conflicts or 0)
    return Driven(
        name, robots, trouble.name, instance, outcome.success and not faults, outcome.arrived,
        outcome.solvable, outcome.collisions + faults, 2 if conflicts is None else 3,
        round(outcome.ratio, 4),
        round(outcome.before_for_s, 1), outcome.simulated_s, round(outcome.cpu_s, 1),
    )  # fmt: skip


def _by_pymapf(run: "MapfRun") -> int | None:
    """Whether a validator that is not ours finds a conflict, 0 or 1; None: it is not installed."""
    try:
        from pymapf import find_first_conflict
    except ImportError:
        return None
    ground = run.setting.ground
    tracks = zip(*run.steps, strict=True)
    paths = {f"{slot}": [ground.cell(cell) for cell in track] for slot, track in enumerate(tracks)}
    return int(find_first_conflict(paths) is not None)


def _elsewhere(name: str, trouble: Trouble) -> list[Driven]:
    """All instances, in a process of its own: what is imported interpreted stays so."""
    done = subprocess.run(
        [sys.executable, "-m", "tools.bench.mapf", name, "--trouble", trouble.name],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, cwd=ROOT, stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    return [Driven(**json.loads(line)) for line in done.stdout.splitlines()]


def figures(quick: bool) -> Iterator[Figure]:
    """Three figures for each map and each kind of trouble."""
    robots, count = (QUICK_ROBOTS, QUICK_INSTANCES) if quick else (ROBOTS, INSTANCES)
    for name, walls in maps(quick):
        for trouble in TROUBLES:
            if quick:
                runs = [driven(name, walls, robots, trouble, seed) for seed in range(1, count + 1)]
            else:
                runs = _elsewhere(name, trouble)
            arrived, solvable = sum(r.arrived for r in runs), sum(r.solvable for r in runs)
            done, collisions = sum(r.success for r in runs), sum(r.collisions for r in runs)
            what = f"MAPF, {name}, {robots} peers, {trouble.name}"
            own = sum(r.instance != PUBLISHED for r in runs)
            scope = (
                f"{own} instances drawn by seed, {len(runs) - own} of the benchmark; {arrived} of "
                f"{solvable} robots arrived"
            )
            share = done / len(runs)
            yield Figure(f"{what}: success", share, "share", "= 1", done == len(runs), "", scope)
            mean = sum(r.ratio for r in runs) / len(runs)
            yield Figure(
                f"{what}: sum of costs", mean, "of the shortest paths", f"<= {RATIO_MAX:g}",
                mean <= RATIO_MAX, "sum of shortest paths: LaCAM* cannot be below it",
                "mean of instances; from the first motion on, whole peers over the wire",
            )  # fmt: skip
            yield Figure(
                f"{what}: collisions", collisions, "", "= 0", not collisions,
                "judged by " + ", ".join(JUDGES[: min(r.judges for r in runs)]), scope,
            )  # fmt: skip


def lines(map_name: str, robots: int, troubles: list[str], first: int, last: int) -> Iterator[Any]:
    """A line for each instance `first` to `last` of each kind of trouble."""
    for name, walls in maps(quick=False):
        if not name.startswith(map_name):
            continue
        for trouble in TROUBLES:
            if trouble.name in troubles:
                for instance in range(first, last + 1):
                    if instance == PUBLISHED and not published(name).is_file():
                        continue
                    yield driven(name, walls, robots, trouble, instance)._asdict()


if __name__ == "__main__":
    use()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", help="the beginning of its name")
    parser.add_argument("--robots", type=int, default=ROBOTS)
    parser.add_argument("--trouble", action="append", choices=[each.name for each in TROUBLES])
    parser.add_argument("--instances", default=f"{PUBLISHED}:{INSTANCES}", help="first:last")
    given = parser.parse_args()
    from_to = [int(part) for part in given.instances.split(":")]
    wanted = given.trouble or [each.name for each in TROUBLES]
    for line in lines(given.map, given.robots, wanted, from_to[0], from_to[-1]):
        print(dumps(line), flush=True)
