"""The one command. Each sub-command imports what it needs when it is called: `--help` stays quick."""

import gc
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tools.cli import bus_commands, keys, robot_commands, setup_commands, tasks
from tools.cli import test_commands as trial_commands
from tools.cli.one_line_errors import (
    hung_up_as_terminated,
    one_line_errors,
    tell_origin,
    terminated_as_interrupted,
)
from tools.cli.panels import (
    DEVELOP,
    LOOK,
    OPERATE,
    PLAY,
    SET_UP,
    SETTINGS,
    Panels,
    only_asked,
    show_version,
)
from tools.common.compiled_caches import guard
from tools.common.exit_codes import INTERRUPTED, WRONG, code_of, wrong
from tools.common.gc_collector import GC_YOUNG
from tools.common.kind_words import KIND_WORDS
from tools.common.options import (
    PAGE_PORT,
    PORT_MAX,
    Bitrate,
    Channel,
    Drive,
    Foxglove,
    Host,
    Json,
    KeyFile,
    Map,
    MapOperatorKey,
    Metrics,
    PagePort,
    Port,
    Robots,
    Seed,
)
from tools.common.told_wait import told_loading
from tools.common.unused_options import refuse_given
from tools.run import coverage

WRONG_WORDS: Any = typer.BadParameter.__base__  # click's UsageError, wherever typer keeps its click
HELP = "A leaderless robot fleet on a CAN bus: every robot is a peer, none is in charge."
WORDS = "Words such as beat, dot, lease and unit: docs/glossary.md in the repository."
app = typer.Typer(
    help=HELP,
    epilog=WORDS,
    cls=Panels,
    context_settings=SETTINGS,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def headland(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=show_version, help="Print the version."),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Print only errors, and with --json the JSON.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="Also where an error came from.")
    ] = False,
) -> None:
    """A leaderless robot fleet on a CAN bus: every robot is a peer, none is in charge."""


@app.command(rich_help_panel=PLAY)
def run(
    scenario: Annotated[
        str, typer.Argument(help="One that ships (headland list), or a .toml, .map or field file.")
    ] = "oxted",
    robots: Robots = None,
    seed: Seed = None,
    feature: Annotated[str | None, typer.Option(help="Which field of a file with several.")] = None,
    drive: Annotated[Drive | None, typer.Option(help="Of a field's robots.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder of the run (none: runs/NAME-N, and runs/latest)."),
    ] = None,
    log: Annotated[
        list[Path] | None, typer.Option(help="A further CAN log: .asc .blf .csv .log .trc")
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(help="End after this long in virtual time, s (none: by area and robots)."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="A warehouse in real time, for more tasks to be added.")
    ] = False,
    port: Annotated[
        int, typer.Option(min=0, max=PORT_MAX, help="With --live: of the bus (0: any free one).")
    ] = 0,
    seconds: Annotated[float | None, typer.Option(help="With --live: end after this long.")] = None,
    keys: KeyFile = None,
    film: Annotated[
        bool,
        typer.Option("--film", help="Also film.gif; of an exploration maps.gif, its map growing."),
    ] = False,
    show_map: Map = False,
    page_port: PagePort = PAGE_PORT,
    json: Json = False,
) -> None:
    """Play a scenario in virtual time: a field, a building, a warehouse, an arena or a grid map.

    The scenario says which. Exit 0 only for a run without a flaw.
    Example: headland run oxted --robots 8 --seed 3 --out runs/eight
    Example: headland run ring --robots 4 --film
    Example: headland run warehouse --live, then elsewhere: headland task add 9.5,2.5 1.5,8.5
    """
    from tools.build.compiled_core import use

    use()
    from sim.scenarios.scenario_kind import Kind, named

    kind, name = named(scenario)
    worked = kind in (Kind.FIELD, Kind.ERRANDS, Kind.PROTOCOL)
    warehouse, arena = kind is Kind.DELIVERY, kind is Kind.EXPLORATION
    unfit = {
        "--live": live and not warehouse, "--port": port and not live,
        "--seconds": seconds is not None and not live, "--map": show_map and not worked,
        "--drive": drive is not None and not worked,
        "--feature": feature is not None and kind not in (Kind.FIELD, Kind.PROTOCOL),
        "--log": bool(log) and not worked,
        "--limit": limit is not None and (live or not (worked or warehouse)),
        "--keys": keys is not None and not (worked or warehouse), "--film": film and kind is Kind.GRID,
    }  # fmt: skip
    _refuse(scenario, KIND_WORDS[kind.value], live, unfit)
    _refuse_page_port(page_port, show_map)
    if warehouse:
        with told_loading():
            from tools.run.run_delivery import haul

        raise SystemExit(
            haul(name, robots, seed, out, json, keys, live, port, seconds, limit, film)
        )
    if arena:
        with told_loading():
            from tools.run.run_exploration import explore as command

        raise SystemExit(command(name, robots, seed, out, json, film))
    if kind is Kind.GRID:
        with told_loading():
            from tools.run.coverage import drive_grid

        raise SystemExit(drive_grid(Path(name), robots, seed or 0, out, json))
    with told_loading():
        from tools.run.run_field import run as work

    page = page_port if show_map else None
    raise SystemExit(
        work(name, robots, seed, out, json, keys, log or [], feature, drive, page, limit, film)
    )


