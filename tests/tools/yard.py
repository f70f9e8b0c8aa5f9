"""A small warehouse in real time, with two robots, in which a test orders two transports by a file."""

import asyncio
import json
import signal
from asyncio.subprocess import Process
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, NamedTuple

from tests.tools.launching import WAIT_S, call, delivered, said, start

SCENARIO = """
name = "yard"
mission = "delivery"
[warehouse]
map = '''
......
......
......
'''
handle_s = 0.5
bays = [[0.5, 2.5]]
[battery]
range_m = 200.0
[fleet]
robots = 2
"""
CSV = "pickup_x_m,pickup_y_m,dropoff_x_m,dropoff_y_m,at_s\n1.5,0.5,3.5,2.5,\n2.5,0.5,4.5,1.5,7.5\n"
KNOWN = [{"task": 0, "known": True}, {"task": 1, "known": True}]


class Told(NamedTuple):
    """What `task add --json` said, how the run ended after Ctrl-C, and its report."""

    code: int
    known: list[Any]
    ended: int | None
    report: dict[str, Any]


def play(
    folder: Path, *words: str, before: Callable[[Process], Awaitable[None]] | None = None
) -> Told:
    """`words`: the command behind `headland`. `before`: what happens before the orders."""
    (folder / "yard.toml").write_text(SCENARIO)
    (folder / "more.csv").write_text(CSV)

    async def story() -> Told:
        process = await start(folder, *words, "--out", "out")
        try:
            port = await said(process, r"socketcand \S+:(\d+)")
            if before is not None:
                await before(process)
            # `--out` is not the newest launch.
            scenario = ("--scenario", "yard.toml") if words[0] == "launch" else ()
            add = ("task", "add", "--file", "more.csv", *scenario, "--json")
            own = ("--keys", "out/keys") if words[0] == "launch" else ()
            code, text = await call(folder, *add, *own, "--port", port)
            print(text)
            await delivered(int(port), 2)
            process.send_signal(signal.SIGINT)
            async with asyncio.timeout(WAIT_S):
                await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        report = json.loads((folder / "out" / "report.json").read_text())
        print(report)
        return Told(code, json.loads(text), process.returncode, report)

    return asyncio.run(story())
