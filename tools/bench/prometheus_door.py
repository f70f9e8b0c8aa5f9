"""The door to Prometheus: figures of a launch and alert rules, judged by promtool and a server."""

import asyncio
import json
import os
import shutil
import signal
import subprocess
from asyncio.subprocess import DEVNULL, Process
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.request import urlopen

from tools.bench.figure import Figure
from tools.bench.systems import CounterpartAbsent
from tools.bench.vda5050.counterparts import drain, end, free_port, said, start

FILES = Path(__file__).parents[2] / "examples" / "prometheus"
AGAINST = "promtool and prometheus of the distribution"
FIRES_S = 120.0
LOOK_S = 0.5
WANTED = {("HeadlandRobotSilent", "1"), ("HeadlandRobotProcessEnded", "1")}


def figures(quick: bool) -> Iterator[Figure]:
    """What promtool finds, and whether a killed robot is told. Raises CounterpartAbsent."""
    if shutil.which("promtool") is None:
        raise CounterpartAbsent("promtool is not installed: apt install prometheus")
    if not FILES.is_dir():
        raise CounterpartAbsent("the rules are files of a checkout: examples/prometheus")
    with TemporaryDirectory(prefix="headland-prometheus-") as folder:
        page, fired_s = asyncio.run(_trial(Path(folder), quick))
    for what, words, given in (
        ("metrics of a launch", ("check", "metrics"), page),
        ("alert rules", ("check", "rules", "alerts.yml"), b""),
        ("tests of the alert rules", ("test", "rules", "alerts_test.yml"), b""),
    ):
        done = subprocess.run(
            ["promtool", *words], cwd=FILES, input=given, capture_output=True, check=False
        )
        remarks = len(done.stderr.splitlines()) + bool(done.returncode)
        yield Figure(
            f"Prometheus: remarks of promtool on the {what}", remarks, "", "= 0", not remarks,
            AGAINST, f"{len(page.splitlines())} lines of metrics" if given else "",
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
    server: Process | None = None
    fired_s = 0.0
    try:
        url = await said(launch, r"metrics: (http://\S+)")
        victim = int(await said(launch, r"robot 1: process (\d+)"))
        await said(launch, r"1:(WORKING|IDLE)")
        reading = asyncio.create_task(drain(launch))
        page = await asyncio.to_thread(_page, url)
        if not quick:
            port = free_port()
            target = url.removeprefix("http://").removesuffix("/metrics")
            config = (FILES / "prometheus.yml").read_text().replace("127.0.0.1:9464", target)
            (folder / "prometheus.yml").write_text(config)
            shutil.copy(FILES / "alerts.yml", folder)
            server = await asyncio.create_subprocess_exec(
                "prometheus", f"--config.file={folder / 'prometheus.yml'}",
                f"--storage.tsdb.path={folder / 'data'}", f"--web.listen-address=127.0.0.1:{port}",
                stdout=DEVNULL, stderr=DEVNULL,
            )  # fmt: skip
            while not await _firing(port):
                await asyncio.sleep(LOOK_S)
            loop = asyncio.get_running_loop()
            begun_s = loop.time()
            os.kill(victim, signal.SIGKILL)
            while not (await _firing(port) or set()) >= WANTED:
                fired_s = loop.time() - begun_s
                if fired_s > FIRES_S:
                    break
                await asyncio.sleep(LOOK_S)
        reading.cancel()
    finally:
        await end(server)
        await end(launch)
    return page, fired_s


async def _firing(port: int) -> set[tuple[str, str | None]] | None:
    """Alerts that fire, with their robot, and one for the server itself; None: it does not answer."""
    try:
        text = await asyncio.to_thread(_page, f"http://127.0.0.1:{port}/api/v1/alerts")
    except OSError:
        return None
    alerts = json.loads(text)["data"]["alerts"]
    firing = [alert["labels"] for alert in alerts if alert["state"] == "firing"]
    return {("up", None), *((labels["alertname"], labels.get("robot")) for labels in firing)}


def _page(url: str) -> bytes:
    with urlopen(url, timeout=10.0) as answer:
        text: bytes = answer.read()
    return text
