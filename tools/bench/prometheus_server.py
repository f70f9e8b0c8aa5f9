"""A Prometheus of the distribution that reads a launch, with the rules of our examples.

The bench of the door and the test of its alerts start the same server.
"""

import asyncio
import json
import shutil
from asyncio.subprocess import DEVNULL, Process
from pathlib import Path
from typing import Self
from urllib.request import urlopen

from tools.bench.vda5050.counterparts import end, free_port

FILES = Path(__file__).parents[2] / "examples" / "prometheus"
EXAMPLE = "127.0.0.1:9464"  # what the example's configuration reads
LOOK_S = 0.5
ANSWER_S = 10.0
Alert = tuple[str, str | None]  # its name, and the robot that it names


class PrometheusServer:
    """One server on a free port of loopback."""

    def __init__(self, process: Process, port: int) -> None:
        self._process, self._alerts = process, f"http://127.0.0.1:{port}/api/v1/alerts"

    @classmethod
    async def start(cls, folder: Path, metrics_url: str) -> Self:
        """Reads `metrics_url`; returns once it answers. Its files are in `folder`."""
        target, port = metrics_url.removeprefix("http://").removesuffix("/metrics"), free_port()
        config = (FILES / "prometheus.yml").read_text().replace(EXAMPLE, target)
        (folder / "prometheus.yml").write_text(config)
        shutil.copy(FILES / "alerts.yml", folder)
        process = await asyncio.create_subprocess_exec(
            "prometheus", f"--config.file={folder / 'prometheus.yml'}",
            f"--storage.tsdb.path={folder / 'data'}", f"--web.listen-address=127.0.0.1:{port}",
            stdout=DEVNULL, stderr=DEVNULL,
        )  # fmt: skip
        server = cls(process, port)
        while await server.firing() is None:
            await asyncio.sleep(LOOK_S)
        return server

    async def firing(self) -> set[Alert] | None:
        """The alerts that fire; None: the server does not answer."""
        try:
            text = await asyncio.to_thread(page, self._alerts)
        except OSError:
            return None
        labels = [a["labels"] for a in json.loads(text)["data"]["alerts"] if a["state"] == "firing"]
        return {(label["alertname"], label.get("robot")) for label in labels}

    async def fires(self, wanted: set[Alert], within_s: float) -> float:
        """Seconds until all of `wanted` fire, or more than `within_s`."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        while not (await self.firing() or set()) >= wanted and loop.time() - begun_s <= within_s:
            await asyncio.sleep(LOOK_S)
        return loop.time() - begun_s

    async def end(self) -> None:
        await end(self._process)


def page(url: str) -> bytes:
    """The body of a page. OSError."""
    with urlopen(url, timeout=ANSWER_S) as answer:
        text: bytes = answer.read()
    return text
