"""The first hour of a new user: start, install, typing errors, the tools of the bus, prose.

A quick run skips what needs a fresh environment or the browser: the size of the install, and the tests
of the operator's round, of axe-core and of the documents' blocks.
"""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import NamedTuple

from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench import wrong_inputs
from tools.bench.browser import missing
from tools.bench.crowded_map import record
from tools.bench.figure import Figure
from tools.bench.operator import page_rate
from tools.bench.typos import answers
from tools.build.prose_checker import LONG, LONG_SHARE_MAX, MEDIAN_MAX, pages, sentences
from tools.run.run_recorder import RunRecorder

ROOT = Path(__file__).parents[2]
COLD_S_MAX, WARM_S_MAX, START_S_MAX, INSTALL_MB_MAX = 100.0, 8.0, 0.3, 100
REPORT_S_MAX, REPORTS = 3.0, 5  # of the demo's run; the median of so many
FIRST_PICTURE_S_MAX = 600.0  # then it is given up
END_S = 20.0  # for a run to write its report when it is interrupted
STARTS = 5  # of each tool; the least is that of the tool, the rest is the machine
TOOLS = ("inspect", "estop", "dbc", "say", "map")
ENDS = {  # until when it is measured: with which words
    "until its help is printed": dict.fromkeys(TOOLS, "--help"),
    "until it has worked or found no launch": dict.fromkeys(TOOLS, "") | {"say": "stop"},
}
# Robots: pictures a second of the map; its server tells thirty.
RATES = {20: 29.5, 100: 20.0}
SIMULATED_MAX = 20  # robots; of more only the frames are made, see `crowded_map`
RATE_RUN_S, RATE_S = 12.0, 8.0  # simulated, and watched of it
MB = 1e6
NO_LAUNCH = 2  # the exit code of a tool that finds none
# Tests of what a person does, by what they show.
ROUNDS = (
    ("an operator's round by keyboard and by touch at 390 x 844, axe: findings", "every step, 0",
     "tests/tools/livemap/test_map_work.py"),
    ("blocks of the first tutorial that run as they stand", "all",
     "tests/tools/cli/test_documented_commands.py -k tutorial"),
    ("blocks of the other tutorials that run as they stand", "all",
     "tests/tools/cli/test_tutorials.py"),
    ("examples and notebooks that run as they stand", "all", "tests/tools/run/test_examples.py"),
    ("wrong inputs of the command line that are not one line", "0",
     "tests/tools/cli/test_wrong_words.py"),
)  # fmt: skip


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Every row of the target table. `seed`: of the run whose first picture is waited for."""
    yield from _typos()
    yield _inputs()
    yield from _prose()
    yield from _starts(ToolStart(sys.executable, "this environment", str(ROOT)))
    yield from _pages(seed)
    yield _warm(seed)
    if quick:
        return
    cold = _cold()
    if cold is not None:
        yield cold
    yield from _install()
    yield _report(seed)
    for name, target, test in ROUNDS:
        failed = _tests_that_fail(test)
        yield Figure(name, float(failed), "tests fail", target, failed == 0, "", test)


def _typos() -> Iterator[Figure]:
    found = list(answers())
    wrong = sum(not answer.good for _, answer in found)
    yield Figure(
        "typing errors in a scenario that are not one line with what and where", float(wrong), "",
        "<= 0", wrong == 0, "", f"{len(found)} files; a traceback would end the bench",
    )  # fmt: skip


def _inputs() -> Figure:
    found = [answer.good for _, answer in wrong_inputs.answers()]
    wrong = len(found) - sum(found)
    return Figure(
        "wrong files, numbers, folders, ports and names that are not one line with what and where",
        float(wrong), "", "<= 0", wrong == 0, "",
        f"{len(found)} calls over all commands; a traceback would end the bench",
    )  # fmt: skip


def _prose() -> Iterator[Figure]:
    counts = [
        words for path in pages(ROOT) for words, _ in sentences(path.read_text(encoding="utf-8"))
    ]
    if not counts:
        return  # no checkout: the documents are not installed
    middle, share = float(median(counts)), sum(words > LONG for words in counts) / len(counts)
    scope = f"{len(counts)} sentences of README.md and docs, without code and tables"
    yield Figure("words of a sentence, median", middle, "words", f"<= {MEDIAN_MAX}",
                 middle <= MEDIAN_MAX, "", scope)  # fmt: skip
    yield Figure(f"sentences over {LONG} words", share, "share", f"<= {LONG_SHARE_MAX:g}",
                 share <= LONG_SHARE_MAX, "", scope)  # fmt: skip


class ToolStart(NamedTuple):
    """From where a tool is started."""

    python: str
    where: str
    path: str = ""  # of the layers, where they are not installed


def _starts(start: ToolStart) -> Iterator[Figure]:
    """CPU time: the time by the clock is that of whatever else runs here."""
    for until, ends in ENDS.items():
        slowest = max(
            min(_cpu_s(start, f"{tool} {end}") for _ in range(STARTS)) for tool, end in ends.items()
        )
        yield Figure(
            f"start of a tool of the bus in {start.where}, {until}, the slowest", slowest, "CPU s",
            f"<= {START_S_MAX:g}", slowest <= START_S_MAX, "",
            f"{', '.join(ends)}; least of {STARTS} starts each",
        )  # fmt: skip


def _cpu_s(start: ToolStart, words: str) -> float:
    """Of one call, in a folder without a launch."""
    environment = {**os.environ, "PYTHONPATH": start.path}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # a person's second start compiles nothing
    before_s = _cpu_of_children_s()
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [start.python, "-m", "headland", *words.split()], cwd=folder, check=False, env=environment,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    if done.returncode not in (0, NO_LAUNCH):
        raise RuntimeError(f"headland {words} in {start.where} ended with {done.returncode}")
    return _cpu_of_children_s() - before_s


def _cpu_of_children_s() -> float:
    """Of all that this process has started and that has ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _report(seed: int) -> Figure:
    """The whole run of the demo, as `headland report` shows it: what a person waits for."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    took_s = []
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "headland"]
        words = [*command, "run", "oxted", "--seed", str(seed), "--out", "demo", "--json"]
        subprocess.run(words, cwd=folder, check=False, env=environment, stdout=subprocess.DEVNULL)
        for _ in range(REPORTS):
            begun_s = perf_counter()
            subprocess.run([*command, "report", "demo"], cwd=folder, check=True, env=environment,
                           stdout=subprocess.DEVNULL)  # fmt: skip
            took_s.append(perf_counter() - begun_s)
    took = median(took_s)
    return Figure(
        "headland report of the demo's run", took, "s", f"<= {REPORT_S_MAX:g}",
        took <= REPORT_S_MAX, "",
        f"by the clock, median of {REPORTS}; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
    )  # fmt: skip


class FirstPicture(NamedTuple):
    """How long a run took to show a robot that moves; infinite if it never did."""

    wall_s: float
    cpu_s: float  # of all its processes, to their end


def _first_picture(words: Sequence[str], folder: Path, **environment: str) -> FirstPicture:
    """From the start of a command to the first robot that moves, as the socket of its map tells it."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    used, begun_s, wall_s = _cpu_of_children_s(), perf_counter(), float("inf")
    run = subprocess.Popen(
        words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True, env={**os.environ, **environment},
    )  # fmt: skip
    try:
        assert run.stdout is not None
        lines = (re.search(r"http://(\S+?)/#([\w-]+)", line) for line in run.stdout)
        address = next((found for found in lines if found), None)
        if address is not None:
            protocols = [Subprotocol("headland"), Subprotocol(address[2])]
            with connect(
                f"ws://{address[1]}/ws", subprotocols=protocols, open_timeout=FIRST_PICTURE_S_MAX
            ) as page:
                pictures = 0
                while perf_counter() - begun_s < FIRST_PICTURE_S_MAX:
                    told = json.loads(page.recv(timeout=FIRST_PICTURE_S_MAX))
                    if any(robot["v"] > 0 for robot in told.get("robots", ())):
                        wall_s = perf_counter() - begun_s
                        break
                    pictures += told["kind"] == "now"
                    page.send(json.dumps({"do": "drawn", "count": pictures}))
    except (ConnectionClosed, TimeoutError):
        pass
    finally:
        _end(run)
    return FirstPicture(wall_s, _cpu_of_children_s() - used)