def _refuse(scenario: str, kind: str, live: bool, unfit: Mapping[str, object]) -> None:
    """An option that would do nothing is said, not ignored."""
    for option, is_unfit in unfit.items():
        if is_unfit:
            how = "" if option == "--live" or live else " without --live"
            how = how if option in ("--port", "--seconds") else ""
            raise SystemExit(
                wrong(f"{option}: does nothing here: {scenario} is {kind}{how}; leave it out")
            )


def _refuse_page_port(page_port: int, show_map: bool) -> None:
    if page_port != PAGE_PORT and not show_map:
        raise SystemExit(wrong(f"--page-port {page_port}: does nothing without --map; add --map"))


@app.command(hidden=True)
def explore(
    scenario: Annotated[
        str, typer.Argument(help="An arena file, or the name of one that ships.")
    ] = "arena",
    robots: Robots = None,
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder of the run (none: runs/NAME-N, and runs/latest)."),
    ] = None,
    film: Annotated[bool, typer.Option("--film", help="Also maps.gif: the map, growing.")] = False,
    json: Json = False,
) -> None:
    """The older name of `headland run` for arenas.

    Example: headland run offices --robots 6 --out runs/offices
    """
    from tools.run.run_exploration import explore as command

    raise SystemExit(command(scenario, robots, seed, out, json, film))


@app.command(rich_help_panel=PLAY)
def launch(
    context: typer.Context,
    scenario: Annotated[
        str, typer.Argument(help="A scenario file, or the name of one that ships.")
    ] = "oxted",
    robots: Robots = None,
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", help="Folder of this fleet (none: runs/NAME-N, and runs/launch)."
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="A new fleet, also where the last one is not done.")
    ] = False,
    port: Annotated[
        int, typer.Option(min=0, max=PORT_MAX, help="Port of the bus hub (0: any free one).")
    ] = 0,
    seconds: Annotated[float | None, typer.Option(help="End after this long.")] = None,
    keys: KeyFile = None,
    no_keys: Annotated[
        bool,
        typer.Option("--no-keys", help="No keys: any device on the bus may release this fleet."),
    ] = False,
    show_map: Map = False,
    page_port: PagePort = PAGE_PORT,
    operator_key: MapOperatorKey = None,
    segment: Annotated[
        int, typer.Option(min=0, max=0x7FFF, help="Of a fleet of several, for headland bridge.")
    ] = 0,
    hub: Annotated[
        int, typer.Option(min=0, max=PORT_MAX, help="Port of a bus by itself: headland hub.")
    ] = 0,
    metrics: Metrics = None,
    foxglove: Foxglove = None,
    json: Json = False,
) -> None:
    """Run every robot as a process of its own, in real time, on a bus others can attach to.

    A fleet whose work is not done is continued by the same command, with its stops and its work.
    It has keys of its own, in its folder. Your tools on its bus take them by themselves.
    Example: headland launch --robots 6, then in another terminal: headland stop
    """
    _refuse_page_port(page_port, show_map)
    if hub:  # the hub has its port, its bus runs without us
        refuse_given(context, {"port": f"with --hub {hub}; leave one of them out"})
    if not show_map:
        refuse_given(context, {"operator_key": "without --map; add --map"})
    with told_loading():
        from tools.run.launch_command import launch as command

    page = page_port if show_map else None
    raise SystemExit(
        command(
            scenario,
            robots,
            seed,
            out,
            port,
            seconds,
            json,
            keys,
            page,
            segment,
            hub,
            fresh,
            operator_key,
            metrics,
            foxglove,
            no_keys,
        )
    )


