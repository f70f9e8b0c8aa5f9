"""A warehouse with real processes: a robot killed, and transports ordered while it runs."""

import os
import signal
from asyncio.subprocess import Process
from pathlib import Path

import pytest

from tests.tools.launching import said
from tests.tools.yard import KNOWN, play


async def kill_one(launch: Process) -> None:
    pids = [int(await said(launch, rf"robot {slot}: process (\d+)")) for slot in range(2)]
    await said(launch, r"0/0 parcels  (.*IDLE.*IDLE)")
    os.kill(pids[1], signal.SIGKILL)
    await said(launch, r"(robot 1 has ended)")


@pytest.mark.slow
def test_a_launched_warehouse_takes_orders_and_outlives_a_robot(tmp_path: Path) -> None:
    told = play(tmp_path, "launch", "yard.toml", before=kill_one)
    assert (told.code, told.known, told.ended) == (0, KNOWN, 130)
    report = told.report
    assert report["delivered"] == report["tasks"] == 2 and report["known_to_all"]
    assert report["contacts"] == 0 and not any(report["flaws"].values())
    assert report["robots_ended"] == [1] and report["lowest_battery"] < 1.0