def _end(run: "subprocess.Popen[str]") -> None:
    """With all that it started: make and what make runs are a group."""
    for number in (signal.SIGINT, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(run.pid, number)
        with suppress(subprocess.TimeoutExpired):
            run.wait(END_S)
            return


def _warm(seed: int) -> Figure:
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "tools.cli.headland", "run", "oxted", "--map", "--page-port", "0",
                 "--seed", str(seed), "--json"]  # fmt: skip
        start = _first_picture(words, Path(folder), PYTHONPATH=str(ROOT))
    return Figure(
        "headland run --map, warm: start to the first moving picture", start.wall_s, "s",
        f"<= {WARM_S_MAX:g}", start.wall_s <= WARM_S_MAX, "",
        f"a real page's socket; kernels are compiled; {start.cpu_s:.1f} CPU s, other work on the machine "
        "counts by the clock",
    )  # fmt: skip


def _cold() -> Figure | None:
    """`make demo` in a fresh clone with an empty home, so that nothing is in a cache. None: there is
    no checkout to clone."""
    if not (ROOT / ".git").exists():
        return None
    with tempfile.TemporaryDirectory() as folder:
        clone, home = Path(folder, "headland"), Path(folder, "home")
        home.mkdir()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        python = Path(sys.base_prefix, "bin", "python3")
        words = ["make", "demo", f"PYTHON={python}", "OPTIONS=--page-port 0"]
        start = _first_picture(
            words, clone, HOME=str(home), UV_CACHE_DIR=str(home / "uv"), PIP_NO_CACHE_DIR="1"
        )  # fmt: skip
    return Figure(
        "make demo on a fresh clone, nothing cached: start to the first moving picture", start.wall_s,
        "s", f"<= {COLD_S_MAX:g}", start.wall_s <= COLD_S_MAX, "",
        f"download, install, compile; {start.cpu_s:.1f} CPU s in all, {os.cpu_count()} cores; other work "
        "on the machine counts by the clock",
    )  # fmt: skip


