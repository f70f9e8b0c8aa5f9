"""`headland mapf`: whole peers on a public MAPF benchmark, by robots, lost frames and crashes."""

import sys
from collections.abc import Iterator
from math import ceil
from pathlib import Path
from random import Random
from typing import Any

from pydantic import ValidationError
from rich.console import Console
from rich.table import Table

from agent.interface.config import PEERS_MAX
from agent.runtime.declared_values import first_error
from sim.files.grid_map import GridFileError, Walls, map_text, read_map
from sim.files.mapf_paths import path_text
from sim.files.mapf_scenario import MapfInstance, drawn_scenario, read_scenario
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.runs.mapf_run import MapfOutcome, MapfRun
from sim.scenarios.coverage_setup import STEP_S
from sim.scenarios.mapf_setup import MapfSetup
from sim.scenarios.scenario import Crash, Fault, Scenario
from sim.world.path_judge import PathVerdict, judge_paths
from tools.build.kernel_cache import told_compiling
from tools.run.coverage_drive import LOSS_MAX
from tools.run.run_mission import ProgressBar

AGREED_S = 15.0  # by then a fleet of a hundred has found itself and drives: crashes come after it
CRASHES_S = 60.0  # and within this
DIGITS_MAX = 9  # of a number of robots; far more than a bus has addresses
LIMIT_FACTOR = 6.0  # of the time in which one robot would cross all rows and columns
PICTURES = (".png", ".svg", ".pdf")


def counts_of(words: str) -> list[int]:
    """How many robots: `20`, or `1:100`, doubled from the first to the last, or `10:100:30` with a
    step. Raises GridFileError.

    >>> counts_of("1:10"), counts_of("10:100:40"), counts_of("7")
    ([1, 2, 4, 8, 10], [10, 50, 90, 100], [7])
    """
    told = words.split(":")
    plain = all(part.isascii() and part.isdecimal() and len(part) <= DIGITS_MAX for part in told)
    parts = [int(part) for part in told] if plain else []
    if not 1 <= len(parts) <= 3 or min(parts) < 1 or parts != [*sorted(parts[:2]), *parts[2:]]:
        raise GridFileError(f"--robots {words}: give 20, 1:100 or 10:100:30")
    if parts[-1 if len(parts) < 3 else 1] > PEERS_MAX:
        raise GridFileError(f"--robots {words}: a bus has addresses for {PEERS_MAX} robots")
    first, last = parts[0], parts[min(1, len(parts) - 1)]
    counts = [first]
    while counts[-1] < last:
        following = counts[-1] + parts[2] if len(parts) == 3 else 2 * counts[-1]
        counts.append(min(following, last))
    return counts


def crashes_of(count: int, agents: int, seed: int) -> list[Fault]:
    """Crashes of `count` robots, drawn by the seed, at times at which the fleet drives.

    Raises GridFileError."""
    if not 0 <= count < agents:
        raise GridFileError(f"--crash {count}: 0 to {agents - 1} of {agents} robots can crash")
    rng = Random(f"{seed}/mapf/crash")
    return [
        Crash(at_s=round(AGREED_S + rng.random() * CRASHES_S, 2), kind="crash", robot=robot)
        for robot in rng.sample(range(agents), count)
    ]


def read(map_file: Path, scenario: Path | None, agents: int, seed: int) -> MapfInstance:
    """An instance from files; without a scenario starts and goals are drawn by the seed."""
    walls = read_map(map_file)
    if scenario is not None:
        return read_scenario(scenario, walls, agents)
    return drawn_scenario(map_file.stem, walls, agents, seed)


def setting_of(mapf: MapfInstance, seed: int, loss: float, crashes: int) -> MapfSetup:
    """A run of an instance; its limit grows with the map. `loss`: share of all frames. Raises
    GridFileError."""
    if not 0.0 <= loss <= LOSS_MAX:
        raise GridFileError(f"--loss is 0 to {LOSS_MAX:g}")
    faults = crashes_of(crashes, len(mapf.starts), seed)
    limit_s = AGREED_S + CRASHES_S + LIMIT_FACTOR * sum(mapf.walls.shape) * STEP_S
    try:
        return MapfSetup.of(
            mapf, seed=seed, loss=loss, faults=faults, time_limit_s=float(ceil(limit_s))
        )
    except ValidationError as problem:
        raise GridFileError(first_error(problem, Scenario)) from None
    except ValueError as error:
        raise GridFileError(f"{mapf.name}: {error}") from None


