"""The cost of refusing a damaged file: mutations of every kind of file that is read.

Each kind has a process of its own, so that its memory is known. An input must end in an answer or one
line, within two seconds. An input that breaks this promise is kept and counted.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import mkdtemp

from sim.chaos.fuzz_targets import FILES
from tools.bench.figure import Figure
from tools.chaos.fuzz import Fuzzed, plainly

RUNS, QUICK = 100_000, 300  # mutations of each kind
SECONDS_MAX, MEGABYTES_MAX = 2.0, 300.0  # of computing for one input; of the whole process


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """For each kind of file the longest time and the most memory that one mutation took."""
    runs = QUICK if quick else RUNS
    out = Path(mkdtemp(prefix="headland-files-"))
    rows: list[Fuzzed] = []
    for name in (target.__name__ for target in FILES):
        row = _alone(name, runs, seed, out)
        rows.append(row)
        scope = f"{row.executions} mutations in {row.cpu_s:.0f} s of computing, seed {seed}"
        if not row.ok:
            scope += f"; headland fuzz {name} --input {row.crash}: {row.why}"
        yield _figure(f"{name}: promises broken", float(not row.ok), "", 0.0, scope)
        yield _figure(f"{name}: longest to read or refuse", row.worst_s, "s", SECONDS_MAX, scope)
        yield _figure(
            f"{name}: most memory of the process", row.peak_mb, "MB", MEGABYTES_MAX, scope
        )
    if all(row.ok for row in rows):
        out.rmdir()
    total_s = sum(row.cpu_s for row in rows)
    yield Figure("computing for all kinds of files", total_s / 60, "min", "", None, "",
                 f"{runs} mutations of each of {len(rows)} kinds")  # fmt: skip


def _figure(name: str, value: float, unit: str, most: float, scope: str) -> Figure:
    return Figure(name, value, unit, f"<= {most:g}", value <= most, "", scope)


def _alone(name: str, runs: int, seed: int, out: Path) -> Fuzzed:
    """In a new process, which has read nothing before."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(plainly, name, runs, None, seed, out).result()