def _size_mb(folder: Path) -> float:
    """What a folder takes on the disk."""
    blocks = (path.lstat().st_blocks for path in folder.rglob("*") if path.is_file())
    return sum(blocks) * 512 / MB


def _install() -> Iterator[Figure]:
    """What the wheel of this checkout adds to a new environment, with all that it needs, and the start
    of its tools."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        pip = [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--no-deps",
            "-w",
            folder,
            str(ROOT),
        ]
        subprocess.run(pip, check=True, stderr=subprocess.DEVNULL)
        subprocess.run([sys.executable, "-m", "venv", folder + "/env"], check=True)
        (wheel,) = here.glob("headland-*.whl")
        bare_mb = _size_mb(here / "env")
        # Where PYTHONPATH leads to the checkout, pip finds that headland is there already.
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        subprocess.run([folder + "/env/bin/pip", "install", "--quiet", str(wheel)], check=True,
                       stderr=subprocess.DEVNULL, env=clean, cwd=folder)  # fmt: skip
        whole_mb = _size_mb(here / "env")
        added_mb = whole_mb - bare_mb
        for name, size_mb in (
            ("base install: what the tools of the bus add to a new environment", added_mb),
            ("base install: the whole new environment, with its pip", whole_mb),
        ):
            yield Figure(
                name, size_mb, "MB", f"<= {INSTALL_MB_MAX}", size_mb <= INSTALL_MB_MAX, "",
                f"blocks on the disk; a wheel in a new venv of Python {sys.version.split()[0]}",
            )  # fmt: skip
        yield from _starts(ToolStart(folder + "/env/bin/python", "the base install"))


def _pages(seed: int) -> Iterator[Figure]:
    """How often the map draws in a real browser."""
    why = missing()
    for robots, least in RATES.items():
        if why:
            yield Figure(f"page at {robots} robots", 0.0, "pictures/s", f">= {least:g}", None, "",
                         f"not measured: {why}")  # fmt: skip
            continue
        with tempfile.TemporaryDirectory() as folder:
            if robots > SIMULATED_MAX:
                record(Path(folder), robots, RATE_RUN_S, seed)
            else:
                _simulate(Path(folder), robots, seed)
            yield page_rate(Path(folder), robots, RATE_S, least)


def _simulate(folder: Path, robots: int, seed: int) -> None:
    scenario = load("oxted").changed(robots, seed)
    limit = scenario.run.model_copy(update={"time_limit_s": RATE_RUN_S})
    setup = FieldSetup(scenario.model_copy(update={"run": limit}))
    keeping = RunRecorder(setup, folder)
    FieldRun(setup, folder, attach=keeping).run()
    keeping.close()


def _tests_that_fail(words: str) -> int:
    """How many; 0 only where at least one passed."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-o", "addopts=--import-mode=importlib -p no:anyio",
         *words.split()],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    passed = re.search(r"(\d+) passed", done.stdout)
    bad = sum(int(n) for n in re.findall(r"(\d+) (?:failed|error)", done.stdout))
    return bad if passed or bad else 1
