"""`headland run` of a warehouse: to the last parcel in virtual time, or live for tasks to be added."""

import asyncio
import signal
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sim.can.socketcand_server import Hub
from sim.files.palette import colour_of
from sim.files.strict_json import dumps
from sim.fleet.virtual_clock import WallLoop
from sim.runs.delivery_run import DeliveryRun, HaulCluster, HaulOutcome, RunProgress
from sim.scenarios.delivery_scenario import load_warehouse
from sim.scenarios.delivery_setup import DeliverySetting
from sim.scenarios.scenario import ScenarioError
from tools.common.bus_attach import CHANNEL
from tools.common.process_identity import identity
from tools.common.result_table import run_table
from tools.common.run_folder import LAUNCH, RUNS, FolderError, folder_for, link
from tools.common.run_recorder import RunRecorder

UNFINISHED, WRONG, UNREACHABLE, INTERRUPTED = 1, 2, 3, 130
HOST = "127.0.0.1"
BUS = "bus.json"  # where tools find the bus of a launch


def haul(
    scenario: str, robots: int | None, seed: int | None, to: Path | None, as_json: bool,
    keys: Path | None, live: bool, port: int, seconds: float | None,
    limit_s: float | None = None,
) -> int:  # fmt: skip
    console = Console(stderr=as_json)
    try:
        setting = DeliverySetting(
            load_warehouse(scenario).changed(robots, seed, keys, time_limit_s=limit_s)
        )
        out = folder_for(to, setting.scenario.name)
        keeping = RunRecorder(setting, out)
    except (ScenarioError, FolderError) as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG
    except OSError as problem:
        print(f"headland: --out: {problem}", file=sys.stderr)
        return WRONG
    try:
        outcome, run, interrupted = _watch(console, setting, out, live, port, seconds, keeping)
    except OSError as problem:
        print(f"headland: --port {port}: {problem}; choose another or 0", file=sys.stderr)
        return WRONG
    finally:
        keeping.close()
    report = {**outcome.to_dict(), "log_hash": keeping.log_hash}
    (out / "report.json").write_text(dumps(report, indent=1) + "\n")
    draw_warehouse(setting, run, outcome, out / "warehouse.png")
    if as_json:
        print(dumps(report))
    else:
        console.print(outcome_table(outcome))
        console.print(f"report.json, warehouse.png, trace.jsonl, {keeping.logs} are in {out}")
    if interrupted:
        return INTERRUPTED
    return exit_code(outcome)


def exit_code(outcome: HaulOutcome) -> int:
    """3: nothing is wrong but that what is left cannot be got to."""
    if outcome.success:
        return 0
    left = outcome.tasks - outcome.delivered
    walled_in = left and left == len(outcome.unreachable) and not outcome.flawed
    return UNREACHABLE if walled_in else UNFINISHED


def _watch(
    console: Console, setting: DeliverySetting, out: Path, live: bool, port: int,
    seconds: float | None, keeping: RunRecorder,
) -> tuple[HaulOutcome, DeliveryRun, bool]:  # fmt: skip
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"),
        TextColumn("{task.fields[note]}"), TimeElapsedColumn(), console=console, transient=True,
    ) as progress:  # fmt: skip
        bar = progress.add_task(setting.scenario.name, total=len(setting.rows), note="")

        def told(moment: RunProgress) -> None:
            plans = "  ".join(
                f"{slot} [{', '.join(stops[:3])}{', ...' if len(stops) > 3 else ''}]"
                for slot, stops in moment.itineraries.items()
            )
            note = f"{moment.simulated_s:.0f} s  {plans}"
            progress.update(bar, completed=moment.delivered, total=moment.tasks, note=note)

        run = DeliveryRun(setting, out, told, forever=live)
        run.attach = keeping
        if not live:
            return run.run(), run, False
        with asyncio.Runner(loop_factory=WallLoop) as runner:
            outcome, interrupted = runner.run(_live(console, run, port, seconds, keeping, out))
        return outcome, run, interrupted


