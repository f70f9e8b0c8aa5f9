"""What benches and tests of VDA 5050 speak to: mosquitto on loopback, and vda-5050-lib in node."""

import asyncio
import json
import re
import shutil
import socket
import subprocess
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiomqtt

from agent.runtime.vda5050.messages import Topic
from tools.bench.systems import CounterpartAbsent
from tools.bench.vda5050.official_schemas import flaws
from tools.common.child_process import module_command

PACKAGE = "vda-5050-lib@1.4.0"  # MIT, Siemens
HERE = Path(__file__).parent
TRY_S = 2.0
WAIT_S = 180.0  # for what takes a second on a quiet machine with warm kernels


async def start(folder: Path, *words: str) -> Process:
    """A `headland` command in a folder, with its output in a pipe."""
    return await asyncio.create_subprocess_exec(
        *module_command("tools.cli.headland"), *words, cwd=folder, stdout=PIPE, stderr=STDOUT
    )


async def said(process: Process, pattern: str) -> str:
    """The first group of a pattern, as soon as a line matches. AssertionError if none does."""
    assert process.stdout is not None
    lines = []
    async with asyncio.timeout(WAIT_S):
        async for raw in process.stdout:
            lines.append(raw.decode())
            found = re.search(pattern, lines[-1])
            if found:
                return found[1]
    raise AssertionError(f"it ended before it said {pattern}: {''.join(lines[-5:])}")


async def release(folder: Path, port: str) -> None:
    """Release every stop of the launch whose bus is at this port, and start its robots."""
    process = await start(folder, "release", "--start", "--port", port)
    async with asyncio.timeout(WAIT_S):
        await process.communicate()


async def drain(process: Process) -> None:
    """Read the output to its end, so that the pipe never fills."""
    assert process.stdout is not None
    async for _ in process.stdout:
        pass


async def end(process: Process | None) -> None:
    """Ask a process to end, and wait for it."""
    if process is not None and process.returncode is None:
        process.terminate()
        await process.wait()


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
    return port


class Mosquitto:
    """A broker that can be killed and started again on its port."""

    def __init__(self, folder: Path) -> None:
        program = shutil.which(
            "mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin"
        )
        if program is None:
            raise CounterpartAbsent("mosquitto is not installed")
        self.program, self.port, self.conf = program, free_port(), folder / "mosquitto.conf"
        self.conf.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        self.process: Process | None = None
        self.up = asyncio.Event()

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    async def start(self) -> None:
        self.process = await asyncio.create_subprocess_exec(
            self.program, "-c", str(self.conf), stdout=DEVNULL, stderr=DEVNULL
        )
        async with asyncio.timeout(WAIT_S):
            while True:
                try:
                    async with aiomqtt.Client("127.0.0.1", self.port, timeout=TRY_S):
                        self.up.set()
                        return
                except aiomqtt.MqttError:
                    assert self.process.returncode is None, "mosquitto does not start"

    async def kill(self) -> None:
        """Without a word, as a machine loses its power."""
        assert self.process is not None
        self.up.clear()
        if self.process.returncode is None:
            self.process.kill()
        await self.process.wait()


def node_folder(tmp: Path) -> Path:
    """A folder in which node finds vda-5050-lib. Raises CounterpartAbsent if that cannot be had."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        raise CounterpartAbsent("node and npm are not installed")
    done = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(tmp), PACKAGE],
        capture_output=True, text=True, check=False, timeout=WAIT_S,
    )  # fmt: skip
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:]
        raise CounterpartAbsent(f"npm cannot install {PACKAGE}: {last}")
    for script in HERE.glob("*.js"):
        shutil.copy(script, tmp)
    return tmp


class NodeProgram:
    """A script in node that prints one JSON line an event."""

    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []
        self.noise: list[str] = []  # what vda-5050-lib says besides, as of messages that it drops
        self.process: Process | None = None
        self._reading: asyncio.Task[None] | None = None
        self._changed = asyncio.Event()

    async def start(self, folder: Path, script: str, *words: str) -> None:
        self.process = await asyncio.create_subprocess_exec(
            "node", script, *words, cwd=folder, stdout=PIPE, stderr=STDOUT
        )
        self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        assert self.process is not None and self.process.stdout is not None
        async for raw in self.process.stdout:
            line = raw.decode().strip()
            try:
                self.events.append(json.loads(line))
            except ValueError:
                self.noise.append(line)
            self._changed.set()

    async def until(self, what: Callable[[list[dict[str, Any]]], bool], seconds: float) -> None:
        """Wait until the events are so."""
        async with asyncio.timeout(seconds):
            while not what(self.events):
                self._changed.clear()
                await self._changed.wait()

    async def kill(self) -> None:
        if self.process is not None and self.process.returncode is None:
            self.process.kill()
            await self.process.wait()
        if self._reading is not None:
            await self._reading


class Witness:
    """Listens to all topics, over restarts of the broker, and judges each message by its schema."""

    def __init__(self, broker: Mosquitto, sender: str, as_vehicle: bool = True) -> None:
        """`sender`: only topics of this manufacturer, and of these what its vehicles say, or what they
        are told."""
        self.broker, self.sender, self.as_vehicle = broker, sender, as_vehicle
        self.counts: Counter[str] = Counter()  # messages by topic
        self._heard: dict[tuple[str, str], int] = {}  # kind and text -> how often
        self._running = asyncio.create_task(self._run())

    async def _run(self) -> None:
        while True:
            try:
                async with aiomqtt.Client("127.0.0.1", self.broker.port) as client:
                    await client.subscribe("#", qos=0)
                    async for message in client.messages:
                        self._hear(str(message.topic), message.payload)
            except aiomqtt.MqttError:
                await self.broker.up.wait()

    def _hear(self, topic: str, payload: Any) -> None:
        _, _, manufacturer, _, kind = topic.split("/")
        if self.sender != manufacturer:
            return
        orders = kind in (Topic.ORDER, Topic.INSTANT_ACTIONS)
        if orders is self.as_vehicle:
            return  # the other side's
        self.counts[kind] += 1
        text = payload.decode()
        self._heard[kind, text] = self._heard.get((kind, text), 0) + 1

    @property
    def flaws(self) -> Counter[str]:
        """What is not valid, by kind. It takes time, so ask when the trial is over. Raises
        CounterpartAbsent."""
        found: Counter[str] = Counter()
        for (kind, text), times in self._heard.items():
            for flaw in flaws(Topic(kind), json.loads(text)):
                found[f"{kind}: {flaw}"] += times
        return found

    async def close(self) -> None:
        self._running.cancel()
        await asyncio.gather(self._running, return_exceptions=True)
