"""The growth of a launch of ten robots with its map in a day, from its growth after a warm-up.

Memory is the anonymous memory of each process (`RssAnon` of `/proc`), which the process has allocated
and which cannot be dropped. A page shows the map all the time, as an operator's does. Files are those
in the folder of the launch, except those with a bound of their own: `can.log` and `run.mcap`, in parts
up to `sim.files.log_parts.LAUNCH_LIMIT` each, and the write-ahead logs of the journals, which sqlite
keeps at 4 MB. Open files of robots, sockets included, are counted.
"""

import contextlib
import json
import os
import queue
import re
import signal
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tools.bench.figure import Figure
from tools.common.child_process import module_command

ROBOTS = 10
SECONDS, QUICK_S = 1800.0, 60.0
WARM_UP = 1 / 3  # of the time: kernels are loaded, caches fill, the first plans are made
SAMPLE_S = 5.0
BEGIN_S = 120.0  # until ten robots are there, on a busy machine
END_S = 30.0
DAY_S = 86_400.0
NO_PROCESS = 0
BOUNDED = re.compile(r"(can(\.\d+)?\.log|run(\.\d+)?\.mcap|robot\d+\.sqlite-wal)")
TARGET_MB = 200.0  # in a day, of all processes: a machine of 4 GB runs for a season


class Grown(NamedTuple):
    """One process over the time that is fitted."""

    kind: str  # launch, map, robot, files
    slope_bytes_s: float
    size_bytes: int  # at the end


def figures(quick: bool, seed: int = 1, seconds: float | None = None) -> Iterator[Figure]:
    """`seconds`: of the run, warm-up included."""
    seconds = seconds or (QUICK_S if quick else SECONDS)
    files_held: dict[int, list[int]] = {}  # process -> how many, at each sample
    with tempfile.TemporaryDirectory() as folder:
        samples = _run(Path(folder), seconds, seed, files_held)
    begin_s = min(t_s for t_s, _, _, _ in samples) + seconds * WARM_UP
    grown = list(_grown([each for each in samples if each[0] >= begin_s]))
    scope = (
        f"{seconds:.0f} s, the first {seconds * WARM_UP:.0f} s left out, a sample each {SAMPLE_S:g} s, "
        f"Theil-Sen; RssAnon, and files but logs of bounded size; {ROBOTS} robots, seed {seed}, "
        f"a page looks; load {os.getloadavg()[0]:.1f}"
    )
    for kind in ("launch", "map", "robot", "files"):
        own = [each for each in grown if each.kind == kind]
        name = f"{len(own)} robots" if kind == "robot" else kind
        grown_mb = sum(each.slope_bytes_s for each in own) * DAY_S / 1e6
        size_mb = sum(each.size_bytes for each in own) / 1e6
        yield Figure(f"growth of {name} in 24 h", grown_mb, "MB", "", None, "",
                     f"{size_mb:.0f} MB at the end; {scope}")  # fmt: skip
    held = [counts for counts in files_held.values() if len(counts) > 2]
    more = sum(counts[-1] - counts[int(len(counts) * WARM_UP)] for counts in held)
    judged = seconds >= SECONDS  # a shorter run says too little about a day
    yield Figure("growth of the open files of robots", more, "", "<= 0" if judged else "",
                 more <= 0 if judged else None, "",
                 f"{sum(counts[-1] for counts in held)} at the end; {scope}")  # fmt: skip
    total_mb = sum(each.slope_bytes_s for each in grown) * DAY_S / 1e6
    yield Figure("growth of launch, robots, map and files in 24 h", total_mb, "MB",
                 f"<= {TARGET_MB:g}" if judged else "", total_mb <= TARGET_MB if judged else None, "",
                 f"extrapolated; {len(grown) - 1} processes and their files; {scope}")  # fmt: skip


Sample = tuple[float, int, str, int]  # seconds, process, kind, bytes


def _grown(samples: list[Sample]) -> Iterator[Grown]:
    for process in sorted({pid for _, pid, _, _ in samples}):
        own = [(t_s, size) for t_s, pid, _, size in samples if pid == process]
        kind = next(kind for _, pid, kind, _ in samples if pid == process)
        if len(own) > 2:
            yield Grown(kind, _slope(own), own[-1][1])


