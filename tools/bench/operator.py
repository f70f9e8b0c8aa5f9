"""The operator's tools: the map in a real browser, and what an open page costs a fleet.

Pictures are counted where they are drawn, in headless Chromium that draws without a graphics card.
"""

import asyncio
import contextlib
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

from rich.console import Console

from sim.record.recording import Recording
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench.browser import browser, missing, open_page, until
from tools.bench.figure import Figure, percentile
from tools.bench.stop import _Presses
from tools.build.warmup import warm
from tools.common.child_process import module_command
from tools.livemap.command import MapThread, recorded
from tools.livemap.playback import Index, Player
from tools.run.run_recorder import RunRecorder

ROBOTS = 20
COUNT = "[headland.pictures, headland.told]"
AT_ITS_OWN_SPEED = (
    "const s = document.getElementById('scrub'); s.value = 0; s.dispatchEvent(new Event('input'));"
    "s.dispatchEvent(new Event('change'));"
    "[...document.querySelectorAll('#speeds button')].find(b => b.dataset.speed === '1').click()"
)
HELPS = 5
JUMPS = 40
WAIT_S = 120.0  # for a page on a busy machine


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Time of `--help`, speed of the page on a long recording, and presses with the page open."""
    yield map_help()
    with tempfile.TemporaryDirectory() as folder:
        yield from map_recording(
            Path(folder), 10.0 if quick else 300.0, 4.0 if quick else 30.0, seed
        )
    yield from map_presses(2 if quick else 300)


def map_help() -> Figure:
    """CPU time, so that a busy machine does not count."""
    words = [*module_command("tools.cli.headland"), "--help"]
    times = []
    for _ in range(HELPS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(words, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    median_s = statistics.median(times)
    return Figure("headland --help", median_s, "s", "<= 0.3", median_s <= 0.3, "",
                  f"CPU time of the process, median of {HELPS}")  # fmt: skip


# -------------------------------------------------------------------- a recording of twenty robots


def map_recording(folder: Path, simulated_s: float, seconds: float, seed: int) -> Iterator[Figure]:
    """The page at 20 robots; the cost of keeping a run; jumps to any time of it."""
    scenario = load("oxted").changed(ROBOTS, seed)
    limit = scenario.run.model_copy(update={"time_limit_s": simulated_s})
    setting = FieldSetup(scenario.model_copy(update={"run": limit}))
    begun_s = time.process_time()
    plain = FieldRun(setting, folder).run()
    between_s = time.process_time()
    keeping = RunRecorder(setting, folder)
    kept = FieldRun(setting, folder, attach=keeping).run()
    keeping.close()
    ended_s = time.process_time()
    yield Figure("keeping a run as MCAP, with intents", (ended_s - between_s) / (between_s - begun_s) - 1,
                 "of its CPU time", "", None, "the same run with a CAN log only",
                 f"{ROBOTS} robots, {simulated_s:g} s simulated")  # fmt: skip
    yield Figure("trace hash of a run that is kept and of one that is not",
                 int(plain.trace_hash != kept.trace_hash), "differ", "0",
                 plain.trace_hash == kept.trace_hash, "", "the same seed")  # fmt: skip
    recording = recorded(folder, None)
    hashes = {
        keeping.log_hash,
        recording.digest.hex,
        recorded(folder / "run.mcap", None).digest.hex,
    }
    yield Figure("hash of the frames: run, replayed log, replayed MCAP", len(hashes), "hashes", "1",
                 len(hashes) == 1, "", f"{recording.count} frames")  # fmt: skip
    yield map_jumps(recording, seed)
    why = missing()
    if why:
        yield _unmeasured(why)
        return
    yield page_rate(folder, ROBOTS, seconds, 20.0)


def page_rate(folder: Path, robots: int, seconds: float, least: float) -> Figure:
    """Pictures a second of the run in `folder`, at its own speed, for `seconds` after the third."""
    shown = MapThread(recorded(folder, None), "bench", 0)
    with browser() as page:
        page.get(shown.url)
        until(page, f"headland.told > 3 && headland.state().robots.length === {robots}", WAIT_S)
        page.execute_script(AT_ITS_OWN_SPEED)
        until(page, "headland.state().speed === 1 && headland.state().t < 3", WAIT_S)
        (first, told), begun_s = page.execute_script(f"return {COUNT}"), time.perf_counter()
        until(page, f"headland.state().t > {3 + seconds}", WAIT_S)
        (last, heard), ended_s = page.execute_script(f"return {COUNT}"), time.perf_counter()
    a_second = (last - first) / (ended_s - begun_s)
    return Figure(f"page at {robots} robots", a_second, "pictures/s", f">= {least:g}", a_second >= least,
                  "", f"headless Chromium, 1440 x 900, drawn by the CPU; a recording at its own speed; "
                  f"{(heard - told) / (ended_s - begun_s):.1f} messages/s; load of the machine "
                  f"{os.getloadavg()[0]:.1f}")  # fmt: skip


def map_jumps(recording: Recording, seed: int) -> Figure:
    """How long a person waits after pulling the slider."""
    index, rng, times = Index(recording), Random(f"{seed}/jumps"), []
    index.work(WAIT_S)
    player = Player(index, False, 1.0)
    player.playing = False
    for _ in range(JUMPS):
        begun_s = time.process_time()
        player.seek(rng.randrange(recording.begin_at_us, recording.end_at_us))
        player.advance(0.0, WAIT_S)
        times.append(time.process_time() - begun_s)
    worst_s = max(times)
    return Figure("jump to any time of a recording, longest", worst_s * 1000, "ms", "", None, "",
                  f"CPU time, {JUMPS} jumps over {recording.end_at_us / 1e6:.0f} s of {ROBOTS} robots, "
                  f"median {statistics.median(times) * 1000:.0f} ms")  # fmt: skip


def _unmeasured(why: str) -> Figure:
    return Figure(
        f"page at {ROBOTS} robots", 0.0, "pictures/s", ">= 20", None, "", f"not measured: {why}"
    )


# -------------------------------------------------------------------- stops with the page open


def map_presses(count: int) -> Iterator[Figure]:
    """The stop bench's launch, without and with a map whose page is open."""
    if missing():
        return
    warm(steering=False)
    for name, launch in (("without a map", _Presses), ("with the page open", _Watched)):
        with tempfile.TemporaryDirectory() as folder:
            running = launch(count, Path(folder))
            with contextlib.redirect_stdout(sys.stderr):
                asyncio.run(running.run(0, None))
        times = sorted(running.times_s)
        complete = len(times) == count
        p999_s = percentile(times, 0.999) if times else 0.0
        scope = f"6 processes on the hub, {len(times)} of {count} presses; load {os.getloadavg()[0]:.1f}"
        if isinstance(running, _Watched):
            scope += f"; {running.pictures_a_second:.1f} pictures/s meanwhile"
        yield Figure(f"press to last echo {name}, p99.9", p999_s * 1000, "ms", "<= 50",
                     complete and p999_s <= 0.050, "the other, in this run", scope)  # fmt: skip
        yield Figure(f"press to last echo {name}, longest", times[-1] * 1000 if times else 0.0,
                     "ms", "<= 320", complete and times[-1] <= 0.320, "", scope)  # fmt: skip


