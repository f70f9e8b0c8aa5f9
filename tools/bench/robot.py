"""Robots as processes on simulated machines: what a lost place does, judged by the machines' integrators.

Each robot is `headland robot` with the body `nmea`, over TCP to its machine and over UDP multicast to
the others. A machine is muted, frozen, late or wrong by some metres while it drives. Its integrator says
when its controller was last told to move, how far it went, and when it goes on.

A whole run also tries the driver of the tutorial, and simulates a day (`tools/bench/long_day.py`). The
robot-hours with sensor faults are those of campaigns (`docs/measured/robot.md`), and half an hour of ten
robots in real time is `headland bench leaks`.
"""

import asyncio
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import combinations
from math import cos, dist, pi, sin
from pathlib import Path
from random import Random
from secrets import randbelow
from typing import Final, NamedTuple

from shapely.geometry import Point, Polygon

from agent.interface.motion_controller import BodyLimits
from agent.interface.vehicle import Vehicle
from agent.peer.sense_freshness import blind_way_m, frozen_way_m
from agent.runtime.files.field_file import read_boundary
from agent.runtime.ready_kernels import are_ready
from sim.files.strict_json import dumps
from sim.machines.nmea_machine import LATENCY_S, Dimensions, NmeaMachine, WheeledBody
from tools.bench import long_day
from tools.bench.figure import Figure, percentile
from tools.common.child_process import ROOT, module_command
from tools.run.body_check import CHECKS

ROBOTS: Final = 6
TRIALS, QUICK_TRIALS = 500, 1  # of each fault, in all robots together
FAULTS: Final = ("muted", "frozen", "jumped", "late")
RADIUS_M, SPEED_M_S = 0.8, 1.5
ACCELERATION_M_S2: Final = Vehicle().acceleration_m_s2  # declared; the machines brake harder
MARGIN_M: Final = (
    0.3  # of the clearance to a fence: what a robot drives before it knows, and its accuracy
)
STOPS_S: Final = 0.3  # from the fault to the last command to move
# What is limited is the way without a believed place, from the fault until the machine stands, by its
# greatest speed (`agent.peer.sense_freshness`). The time of a frozen place is limited from this speed on:
# it takes 0.42 s at most (`frozen_for_s`), and the system and this process may take 0.03 s.
FROZEN_STOPS_S: Final = 0.45
WORKS_M_S: Final = 0.4
DRIVES_M_S: Final = 0.3  # a trial begins at this speed
POLL_S: Final = 0.005
BETWEEN_S: Final = 0.3, 1.5  # of driving, before the next fault
WENT_ON_M: Final = 0.1
WITNESS: Final = ROBOTS - 1  # this robot has no trials: the fleet goes on without the others
UP_S: Final = 60.0
# Turns and waits for others included; a robot that does not go on for this long did not come back.
BACK_S: Final = 30.0
START_TARGET_S, MEMORY_TARGET_MB = 1.5, 120.0
NO_FAULT: Final = "no fault"  # of a machine that did not drive, so that there was no trial
# 41 m by 33 m, as that of the tutorial.
MEADOW: Final = ((5.0, 52.0), (5.0006, 52.0), (5.0006, 52.0003), (5.0, 52.0003), (5.0, 52.0))
STARTS: Final = 5
DRIVES_FOR_S: Final = 10.0  # before its memory is looked at
DRIVER_LINES: Final = 60
EXAMPLE: Final = ROOT / "examples" / "robot" / "rover.py"
SPY: Final = """
import atexit, json, sys
def tell():
    loaded = {each.removeprefix("headland.") for each in sys.modules}
    foreign = sorted(each for each in loaded if each.split(".")[0] in ("sim", "pymunk"))
    print(json.dumps(foreign, allow_nan=False), file=sys.stderr)
atexit.register(tell)
"""
# A robot that tells what it decides: why it stands is read from there.
TELLS: Final = "import logging; logging.basicConfig(level=logging.INFO, format='%(message)s'); "
# 25 ha: six robots need two hours, longer than all trials. A robot without work does not go on.
CORNERS: Final = ((5.0, 52.0), (5.009, 52.0), (5.009, 52.0036), (5.0, 52.0036), (5.0, 52.0))
FLEET: Final = """
name = "bench"
[fleet]
robots = {robots}
drive = "differential"
radius_m = {radius}
speed_m_s = {speed}
[field]
file = "field.geojson"
implement_width_m = {width}
[bus]
interface = "udp_multicast"
channel = "{group}"
[body]
plugin = "nmea"
"""
LONE: Final = """
name = "lone"
[robot]
slot = 0
[fleet]
robots = 1
[field]
file = "field.geojson"
[bus]
interface = "virtual"
"""
MACHINE: Final = """
[[machine]]
slot = {slot}
body_options = {{ gnss = "tcp://127.0.0.1:{gnss}", wheels = "tcp://127.0.0.1:{wheels}" }}
"""


