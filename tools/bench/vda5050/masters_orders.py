"""An independent master control orders from a launched fleet, while broker, robots and gateway die.

What is delivered is read from the world of the launch, and what the master believes from the master.
"""

import asyncio
import json
import os
import signal
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tools.bench.vda5050.counterparts import (
    WAIT_S,
    Mosquitto,
    NodeProgram,
    Witness,
    drain,
    end,
    said,
    start,
)

ROBOTS = 4
SCENARIO = f"""
name = "yard"
mission = "delivery"
[warehouse]
map = '''
............
............
....##......
............
............
............
'''
handle_s = 0.5
[fleet]
robots = {ROBOTS}
"""
CELLS = [[0.5, 0.5], [5.5, 0.5], [11.5, 0.5], [0.5, 5.5], [6.5, 5.5], [11.5, 4.5]]
RUN_S = 1800.0  # for all orders; 50 take six minutes on two cores that others use as well


class MastersOrders(NamedTuple):
    """What came of the orders of a master."""

    report: dict[str, Any]  # of the launch: the truth about parcels
    done: list[int]  # orders, as the master was told
    dropped: list[str]  # messages that vda-5050-lib refused
    flaws: dict[str, int]  # by the official schemas
    messages: dict[str, int]  # sent, by topic

    @property
    def delivered_once(self) -> int:
        """Parcels that lie where they should, if none was mishandled."""
        return 0 if any(self.report["flaws"].values()) else int(self.report["delivered"])


async def serve(folder: Path, port: str, url: str, *more: str) -> Process:
    """`headland vda5050` for the launch at this port. `more`: words of its command line."""
    words = ("--broker", url, "--scenario", "yard.toml", "--port", port, "--book", "book.jsonl")
    return await start(folder, "vda5050", *words, *more)


@asynccontextmanager
async def vehicles(
    folder: Path, launch: Process, robots: int, url: str,
    read: Callable[[Process], Awaitable[None]] = drain, more: Sequence[str] = (),
) -> AsyncIterator[str]:  # fmt: skip
    """A gateway that shows all robots of this launch as vehicles; gives the port of the launch.

    `read`: takes the output of the launch once its robots are there. `more`: words for the gateway."""
    port = await said(launch, r"socketcand \S+:(\d+)")
    await said(launch, rf"(robot {robots - 1}: process)")
    readings = [asyncio.ensure_future(read(launch))]
    gateway = await serve(folder, port, url, *more)
    try:
        for _ in range(robots):
            await said(gateway, r"(a vehicle at)")
        readings.append(asyncio.create_task(drain(gateway)))
        yield port
    finally:
        for reading in readings:
            reading.cancel()
        await end(gateway)


async def trial(folder: Path, node: Path, orders: int, deaths: bool = True) -> MastersOrders:
    """Broker killed twice, two robots killed, the gateway killed once, all without a word.

    `node`: where vda-5050-lib is. Without `deaths` nothing is killed."""
    (folder / "yard.toml").write_text(SCENARIO)
    broker, master = Mosquitto(folder), NodeProgram()
    await broker.start()
    launch = await start(folder, "launch", "yard.toml", "--out", "out", "--fresh", "--no-keys")
    witness, gateway = Witness(broker, "Headland"), None
    try:
        port = await said(launch, r"socketcand \S+:(\d+)")
        pids = [int(await said(launch, rf"robot {slot}: process (\d+)")) for slot in range(ROBOTS)]
        reading = asyncio.create_task(drain(launch))
        gateway = await serve(folder, port, broker.url)
        await master.start(
            node, "master.js", broker.url, "0", str(orders), "yard", json.dumps(CELLS)
        )

        async def done(count: int) -> None:
            await master.until(lambda events: sum("done" in e for e in events) >= count, RUN_S)

        if deaths:
            step = orders // 6
            await done(step)
            await broker.kill()
            await broker.start()
            await done(2 * step)
            os.kill(pids[1], signal.SIGKILL)
            await done(3 * step)
            gateway.kill()
            await gateway.wait()
            gateway = await serve(folder, port, broker.url)
            await done(4 * step)
            await broker.kill()
            await broker.start()
            os.kill(pids[2], signal.SIGKILL)
        await done(orders)
        launch.send_signal(signal.SIGINT)
        async with asyncio.timeout(WAIT_S):
            await reading
            await launch.wait()
    finally:
        await master.kill()
        await witness.close()
        await end(gateway)
        await end(launch)
        await broker.kill()
    return MastersOrders(
        json.loads((folder / "out" / "report.json").read_text()),
        sorted(event["done"] for event in master.events if "done" in event),
        [line for line in master.noise if "Drop inbound" in line],
        dict(witness.flaws), dict(witness.counts),
    )  # fmt: skip
