"""`headland coverage`: plan how robots cover a grid map together, and replay a plan in the terminal."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.common.exit_codes import code_of, wrong
from tools.common.options import Json, Silence
from tools.common.told_wait import told_loading

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sim.files.grid_map import Instance
    from sim.runs.planned_coverage import Arrival, Death

app = typer.Typer(
    help="Plan and replay how robots cover a grid map together.", no_args_is_help=True,
    pretty_exceptions_enable=False, rich_markup_mode=None,
)  # fmt: skip

GRID_ROBOTS = 6  # of `headland run` of a .map, where no number is given
RANDOM = 32, 32, 0.2  # rows, columns and share of walls of a random map
ROBOT_CELLS_MAX = 1 << 27  # a team keeps eight bytes for each robot and cell: a gibibyte


@app.command()
def solve(
    map: Annotated[Path | None, typer.Argument(help="A .map or .mcpp; none: a random map.")] = None,
    robots: Annotated[int | None, typer.Option(help="How many (an .mcpp: only the first).")] = None,
    seed: Annotated[int, typer.Option(help="Of the start cells and of a random map.")] = 0,
    height: Annotated[int, typer.Option("--H", help="Rows of a random map.")] = RANDOM[0],
    width: Annotated[int, typer.Option("--W", help="Columns of a random map.")] = RANDOM[1],
    wall_prob: Annotated[float, typer.Option(help="Share of walls of a random map.")] = RANDOM[2],
    gate: Annotated[bool, typer.Option("--gate", help="All start together in a corner.")] = False,
    turn_cost: Annotated[float, typer.Option(help="Steps that a quarter turn costs.")] = 0.0,
    die: Annotated[list[str] | None, typer.Option(help="ROBOT@STEP becomes a wreck.")] = None,
    join: Annotated[list[str] | None, typer.Option(help="ROW,COLUMN@STEP: one more.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="The plan file.")] = Path(
        "vacuum_plan.json"
    ),
    export: Annotated[
        Path | None, typer.Option(help="Write map and starts as .map or .mcpp, too.")
    ] = None,
    reachable_only: Annotated[
        bool, typer.Option("--reachable-only", help="Cells that no robot can come to are no fault.")
    ] = False,
    json: Json = False,
) -> None:
    """Plan a coverage run, judge it, and write the plan file. Exit 0 only for a plan without faults.

    Example: headland coverage solve --H 32 --W 32 --robots 20 --wall-prob 0.20 --seed 1
    """
    from sim.files.grid_map import GridFileError, write_instance
    from tools.run.coverage_report import solved

    try:
        instance = _instance(map, robots, seed, (height, width, wall_prob), gate)
        _check_turn_cost(turn_cost)
        events = _deaths(die or [], instance), _arrivals(join or [], instance)
        if export is not None:
            if export.suffix not in (".map", ".mcpp"):
                raise GridFileError(f"{export}: an export ends in .map or .mcpp")
            write_instance(export, instance)
        raise SystemExit(
            solved(instance, turn_cost, *events, out, json, reachable_only or map is None)
        )
    except (GridFileError, OSError) as error:
        raise SystemExit(wrong(error, code_of(error))) from None


@app.command()
def replay(
    plan: Annotated[Path | None, typer.Argument(help="A plan file.")] = None,
    plan_option: Annotated[Path | None, typer.Option("--plan", help="The same, as option.")] = None,
    delay: Annotated[float, typer.Option(help="Seconds between steps.")] = 0.03,
    stop_on_done: Annotated[
        bool, typer.Option("--stop-on-done", help="End when all is covered, not with the plan.")
    ] = False,
    turn_cost: Annotated[
        float, typer.Option(help="Steps a quarter turn costs in the score.")
    ] = 0.0,
    json: Json = False,
) -> None:
    """Replay a plan on exactly its map, drawn in the terminal, and judge it. Exit 0: no faults.

    Example: headland coverage replay vacuum_plan.json --delay 0.03 --stop-on-done
    """
    from sim.files.coverage_plan_file import read_plan
    from sim.files.grid_map import GridFileError
    from tools.run.coverage_report import replayed

    path = plan or plan_option or Path("vacuum_plan.json")
    try:
        if plan is not None and plan_option is not None:
            raise GridFileError(f"--plan {plan_option}: {plan} is the plan already")
        if not 0.0 <= delay <= 60.0:
            raise GridFileError("--delay is 0 to 60 seconds")
        _check_turn_cost(turn_cost)
        found = read_plan(path)
    except GridFileError as error:
        raise SystemExit(wrong(error)) from None
    raise SystemExit(replayed(found, delay, stop_on_done, turn_cost, json))


@app.command(hidden=True)
def drive(
    map: Annotated[Path | None, typer.Argument(help="A .map or .mcpp; none: a random map.")] = None,
    robots: Annotated[int | None, typer.Option(help="How many (an .mcpp: only the first).")] = None,
    seed: Annotated[int, typer.Option(help="Of start cells, a random map, and the wire.")] = 0,
    height: Annotated[int, typer.Option("--H", help="Rows of a random map.")] = RANDOM[0],
    width: Annotated[int, typer.Option("--W", help="Columns of a random map.")] = RANDOM[1],
    wall_prob: Annotated[float, typer.Option(help="Share of walls of a random map.")] = RANDOM[2],
    gate: Annotated[bool, typer.Option("--gate", help="All start together in a corner.")] = False,
    turn_cost: Annotated[float, typer.Option(help="Steps that a quarter turn costs.")] = 0.0,
    die: Annotated[list[str] | None, typer.Option(help="ROBOT@SECOND: power off.")] = None,
    join: Annotated[list[str] | None, typer.Option(help="ROBOT@SECOND: only now on.")] = None,
    split: Annotated[
        list[str] | None, typer.Option(help="ROBOT,...@SECOND-SECOND: cut off from the others.")
    ] = None,
    loss: Annotated[float, typer.Option(help="Odds that a receiver misses a frame.")] = 0.0,
    silence: Annotated[Silence, typer.Option(help="When a robot falls silent.")] = "continue",
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for the trace and a candump log.")
    ] = None,
    reachable_only: Annotated[
        bool, typer.Option("--reachable-only", help="Cells that no robot can come to are no fault.")
    ] = False,
    json: Json = False,
) -> None:
    """Cover a map with whole peers on the simulated bus, judged from outside. Exit 0: no faults.

    Example: headland coverage drive --H 24 --W 24 --robots 6 --die 2@70 --split 0,1,2@90-150
    """
    from sim.files.grid_map import GridFileError
    from sim.scenarios.scenario import ScenarioError
    from tools.common.run_folder import FolderError, folder_for

    with told_loading():
        from tools.run.coverage_drive import driven, faults_of, setting_of
        from tools.run.coverage_report import unreached

    try:
        instance = _instance(map, robots, seed, (height, width, wall_prob), gate)
        faults = faults_of(die or [], join or [], split or [], len(instance.starts))
        setting = setting_of(instance, seed, faults, loss, silence, turn_cost)
        left = unreached(instance.walls, instance.starts)
        with nullcontext() if out is None else folder_for(out, instance.name) as folder:
            raise SystemExit(driven(setting, folder, json, left, reachable_only or map is None))
    except (GridFileError, ScenarioError, FolderError, OSError) as error:
        raise SystemExit(wrong(error, code_of(error))) from None


def drive_grid(map: Path, robots: int | None, seed: int, out: Path | None, as_json: bool) -> int:
    """`headland run` of a .map or .mcpp: whole peers, without faults. Returns the exit code."""
    from sim.files.grid_map import GridFileError
    from sim.scenarios.scenario import ScenarioError
    from tools.common.run_folder import FolderError, folder_for

    with told_loading():
        from tools.run.coverage_drive import driven, setting_of
        from tools.run.coverage_report import unreached

    try:
        instance = instance_of(map, robots, seed)
        setting = setting_of(instance, seed, (), 0.0, "continue", 0.0)
        left = unreached(instance.walls, instance.starts)
        with folder_for(out, instance.name) as folder:
            return driven(setting, folder, as_json, left, False)
    except (GridFileError, ScenarioError, FolderError, OSError) as error:
        return wrong(error, code_of(error))


def instance_of(map: Path, robots: int | None, seed: int) -> "Instance":
    """A map and where so many robots start on it. Raises GridFileError and OSError.

    `robots`: None, all of an .mcpp, which says where they start, and GRID_ROBOTS of a .map.
    """
    if robots is None and map.suffix != ".mcpp":
        robots = GRID_ROBOTS
    return _instance(map, robots, seed, RANDOM, False)


def _instance(
    path: Path | None, agents: int | None, seed: int, random: tuple[int, int, float], gate: bool
) -> "Instance":
    from sim.files.grid_map import (
        CELLS_MAX,
        GridFileError,
        Instance,
        gate_starts,
        random_starts,
        random_walls,
        read_instance,
        read_map,
    )

    if path is not None and random != RANDOM:
        raise GridFileError(
            f"--H, --W and --wall-prob are of a random map: leave them out with {path}"
        )
    if path is not None and path.suffix == ".mcpp" and not gate:
        instance = read_instance(path)
        _check_size(instance.walls)
        if agents is not None and not 0 < agents <= len(instance.starts):
            raise GridFileError(f"{path}: has starts for 1 to {len(instance.starts)} robots")
        return instance._replace(starts=instance.starts[:agents])
    if path is not None:
        walls = read_instance(path).walls if path.suffix == ".mcpp" else read_map(path)
    else:
        rows, columns, share = random
        if rows < 1 or columns < 1 or not 0.0 <= share <= 1.0:
            raise GridFileError("--H and --W are 1 or more, --wall-prob is 0 to 1")
        if rows * columns > CELLS_MAX:
            raise GridFileError(f"--H times --W is more than {CELLS_MAX} cells")
        walls = random_walls(rows, columns, share, seed)
    _check_size(walls)
    if agents is None or agents < 1:
        raise GridFileError("say how many robots: --robots K")
    if agents * walls.size > ROBOT_CELLS_MAX:
        raise GridFileError(f"{agents} robots on {walls.size} cells need too much memory")
    try:
        starts = gate_starts(walls, agents) if gate else random_starts(walls, agents, seed)
    except ValueError as error:
        raise GridFileError(str(error)) from error
    return Instance(path.stem if path else f"random-{seed}", walls, starts)


def _check_size(walls: "NDArray[np.bool_]") -> None:
    from sim.files.grid_map import FREE_CELLS_MAX, GridFileError

    free = int(walls.size - walls.sum())
    if free > FREE_CELLS_MAX:
        raise GridFileError(
            f"{free} free cells; up to {FREE_CELLS_MAX} are planned: divide the map"
        )


def _check_turn_cost(steps: float) -> None:
    from agent.coverage.team import TURN_COST_MAX
    from sim.files.grid_map import GridFileError

    if not 0.0 <= steps <= TURN_COST_MAX:
        raise GridFileError(f"--turn-cost is 0 to {TURN_COST_MAX:.0f} steps")


def _numbers(text: str, form: str) -> list[int]:
    from sim.files.grid_map import GridFileError

    parts = text.replace("@", ",").split(",")
    if len(parts) != form.replace("@", ",").count(",") + 1 or not all(p.isdecimal() for p in parts):
        raise GridFileError(f"{text!r} is not {form}")
    return [int(part) for part in parts]


def _deaths(words: list[str], instance: "Instance") -> "list[Death]":
    from sim.files.grid_map import GridFileError
    from sim.runs.planned_coverage import Death

    found = []
    for word in words:
        robot, step = _numbers(word, "ROBOT@STEP")
        if robot >= len(instance.starts):
            raise GridFileError(f"--die {word}: robots are 0 to {len(instance.starts) - 1}")
        found.append(Death(step, robot))
    return found


def _arrivals(words: list[str], instance: "Instance") -> "list[Arrival]":
    from sim.files.grid_map import GridFileError
    from sim.runs.planned_coverage import Arrival

    found = []
    for word in words:
        row, column, step = _numbers(word, "ROW,COLUMN@STEP")
        rows, columns = instance.walls.shape
        if row >= rows or column >= columns or instance.walls[row, column]:
            raise GridFileError(f"--join {word}: not a free cell of the map")
        found.append(Arrival(step, (row, column)))
    return found
