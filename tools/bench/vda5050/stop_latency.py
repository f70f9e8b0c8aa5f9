"""Stops from a master control, and on the bus: how long until the last body stands.

A master has two ways to let vehicles stand. The standard has no instant action that is an emergency stop.
Its own is `startPause`, for one vehicle: here each vehicle is told, and each goes on by `stopPause`. Ours
is `stop`, which the factsheet declares: told to one vehicle, it is a stop of the whole fleet, and only an
operator releases it.

Robots are processes of a launch. Bodies are judged by their world (`tools.bench.standing_bodies`). A stop
is also judged by the first beat in which the last robot says that it is latched, at most 50 ms too late.
"""

import asyncio
import json
from asyncio.subprocess import PIPE, STDOUT, Process
from pathlib import Path
from typing import Final, NamedTuple

from sim.scenarios.delivery_scenario import load_warehouse
from tools.bench.standing_bodies import Bodies, BodiesPress, start_watched
from tools.bench.stopped_beats import Beats
from tools.bench.vda5050.counterparts import Mosquitto, end, release, said
from tools.bench.vda5050.masters_orders import ROBOTS, SCENARIO, vehicles
from tools.common.bus_address import CHANNEL
from tools.common.bus_attach import attach
from tools.operate.operator_device import Operator

PRESSES = 10
STOP: Final = "by a master's `stop`"
PAUSE: Final = "by a master's `startPause` of each vehicle"
BUS: Final = "on the bus"
SIDES: Final = (STOP, PAUSE, BUS)


class StopLatency(NamedTuple):
    """Each press, by the side on which it was."""

    latched_ms: dict[str, list[float]]  # until the last beat says it; a pause latches nothing
    bodies: dict[str, list[BodiesPress]]


async def trial(folder: Path, node: Path, presses: int = PRESSES) -> StopLatency:
    """So many presses of each side, each while bodies drive."""
    (folder / "yard.toml").write_text(SCENARIO.replace("handle_s", "random_tasks = 60\nhandle_s"))
    broker = Mosquitto(folder)
    await broker.start()
    launch = await start_watched(folder, "yard.toml", ROBOTS)
    master: Process | None = None
    fleet = load_warehouse(str(folder / "yard.toml")).fleet
    beats, bodies = Beats(ROBOTS), Bodies(fleet.speed_m_s)
    told = StopLatency({STOP: [], BUS: []}, {side: [] for side in SIDES})
    try:
        async with vehicles(folder, launch, ROBOTS, broker.url, bodies.read) as port:
            master = await asyncio.create_subprocess_exec(
                "node", str(node / "stop.js"), broker.url, str(ROBOTS),
                stdin=PIPE, stdout=PIPE, stderr=STDOUT,
            )  # fmt: skip
            assert master.stdin is not None
            await said(master, "(ready)")
            bus = attach("socketcand", CHANNEL, 250_000, "127.0.0.1", int(port))
            bus.subscribe(beats.hear)
            operator = Operator(bus, None)
            await operator.device.held()
            await beats.until(False)
            loop = asyncio.get_running_loop()
            for _ in range(presses):
                for side in SIDES:
                    driving = await bodies.drive()
                    beats.all_at_s, pressed_s = None, loop.time()
                    if side == PAUSE:
                        master.stdin.write(b"startPause\n")
                    elif side == STOP:
                        master.stdin.write(b"stop\n")
                        told.latched_ms[side].append(await beats.since(pressed_s))
                    else:
                        told.latched_ms[side].append(await beats.pressed(operator))
                    told.bodies[side].append(await bodies.stood(pressed_s, driving))
                    if side == PAUSE:
                        master.stdin.write(b"stopPause\n")
                    else:
                        await release(folder, port)
                        await beats.until(False)
            bus.close()
    finally:
        if master is not None and master.returncode is None:
            master.kill()
            await master.wait()
        await end(launch)
        await broker.kill()
    (folder / "took.json").write_text(json.dumps(told._asdict()))
    return told