def cpu_s(process: int) -> float:
    """What a process has used of the CPU so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


class LostPlaceTrial(NamedTuple):
    """One fault of one machine."""

    fault: str
    stopped_after_s: float  # until the last command to move
    driven_m: float  # until it stands, or until the fault is over
    fastest_m_s: float  # meanwhile
    slowest_m_s: float  # until the last command to move
    outside_m: float  # of the body, beyond the field
    returned: bool  # it went on by itself
    witness_went_on: bool  # the robot that has no trials
    order: str = ""  # that its machine was given
    why: str = ""  # it did not go on, by its own words


def why_it_stands(log: Path, since: int) -> str:
    """The causes that still hold a robot by the last lines of its log, and how often it braked for
    members that it did not hear; from this byte of its log on."""
    held: dict[str, str] = {}
    silences = 0
    for line in log.read_text().encode()[since:].decode().splitlines():
        _, safety, told = line.partition(": safety ")
        if not safety:
            continue
        raised, gone = re.match(r" ([A-Z_]+) PROTECTIVE (.*)", told), told.split()[1:]
        if raised and raised[1] == "SILENCE":
            silences += 1
        elif raised:
            held[raised[1]] = raised[2]
        elif gone[-1:] == ["gone"]:
            held.pop(gone[0], None)
    causes = [f"{cause} ({why})" for cause, why in held.items()]
    return ", ".join(causes or ["no cause"]) + f", {silences} silences"


class Yard:
    """Machines, their robots, and the trials so far."""

    def __init__(
        self, folder: Path, seed: int, robots: int = ROBOTS,
        corners: Sequence[tuple[float, float]] = CORNERS, declared: int = 0,
        implement_width_m: float = 3.0,
    ) -> None:  # fmt: skip
        """`corners`: longitude and latitude, the first one again at the end. `declared`: robots of the
        fleet, if more than run."""
        self.folder, self.rng, self.count, self.corners = folder, Random(seed), robots, corners
        self.declared, self.implement_width_m = declared or robots, implement_width_m
        self.machines: list[NmeaMachine] = []
        self.robots: list[asyncio.subprocess.Process] = []
        self.trials: list[LostPlaceTrial] = []
        self.started_s: list[float] = []
        self.started_cpu_s: list[float] = []
        self.nearest_m = float("inf")  # between two middles
        self.field = Polygon()

    async def begin(self) -> None:
        """Machines on the field, and a robot on each."""
        (self.folder / "field.geojson").write_text(
            dumps({"type": "Polygon", "coordinates": [self.corners]})
        )
        boundary = read_boundary(self.folder / "field.geojson", None)
        self.field = boundary.polygon
        west_m, south_m, *_ = self.field.bounds
        x_m, y_m = west_m + 6.0, south_m + 10.0
        if self.count == 1:
            inside = self.field.representative_point()
            x_m, y_m = inside.x, inside.y
        # Another run of this bench is another fleet.
        group = f"239.74.{randbelow(256)}.{1 + randbelow(254)}"
        text = FLEET.format(robots=self.declared, radius=RADIUS_M, speed=SPEED_M_S, group=group,
                            width=self.implement_width_m)  # fmt: skip
        for slot in range(self.count):
            body = WheeledBody(Dimensions(), x_m, y_m + 6.0 * slot, 0.0)
            machine = NmeaMachine(body, boundary.origin, slot)
            gnss, wheels, _ = await machine.start("127.0.0.1", 0, 0, 0)
            text += MACHINE.format(slot=slot, gnss=gnss, wheels=wheels)
            self.machines.append(machine)
        (self.folder / "fleet.toml").write_text(text)
        for slot in range(self.count):
            await self.start(slot)

    async def start(self, slot: int) -> None:
        """A robot, until it takes part."""
        start_at_s = time.monotonic()
        *words, program = module_command("tools.cli.entrance")
        with self.log(slot).open("wb") as told:
            robot = await asyncio.create_subprocess_exec(
                *words, TELLS + program, "robot", "fleet.toml", "--slot", str(slot), "--first-boot",
                cwd=self.folder, stdout=asyncio.subprocess.PIPE, stderr=told,
            )  # fmt: skip
        self.robots.append(robot)
        assert robot.stdout is not None
        async with asyncio.timeout(UP_S):
            await robot.stdout.readline()
        self.started_s.append(time.monotonic() - start_at_s)
        self.started_cpu_s.append(cpu_s(robot.pid))

    def log(self, slot: int) -> Path:
        """The file of what a robot tells."""
        return self.folder / f"robot{slot}.log"

    def memory_mb(self) -> list[float]:
        """Of each robot's process: what no other process shares, and files that it has mapped."""
        sizes = []
        for robot in self.robots:
            if robot.returncode is not None:
                continue
            status = Path(f"/proc/{robot.pid}/status").read_text()
            rss_kb = next(line for line in status.splitlines() if line.startswith("VmRSS"))
            sizes.append(int(rss_kb.split()[1]) / 1000)
        return sizes

    async def end(self) -> None:
        """Robots leave, machines close."""
        for robot in self.robots:
            if robot.returncode is None:
                robot.terminate()
        await asyncio.gather(*(robot.wait() for robot in self.robots))
        await asyncio.gather(*(machine.stop() for machine in self.machines))

    def outside_m(self, machine: NmeaMachine) -> float:
        """How far the body of a machine is beyond the field."""
        truth = machine.truth()
        here = Point(truth.x_m, truth.y_m)
        inside_m: float = self.field.exterior.distance(here) * (
            1 if self.field.contains(here) else -1
        )
        return max(RADIUS_M - inside_m, 0.0)

    def look(self) -> None:
        """Note how near two machines are."""
        places = [machine.truth()[:2] for machine in self.machines]
        self.nearest_m = min(self.nearest_m, *(dist(a, b) for a, b in combinations(places, 2)))

    async def until_drives(self, slot: int, for_s: float) -> bool:
        """Whether a machine reaches the speed of a trial in time."""
        machine = self.machines[slot]
        ends_at_s = time.monotonic() + for_s
        while abs(machine.truth().ahead_m_s) < DRIVES_M_S:
            if time.monotonic() > ends_at_s:
                return False
            await asyncio.sleep(POLL_S)
        return True

    async def serve(self, slot: int, faults: list[str]) -> None:
        """Take faults from the list until it is empty."""
        machine = self.machines[slot]
        await self.until_drives(slot, UP_S)
        while faults:
            fault = faults.pop()
            await asyncio.sleep(self.rng.uniform(*BETWEEN_S))
            if not await self.until_drives(slot, UP_S):
                self.trials.append(
                    LostPlaceTrial(
                        fault, 0.0, 0.0, 0.0, 0.0, self.outside_m(machine), False, True, NO_FAULT,
                        why_it_stands(self.log(slot), 0),
                    )
                )  # fmt: skip
                continue
            await self._trial(slot, machine, fault)

    async def _trial(self, slot: int, machine: NmeaMachine, fault: str) -> None:
        for_s, angle_rad = self.rng.uniform(0.8, 3.0), self.rng.uniform(-pi, pi)
        far_m, late_for_s = self.rng.uniform(0.5, 5.0), self.rng.uniform(0.3, 1.5)
        values = {
            "jumped": [far_m * cos(angle_rad), far_m * sin(angle_rad)], "late": [late_for_s],
        }.get(fault, [])  # fmt: skip
        before_m = self.machines[WITNESS].truth().driven_m
        said_before = self.log(slot).stat().st_size
        start_at_s = time.monotonic()
        order = [fault, *map(str, values), str(for_s)]
        assert machine.order(order) == b"ok"
        told_at_s, outside_m = start_at_s, 0.0
        truth = before = machine.truth()
        fastest_m_s = slowest_m_s = abs(truth.ahead_m_s)
        while (now_s := time.monotonic()) < start_at_s + for_s:
            truth = machine.truth()
            fastest_m_s = max(fastest_m_s, abs(truth.ahead_m_s))
            if truth.is_told_to_move:
                told_at_s, slowest_m_s = now_s, min(slowest_m_s, abs(truth.ahead_m_s))
            outside_m = max(outside_m, self.outside_m(machine))
            await asyncio.sleep(POLL_S)
        returned = await self.until_drives(slot, BACK_S)
        went_on = await self._until_witness(before_m + WENT_ON_M)
        self.trials.append(
            LostPlaceTrial(
                fault,
                told_at_s - start_at_s,
                truth.driven_m - before.driven_m,
                fastest_m_s,
                slowest_m_s,
                outside_m,
                returned,
                went_on,
                " ".join([fault, *(f"{each:.2f}" for each in (*values, for_s))]),
                "" if returned else why_it_stands(self.log(slot), said_before),
            )
        )

    async def _until_witness(self, driven_m: float) -> bool:
        """Whether the robot without trials has driven so far by `BACK_S` from now."""
        ends_at_s = time.monotonic() + BACK_S
        while self.machines[WITNESS].truth().driven_m < driven_m:
            if time.monotonic() > ends_at_s:
                return False
            await asyncio.sleep(POLL_S)
        return True