def path_file(run: MapfRun, outcome: MapfOutcome, map_file: str = "") -> str:
    """The file of paths of a run that is over, as MAPF validators read it. `map_file`: the name of the
    map, which viewers open; empty: that of the instance."""
    setting, ground = run.setting, run.setting.ground
    starts = [ground.cell(number) for number in setting.cells]
    goals = [ground.cell(number) for number in setting.goals]
    steps = [[ground.cell(number) for number in cells] for cells in run.steps]
    head = {
        "agents": len(starts), "map_file": map_file or outcome.map, "solver": "headland",
        "solved": int(outcome.success), "soc": round(outcome.sum_of_costs),
        "soc_lb": outcome.shortest, "makespan": len(steps) - 1, "seed": outcome.seed,
    }  # fmt: skip
    return path_text(head, starts, goals, steps)


def judged(run: MapfRun, outcome: MapfOutcome, walls: Walls) -> PathVerdict:
    """The verdict of the judge of path files, which excuses robots that crashed or cannot arrive."""
    if outcome.conflict:
        return PathVerdict([outcome.conflict], 0, 0, 0)
    return judge_paths(path_file(run, outcome), map_text(walls), run.excused)


def reports(
    map_file: Path, scenario: Path | None, counts: list[int], seed: int, loss: float, crashes: int,
    out: Path | None, picture: Path | None = None,
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """One run for each number of robots, and its figures; the last one's paths are written."""
    for agents in counts:
        mapf = read(map_file, scenario, agents, seed)
        # Where one number of robots was asked for, too many crashes are an error.
        least = min(crashes, agents - 1) if len(counts) > 1 else crashes
        if least < crashes:
            print(f"headland: --crash {crashes}: {least} of {agents} robots crash", file=sys.stderr)
        setting = setting_of(mapf, seed, loss, least)
        run = MapfRun(setting)
        console = Console(stderr=True)
        title = f"{mapf.name}, {agents} robots"
        with ProgressBar(console, title, run, "goals"), told_compiling(console.print):
            outcome = run.run()
        verdict = judged(run, outcome, mapf.walls)
        if out is not None and not outcome.conflict:
            write_whole(out, path_file(run, outcome, map_file.name))
        if picture is not None and not outcome.conflict:
            _draw(picture, run, outcome, mapf)
        yield {
            **outcome.to_dict(), "loss": loss, "faults_of_paths": verdict.faults,
            "success": outcome.success and not verdict.faults,
        }  # fmt: skip


def _draw(picture: Path, run: MapfRun, outcome: MapfOutcome, mapf: MapfInstance) -> None:
    from tools.run.mapf_picture import draw_ways

    steps = [[run.setting.ground.cell(number) for number in cells] for cells in run.steps]
    title = (
        f"{outcome.map}: {outcome.arrived} of {outcome.solvable} arrived, "
        f"sum of costs {outcome.ratio:.2f} of the shortest paths"
    )
    draw_ways(picture, mapf.walls, steps, mapf.goals, title)


def measured(
    map_file: Path, scenario: Path | None, counts: list[int], seed: int, loss: float, crashes: int,
    out: Path | None, picture: Path | None, as_json: bool,
) -> int:  # fmt: skip
    """Print a line for each number of robots; 0 if every run succeeded."""
    for option, path in (("--out", out), ("--picture", picture)):  # said before the runs
        if path is not None and not path.absolute().parent.is_dir():
            raise GridFileError(f"{option} {path}: {path.parent} is not a folder")
        if path is not None and path.is_dir():
            raise GridFileError(f"{option} {path}: it is a folder; give the name of a file")
    if picture is not None and picture.suffix not in PICTURES:
        raise GridFileError(f"--picture {picture}: a picture ends in {', '.join(PICTURES)}")
    clean = True
    table = Table(
        "robots", "arrived", "sum of costs", "shortest", "ratio", "makespan", "agreed after",
        "rounds", "collisions",
    )  # fmt: skip
    for report in reports(map_file, scenario, counts, seed, loss, crashes, out, picture):
        clean = clean and report["success"]
        if as_json:
            print(dumps(report), flush=True)
        table.add_row(
            f"{report['robots']}", f"{report['arrived']} of {report['solvable']}",
            f"{report['sum_of_costs']:.0f}", f"{report['shortest']}", f"{report['ratio']:.3f}",
            f"{report['makespan']:.0f}", f"{report['before_for_s']:.1f} s", f"{report['rounds']}",
            f"{report['collisions'] + len(report['faults_of_paths'])}",
        )  # fmt: skip
    if not as_json:
        Console().print(table)
    return 0 if clean else 1
