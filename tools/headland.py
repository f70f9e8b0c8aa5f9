"""The one command. Each sub-command imports what it needs when it is called: `--help` stays quick."""

from pathlib import Path
from typing import Annotated

import typer

from tools import coverage, tasks
from tools.keys import app as keys_app

HELP = "A leaderless robot fleet on a CAN bus: every robot is a peer, none is in charge."
app = typer.Typer(
    help=HELP, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None
)
app.add_typer(coverage.app, name="coverage")
app.add_typer(tasks.app, name="task")

Interface = Annotated[
    str, typer.Option("-i", "--interface", help="python-can interface, as for can_logger.")
]
Channel = Annotated[str, typer.Option("-c", "--channel", help="Channel of the interface.")]
Bitrate = Annotated[int, typer.Option("-b", "--bitrate", help="Bit rate of the bus, bit/s.")]
Host = Annotated[str, typer.Option("--host", help="Host of a socketcand interface.")]
Port = Annotated[
    int, typer.Option("--port", help="Port of a socketcand interface (0: the newest launch).")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
KeyFile = Annotated[Path | None, typer.Option("--keys", help="The fleet's key file.")]
OperatorKey = Annotated[
    Path | None, typer.Option("--operator-key", help="The operator's key file.")
]


@app.command()
def run(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file, or the name of one that ships.")
    ] = "oxted",
    robots: Annotated[int | None, typer.Option(help="Instead of the scenario's number.")] = None,
    seed: Annotated[int | None, typer.Option(help="Instead of the scenario's seed.")] = None,
    feature: Annotated[str | None, typer.Option(help="Which field of a file with several.")] = None,
    drive: Annotated[str | None, typer.Option(help="mecanum, differential or ackermann.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for report, picture and log.")] = Path(
        "runs/run"
    ),
    log: Annotated[
        list[Path] | None, typer.Option(help="A further CAN log: .asc .blf .csv .log .trc")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="A warehouse in real time, for more tasks to be added.")
    ] = False,
    port: Annotated[int, typer.Option(help="With --live: of the bus (0: any free one).")] = 0,
    seconds: Annotated[float | None, typer.Option(help="With --live: end after this long.")] = None,
    keys: KeyFile = None,
    json: Json = False,
) -> None:
    """Work a scenario to its end in virtual time, as fast as it can go. A field file is one, too.

    Example: headland run oxted --robots 8 --seed 3 --out runs/eight
    Example: headland run warehouse --live, then elsewhere: headland task add 9.5,2.5 1.5,8.5
    """
    from sim.warehouse_scenario import is_warehouse
    from tools.run import run as command

    if is_warehouse(scenario):
        from tools.haul import haul

        raise SystemExit(haul(scenario, robots, seed, out, json, keys, live, port, seconds))
    raise SystemExit(command(scenario, robots, seed, out, json, keys, log or [], feature, drive))


@app.command()
def explore(
    scenario: Annotated[
        str, typer.Argument(help="An arena file, or the name of one that ships.")
    ] = "arena",
    robots: Annotated[int | None, typer.Option(help="Instead of the scenario's number.")] = None,
    seed: Annotated[int | None, typer.Option(help="Instead of the scenario's seed.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for report, pictures and log.")] = Path(
        "runs/explore"
    ),
    animate: Annotated[
        bool, typer.Option("--film", help="Also maps.gif: the map, growing.")
    ] = False,
    json: Json = False,
) -> None:
    """Explore an arena to its end in virtual time. Exit 0 only for a run without a flaw.

    Example: headland explore offices --robots 6 --out runs/offices
    """
    from tools.explore import explore as command

    raise SystemExit(command(scenario, robots, seed, out, json, animate))


@app.command()
def launch(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file, or the name of one that ships.")
    ] = "oxted",
    robots: Annotated[int | None, typer.Option(help="Instead of the scenario's number.")] = None,
    seed: Annotated[int | None, typer.Option(help="Instead of the scenario's seed.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of this launch.")] = Path("runs/launch"),
    port: Annotated[int, typer.Option(help="Port of the bus hub (0: any free one).")] = 0,
    seconds: Annotated[float | None, typer.Option(help="End after this long.")] = None,
    keys: KeyFile = None,
    json: Json = False,
) -> None:
    """Run every robot as a process of its own, in real time, on a bus others can attach to.

    Example: headland launch --robots 6, then in another terminal: headland estop
    """
    from tools.launch import launch as command

    raise SystemExit(command(scenario, robots, seed, out, port, seconds, json, keys))


