"""A warehouse with real processes: a robot killed, and transports ordered while it runs."""

import asyncio
import json
import os
import signal
from pathlib import Path

from tests.tools.launching import WAIT_S, call, delivered, said, start

SCENARIO = """
name = "yard"
mission = "delivery"
[warehouse]
map = '''
..........
..........
..........
'''
handle_s = 0.5
bays = [[0.5, 2.5]]
[battery]
range_m = 200.0
[fleet]
robots = 2
"""
ORDERS = "pickup_x_m,pickup_y_m,dropoff_x_m,dropoff_y_m\n1.5,0.5,6.5,2.5\n4.5,0.5,7.5,1.5\n"


def test_a_launched_warehouse_takes_orders_and_outlives_a_robot(tmp_path: Path) -> None:
    (tmp_path / "yard.toml").write_text(SCENARIO)
    (tmp_path / "more.csv").write_text(ORDERS)

    async def story() -> None:
        launch = await start(tmp_path, "launch", "yard.toml", "--out", "out")
        try:
            port = await said(launch, r"socketcand \S+:(\d+)")
            pids = [int(await said(launch, rf"robot {slot}: process (\d+)")) for slot in range(2)]
            await said(launch, r"0/0 parcels  (.*IDLE.*IDLE)")
            os.kill(pids[1], signal.SIGKILL)
            await said(launch, r"(robot 1 has ended)")
            add = ("task", "add", "--file", "more.csv", "--scenario", "yard.toml", "--port", port)
            code, text = await call(tmp_path, *add, "--json")
            assert code == 0, text
            assert [json.loads(line) for line in text.splitlines()] == [
                {"task": 0, "known": True}, {"task": 1, "known": True},
            ]  # fmt: skip
            await delivered(int(port), 2)
            launch.send_signal(signal.SIGINT)
            async with asyncio.timeout(WAIT_S):
                await launch.communicate()
        finally:
            if launch.returncode is None:
                launch.kill()
                await launch.wait()
        report = json.loads((tmp_path / "out" / "report.json").read_text())
        print(report)
        assert launch.returncode == 130
        assert report["delivered"] == report["tasks"] == 2 and report["known_to_all"]
        assert report["contacts"] == 0 and not any(report["flaws"].values())
        assert report["robots_ended"] == [1] and report["lowest_battery"] < 1.0

    asyncio.run(story())
