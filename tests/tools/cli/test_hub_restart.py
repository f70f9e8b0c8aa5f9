"""The bus is a process that is killed and started again: robots stand meanwhile, and come back alone."""

import asyncio
import json
import os
import signal
from asyncio.subprocess import Process
from math import dist, hypot
from pathlib import Path
from socket import socket

import pytest

from sim.record.intent_stream import IntentListener
from tests.tools.complaint import Complaints
from tests.tools.launching import WAIT_S, call, robots_up, start
from tests.tools.watch import STANDING_M_S, Watch

ROBOTS = 3
STOOD_S = 1.5  # standing for longer than an order to drive lives, many times
MOVED_M = 0.05


def stand(watch: Watch) -> bool:
    return all(i["holds"] and hypot(i["vx"], i["vy"]) < STANDING_M_S for i in watch.now.values())


def know_they_are_off(watch: Watch) -> bool:
    return stand(watch) and all("BUS_OFF" in i["holds"] for i in watch.now.values())


def places(watch: Watch) -> dict[int, tuple[float, float]]:
    return {slot: (i["x"], i["y"]) for slot, i in watch.now.items()}


async def hub(folder: Path, port: int) -> tuple[Process, int]:
    process = await start(folder, "hub", "--port", str(port), "--json")
    assert process.stdout is not None
    async with asyncio.timeout(WAIT_S):
        line = await process.stdout.readline()
    return process, int(json.loads(line)["port"])


async def stands_and_goes_on(watch: Watch, told: str) -> None:
    await watch.until(f"{told}: they stand", lambda: know_they_are_off(watch))
    before = places(watch)
    await watch.for_s(STOOD_S)
    moved_m = max(dist(before[slot], place) for slot, place in places(watch).items())
    assert moved_m < MOVED_M and stand(watch), watch


@pytest.mark.slow
def test_a_hub_that_is_killed_hangs_and_comes_back(tmp_path: Path) -> None:
    async def story() -> None:
        bus, port = await hub(tmp_path, 0)
        processes = [bus]
        try:
            launch = await start(tmp_path, "launch", "yard", "--hub", str(port))
            processes.append(launch)
            await robots_up(launch, ROBOTS)
            where = json.loads((tmp_path / "runs/launch/bus.json").read_text())
            assert where["port"] == port
            watch = Watch(ROBOTS)
            watching = await IntentListener(watch.told).connect(Path(where["bodies"]))
            telling = asyncio.create_task(watching.run())
            await watch.until("they work", watch.work)

            os.kill(bus.pid, signal.SIGSTOP)  # it hangs: connections stay, nothing comes
            await stands_and_goes_on(watch, "a hub that hangs")
            os.kill(bus.pid, signal.SIGCONT)
            await watch.until("they work after the hub hung", watch.work)

            bus.kill()
            await bus.wait()
            await stands_and_goes_on(watch, "a hub that was killed")
            bus, _ = await hub(tmp_path, port)
            processes.append(bus)
            await watch.until("they work on the new hub", watch.work)
            code, text = await call(tmp_path, "estop", "--json")  # and hear a stop on it
            assert code == 0 and len(json.loads(text)["stopped"]) == ROBOTS, text
            telling.cancel()
            watching.end()
            launch.send_signal(signal.SIGINT)
            async with asyncio.timeout(WAIT_S):
                await launch.wait()
            told = json.loads((tmp_path / "runs/launch/report.json").read_text())
            assert told["contacts"] == 0 and told["robots_ended"] == [], told
        finally:
            for process in processes:
                if process.returncode is None:
                    process.kill()
                    await process.wait()

    asyncio.run(story())


@pytest.mark.slow
def test_a_launch_without_its_hub_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    said = Complaints(monkeypatch, capfd).of(f"launch yard --hub {port}", tmp_path)
    assert said.code == 2 and said.line.startswith(f"headland: --hub {port}")