@app.command()
def estop(
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, keys: KeyFile = None,
    reason: Annotated[str, typer.Option(help="Reason code.")] = "OPERATOR_INTERVENTION",
    timeout: Annotated[float, typer.Option(help="Seconds to wait for every robot's echo.")] = 2.0,
    watch: Annotated[bool, typer.Option("--watch", help="Keep showing who is stopped.")] = False,
    json: Json = False,
) -> None:  # fmt: skip
    """Stop every robot on a bus, and say who has confirmed. Exit 0 only when all live ones did.

    Example: headland estop -i socketcan -c can0
    """
    from tools.estop import estop as command

    raise SystemExit(
        command(interface, channel, bitrate, host, port, keys, reason, timeout, watch, json)
    )


@app.command()
def reset(
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, key: OperatorKey = None,
    start: Annotated[bool, typer.Option("--start/--no-start", help="And start the work.")] = False,
    timeout: Annotated[float, typer.Option(help="Seconds to wait.")] = 5.0,
    json: Json = False,
) -> None:  # fmt: skip
    """Clear the stops that are shown, reset each machine, and (with --start) start the work again.

    Example: headland reset --start
    """
    from tools.reset import reset as command

    raise SystemExit(command(interface, channel, bitrate, host, port, key, start, timeout, json))


@app.command()
def order(
    robot: Annotated[int, typer.Argument(help="The robot's number.")],
    what: Annotated[
        str, typer.Argument(help="wait, continue, replan, stop, go-home, set-goal or start.")
    ],
    place: Annotated[
        str | None, typer.Argument(help="Of set-goal: metres east,north, as 12.5,-40.")
    ] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, key: OperatorKey = None,
    timeout: Annotated[float, typer.Option(help="Seconds to wait for the robot's word.")] = 5.0,
    json: Json = False,
) -> None:  # fmt: skip
    """Answer a robot that has stopped before something, or direct it. It confirms, or exit 1.

    Example: headland order 2 replan
    """
    from tools.order import order as command

    bus = (interface, channel, bitrate, host, port)
    raise SystemExit(command(robot, what, place, bus, key, timeout, json))


@app.command()
def say(
    phrase: Annotated[
        list[str] | None, typer.Argument(help="What you want, in words; none: a conversation.")
    ] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, key: OperatorKey = None,
    places: Annotated[
        Path | None, typer.Option(help="TOML with named places; none: the launch's.")
    ] = None,
    by: Annotated[str | None, typer.Option(help="Which robot answers questions, or any.")] = None,
    log: Annotated[
        Path | None, typer.Option(help="Ask a run folder or a log instead of a bus.")
    ] = None,
    read: Annotated[bool, typer.Option("--read", help="Only show how it is understood.")] = False,
    queue: Annotated[Path, typer.Option(help="Where goals wait for an idle robot.")] = Path(
        "runs/queue.json"
    ),
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Stay until what is queued was given.")
    ] = True,
    yes: Annotated[bool, typer.Option("--yes", help="Say yes to what is asked back.")] = False,
    endpoint: Annotated[
        str | None, typer.Option(help="OpenAI-compatible URL for what the grammar cannot read.")
    ] = None,
    model: Annotated[str, typer.Option(help="Of the endpoint.")] = "default",
    timeout: Annotated[float, typer.Option(help="Seconds to wait for a robot's word.")] = 5.0,
    json: Json = False,
) -> None:  # fmt: skip
    """Tell or ask the fleet something in plain language. Ambiguous or unsafe: exit 3 and a question.

    Example: headland say "send the nearest robot to the gate"
    """
    from tools.say import Options
    from tools.say import say as command

    bus = (interface, channel, bitrate, host, port)
    options = Options(
        bus, key, places, queue, by, endpoint, model, timeout, wait, yes, read, log, json
    )
    raise SystemExit(command(phrase or [], options))


