"""`headland launch`: N robot processes on one simulated bus and world, in real time.

This process owns the world and, unless a separate hub is given, the wire. It starts the
robots and decides nothing for them. Killing any robot must not stop the work. Ctrl-C ends all of them;
robots end by themselves when this process dies, because the pipe on their stdin does.
"""

import asyncio
import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from agent.interface.lifecycle import State
from agent.runtime.end_signals import on_end
from agent.runtime.gc_tuning import freeze_gc
from agent.safety.stop_cause import Severity, cause_of
from protocol.frames.frame import Frame
from sim.files.candump import CandumpWriter
from sim.files.log_parts import LAUNCH_LIMIT, PartedLog
from sim.files.recording_end import Ending
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.fleet.outcome import COVERAGE_MIN
from sim.record.remote_body import BodyServer
from sim.record.scene_builder import scene_of
from sim.scenarios.field_setup import FieldSetup
from sim.world.coverage_truth import coverage, sample_points
from sim.world.implement_contacts import implement_contacts
from sim.world.missed_ground import told_missed
from sim.world.parcel_truth import Parcels
from sim.world.world_memory import WorldMemory
from tools.common.bus_address import CHANNEL, LAUNCH, absolute
from tools.common.child_process import module_command, politely
from tools.common.counted import counted
from tools.common.exit_codes import INTERRUPTED
from tools.common.launch_keys import KEYS
from tools.common.process_identity import identity
from tools.inspect.inspector import NO_KEYS, Inspector
from tools.inspect.measured_inspector import MeasuredInspector
from tools.inspect.metrics_address import MetricsAddress
from tools.run.fleet_folder import TRUTH, FleetFolder, begin_fleet, end_fleet
from tools.run.launch_bus import LaunchBus, OutsideHub, OwnHub, viewer_command
from tools.run.launch_setup import AnySetting, places_of, robot_document
from tools.run.launch_status import LaunchStatus
from tools.run.run_recorder import RunRecorder

if TYPE_CHECKING:
    from tools.inspect.prometheus_metrics import MetricsServer
    from tools.run.launch_viewers import LaunchViewers

HOST = "127.0.0.1"
LOOK_S = 0.5
# Largest error of a thinned true track, that of RTK GNSS: one point in 2 s of driving.
STRAIGHT_M = 0.02
QUIET_LOOKS = 6  # checks in a row at which all is done before the launch ends
MAP_NICE = 5  # niceness of the map's process; robots go first
GRACE_S = 3.0  # between asking a robot to leave and killing it
UNFINISHED = 1


class BusError(Exception):
    """One line: why there is no bus to launch on."""


