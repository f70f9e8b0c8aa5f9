"""An independent master control orders from a launched fleet, while broker, robots and gateway die."""

import asyncio
import json
import os
import signal
from asyncio.subprocess import Process
from pathlib import Path
from typing import Any

import pytest

from tests.tools.launching import WAIT_S, said, start
from tests.tools.vda5050.counterparts import Mosquitto, NodeProgram, Witness, node_folder

SCENARIO = """
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
robots = 4
"""
CELLS = [[0.5, 0.5], [5.5, 0.5], [11.5, 0.5], [0.5, 5.5], [6.5, 5.5], [11.5, 4.5]]
RUN_S = 900.0
ORDERS = 50


async def drained(process: Process) -> list[str]:
    assert process.stdout is not None
    return [raw.decode().rstrip() async for raw in process.stdout]


async def serve(folder: Path, port: str, url: str) -> Process:
    words = ("--broker", url, "--scenario", "yard.toml", "--port", port, "--book", "book.jsonl")
    return await start(folder, "vda5050", *words)


async def story(folder: Path, node: Path, orders: int) -> dict[str, Any]:
    """Broker killed twice, two robots killed, the gateway killed once, all without a word."""
    (folder / "yard.toml").write_text(SCENARIO)
    broker, master = Mosquitto(folder), NodeProgram()
    await broker.start()
    launch = await start(folder, "launch", "yard.toml", "--out", "out", "--fresh")
    witness, gateway = Witness(broker, "Headland"), None
    try:
        port = await said(launch, r"socketcand \S+:(\d+)")
        pids = [int(await said(launch, rf"robot {slot}: process (\d+)")) for slot in range(4)]
        reading = asyncio.create_task(drained(launch))
        gateway = await serve(folder, port, broker.url)
        await master.start(
            node, "master.js", broker.url, "0", str(orders), "yard", json.dumps(CELLS)
        )

        async def done(count: int) -> None:
            await master.until(lambda events: sum("done" in e for e in events) >= count, RUN_S)

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
    finally:
        await master.kill()
        await witness.close()
        for process in (gateway, launch):
            if process is not None and process.returncode is None:
                process.terminate()
                await process.wait()
        await broker.kill()
    report: dict[str, Any] = json.loads((folder / "out" / "report.json").read_text())
    return {
        "report": report, "events": master.events, "noise": master.noise,
        "flaws": dict(witness.flaws), "messages": dict(witness.counts),
    }  # fmt: skip


@pytest.mark.slow
def test_50_orders_of_an_independent_master_are_delivered_once(tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    folder.mkdir()
    told = asyncio.run(story(folder, node_folder(tmp_path), ORDERS))
    report = told["report"]
    assert (report["tasks"], report["delivered"]) == (ORDERS, ORDERS)
    assert not any(report["flaws"].values()) and report["contacts"] == 0
    assert report["robots_ended"] == [1, 2]
    done = [event["done"] for event in told["events"] if "done" in event]
    assert sorted(done) == list(range(ORDERS))
    assert told["flaws"] == {}
    assert not [line for line in told["noise"] if "Drop inbound" in line]