class _Watched(_Presses):
    """The same with a map, and a browser that looks at it."""

    def __init__(self, count: int, out: Path) -> None:
        super().__init__(count, out)
        self.page_port = 0
        self.map_out = asyncio.subprocess.PIPE
        self.url = ""
        self.console = Console(stderr=True, quiet=True)
        self.pictures_a_second = 0.0

    async def _start_map(self) -> None:
        await super()._start_map()
        assert self.map is not None and self.map.stdout is not None
        self.url = (await self.map.stdout.readline()).decode().split()[1]

    async def _watch(self, end: asyncio.Event, seconds: float | None) -> bool:
        opened, over = threading.Event(), threading.Event()
        looking = asyncio.create_task(asyncio.to_thread(self._look, opened, over))
        await asyncio.to_thread(opened.wait, WAIT_S)
        try:
            return await super()._watch(end, seconds)
        finally:
            over.set()
            await looking

    def _look(self, opened: threading.Event, over: threading.Event) -> None:
        try:
            with browser() as page:
                open_page(page, self.url, WAIT_S)
                until(page, "headland.told > 10", WAIT_S)
                (first, _), begun_s = page.execute_script(f"return {COUNT}"), time.perf_counter()
                opened.set()
                over.wait()
                (last, _), ended_s = page.execute_script(f"return {COUNT}"), time.perf_counter()
                self.pictures_a_second = (last - first) / (ended_s - begun_s)
        finally:
            opened.set()
