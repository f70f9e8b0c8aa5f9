"""Stopping: from a press, or from silence, to the last robot's zero command."""

import asyncio
import tempfile
from collections.abc import Iterator
from pathlib import Path
from random import Random

from rich.console import Console

from agent.interface.config import ACTUATOR_TTL_US, S, beat_of
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import (
    Command,
    EmergencyReset,
    EmergencyStop,
    OperatorCommand,
    Reason,
)
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus, segment
from sim.fleet.virtual_clock import run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench.drill import ProtocolFleet
from tools.bench.figure import Figure, percentile
from tools.bench.stop_rig import LIMIT_US, StopFleet
from tools.build.warmup import warm
from tools.operate.tool_address import DeviceAddress
from tools.run.fleet_folder import fleet_folder
from tools.run.launch import Launch

FLEETS = (3, 5, 20, 100)
RATES = (0.0, 0.01, 0.10, 0.30)
# Share of the presses by size of fleet; a hundred robots cost most.
SHARES = {3: 0.35, 5: 0.35, 20: 0.25, 100: 0.05}
SILENCES = ("cut", "kill", "freeze", "bus-off")
SILENCE_SLACK_US = 20_000  # a control tick and the jitter of a busy bus
OPERATOR = 249
READY_S, AGAIN_S = 60.0, 0.25


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Presses on a lossy wire, silences, and presses over real processes."""
    yield from presses(2_000 if quick else 100_000, seed)
    for robots in (6, 30) if quick else (6, 30, 50, 108):
        yield silence(robots, 1 if quick else 4, seed)
    yield from processes(10 if quick else 1_000)


# -------------------------------------------------------------------- presses


def presses(total: int, seed: int) -> Iterator[Figure]:
    """How many of `total` presses were above the bound or unheard, over sizes of fleets and rates
    of loss."""
    above = unheard = done = 0
    for robots in FLEETS:
        for rate in RATES:
            count = round(total * SHARES[robots] / len(RATES))
            rows = [
                StopFleet(robots, rate, rate, f"{seed}/{robots}/{rate}/{k}").press()
                for k in range(count)
            ]
            done += count
            above += sum(heard.last_for_us > heard.bound_for_us for heard in rows)
            unheard += sum(heard.last_for_us >= LIMIT_US for heard in rows)
            worst = max(rows, key=lambda heard: heard.last_for_us)
            yield Figure(
                f"press to last zero command, {robots} robots, {rate:.0%} omissions and errors",
                worst.last_for_us / 1000, "ms", f"<= {worst.bound_for_us / 1000:g} (computed)",
                all(heard.last_for_us <= heard.bound_for_us for heard in rows),
                "bound from the errors, missed copies and dry rounds of each press",
                f"{count} presses, saturated bus, safeties on the wire model",
            )  # fmt: skip
    yield Figure("presses above their bound", above, "presses", "0", above == 0, "",
                 f"{done} presses; {unheard} not heard by all within {LIMIT_US / S:g} s")  # fmt: skip


# -------------------------------------------------------------------- silence


def silence(robots: int, rounds: int, seed: int) -> Figure:
    """The longest time until all robots stood, over kinds of silence."""
    limit_us = beat_of(robots).silence_for_us + SILENCE_SLACK_US
    worst_us, which = 0, ""
    for number in range(rounds):
        for kind in SILENCES:
            stood_us = run_virtual(_silence(robots, kind, f"{seed}/{number}/{kind}"))
            if stood_us > worst_us:
                worst_us, which = stood_us, kind
    return Figure(
        f"silence to last zero command, {robots} robots", worst_us / 1000, "ms",
        f"<= {limit_us / 1000:g}", worst_us <= limit_us, "",
        f"{', '.join(SILENCES)}, {rounds} each, whole peers at work; longest: {which}",
    )  # fmt: skip


async def _silence(robots: int, kind: str, seed: str) -> int:
    """Microseconds from the event until no robot's command to move is in force."""
    rng, fleet = Random(seed), ProtocolFleet(robots, hash_free(seed))
    try:
        assert await fleet.until_working(), "a drill that does not begin shows nothing"
        await asyncio.sleep(rng.uniform(0.5, 1.5))
        loop = asyncio.get_running_loop()
        at_us, victim = round(loop.time() * 1e6), rng.randrange(robots)
        runner = fleet.runners[victim]
        nodes = [fleet.node_of(slot) for slot in range(robots)]
        match kind:
            case "cut":
                half = set(rng.sample(nodes, robots // 2))
                fleet.segment.wire.partition(half, set(nodes) - half)
            case "kill":
                fleet.tasks[victim].cancel()
                runner.bus.close()
            case "freeze":
                runner.freeze(3.0)
            case "bus-off":
                fleet.segment.wire.bus_off(nodes[victim], at_us + 3 * S)
        await asyncio.sleep(2 * beat_of(robots).silence_for_us / S)
        return max(body.moved_until_us(ACTUATOR_TTL_US) for body in fleet.bodies) - at_us
    finally:
        await fleet.close()


def hash_free(text: str) -> int:
    """A number from a seed's text, the same in every process."""
    return Random(text).getrandbits(30)


# -------------------------------------------------------------------- real processes


def processes(count: int) -> Iterator[Figure]:
    """Milliseconds from a press to the last zero command of a launch, over so many presses."""
    warm(steering=False)
    with tempfile.TemporaryDirectory() as folder:
        launch = _Presses(count, Path(folder))
        asyncio.run(launch.run(0, None))
    times = sorted(launch.times_s)
    if len(times) < count:
        yield Figure("presses with real processes", len(times), "presses", f"{count}", False, "",
                     "not heard by all robots, or the fleet did not come back")  # fmt: skip
        return
    scope = f"6 processes on the hub, {count} presses; the echo leaves after the zero command"
    p999_s = percentile(times, 0.999)
    yield Figure("press to last echo, real processes, p99.9", p999_s * 1000, "ms", "<= 50",
                 p999_s <= 0.050, "", scope)  # fmt: skip
    yield Figure("press to last echo, real processes, longest", times[-1] * 1000, "ms", "<= 320",
                 times[-1] <= 0.320, "", scope)  # fmt: skip


class _Presses(Launch):
    """A launch whose watcher presses, waits for every echo, resets, starts, and presses again."""

    def __init__(self, count: int, out: Path) -> None:
        setting = FieldSetup(load("small").changed(6, 1))
        fleet = fleet_folder(out, setting, fresh=True)
        super().__init__(setting, "small", fleet, Console(quiet=True), None)
        self.count, self.times_s = count, list[float]()
        self._dot: tuple[int, int, int] | None = None
        self._echoes: dict[int, float] = {}
        self._frame = asyncio.Event()

    def _heard(self, t_us: int, frame: Frame) -> None:
        super()._heard(t_us, frame)
        source, message = decode(frame)
        if isinstance(message, EmergencyStop) and message.echo and message[:3] == self._dot:
            slot = self.inspector.slot_of.get(source)
            if slot is not None:
                self._echoes.setdefault(slot, t_us / 1e6)
        self._frame.set()

    async def _watch(self, end: asyncio.Event, seconds: float | None) -> bool:
        import os

        loop = asyncio.get_running_loop()
        bus = CanBus(FieldBus(segment(f"launch {os.getpid()}").channel))
        device = DeviceAddress(bus)
        bus.subscribe(lambda frame: device.hear(loop.time(), frame))
        try:
            for number in range(self.count):
                await self._until(self._ready, READY_S, lambda: self._release(device))
                await self._press(device, number)
        except TimeoutError:
            return False
        finally:
            bus.close()
        return True

    def _ready(self) -> bool:
        return self._all("IDLE", "WORKING")

    def _all(self, *states: str) -> bool:
        robots = self.inspector.robots.values()
        return len(robots) == 6 and all(robot.state in states for robot in robots)

    def _release(self, device: DeviceAddress) -> None:
        """Clear what is shown, reset the machines, give the start; said until it has come about."""
        for dot in self.inspector.latched:
            device.send(EmergencyReset(*dot, OPERATOR))
        for command in (Command.MANUAL_RESET, Command.START):
            device.send(OperatorCommand(command, 255, OPERATOR))

    async def _press(self, device: DeviceAddress, number: int) -> None:
        loop = asyncio.get_running_loop()
        self._echoes.clear()
        self._dot = (OPERATOR, number >> 8, number & 0xFF)
        begun_s = loop.time()
        stop = EmergencyStop(*self._dot, Reason.OPERATOR_INTERVENTION)
        device.send(stop)
        await self._until(lambda: len(self._echoes) == 6, 3.0, lambda: None)
        self.times_s.append(max(self._echoes.values()) - begun_s)
        await self._until(lambda: self._all("EMERGENCY_STOP"), READY_S, lambda: None)

    async def _until(self, holds, limit_s: float, again) -> None:  # type: ignore[no-untyped-def]
        loop = asyncio.get_running_loop()
        end_s, again_s = loop.time() + limit_s, loop.time()
        while not holds():
            if loop.time() >= end_s:
                raise TimeoutError
            if loop.time() >= again_s:
                again_s += AGAIN_S
                again()
            self._frame.clear()
            try:
                async with asyncio.timeout(AGAIN_S):
                    await self._frame.wait()
            except TimeoutError:
                continue