@app.command()
def inspect(
    source: Annotated[Path | None, typer.Argument(help="Run folder or log; none: a live bus.")] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0,
    seconds: Annotated[float, typer.Option(help="Listen this long to a live bus.")] = 3.0,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Print the state machine.")] = False,
    why: Annotated[str | None, typer.Option(help="How a section (S7) came to its owner.")] = None,
    traces: Annotated[int | None, typer.Option(help="Ask this robot for its newest traces.")] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Text, also at a terminal.")] = False,
    speed: Annotated[float, typer.Option(help="Of a log on the screen; 0: show its end.")] = 0.0,
    picture: Annotated[Path | None, typer.Option(help="Write the screen as an SVG.")] = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Show each robot's state, peers, sections, vector clock, and the path of states that led there.

    At a terminal this is a screen (`q` ends it); otherwise, and with --plain, text.

    Example: headland inspect runs/run --why S7
    """
    from tools.inspection import inspect as command

    bus = (interface, channel, bitrate, host, port)
    raise SystemExit(
        command(source, *bus, seconds, mermaid, why, json, traces, plain, speed, picture)
    )


app.add_typer(keys_app, name="keys")


@app.command()
def chaos(
    seeds: Annotated[str, typer.Option(help="FIRST:END, or one seed.")] = "0:20",
    profile: Annotated[str, typer.Option(help="all, bus, crash, stop, body or protocol.")] = "all",
    jobs: Annotated[int, typer.Option(help="Processes at a time (0: one a core).")] = 0,
    seconds: Annotated[float | None, typer.Option(help="Begin no run after this long.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for results and reproductions.")] = Path(
        "runs/chaos"
    ),
    mutants: Annotated[
        bool, typer.Option("--mutants", help="Look for planted bugs instead: all must be found.")
    ] = False,
    scenario: Annotated[
        Path | None,
        typer.Option(help="Judge this scenario file instead, written by hand or found."),
    ] = None,
    json: Json = False,
) -> None:
    """Give a fleet bad luck, judge from outside whether it kept the rules. Exit 0 when it did.

    The first failing seed is made small and saved as a scenario.
    Example: headland chaos --seeds 0:1000 --profile stop --jobs 2
    """
    from tools.chaos import chaos as command
    from tools.chaos import judge_file

    if scenario is not None:
        raise SystemExit(judge_file(scenario, json))
    raise SystemExit(command(seeds, profile, jobs, seconds, out, mutants, json))


@app.command()
def fuzz(
    targets: Annotated[list[str] | None, typer.Argument(help="Decoders; none: all.")] = None,
    runs: Annotated[int, typer.Option(help="Executions of each target.")] = 100_000,
    seconds: Annotated[float | None, typer.Option(help="At most this long for each target.")] = None,
    seed: Annotated[int, typer.Option(help="Of what is tried.")] = 1,
    engine: Annotated[str, typer.Option(help="auto, plain or atheris (pip install atheris).")] = "auto",
    keep: Annotated[bool, typer.Option("--keep", help="New inputs join the corpus.")] = False,
    again: Annotated[Path | None, typer.Option("--input", help="Run one input again.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for what breaks something.")] = Path("runs/fuzz"),
    json: Json = False,
) -> None:  # fmt: skip
    """Any bytes into every decoder, from a corpus in the tree. Exit 0 when no promise was broken.

    Example: headland fuzz frame sync --runs 1000000
    """
    from tools.fuzz import fuzz as command
    from tools.fuzz import replay as once

    if again is not None:
        raise SystemExit(once((targets or [""])[0], again))
    raise SystemExit(command(targets or [], runs, seconds, seed, engine, keep, out, json))


@app.command()
def bench(
    name: Annotated[str, typer.Argument(help="Which one, or all.")] = "all",
    quick: Annotated[bool, typer.Option("--quick", help="Less than a minute each.")] = False,
    seed: Annotated[int, typer.Option(help="Where chance takes part.")] = 1,
    json: Json = False,
) -> None:
    """Measure again what the documents claim. Exit 0 when every target holds.

    Example: headland bench wire --quick --json
    """
    from tools.bench.command import bench as command

    raise SystemExit(command(name, quick, seed, json))


@app.command()
def dbc(
    out: Annotated[
        Path | None, typer.Argument(help="Where to write; none: to the terminal.")
    ] = None,
) -> None:
    """Write a DBC of every frame, for cantools, SavvyCAN, CANalyzer and the like.

    Example: headland dbc headland.dbc
    """
    from tools.dbc import dbc as command

    raise SystemExit(command(out))


@app.command()
def replay(
    log: Annotated[Path, typer.Argument(help="Run folder, or log: .log .asc .blf .csv .trc")],
    speed: Annotated[float, typer.Option(help="Times real time; 0: at once.")] = 0.0,
    interface: Annotated[
        str, typer.Option("-i", "--interface", help="Also send the frames to this interface.")
    ] = "",
    channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0,
    json: Json = False,
) -> None:  # fmt: skip
    """Feed a log to the inspector, at the speed it was recorded or as fast as it goes.

    Example: headland replay runs/run --speed 10
    """
    from tools.replay import replay as command

    raise SystemExit(command(log, speed, interface, channel, bitrate, host, port, json))


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    isoxml: Annotated[
        Path | None, typer.Option(help="Write ISO 11783-10 task data: a folder, or NAME.zip.")
    ] = None,
    geojson: Annotated[Path | None, typer.Option(help="Write GeoJSON.")] = None,
) -> None:
    """Write what a run has worked in formats that farm software reads.

    Example: headland export runs/run --isoxml TASKDATA
    """
    from tools.export import export as command

    raise SystemExit(command(run, isoxml, geojson))


@app.command()
def warmup() -> None:
    """Compile the kernels once, so that no robot waits for it.

    Example: headland warmup
    """
    from tools.warmup import main as command

    raise SystemExit(command())


def main() -> None:
    try:
        app()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