@app.command(hidden=True)
def replay(
    log: Annotated[Path, typer.Argument(help="Run folder, or log: .log .mcap .asc .blf .csv .trc")],
    speed: Annotated[float, typer.Option(help="Times real time; 0: at once.")] = 0.0,
    interface: Annotated[
        str, typer.Option("-i", "--interface", help="Also send the frames to this interface.")
    ] = "",
    channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, show_map: Map = False, page_port: PagePort = PAGE_PORT,
    json: Json = False,
) -> None:  # fmt: skip
    """Feed a log to the inspector, at the speed it was recorded or as fast as it goes.

    Example: headland replay runs/latest --speed 10
    """
    from tools.run.replay import replay as command

    page = page_port if show_map else None
    raise SystemExit(command(log, speed, interface, channel, bitrate, host, port, json, page))


@app.command(rich_help_panel=LOOK)
def report(
    source: Annotated[Path, typer.Argument(help="Run folder or log.")] = Path("runs/latest"),
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The page; none: in the run's folder.")
    ] = None,
    json: Json = False,
) -> None:
    """Write a run as one HTML page: tracks, errors, sections, bus load, states, stops, events.

    Example: headland report runs/latest -o report.html
    """
    from tools.report.command import report as command

    raise SystemExit(command(source, out, json))


@app.command(rich_help_panel=SET_UP)
def fields(
    file: Annotated[Path, typer.Argument(help="GeoJSON, or task data: TASKDATA.XML, folder, zip.")],
    json: Json = False,
) -> None:
    """List the fields of a file, with their size, and what is wrong with which.

    Example: headland fields TASKDATA/
    """
    from tools.cli.fields import fields as command

    raise SystemExit(command(file, json))


@app.command(rich_help_panel=PLAY)
def plan(
    field: Annotated[
        str, typer.Argument(help="A field file, all its fields; a scenario, or one that ships.")
    ] = "oxted",
    robots: Annotated[int | None, typer.Option(help="Instead of the scenario's number.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            help="Folder for plan.geojson, plan.kml and TASKDATA (none: a table alone).",
        ),
    ] = None,
    done: Annotated[
        Path | None, typer.Option(help="The work.geojson of a run: plan what it left.")
    ] = None,
    feature: Annotated[str | None, typer.Option(help="One field of a file with several.")] = None,
    drive: Annotated[str | None, typer.Option(help="Of the bodies: mecanum.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the search; robots use 0.")] = 0,
    json: Json = False,
) -> None:
    """Plan which robot works which sections from when to when, as robots do it, without a run.

    Exit 0 when every field is planned, 1 when one could not be, 2 when none could.
    Example: headland plan oxted --robots 6 --out plan
    """
    with told_loading():
        from tools.run.plan import plan as command

    raise SystemExit(command(field, robots, out, done, feature, drive, seed, json))


@app.command(rich_help_panel=LOOK)
def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    isoxml: Annotated[
        Path | None, typer.Option(help="Write ISO 11783-10 task data: a folder, or NAME.zip.")
    ] = None,
    geojson: Annotated[Path | None, typer.Option(help="Write GeoJSON.")] = None,
    bag: Annotated[
        Path | None, typer.Option(help="Write a ROS 2 bag with standard messages: a new folder.")
    ] = None,
    storage: Annotated[Literal["mcap", "sqlite3"], typer.Option(help="Of the bag.")] = "mcap",
    film: Annotated[
        Path | None, typer.Option(help="Write a film of the run, 20 s: a .gif or .webp.")
    ] = None,
    json: Json = False,
) -> None:
    """Write what a run has worked in formats that farm software and ROS 2 read, or as a film.

    Example: headland export runs/latest --isoxml TASKDATA
    Example: headland export runs/latest --bag latest_bag
    Example: headland export runs/latest --film latest.gif
    """
    from tools.run.export import export as command

    raise SystemExit(command(run, isoxml, geojson, bag, storage, film, json))