async def _measure(
    folder: Path, trials: int, seed: int, deadline_s: float
) -> tuple[Yard, list[float]]:
    yard = Yard(folder, seed)
    faults = [fault for fault in FAULTS for _ in range(trials)]
    yard.rng.shuffle(faults)
    try:
        await yard.begin()

        async def looks() -> None:
            while True:
                yard.look()
                await asyncio.sleep(10 * POLL_S)

        looking = asyncio.create_task(looks())
        with suppress(TimeoutError):  # the trials so far
            async with asyncio.timeout(deadline_s):
                await asyncio.gather(*(yard.serve(slot, faults) for slot in range(WITNESS)))
        looking.cancel()
        return yard, yard.memory_mb()
    finally:
        await yard.end()


def figures(quick: bool, seed: int = 1, seconds: float | None = None) -> Iterator[Figure]:
    """`seconds`: nothing but trials, for this long; none: all of them, and the other figures."""
    trials = QUICK_TRIALS if quick else TRIALS
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        yard, memory_mb = asyncio.run(
            _measure(place, trials, seed, seconds or (35.0 if quick else 7200.0))
        )
    scope = (
        f"{ROBOTS} robots, differential, {SPEED_M_S} m/s, TCP and UDP multicast, seed {seed}, "
        f"polled every {POLL_S * 1000:.0f} ms; load {os.getloadavg()[0]:.1f}; "
        f"{'kernels ready' if are_ready() else 'kernels by numba: headland compile --kernels'}; "
        f"Python {sys.version_info[0]}.{sys.version_info[1]}"
    )
    yield from trial_figures(yard.trials, scope)
    stood = [each.why for each in yard.trials if each.order == NO_FAULT]
    yield Figure("times that a robot did not drive for a minute, without a fault", len(stood), "", "0",
                 not stood, "", f"{stood or ''}; {scope}")  # fmt: skip
    clear_m = yard.nearest_m - 2 * RADIUS_M
    yield Figure(
        "nearest two machines", clear_m, "m", "> 0", clear_m > 0, "", f"between circles; {scope}"
    )
    yield from process_figures("25 ha", yard, memory_mb, scope)
    with tempfile.TemporaryDirectory() as folder:
        lone, memory_mb = asyncio.run(start_alone(Path(folder), seed, MEADOW))
    yield from process_figures("the meadow of the tutorial", lone, memory_mb, f"alone; {scope}")
    if seconds is not None:
        return
    foreign = foreign_modules()
    yield Figure("modules of the simulator in a robot process", len(foreign), "", "0", not foreign, "",
                 ", ".join(foreign) or "after it took part in a field; sim and pymunk")  # fmt: skip
    if EXAMPLE.exists():  # a checkout
        yield from driver_figures()
    if not quick:
        yield from long_day.figures(quick, seed)