async def _live(
    console: Console,
    run: DeliveryRun,
    port: int,
    seconds: float | None,
    keeping: RunRecorder,
    out: Path,
) -> tuple[HaulOutcome, bool]:
    """In real time, on a bus that tools can attach to."""
    loop = asyncio.get_running_loop()
    interrupted = False
    hubs: list[Hub] = []
    opening: list[asyncio.Task[None]] = []

    def end(by_person: bool = True) -> None:
        nonlocal interrupted
        interrupted, run.ended = by_person, True

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    if seconds is not None:
        loop.call_later(seconds, end, False)

    def attach(cluster: HaulCluster) -> None:
        keeping(cluster)
        hubs.append(Hub(cluster.segment, CHANNEL))
        starting = loop.create_task(_open(hubs[0], port, console, out))
        opening.append(starting)
        starting.add_done_callback(lambda task: None if task.exception() is None else end(False))

    try:
        outcome = await run.live(attach)
        problem = opening[0].exception() if opening and opening[0].done() else None
        if problem is not None:
            raise problem
        return outcome, interrupted
    finally:
        for hub in hubs:
            await hub.stop()
        (out / BUS).unlink(missing_ok=True)


async def _open(hub: Hub, port: int, console: Console, out: Path) -> None:
    await hub.start(HOST, port)
    where = {"host": HOST, "port": hub.port, "channel": CHANNEL, **identity()}
    (out / BUS).write_text(dumps(where))
    RUNS.mkdir(parents=True, exist_ok=True)
    link(RUNS / LAUNCH, out)
    console.print(f"bus: socketcand {HOST}:{hub.port} channel {CHANNEL}")


def outcome_table(outcome: HaulOutcome) -> Table:
    flaws = ", ".join(f"{n} {what}" for what, n in outcome.flaws.items())
    empty = "never" if not outcome.empty else f"[red]robots {outcome.empty}[/red]"
    facts = [
        (
            "delivered",
            f"{outcome.delivered} of {outcome.tasks} parcels in {outcome.makespan_s:.1f} s",
        ),
        ("unreachable", ", ".join(f"task {n}" for n in outcome.unreachable) or "none"),
        ("mean latency", f"{outcome.latency_s:.1f} s from a task's appearing to its delivery"),
        ("deliveries done twice, lost, by two, moved again", flaws),
        (
            "battery empty",
            f"{empty} (lowest {outcome.lowest_battery:.0%}, {outcome.charges} charges)",
        ),
        ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
        ("plans of all together", str(outcome.rounds)),
        ("agreements in jams", str(outcome.agreements)),
        ("paths planned ahead", str(outcome.ahead)),
        ("driven", f"{outcome.travel_m:.0f} m"),
        ("replicas", "equal" if outcome.replicas_equal else "[red]differ[/red]"),
        ("bus load", f"{outcome.bus_load:.1%}"),
    ]
    return run_table(outcome, facts)


def draw_warehouse(
    setting: DeliverySetting, run: DeliveryRun, outcome: HaulOutcome, out: Path
) -> None:
    """One PNG: walls, bays, and where each robot drove."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    floor = setting.floor
    rows, columns = floor.walls.shape
    west, south = floor.origin
    box = (west, west + columns * floor.cell_m, south, south + rows * floor.cell_m)
    figure, axes = pyplot.subplots(figsize=(11, 7), dpi=110)
    axes.imshow(floor.walls, origin="lower", extent=box, cmap="Greys", alpha=0.5)
    for slot, track in sorted(run.tracks.items()):
        axes.plot([p[1] for p in track], [p[2] for p in track], color=colour_of(slot),
                  linewidth=0.7, alpha=0.7, label=f"robot {slot}")  # fmt: skip
    for number, (x_m, y_m) in enumerate(setting.house.bays):
        axes.annotate(f"C{number}", (x_m, y_m), ha="center", va="center", fontsize=7)
    axes.set_title(f"{outcome.scenario}: {outcome.delivered} parcels, {outcome.makespan_s:.0f} s")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_aspect("equal")
    if len(run.tracks) <= 10:
        axes.legend(loc="upper right", fontsize=7)
    figure.tight_layout()
    figure.savefig(out)
    pyplot.close(figure)
