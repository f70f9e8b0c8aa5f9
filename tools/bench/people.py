"""The first hour of a new user: start, install, typing errors, the tools of the bus, prose.

A quick run skips what needs a fresh environment or the browser: the size of the install, and the tests
of the operator's round, of axe-core and of the documents' blocks.
"""

import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from time import perf_counter

from tools.bench.figure import Figure
from tools.bench.typos import answers
from tools.build.prose_checker import LONG, LONG_SHARE_MAX, MEDIAN_MAX, pages, sentences

ROOT = Path(__file__).parents[2]
WARM_S_MAX, START_S_MAX, INSTALL_MB_MAX = 8.0, 0.3, 100
FIRST_PICTURE_S_MAX = 120.0  # then it is given up
STARTS = 5  # of each tool; the least is that of the tool, the rest is the machine
TOOLS = ("inspect", "estop", "dbc", "say", "map")
ENDS = {  # until when it is measured: with which words
    "until its help is printed": dict.fromkeys(TOOLS, "--help"),
    "until it has worked or found no launch": dict.fromkeys(TOOLS, "") | {"say": "stop"},
}
MB = 1e6
# Tests of what a person does, by what they show.
ROUNDS = (
    ("an operator's round by keyboard and by touch at 390 x 844, axe: findings", "every step, 0",
     "tests/tools/livemap/test_map_work.py"),
    ("blocks of the tutorial that run as they stand", "all",
     "tests/tools/cli/test_documented_commands.py -k tutorial"),
    ("wrong inputs of the command line that are not one line", "0",
     "tests/tools/cli/test_wrong_words.py"),
)  # fmt: skip


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Every row of the target table. `seed`: of the run whose first picture is waited for."""
    yield from _typos()
    yield from _prose()
    yield from _starts()
    first_s = _first_picture(seed)
    yield Figure(
        "headland run --map, warm: start to the first moving picture", first_s, "s",
        f"<= {WARM_S_MAX:g}", first_s <= WARM_S_MAX, "",
        "a real page's socket; kernels are compiled; other work on the machine counts",
    )  # fmt: skip
    if quick:
        return
    yield _install()
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


def _starts() -> Iterator[Figure]:
    """CPU time: the time by the clock is that of whatever else runs here."""
    for until, ends in ENDS.items():
        slowest = max(
            min(_cpu_s(f"{tool} {end}") for _ in range(STARTS)) for tool, end in ends.items()
        )
        yield Figure(
            f"start of a tool of the bus, {until}, the slowest", slowest, "CPU s",
            f"<= {START_S_MAX:g}", slowest <= START_S_MAX, "",
            f"{', '.join(ends)}; least of {STARTS} starts each",
        )  # fmt: skip


def _cpu_s(words: str) -> float:
    """Of one call, in a folder without a launch."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "tools.cli.headland", *words.split()], cwd=folder, check=False,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _first_picture(seed: int) -> float:
    """Seconds until the map's socket tells of a robot that moves; infinite if it never does."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    with tempfile.TemporaryDirectory() as folder:
        begun_s = perf_counter()
        run = subprocess.Popen(
            [sys.executable, "-m", "tools.cli.headland", "run", "oxted", "--map", "--page-port", "0",
             "--seed", str(seed), "--json"],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        try:
            assert run.stdout is not None
            lines = (re.search(r"http://(\S+?)/#([\w-]+)", line) for line in run.stdout)
            address = next((found for found in lines if found), None)
            if address is None:
                return float("inf")
            protocols = ["headland", address[2]]
            with connect(f"ws://{address[1]}/ws", subprotocols=protocols) as page:  # type: ignore[arg-type]
                pictures = 0
                while perf_counter() - begun_s < FIRST_PICTURE_S_MAX:
                    told = json.loads(page.recv(timeout=FIRST_PICTURE_S_MAX))
                    if any(robot["v"] > 0 for robot in told.get("robots", ())):
                        return perf_counter() - begun_s
                    pictures += told["kind"] == "now"
                    page.send(json.dumps({"do": "drawn", "count": pictures}))
        except (ConnectionClosed, TimeoutError):
            return float("inf")
        finally:
            run.kill()
            run.wait()
    return float("inf")


def _install() -> Figure:
    """A fresh environment with the wheel of this checkout and what it needs, as `du -sm` counts."""
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
        subprocess.run([folder + "/env/bin/pip", "install", "--quiet", str(wheel)], check=True,
                       stderr=subprocess.DEVNULL)  # fmt: skip
        size = sum(
            path.lstat().st_blocks * 512 for path in (here / "env").rglob("*") if path.is_file()
        )
    return Figure(
        "base install: the tools of the bus, with their environment and pip", size / MB, "MB",
        f"<= {INSTALL_MB_MAX}", size / MB <= INSTALL_MB_MAX, "", "a wheel in a fresh venv",
    )  # fmt: skip


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