def _slope(points: list[tuple[float, int]]) -> float:
    """Theil and Sen: the median of the slopes between all pairs; jumps of single samples do not count."""
    return statistics.median(
        (size - before) / (t_s - was_s)
        for k, (t_s, size) in enumerate(points)
        for was_s, before in points[:k]
        if t_s > was_s
    )


# A job of 18 hours for weeders, so that robots drive all the time. Tables with a limit are full after
# some hundred units of work: with slower robots, they would fill for longer than the warm-up.
WIDE_DEGREES, HIGH_DEGREES = 0.022, 0.009  # 1.5 by 1 km
CORNERS = [(0, 0), (WIDE_DEGREES, 0), (WIDE_DEGREES, HIGH_DEGREES), (0, HIGH_DEGREES), (0, 0)]
RING = [[5.0 + east, 52.0 + north] for east, north in CORNERS]
FIELD = {
    "type": "Feature",
    "properties": {},
    "geometry": {"type": "Polygon", "coordinates": [RING]},
}
SCENARIO = f"""
name = "leaks"
[field]
file = "field.geojson"
[fleet]
robots = {ROBOTS}
speed_m_s = 0.6
silence = "continue"
"""


def _run(folder: Path, seconds: float, seed: int, files_held: dict[int, list[int]]) -> list[Sample]:
    (folder / "leaks.toml").write_text(SCENARIO)
    (folder / "field.geojson").write_text(json.dumps(FIELD))
    words = [*module_command("tools.cli.headland"), "launch", "leaks.toml", "--seed", str(seed),
             "--map", "--page-port", "0", "--out", "launch"]  # fmt: skip
    process = subprocess.Popen(
        words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_read, args=(process, lines), daemon=True).start()
    over = threading.Event()
    try:
        url = _url(lines)
        threading.Thread(target=_look, args=(url, over), daemon=True).start()
        return list(_samples(process.pid, seconds, folder / "launch", files_held))
    finally:
        over.set()
        process.send_signal(signal.SIGINT)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _read(process: "subprocess.Popen[str]", lines: "queue.Queue[str]") -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")


def _url(lines: "queue.Queue[str]") -> str:
    told = []
    while line := lines.get(timeout=BEGIN_S):
        told.append(line)
        if line.startswith("map: "):
            return line.split()[1]
    raise RuntimeError("the launch has ended: " + "".join(told))


def _look(url: str, over: threading.Event) -> None:
    """What a page does: it hears each picture and says that it has drawn it."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    address, token = url.split("#")
    protocols: Any = ["headland", token]
    drawn = 0
    with contextlib.suppress(ConnectionClosed, OSError):
        where = address.replace("http", "ws") + "ws"
        with connect(where, subprotocols=protocols, max_size=None) as page:
            while not over.is_set():
                if json.loads(page.recv())["kind"] == "now":
                    drawn += 1
                    page.send(json.dumps({"do": "drawn", "count": drawn}))


def _samples(
    launch: int, seconds: float, files: Path, files_held: dict[int, list[int]]
) -> Iterator[Sample]:
    begun_s = time.monotonic()
    while (now_s := time.monotonic()) - begun_s < seconds:
        for process, kind in _processes(launch).items():
            with contextlib.suppress(OSError, ValueError):  # it has just ended
                yield now_s, process, kind, _anonymous_bytes(process)
                if kind == "robot":
                    count = sum(1 for _ in Path(f"/proc/{process}/fd").iterdir())
                    files_held.setdefault(process, []).append(count)
        yield now_s, NO_PROCESS, "files", _file_bytes(files)
        time.sleep(SAMPLE_S)


def _file_bytes(folder: Path) -> int:
    total = 0
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # it has just been put away
            total += 0 if BOUNDED.fullmatch(path.name) else path.stat().st_size
    return total


def _processes(launch: int) -> dict[int, str]:
    found = {launch: "launch"}
    for task in Path(f"/proc/{launch}/task").iterdir():
        for child in (task / "children").read_text().split():
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
                found[int(child)] = "map" if b"map" in words else "robot"
    return found


def _anonymous_bytes(process: int) -> int:
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024
    raise ValueError("no RssAnon")