def trial_figures(trials: Sequence[LostPlaceTrial], scope: str) -> Iterator[Figure]:
    """Of each fault what its trials show, or that there were none."""
    for fault in FAULTS:
        own = [each for each in trials if each.fault == fault and each.order != NO_FAULT]
        if not own:
            yield Figure(f"{fault}: trials", 0, "", "", None, "",
                         f"not measured: no machine drove in time; {scope}")  # fmt: skip
            continue
        yield from way_figures(fault, own, scope)
        outside_m = max(max(trial.outside_m - MARGIN_M, 0.0) for trial in own)
        yield Figure(f"{fault}: beyond the margin of {MARGIN_M} m, worst of {len(own)}", outside_m, "m",
                     "0", outside_m == 0.0, "", scope)  # fmt: skip
        lost = [f"{trial.order}: {trial.why}" for trial in own if not trial.returned]
        yield Figure(f"{fault}: robots that did not go on by themselves, of {len(own)}", len(lost), "",
                     "0", not lost, "", f"within {BACK_S:.0f} s; {lost or ''}; {scope}")  # fmt: skip
        stuck = sum(not trial.witness_went_on for trial in own)
        yield Figure(f"{fault}: the robot without trials did not go on, of {len(own)}", stuck, "", "0",
                     stuck == 0, "",
                     f"less than {WENT_ON_M} m by {BACK_S:.0f} s after the return; {scope}")  # fmt: skip


