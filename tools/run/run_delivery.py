"""`headland run` of a warehouse: to the last parcel in virtual time, or live for tasks to be added."""

import asyncio
from pathlib import Path

from rich.console import Console

from agent.runtime.end_signals import on_end
from sim.can.socketcand_server import Hub
from sim.files.palette import colour_of
from sim.files.strict_json import dumps
from sim.files.whole_file import whole_file, write_whole
from sim.fleet.virtual_clock import WallLoop
from sim.runs.delivery_fleet import DeliveryFleet
from sim.runs.delivery_run import DeliveryOutcome, DeliveryRun
from sim.scenarios.delivery_scenario import load_warehouse
from sim.scenarios.delivery_setup import DeliverySetup
from tools.common.bus_address import CHANNEL, absolute
from tools.common.counted import counted
from tools.common.exit_codes import INTERRUPTED
from tools.common.process_identity import identity
from tools.common.result_table import Fact
from tools.common.run_folder import LAUNCH, RUNS, link
from tools.run.plain_text import plain_text
from tools.run.run_mission import UNFINISHED, MissionCommand, RunError, run_mission
from tools.run.run_recorder import RunRecorder

UNREACHABLE = 3
HOST = "127.0.0.1"
BUS = "bus.json"  # where tools find the bus of a launch


def haul(
    scenario: str, robots: int | None, seed: int | None, to: Path | None, as_json: bool,
    keys: Path | None, live: bool, port: int, seconds: float | None,
    limit_s: float | None = None, film: bool = False,
) -> int:  # fmt: skip
    """The exit code of `headland run` for a warehouse: 0 if all is delivered, 3 if tasks are left
    that cannot be reached."""

    def make() -> DeliveryCommand:
        warehouse = load_warehouse(scenario).changed(robots, seed, keys, time_limit_s=limit_s)
        run = DeliveryRun(DeliverySetup(warehouse))
        return LiveDeliveryCommand(run, scenario, port, seconds) if live else DeliveryCommand(run)

    return run_mission(make, to, as_json, film=film)


def exit_code(outcome: DeliveryOutcome) -> int:
    """3: nothing is wrong but that what is left cannot be got to."""
    if outcome.success:
        return 0
    left = outcome.tasks - outcome.delivered
    walled_in = left and left == len(outcome.unreachable) and not outcome.flawed
    return UNREACHABLE if walled_in else UNFINISHED


class DeliveryCommand(MissionCommand[DeliveryRun]):
    """A delivery in virtual time, with a picture of the warehouse."""

    unit = "parcels"

    def exit_code(self, outcome: DeliveryOutcome) -> int:
        """0, 1, or 3 for tasks that cannot be reached."""
        return exit_code(outcome)

    def draw(self, outcome: DeliveryOutcome, folder: Path, log_hash: str) -> list[str]:
        draw_warehouse(self.run.setting, self.run, outcome, folder / "warehouse.png")
        return ["warehouse.png"]

    def facts(self, outcome: DeliveryOutcome) -> list[Fact]:
        beyond = outcome.beyond_battery
        flaws = ", ".join(f"{n} {what}" for what, n in outcome.flaws.items())
        empty = "never" if not outcome.empty else f"[red]robots {outcome.empty}[/red]"
        return [
            (
                "delivered",
                f"{outcome.delivered} of {outcome.tasks} parcels in {outcome.makespan_s:.1f} s",
            ),
            ("unreachable", ", ".join(f"task {n}" for n in outcome.unreachable) or "none"),
            *(
                [("a full battery does not last for", ", ".join(f"task {n}" for n in beyond))]
                if beyond
                else []
            ),
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


class LiveDeliveryCommand(DeliveryCommand):
    """In real time, on a bus that tools can attach to, until a person ends it."""

    def __init__(self, run: DeliveryRun, scenario: str, port: int, seconds: float | None) -> None:
        """`scenario`: its name or file, for tools on the bus."""
        super().__init__(run)
        self.scenario = scenario
        self.run.forever = True
        self.port, self.seconds, self.interrupted = port, seconds, False

    def exit_code(self, outcome: DeliveryOutcome) -> int:
        """130 if a person ended the run, else as in virtual time."""
        return INTERRUPTED if self.interrupted else super().exit_code(outcome)

    def play(self, console: Console, folder: Path, recorder: RunRecorder) -> DeliveryOutcome:
        try:
            with asyncio.Runner(loop_factory=WallLoop) as runner:
                return runner.run(self._live(console, folder, recorder))
        except OSError as problem:
            raise RunError(f"--port {self.port}: {problem}; choose another or 0") from None

    def _end(self, by_person: bool = True) -> None:
        self.interrupted, self.run.ended = by_person, True

    async def _live(self, console: Console, folder: Path, recorder: RunRecorder) -> DeliveryOutcome:
        loop = asyncio.get_running_loop()
        hubs: list[Hub] = []
        opening: list[asyncio.Task[None]] = []
        on_end(loop, self._end)
        if self.seconds is not None:
            loop.call_later(self.seconds, self._end, False)

        def attach(cluster: DeliveryFleet) -> None:
            recorder(cluster)
            hubs.append(Hub(cluster.segment, CHANNEL))
            opening.append(loop.create_task(self._open(hubs[0], console, folder)))
            opening[0].add_done_callback(lambda t: self._end(False) if t.exception() else None)

        self.run.attach = attach
        try:
            outcome = await self.run.live()
            problem = opening[0].exception() if opening and opening[0].done() else None
            if problem is not None:
                raise problem
            return outcome
        finally:
            for hub in hubs:
                await hub.stop()
            (folder / BUS).unlink(missing_ok=True)

    async def _open(self, hub: Hub, console: Console, out: Path) -> None:
        await hub.start(HOST, self.port)
        where = {
            "host": HOST, "port": hub.port, "channel": CHANNEL, **identity(),
            "scenario": absolute(self.scenario),
        }  # fmt: skip
        write_whole(out / BUS, dumps(where))
        RUNS.mkdir(parents=True, exist_ok=True)
        link(RUNS / LAUNCH, out)
        console.print(f"bus: socketcand {HOST}:{hub.port} channel {CHANNEL}")


@plain_text()
def draw_warehouse(
    setting: DeliverySetup, run: DeliveryRun, outcome: DeliveryOutcome, out: Path
) -> None:
    """One PNG: walls, bays, and where each robot drove."""
    from matplotlib.figure import Figure

    floor = setting.floor
    rows, columns = floor.walls.shape
    west, south = floor.origin
    box = (west, west + columns * floor.cell_m, south, south + rows * floor.cell_m)
    figure = Figure(figsize=(11, 7), dpi=110)
    axes = figure.subplots()
    axes.imshow(floor.walls, origin="lower", extent=box, cmap="Greys", alpha=0.5)
    for slot, track in sorted(run.tracks.items()):
        axes.plot([p[1] for p in track], [p[2] for p in track], color=colour_of(slot),
                  linewidth=0.7, alpha=0.7, label=f"robot {slot}")  # fmt: skip
    for number, (x_m, y_m) in enumerate(setting.house.bays):
        axes.annotate(f"C{number}", (x_m, y_m), ha="center", va="center", fontsize=7)
    axes.set_title(
        f"{outcome.scenario}: {counted(outcome.delivered, '{} parcel{s}')}, {outcome.makespan_s:.0f} s"
    )
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_aspect("equal")
    if len(run.tracks) <= 10:
        axes.legend(loc="upper right", fontsize=7)
    figure.tight_layout()
    with whole_file(out) as part:
        figure.savefig(part)
