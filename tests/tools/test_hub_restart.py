"""The bus is a process that is killed and started again: robots stand meanwhile, and come back alone."""

import asyncio
import json
import os
import signal
from asyncio.subprocess import Process
from collections.abc import Callable
from math import dist, hypot
from pathlib import Path
from typing import Any

from sim.intent_link import Watching
from tests.tools.launching import WAIT_S, call, robots_up, start

ROBOTS = 3
STANDING_M_S, STOOD_S = 0.02, 1.5  # standing for longer than an order to drive lives, many times
MOVED_M = 0.05


class Watch:
    """What each robot says it does, beside the bus: datagrams five times a second."""

    def __init__(self) -> None:
        self.now: dict[int, dict[str, Any]] = {}
        self.news = asyncio.Event()

    def heard(self, intent: dict[str, Any]) -> None:
        self.now[intent["slot"]] = intent
        self.news.set()

    async def until(self, what: str, holds: Callable[[dict[str, Any]], bool]) -> None:
        """Of all robots at once."""
        try:
            async with asyncio.timeout(WAIT_S):
                while len(self.now) < ROBOTS or not all(map(holds, self.now.values())):
                    self.news.clear()
                    await self.news.wait()
        except TimeoutError:
            raise AssertionError(f"{what}: {self.now}") from None

    async def for_s(self, seconds: float) -> None:
        over = asyncio.get_running_loop().time() + seconds
        while asyncio.get_running_loop().time() < over:
            self.news.clear()
            await self.news.wait()

    @property
    def places(self) -> dict[int, tuple[float, float]]:
        return {slot: (i["x"], i["y"]) for slot, i in self.now.items()}


def stands(intent: dict[str, Any]) -> bool:
    return bool(intent["holds"]) and hypot(intent["vx"], intent["vy"]) < STANDING_M_S


def knows_it_is_off(intent: dict[str, Any]) -> bool:
    return stands(intent) and "BUS_OFF" in intent["holds"]


def works(intent: dict[str, Any]) -> bool:
    return not intent["holds"] and len(intent["hears"]) == ROBOTS


async def hub(folder: Path, port: int) -> tuple[Process, int]:
    process = await start(folder, "hub", "--port", str(port), "--json")
    assert process.stdout is not None
    async with asyncio.timeout(WAIT_S):
        line = await process.stdout.readline()
    return process, int(json.loads(line)["port"])


async def stands_and_goes_on(watch: Watch, told: str) -> None:
    await watch.until(f"{told}: they stand", knows_it_is_off)
    before = watch.places
    await watch.for_s(STOOD_S)
    moved_m = max(dist(before[slot], place) for slot, place in watch.places.items())
    assert moved_m < MOVED_M and all(map(stands, watch.now.values())), watch.now


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
            watch = Watch()
            transport, watching = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: Watching(watch.heard), remote_addr=("127.0.0.1", where["body_port"])
            )
            telling = asyncio.create_task(watching.run())
            await watch.until("they work", works)

            os.kill(bus.pid, signal.SIGSTOP)  # it hangs: connections stay, nothing comes
            await stands_and_goes_on(watch, "a hub that hangs")
            os.kill(bus.pid, signal.SIGCONT)
            await watch.until("they work after the hub hung", works)

            bus.kill()
            await bus.wait()
            await stands_and_goes_on(watch, "a hub that was killed")
            bus, _ = await hub(tmp_path, port)
            processes.append(bus)
            await watch.until("they work on the new hub", works)
            code, text = await call(tmp_path, "estop", "--json")  # and hear a stop on it
            assert code == 0 and len(json.loads(text)["stopped"]) == ROBOTS, text
            telling.cancel()
            transport.close()
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


def test_a_launch_without_its_hub_is_one_line(tmp_path: Path) -> None:
    async def story() -> None:
        server = await asyncio.start_server(lambda r, w: None, "127.0.0.1", 0)
        port = str(server.sockets[0].getsockname()[1])
        server.close()
        await server.wait_closed()
        code, text = await call(tmp_path, "launch", "yard", "--hub", port)
        assert code == 2 and text.splitlines()[-1].startswith(f"headland: --hub {port}"), text
        assert "Traceback" not in text

    asyncio.run(story())