def way_limit_m(trial: LostPlaceTrial) -> float:
    """How far a machine may drive without a believed place until it stands, by its greatest speed."""
    limits = BodyLimits(RADIUS_M, trial.fastest_m_s, ACCELERATION_M_S2)
    if trial.fault == "frozen":
        return frozen_way_m(trial.fastest_m_s, limits, LATENCY_S)
    return blind_way_m(limits)


def way_figures(fault: str, trials: list[LostPlaceTrial], scope: str) -> Iterator[Figure]:
    """Of one fault: the way that machines drove without a believed place, and how long they were told
    to."""
    ways = [(trial.driven_m / max(way_limit_m(trial), 1e-9), trial) for trial in trials]
    share, worst = max(ways)
    yield Figure(
        f"{fault}: way until it stands, share of what its speed allows, worst of {len(trials)}",
        share, "", "<= 1", share <= 1.0, "",
        f"{worst.driven_m:.3f} m of {way_limit_m(worst):.3f} m at {worst.fastest_m_s:.2f} m/s; longest "
        f"way of all {max(trial.driven_m for trial in trials):.3f} m; {scope}",
    )  # fmt: skip
    limit_s, timed = STOPS_S, [trial.stopped_after_s for trial in trials]
    about, note = "", f"median {percentile(timed, 0.5):.3f} s; "
    if fault == "frozen":
        slow = [t.stopped_after_s for t in trials if t.slowest_m_s < WORKS_M_S]
        timed = [t.stopped_after_s for t in trials if t.slowest_m_s >= WORKS_M_S]
        limit_s, about = FROZEN_STOPS_S, f" at {WORKS_M_S} m/s or more"
        note += f"slower, worst of {len(slow)}: {max(slow, default=0.0):.3f} s; "
    slowest = max(trials, key=lambda trial: trial.stopped_after_s)
    note += f"the longest of all {slowest.stopped_after_s:.3f} s, after {slowest.order!r}; "
    if timed:
        yield Figure(
            f"{fault}{about}: last command to move after the fault, worst of {len(timed)}", max(timed),
            "s", f"<= {limit_s}", max(timed) <= limit_s, "", note + scope,
        )  # fmt: skip


