"""A `headland launch` begun by a test, in a folder of its own: its robots and their states."""

import asyncio
import json
import os
import re
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from pathlib import Path

from crdt import FieldAllocationCRDT
from crdt.claim_register import pack
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.work_frames import StateSyncResponse, TaskClaim
from tools.common.bus_address import CHANNEL
from tools.common.bus_attach import attach

ROOT = Path(__file__).parents[2]
WAIT_S = 180.0  # for what takes a second on a quiet machine with warm kernels
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


async def start(folder: Path, *words: str) -> Process:
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "tools.cli.headland", *words,
        cwd=folder, stdout=PIPE, stderr=STDOUT, env=ENVIRONMENT,
    )  # fmt: skip


async def call(folder: Path, *words: str) -> tuple[int, str]:
    process = await start(folder, *words)
    async with asyncio.timeout(WAIT_S):
        out, _ = await process.communicate()
    assert process.returncode is not None
    return process.returncode, out.decode()


async def said(launch: Process, pattern: str) -> str:
    """The first group, as soon as a line matches. Fails with all that was said instead."""
    assert launch.stdout is not None
    lines: list[str] = []
    try:
        async with asyncio.timeout(WAIT_S):
            async for raw in launch.stdout:
                lines.append(raw.decode())
                found = re.search(pattern, lines[-1])
                if found:
                    return found[1]
    except TimeoutError:
        raise AssertionError(f"no line of {pattern} in {WAIT_S} s:\n{''.join(lines)}") from None
    raise AssertionError(f"the launch ended early:\n{''.join(lines)}")


async def delivered(port: int, count: int) -> None:
    """Listens on the bus until so many tasks are done."""
    allocation, done = FieldAllocationCRDT(), asyncio.Event()
    bus = attach("socketcand", CHANNEL, 250_000, "127.0.0.1", port)

    def hear(frame: Frame) -> None:
        _, message = decode(frame)
        if isinstance(message, TaskClaim | StateSyncResponse):
            fields = message.epoch, message.phase, message.bid, message.lamport, message.owner
            allocation.apply(message.section, pack(*fields))
        if allocation.done_count() >= count:
            done.set()

    bus.subscribe(hear)
    try:
        async with asyncio.timeout(WAIT_S):
            await done.wait()
    finally:
        bus.close()


async def robots_up(launch: Process, count: int) -> list[int]:
    """Process ids of the robots, once all of them are working."""
    pids = [int(await said(launch, rf"^robot {slot}: process (\d+)")) for slot in range(count)]
    await said(launch, rf"((WORKING.*){{{count}}})")
    return pids


async def states(folder: Path) -> dict[int, str]:
    code, out = await call(folder, "inspect", "--seconds", "0.6", "--json")
    assert code == 0, out
    return {r["slot"]: r["state"] for r in json.loads(out)["robots"] if not r["silent"]}