@app.command(rich_help_panel=SET_UP)
def dbc(
    out: Annotated[
        Path | None,
        typer.Argument(
            help="Where to write, as .dbc, .arxml, .kcd or .sym; none: to the terminal."
        ),
    ] = None,
    addresses: Annotated[
        str | None,
        typer.Option(
            help="Exact identifiers of these addresses, as 128-133; none: match by group."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Write a DBC of every frame, for cantools, SavvyCAN, CANalyzer and the like.

    Example: headland dbc headland.dbc --addresses 128-133
    """
    from tools.cli.dbc import dbc as command

    raise SystemExit(command(out, addresses, json))


@app.command(hidden=True)
def warmup(
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0: one for each core.")] = 0,
) -> None:
    """Compile the kernels once, so that no robot waits for it.

    Example: headland warmup
    """
    from tools.build.warmup import main as command

    raise SystemExit(command(jobs))


@app.command(name="compile", rich_help_panel=DEVELOP)
def compile_core(
    remove: Annotated[bool, typer.Option("--remove", help="Delete what was compiled.")] = False,
    kernels: Annotated[
        bool,
        typer.Option(
            "--kernels", help="Only the kernels of every run, and with g++ those of robots."
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Make machine code of what simulations spend their time in. `run`, `mapf` and `chaos` use it then.

    Takes some minutes and a C compiler; results stay the same, bit for bit.
    Example: headland compile
    Example: headland compile --kernels
    """
    if kernels and remove:
        raise SystemExit(wrong("--remove: does nothing with --kernels; leave one of them out"))
    if kernels:
        from tools.build.warmup import main as compile_kernels

        raise SystemExit(compile_kernels(0, json))
    from tools.build.compile import compile_core as command

    raise SystemExit(command(remove, json))


@app.command(rich_help_panel=PLAY)
def mapf(
    map: Annotated[Path, typer.Argument(help="A MovingAI .map.")],
    scenario: Annotated[
        Path | None, typer.Argument(help="Its .scen; none: starts and goals drawn by the seed.")
    ] = None,
    robots: Annotated[
        str, typer.Option(help="How many: 20, 1:100 (doubled), 10:100:30 (with a step).")
    ] = "20",
    loss: Annotated[float, typer.Option(help="Odds that a receiver misses a frame.")] = 0.0,
    crash: Annotated[int, typer.Option(min=0, help="Robots that fail on the way.")] = 0,
    seed: Annotated[int, typer.Option(help="Of the wire, the crashes, and drawn goals.")] = 1,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The paths that were driven, a file.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="The same as a picture, .png, .svg or .pdf.")
    ] = None,
    json: Json = False,
) -> None:
    """Drive a public MAPF instance with whole peers on a bus, judged from outside. Exit 0: no faults.

    Nobody plans for all: robots tell each other where they are and want to be, and agree. `--loss` is
    a share of all frames from 0 to 0.9, `--crash` a number of robots.
    Example: headland mapf room-64-64-8.map room-64-64-8-random-1.scen --robots 1:50 --loss 0.02
    """
    from tools.build.compiled_core import use

    use()  # a hundred peers cost minutes of CPU
    with told_loading():
        from sim.files.grid_map import GridFileError
        from tools.run.mapf import counts_of, measured

    try:
        counts = counts_of(robots)
        raise SystemExit(measured(map, scenario, counts, seed, loss, crash, out, picture, json))
    except (GridFileError, OSError) as error:
        raise SystemExit(wrong(error, code_of(error))) from None


app.add_typer(bus_commands.app)
app.add_typer(trial_commands.app)
app.add_typer(setup_commands.app)
app.add_typer(robot_commands.app)
app.add_typer(coverage.app, name="coverage", cls=Panels, rich_help_panel=PLAY)
app.add_typer(keys.app, name="keys", cls=Panels, rich_help_panel=SET_UP)
app.add_typer(tasks.app, name="task", cls=Panels, rich_help_panel=OPERATE)


def main() -> None:
    """Whatever a person can cause is one line; the exit code is that of the command."""
    gc.set_threshold(GC_YOUNG)
    guard()
    try:
        with one_line_errors(), terminated_as_interrupted(), hung_up_as_terminated():
            asked = only_asked(app, sys.argv[1:])
            raise SystemExit(asked(prog_name="headland", standalone_mode=False))
    except typer.Abort:
        raise SystemExit(INTERRUPTED) from None
    except WRONG_WORDS as problem:
        tell_origin()
        context = problem.ctx
        where = "headland" if context is None else context.command_path
        if type(problem).__name__ == "NoArgsIsHelpError":
            # Without any argument: print the help, not an error.
            problem.show()
            raise SystemExit(WRONG) from None
        line = " ".join(problem.format_message().split()).rstrip(".")
        raise SystemExit(wrong(f"{line}; see: {where} --help")) from None


if __name__ == "__main__":
    main()