def process_figures(field: str, yard: Yard, memory_mb: list[float], scope: str) -> Iterator[Figure]:
    """Start and memory of the robots of a yard, the first start left out."""
    start_s = percentile(yard.started_s[1:], 0.5)
    yield Figure(f"start of a robot process, warm, median; {field}", start_s, "s",
                 f"<= {START_TARGET_S}", start_s <= START_TARGET_S, "",
                 f"from exec to taking part, first place included; {scope}")  # fmt: skip
    yield Figure("the same in seconds of CPU", percentile(yard.started_cpu_s[1:], 0.5), "s", "", None,
                 "", f"user and system; {scope}")  # fmt: skip
    yield Figure(f"memory of a robot process; {field}", max(memory_mb), "MB",
                 f"<= {MEMORY_TARGET_MB:g}", max(memory_mb) <= MEMORY_TARGET_MB, "",
                 f"VmRSS, largest; {scope}")  # fmt: skip


async def start_alone(
    folder: Path, seed: int, corners: Sequence[tuple[float, float]], declared: int = 1,
    implement_width_m: float = 3.0,
) -> tuple[Yard, list[float]]:  # fmt: skip
    """One robot of a fleet on a field, started again and again; its memory in MB after some driving."""
    yard = Yard(folder, seed, 1, corners, declared, implement_width_m)
    try:
        await yard.begin()
        for _ in range(STARTS):
            yard.robots[-1].terminate()
            await yard.robots[-1].wait()
            await yard.start(0)
        await yard.until_drives(0, DRIVES_FOR_S)
        await asyncio.sleep(DRIVES_FOR_S)
        return yard, yard.memory_mb()[-1:]
    finally:
        await yard.end()


def foreign_modules() -> list[str]:
    """The modules of the simulator that a robot has loaded when it has taken part and left."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "field.geojson").write_text(
            dumps({"type": "Polygon", "coordinates": [CORNERS]})
        )
        (Path(folder) / "fleet.toml").write_text(LONE)
        robot = subprocess.Popen(
            [*spied_command(), "robot", "fleet.toml", "--first-boot"],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert robot.stdout is not None
        robot.stdout.readline()
        robot.terminate()
        _, told = robot.communicate(timeout=UP_S)
    found: list[str] = json.loads(told.splitlines()[-1])
    return found


def spied_command() -> list[str]:
    """The words that start a `headland` that tells its foreign modules in its last line."""
    *words, start = module_command("tools.cli.entrance")
    return [*words, SPY + start]


def driver_figures() -> Iterator[Figure]:
    """The driver of the tutorial: its lines, and its ten checks on a simulated machine."""
    lines = len(EXAMPLE.read_text().splitlines())
    yield Figure("lines of the driver of the tutorial", lines, "", f"<= {DRIVER_LINES}",
                 lines <= DRIVER_LINES, "", "differential; blank lines, too")  # fmt: skip
    headland = module_command("tools.cli.headland")
    machine = subprocess.Popen(
        [*headland, "machine", "--gnss", "0", "--wheels", "0", "--orders", "0", "--json"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert machine.stdout is not None
        ports = json.loads(machine.stdout.readline())
        done = subprocess.run(
            [*headland, "body-check", "rover:Rover", "--origin", "52,5", "--machine",
             f"127.0.0.1:{ports['orders']}", "--option", f"gnss={ports['gnss']}",
             "--option", f"wheels={ports['wheels']}", "--json"],
            cwd=EXAMPLE.parent, stdout=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
        said = json.loads(done.stdout)
    finally:
        machine.terminate()
        machine.wait()
    failed = [each["what"] for each in said["findings"] if each["ok"] is not True]
    yield Figure("checks that this driver passes", said["passed"], "", f"{len(CHECKS)}",
                 said["passed"] == len(CHECKS), "", ", ".join(failed))  # fmt: skip