class Launch:
    """Starts the processes of a fleet, moves its world in real time, and ends everything in order."""

    log_limit = LAUNCH_LIMIT  # of can.log, and of run.mcap
    endless = False  # whether it goes on when all is done, because more may come

    def __init__(
        self, setting: AnySetting, name: str, fleet: FleetFolder, console: Console, keys: Path | None,
        page_port: int | None = None,
    ) -> None:  # fmt: skip
        # File of the map; its page may release and start with it.
        self.operator_key: str | None = None
        self.fleet, out = fleet, fleet.folder
        self.page_port, self.log_hash, self.logs = page_port, "", ""
        self.segment = 0  # number of the segment; 0: the fleet has no others
        self.hub_port = 0  # port of a hub that runs by itself; 0: ours
        self.metrics_address: MetricsAddress | None = None  # of figures for Prometheus
        self.foxglove_port: int | None = None  # where viewers look
        self.viewers: LaunchViewers | None = None
        self.map: asyncio.subprocess.Process | None = None
        self.map_out: int | None = 2 if console.stderr else None  # where it prints its address
        self.keys = None if keys is None else str(keys.absolute())  # of its stop panel, the map
        self.own_keys: str | None = None  # folder of the keys that it made; tools here take them
        self.setting, self.name, self.out, self.console = setting, name, out, console
        self.inspector = Inspector(self._sections())
        self.processes: dict[int, asyncio.subprocess.Process] = {}
        self.world = setting.world()
        self.gone: set[int] = set()
        self.latched: list[int] = []  # robots that a person has to look at before they move
        self.unkept = False  # the truth of the world could not be written
        self.memory: WorldMemory
        # Of the world's clock on that of the loop, which counts from when the machine was switched on.
        self.zero_at_us = 0
        self.world_began_us = 0  # time at which the world continues after an earlier launch
        self.difference = ""  # how reports of robots differ from the truth; empty: they do not

    async def run(self, port: int, seconds: float | None) -> int:
        """Run until the work is done, `seconds` are over, or a person ends it. Returns the exit
        code. Raises BusError if the port is taken."""
        loop = asyncio.get_running_loop()
        end = asyncio.Event()
        on_end(loop, end.set)
        memory = WorldMemory(self.out / TRUTH, self.world, self._parcels())
        self.world_began_us, self.memory = memory.now_us, memory
        for body in self.world.robots.values():
            body.track.straight_m = STRAIGHT_M
        bus = self._bus(port)
        metrics = self._serve_metrics(loop)
        # Logs of a launch carry the time of day, so that other logs can be laid beside them.
        epoch_us = round((time.time() - loop.time()) * 1e6)
        begin_at_us, told = epoch_us + round(loop.time() * 1e6), self.console.print
        log = PartedLog(
            self.out / "can.log",
            lambda path, _: CandumpWriter(path),
            begin_at_us,
            self.log_limit,
            told,
        )
        keeping = RunRecorder(
            self.setting, self.out, begin_at_us=begin_at_us, told=told, limit=self.log_limit
        )
        text = Ending("can.log", told)

        def keep(t_us: int, frame: Frame) -> None:
            keeping.write(epoch_us + t_us, frame)
            text(log.write, epoch_us + t_us, frame)

        try:
            await bus.start([keep, self._heard])
        except OSError as problem:
            raise BusError(problem.strerror or str(problem)) from None
        self.zero_at_us = round(loop.time() * 1e6) - memory.now_us
        bodies = BodyServer(self.world, self.zero_at_us)
        path = await bodies.start()
        where = {
            "host": HOST, "port": bus.port, "channel": CHANNEL, **identity(),
            "bodies": str(path), "folder": str(self.out.absolute()),
            "robots": sorted(self.world.robots), KEYS: self.own_keys,
            "scenario": absolute(self.name),
        }  # fmt: skip
        going_on = self._furnish(bodies, bus)

        def intend(intent: dict[str, Any]) -> None:
            keeping.tell(epoch_us + round(loop.time() * 1e6), intent)
            if self.viewers is not None:
                self.viewers.feed.intend(loop.time(), intent)

        bodies.relay.keep = intend
        write_whole(self.out / "bus.json", dumps(where))
        write_whole(self.out / "places.toml", places_of(self.setting))
        self.console.print(
            f"bus: socketcand {HOST}:{bus.port} channel {CHANNEL}   "
            f"({viewer_command(HOST, bus.port)})"
        )
        self._tell_keys()
        self._serve_viewers(bus.port)
        stepping = asyncio.create_task(bodies.run())
        try:
            if self.page_port is not None:
                await self._start_map()
            begin_fleet(self.fleet, self.setting)
            await self._start_all(bus.port, path)
            freeze_gc()
            finished = await self._watch(end, seconds)
            self.latched = self._latched()
        finally:
            await self._end_all()
            for task in (stepping, *going_on):
                task.cancel()
            if self.viewers is not None:
                self.viewers.close()
            await bus.stop()
            if metrics is not None:
                metrics.close()
            bodies.close()
            self._keep_truth()
            Ending(TRUTH, self._untold).close(memory.close)
            text.close(log.close)
            keeping.close()
            self.log_hash, self.logs = keeping.log_hash, keeping.logs
            (self.out / "bus.json").unlink(missing_ok=True)
        self._report(bodies.now_us() / 1e6, finished)
        if finished and not self.latched and not self.difference:
            end_fleet(self.fleet, self.setting)
        if end.is_set():
            return INTERRUPTED
        return 0 if finished and not self.flawed and not self.difference else UNFINISHED

    def _tell_keys(self) -> None:
        if self.setting.keys is None:
            self.console.print(f"[bold red]{NO_KEYS}[/bold red]")
        elif self.own_keys is not None:
            told = "your tools on this bus take them"
            if self.out.resolve() != LAUNCH.parent.resolve():
                told = f"tools take them with --keys, because the launch is not in {LAUNCH.parent}"
            self.console.print(f"keys: in {escape(str(self.own_keys))}; {told}")

    # ---------------------------------------------------------------- what another mission has otherwise

    @property
    def flawed(self) -> bool:
        """Whether a body touched something."""
        return bool(self.world.contacts)

    def _furnish(self, bodies: BodyServer, bus: LaunchBus) -> list["asyncio.Task[None]"]:
        """What else is in the world; tasks that go on until the end."""
        return []

    def _progress(self) -> tuple[int, int, str]:
        """How much is done, of how much, of what."""
        return self.inspector.allocation.done_count(), self.setting.reachable_count, "sections"

    def _sections(self) -> frozenset[int]:
        """Of the field; work in others is none. Empty: any may be there."""
        assert isinstance(self.setting, FieldSetup)
        return frozenset(section.id for section in self.setting.field.sections)

    def _parcels(self) -> Parcels | None:
        """What is true of the parcels of this world, where it has any."""
        return None

    def _bus(self, port: int) -> LaunchBus:
        if self.hub_port:
            return OutsideHub(HOST, self.hub_port)
        scenario = self.setting.scenario
        return OwnHub(HOST, port, scenario.bus.bitrate, scenario.run.seed)

    def _heard(self, t_us: int, frame: Frame) -> None:
        self.inspector.hear(t_us / 1e6, frame)
        if self.viewers is not None:
            self.viewers.feed.hear(t_us / 1e6, frame)

    async def _start_all(self, bus_port: int, bodies: Path) -> None:
        bus = {
            "interface": "socketcand", "channel": CHANNEL,
            "options": {"host": HOST, "port": bus_port},
        }  # fmt: skip
        for slot in range(self.setting.scenario.fleet.robots):
            robot = robot_document(self.setting, slot, bus, bodies, self.out, self.segment)
            order = {"robot": robot, "first_boot": not self.fleet.continues}
            with (self.out / f"robot{slot}.log").open("wb") as errors:
                process = await asyncio.create_subprocess_exec(
                    *module_command("tools.run.robot"),
                    stdin=asyncio.subprocess.PIPE, stdout=errors, stderr=errors,
                    start_new_session=True,  # the terminal's Ctrl-C is ours to pass on
                )  # fmt: skip
            assert process.stdin is not None
            process.stdin.write(dumps(order).encode() + b"\n")
            self.processes[slot] = process
            self.console.print(f"robot {slot}: process {process.pid}")

    def _serve_metrics(self, loop: asyncio.AbstractEventLoop) -> "MetricsServer | None":
        """Before the bus: the inspector then also counts. Raises OSError if the port is taken."""
        if self.metrics_address is None:
            return None
        from tools.inspect.prometheus_metrics import FleetCollector, MetricsServer, RobotProcesses

        server = MetricsServer(self.metrics_address)
        measured = MeasuredInspector(self._sections(), self.setting.scenario.bus.bitrate)
        self.inspector = measured
        FleetCollector(measured, loop.time, server.registry)
        RobotProcesses(lambda: list(self.processes), self._pids, server.registry)
        self.console.print(f"metrics: {server.start()}")
        return server

    def _serve_viewers(self, bus_port: int) -> None:
        if self.foxglove_port is None:
            return
        from tools.run.launch_viewers import LaunchViewers

        key = None if self.operator_key is None else Path(self.operator_key)
        self.viewers = viewers = LaunchViewers(
            scene_of(self.setting), self.foxglove_port, (HOST, bus_port),
            None if self.keys is None else Path(self.keys), key,
        )  # fmt: skip
        self.console.print(f"foxglove: {viewers.feed.url}   key of its services: {viewers.key}")

    def _pids(self) -> dict[int, int]:
        """Of the robots whose process runs."""
        running = self.processes.items()
        return {slot: process.pid for slot, process in running if process.returncode is None}

    async def _start_map(self) -> None:
        """A process of its own, and a polite one: the bus and the robots go first.

        It ends with this one. A map that went on after a kill would keep the port of its page."""
        words = ["map", str(self.out), "--page-port", str(self.page_port), "--ends-with-input"]
        words += [] if self.keys is None else ["--keys", self.keys]
        words += [] if self.operator_key is None else ["--operator-key", self.operator_key]
        self.map = await asyncio.create_subprocess_exec(
            *module_command("tools.cli.headland"), *words, start_new_session=True,
            stdin=asyncio.subprocess.PIPE, stdout=self.map_out, preexec_fn=politely(MAP_NICE),
        )  # fmt: skip

    async def _watch(self, end: asyncio.Event, seconds: float | None) -> bool:
        loop = asyncio.get_running_loop()
        begun_s, quiet = loop.time(), 0
        with LaunchStatus(self.console, self.inspector, self.setting.keys is not None) as status:
            while not end.is_set() and (self.endless or quiet < QUIET_LOOKS):
                if seconds is not None and loop.time() - begun_s >= seconds:
                    break
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_S):
                        await end.wait()
                self._notice_deaths()
                self._keep_truth()
                if len(self.gone) == len(self.processes):
                    self.console.print("every robot process has ended")
                    break
                done, all_of_it, what = self._progress()
                quiet = quiet + 1 if done == all_of_it else 0
                status.tell(loop.time() - begun_s, done, all_of_it, what)
        return quiet >= QUIET_LOOKS

    def _keep_truth(self) -> None:
        """A full disk ends no launch; the next one begins where the last look is."""
        try:
            self.memory.look()
        except OSError as problem:
            if not self.unkept:
                self.console.print(f"the world is not kept for the next launch: {problem.strerror}")
            self.unkept = True

    def _untold(self, message: str) -> None:
        """What is said otherwise."""

    def _notice_deaths(self) -> None:
        for slot, process in self.processes.items():
            if process.returncode is not None and slot not in self.gone:
                self.gone.add(slot)
                code = process.returncode
                how = f"signal {-code}" if code < 0 else f"exit code {code}; see robot{slot}.log"
                self.console.print(f"robot {slot} has ended ({how}); the others go on")
        if self.map is not None and self.map.returncode is not None:
            self.console.print(
                f"[red]the map has ended (exit code {self.map.returncode}): its page is dead and "
                f"its STOP stops no robot[/red]; again: headland map {escape(str(self.out))}"
            )
            self.map = None

    async def _end_all(self) -> None:
        everybody = [*self.processes.values(), *([self.map] if self.map is not None else [])]
        running = [p for p in everybody if p.returncode is None]
        for process in running:
            with contextlib.suppress(ProcessLookupError):
                if process.stdin is not None:
                    process.stdin.close()  # a robot leaves the fleet, and ends; see `on_closed_input`
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(GRACE_S):
                await asyncio.gather(*(p.wait() for p in running))
        for process in running:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()

    def _latched(self) -> list[int]:
        """Robots that are latched, or whose process has ended, so that this is unknown."""
        known, stopped = self.inspector.robots, State.EMERGENCY_STOP.name
        return [
            slot for slot in self.processes
            if slot in self.gone or slot not in known or known[slot].state == stopped
        ]  # fmt: skip

    def _held(self) -> dict[int, list[str]]:
        """Of each robot whose process runs the causes for which it may not move, by name, as it last
        told them, worst first."""
        now_us, told = round(self.inspector.now_s * 1e6), dict[int, list[str]]()
        for slot in self.processes.keys() - self.gone:
            seen = self.inspector.robots.get(slot)
            told[slot] = []
            for frame in () if seen is None else seen.causes.fresh(now_us):
                cause = cause_of(frame.cause)
                if cause is not None and cause.severity is not Severity.SLOW:
                    told[slot].append(cause.name)
        return told

    def _report(self, elapsed_s: float, finished: bool) -> None:
        assert isinstance(self.setting, FieldSetup)
        field = self.setting.field
        raster = sample_points(field.polygon, field.implement_width_m, field.overlap_m)
        tracks = {slot: body.track for slot, body in self.world.robots.items()}
        ground = self.setting.ground(raster)
        truth = coverage(raster, tracks, field.implement_width_m, ground.cells)
        if finished and truth.reached < COVERAGE_MIN:
            self.difference = f"robots say 100 %, the ground says {truth.reached:.2%}"
        radius_m = self.setting.scenario.fleet.radius_m
        met = implement_contacts(tracks, field.implement_width_m, field.overlap_m, radius_m)
        of_it = {
            "coverage": truth.share, "reachable": ground.share, "reached": truth.reached,
            "unreached": [part._asdict() for part in ground.unreached],
            "missed": told_missed(truth.missed, raster.cell_m, field.implement_width_m,
                                  {slot: track.points for slot, track in tracks.items()},
                                  self._held()),
            "implement_contacts": len(met),
        }  # fmt: skip
        touches = f"{counted(len(self.world.contacts), '{} contact{s}')}, {len(met)} of implements"
        verdict = f"coverage {truth.share:.2%}, {touches}"
        self._write(elapsed_s, finished, of_it, verdict)

    def _write(self, elapsed_s: float, finished: bool, of_it: dict[str, Any], verdict: str) -> None:
        touched = [
            {"t_s": c.t_us / 1e6, "robot": c.first, "against": c.against, "depth_m": c.depth_m}
            for c in self.world.contacts
        ]
        report: dict[str, Any] = {
            "finished": finished, "seconds": round(elapsed_s, 1), **of_it,
            "contacts": len(self.world.contacts),
            "pymunk_steps": self.world.pymunk_steps,
            "robots_ended": sorted(self.gone), "touched": touched,
            "silence_policy": self.setting.scenario.fleet.silence,
            "authenticated": self.setting.keys is not None, "difference": self.difference,
            "launches": self.fleet.launches, "latched": self.latched,
            "log_hash": self.log_hash, **self.inspector.to_dict(self.zero_at_us / 1e6),
        }  # fmt: skip
        written = Ending("report.json", self._untold)
        written(write_whole, self.out / "report.json", dumps(report, indent=1) + "\n")
        if written.why:
            self.console.print(f"report.json is not written: {written.why}")
        how = "finished" if finished else "not finished"
        where = escape(str(self.out))
        took = f"{elapsed_s:.0f} s"
        if self.world_began_us:
            took += f", {elapsed_s - self.world_began_us / 1e6:.0f} s of them in this launch"
        self.console.print(
            f"{how} after {took}: {verdict}; report.json, {self.logs} are in {where}"
        )
        if self.difference:
            self.console.print(f"[red]{self.difference}[/red]")
        if self.setting.keys is None:
            self._tell_keys()
        self.report = report
