"""The door to Prometheus: figures of a launch and alert rules, judged by promtool and a server."""

import asyncio
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.bench.figure import Figure
from tools.bench.prometheus_server import FILES, Alert, PrometheusServer, page
from tools.bench.systems import CounterpartAbsent
from tools.bench.vda5050.counterparts import drain, end, said, start

AGAINST = "promtool and prometheus of the distribution"
FIRES_S = 120.0
WANTED: set[Alert] = {("HeadlandRobotSilent", "1"), ("HeadlandRobotProcessEnded", "1")}


def figures(quick: bool) -> Iterator[Figure]:
    """What promtool finds, and whether a killed robot is told. Raises CounterpartAbsent."""
    if shutil.which("promtool") is None:
        raise CounterpartAbsent("promtool is not installed: apt install prometheus")
    if not FILES.is_dir():
        raise CounterpartAbsent("the rules are files of a checkout: examples/prometheus")
    with TemporaryDirectory(prefix="headland-prometheus-") as folder:
        text, fired_s = asyncio.run(_trial(Path(folder), quick))
    for what, words, given in (
        ("metrics of a launch", ("check", "metrics"), text),
        ("alert rules", ("check", "rules", "alerts.yml"), b""),
        ("tests of the alert rules", ("test", "rules", "alerts_test.yml"), b""),
    ):
        done = subprocess.run(
            ["promtool", *words], cwd=FILES, input=given, capture_output=True, check=False
        )
        remarks = len(done.stderr.splitlines()) + bool(done.returncode)
        yield Figure(
            f"Prometheus: remarks of promtool on the {what}", remarks, "", "= 0", not remarks,
            AGAINST, f"{len(text.splitlines())} lines of metrics" if given else "",
        )  # fmt: skip
    if quick:  # the rules wait before they fire
        return
    yield Figure(
        "Prometheus: alert on a killed robot", fired_s, "s", f"<= {FIRES_S:g}",
        fired_s <= FIRES_S, AGAINST, "from the kill until both alerts on it fire; a launch of two",
    )  # fmt: skip


async def _trial(folder: Path, quick: bool) -> tuple[bytes, float]:
    """The page of a launch, and seconds from a kill to its alerts."""
    launch = await start(folder, "launch", "small", "--robots", "2", "--fresh", "--metrics", "0")
    server: PrometheusServer | None = None
    fired_s = 0.0
    try:
        url = await said(launch, r"metrics: (http://\S+)")
        victim = int(await said(launch, r"robot 1: process (\d+)"))
        await said(launch, r"1:(WORKING|IDLE)")
        reading = asyncio.create_task(drain(launch))
        text = await asyncio.to_thread(page, url)
        if not quick:
            server = await PrometheusServer.start(folder, url)
            os.kill(victim, signal.SIGKILL)
            fired_s = await server.fires(WANTED, FIRES_S)
        reading.cancel()
    finally:
        if server is not None:
            await server.end()
        await end(launch)
    return text, fired_s
