"""A stop from a master control, and one on the bus: how long until the last robot is latched.

Robots are processes of a launch. The end of each trial is the first beat of the last robot that says it
is stopped; a robot brakes before it says so. Beats come every 50 ms, so a trial is that much too long at
most.
"""

import asyncio
import json
from asyncio.subprocess import PIPE, STDOUT, Process
from pathlib import Path
from typing import NamedTuple

from protocol.frames.safety_frames import EmergencyStop, Reason
from tools.bench.stopped_beats import BUS_BOUND_MS, REPEAT_S, TIMEOUT_S, Beats
from tools.bench.vda5050.counterparts import WAIT_S, Mosquitto, end, said, start
from tools.bench.vda5050.masters_orders import ROBOTS, SCENARIO, vehicles
from tools.common.bus_address import CHANNEL
from tools.common.bus_attach import attach
from tools.operate.operator_device import Operator

PRESSES = 10


class StopLatency(NamedTuple):
    """The longest of each side, milliseconds."""

    presses: int  # of each side
    master_ms: float
    bus_ms: float
    bus_bound_ms: float = BUS_BOUND_MS


async def trial(folder: Path, node: Path) -> StopLatency:
    """`PRESSES` of each side, with a release between them."""
    (folder / "yard.toml").write_text(SCENARIO.replace("handle_s", "random_tasks = 40\nhandle_s"))
    broker = Mosquitto(folder)
    await broker.start()
    launch = await start(folder, "launch", "yard.toml", "--out", "out", "--fresh", "--no-keys")
    master: Process | None = None
    beats = Beats(ROBOTS)
    took: dict[str, list[float]] = {"master": [], "bus": []}
    try:
        async with vehicles(folder, launch, ROBOTS, broker.url) as port:
            master = await asyncio.create_subprocess_exec(
                "node", str(node / "stop.js"), broker.url, stdin=PIPE, stdout=PIPE, stderr=STDOUT
            )
            await said(master, "(ready)")
            bus = attach("socketcand", CHANNEL, 250_000, "127.0.0.1", int(port))
            bus.subscribe(beats.hear)
            operator = Operator(bus, None)
            await operator.device.held()
            await beats.until(False)
            loop = asyncio.get_running_loop()
            for _ in range(PRESSES):
                for side, times in took.items():
                    beats.all_at_s = None
                    if side == "master":
                        assert master.stdin is not None
                        master.stdin.write(b"stop\n")
                        pressed_at_s = loop.time()
                    else:
                        stop: EmergencyStop = operator.new_stop(Reason.OPERATOR_INTERVENTION)
                        operator.stop(stop)
                        pressed_at_s = loop.time()
                    async with asyncio.timeout(TIMEOUT_S):
                        while beats.all_at_s is None:
                            await asyncio.sleep(REPEAT_S)
                            if side == "bus":
                                operator.stop(stop)
                    times.append(1000 * (beats.all_at_s - pressed_at_s))
                    await _release(folder, port)
                    await beats.until(False)
            bus.close()
    finally:
        if master is not None and master.returncode is None:
            master.kill()
            await master.wait()
        await end(launch)
        await broker.kill()
    (folder / "took.json").write_text(json.dumps(took))
    return StopLatency(PRESSES, max(took["master"]), max(took["bus"]))


async def _release(folder: Path, port: str) -> None:
    process = await start(folder, "release", "--start", "--port", port)
    async with asyncio.timeout(WAIT_S):
        await process.communicate()
