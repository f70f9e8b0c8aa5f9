"""`headland fuzz`: any bytes into every decoder, from a corpus that is kept in the tree.

Two engines: atheris (libFuzzer: inputs that reach new code are kept) where it is installed, else plain
mutation of the corpus. An input that breaks a promise is written to a file and named.
"""

import importlib.util
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from random import Random
from typing import NamedTuple

from rich.console import Console

from sim.chaos.fuzz_targets import TARGETS, seeds
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from tools.common.child_process import module_command
from tools.common.exit_codes import code_of, wrong

FAILED = 1
CORPUS = Path(__file__).parents[2] / "tests" / "fuzz" / "corpus"
SIZE_MAX = 1024  # longest input, bytes; no valid one is longer
TIME_MAX_S = 2.0  # of computing for one input
SPARE = 64  # bytes by which a long input may grow
POOL_MAX = 4096  # inputs remembered by the plain engine
KEPT_MAX = 60  # most inputs kept of a target: the shortest that reach new code
CHUNK = 256  # runs between two looks at the clock
DONE = re.compile(r"Done (\d+) runs in (\d+) second")


class Fuzzed(NamedTuple):
    """What came of one target: how many inputs, at what cost, and the input that broke a promise."""

    target: str
    engine: str
    executions: int
    cpu_s: float
    crash: str  # the file with the input that broke a promise; empty: none
    why: str
    worst_s: float = 0.0  # of computing, for one input
    peak_mb: float = 0.0  # of this process so far, all of its memory; 0: the system does not tell

    @property
    def ok(self) -> bool:
        """Whether no input broke a promise."""
        return not self.crash


def fuzz(
    names: list[str], runs: int, seconds: float | None, seed: int, engine: str, keep: bool,
    out: Path, as_json: bool,
) -> int:  # fmt: skip
    """The exit code of `headland fuzz`: 0 if every target kept its promises, 1 if one did not, 2
    for a wrong name or engine."""
    console = Console(stderr=as_json)
    engine = engine if engine != "auto" else ("atheris" if has_atheris() else "plain")
    try:
        _check(names, engine)
        out.mkdir(parents=True, exist_ok=True)
    except (ValueError, OSError) as problem:
        return wrong(problem, code_of(problem))
    rows: list[Fuzzed] = []
    for name in names or TARGETS:
        with console.status(f"{name}: {runs} runs with {engine}"):
            play = with_atheris if engine == "atheris" else plainly
            row = play(name, runs, seconds, seed, out, keep)
        rows.append(row)
        if as_json:
            print(dumps(row._asdict()), flush=True)
        else:
            verdict = "[green]sound [/]" if row.ok else "[red]BROKEN[/]"
            console.print(f"{verdict} {row.target:12} {row.executions:>10} runs {row.cpu_s:7.1f} s")
            if not row.ok:
                console.print(f"  {row.why}: headland fuzz {row.target} --input {row.crash}")
    results = {"seed": seed, "fuzzed": [row._asdict() for row in rows]}
    write_whole(out / "fuzz.json", dumps(results, indent=1) + "\n")
    if not as_json:
        console.print(f"{sum(row.executions for row in rows)} executions with {engine}")
    return FAILED if any(not row.ok for row in rows) else 0


def replay(name: str, path: Path) -> int:
    """Play one input again, with the traceback that it makes. The exit code is 0 where it makes
    none, 2 where there is no such target or file."""
    try:
        _check([name], "plain")
        data = path.read_bytes()
    except (ValueError, OSError) as problem:
        return wrong(problem)
    TARGETS[name](data)
    print(f"{path}: sound")
    return 0


def has_atheris() -> bool:
    """Whether libFuzzer can be used here."""
    return importlib.util.find_spec("atheris") is not None


def _check(names: list[str], engine: str) -> None:
    for name in names:
        if name not in TARGETS:
            raise ValueError(f"no fuzz target {name}: choose of {', '.join(TARGETS)}")
    if engine not in ("plain", "atheris"):
        raise ValueError(f"--engine {engine}: auto, plain or atheris")
    if engine == "atheris" and not has_atheris():
        raise ValueError("--engine atheris: it is not installed: pip install 'headland[fuzz]'")


# -------------------------------------------------------------------- corpus


def corpus(name: str) -> list[bytes]:
    """Sound inputs, and those that once reached new code: a line of hexadecimal each."""
    path = CORPUS / f"{name}.hex"
    lines = path.read_text(encoding="ascii").split() if path.exists() else []
    return [*seeds(name), *(bytes.fromhex(line) for line in lines)]


def keep_corpus(name: str, inputs: list[bytes]) -> None:
    """Write the shortest new inputs of a target into its corpus, one a line, in hexadecimal."""
    CORPUS.mkdir(parents=True, exist_ok=True)
    known = set(seeds(name))
    new = {data for data in inputs if data and data not in known}
    lines = sorted(
        data.hex() for data in sorted(new, key=lambda data: (len(data), data))[:KEPT_MAX]
    )
    (CORPUS / f"{name}.hex").write_text("".join(f"{line}\n" for line in lines), encoding="ascii")


# -------------------------------------------------------------------- engines


def plainly(
    name: str, runs: int, seconds: float | None, seed: int, out: Path, keep: bool = False
) -> Fuzzed:
    """Mutations of the corpus; an input that is read without a complaint joins the pool."""
    rng, target, pool = Random(f"{seed}/fuzz/{name}"), TARGETS[name], corpus(name) or [b""]
    begun_s, done, worst_s = time.process_time(), 0, 0.0
    end_s = time.monotonic() + (seconds if seconds is not None else float("inf"))
    for data in pool[:runs] if runs else pool:
        crash = _try(name, data, out)
        done += 1
        if crash is not None:
            return Fuzzed(name, "plain", done, time.process_time() - begun_s, *crash)
    while done < runs and (done % CHUNK or time.monotonic() < end_s):
        data = mutated(rng.choice(pool), rng.choice(pool), rng)
        done += 1
        begin_s = time.thread_time()
        try:
            target(data)
            worst_s = max(worst_s, time.thread_time() - begin_s)
            assert time.thread_time() - begin_s <= TIME_MAX_S, "too slow"
        except Exception:
            crash = _try(name, data, out)
            if crash is None and time.thread_time() - begin_s > TIME_MAX_S:
                continue  # slow once, by the machine
            assert crash is not None, "a target must not remember anything"
            return Fuzzed(name, "plain", done, time.process_time() - begun_s, *crash)
        if len(pool) < POOL_MAX and rng.random() < 0.01:
            pool.append(data)
    cpu_s = round(time.process_time() - begun_s, 1)
    return Fuzzed(name, "plain", done, cpu_s, "", "", round(worst_s, 4), _peak_mb())


def _peak_mb() -> float:
    with suppress(OSError):  # `ru_maxrss` keeps what the process that started this one had
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    try:
        import resource
    except ImportError:
        return 0.0  # Windows does not tell
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def _try(name: str, data: bytes, out: Path) -> tuple[str, str] | None:
    begin_s = time.thread_time()
    try:
        TARGETS[name](data)
        took_s = time.thread_time() - begin_s
        assert took_s <= TIME_MAX_S, f"{took_s:.1f} s for {len(data)} bytes"
    except Exception as problem:
        path = out / f"{name}-{sha256(data).hexdigest()[:12]}"
        path.write_bytes(data)
        return str(path), f"{type(problem).__name__}: {problem}"
    return None


def mutated(data: bytes, other: bytes, rng: Random) -> bytes:
    """One to four small changes."""
    work = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at, kind = rng.randrange(len(work) + 1), rng.randrange(6)
        if kind == 0 and work:
            work[at % len(work)] ^= 1 << rng.randrange(8)
        elif kind == 1 and work:
            work[at % len(work)] = rng.choice((0, 1, 0x7F, 0x80, 0xFE, 0xFF, rng.randrange(256)))
        elif kind == 2:
            work[at:at] = rng.randbytes(rng.randint(1, 12))
        elif kind == 3:
            del work[at : at + rng.randint(1, 12)]
        elif kind == 4 and other:
            begin = rng.randrange(len(other))
            work[at : at + rng.randint(0, 16)] = other[begin : begin + rng.randint(1, 64)]
        else:
            end = at + rng.randint(1, 16)
            work[at:at] = work[at:end]
    return bytes(work[: max(SIZE_MAX, len(data) + SPARE)])


def with_atheris(
    name: str, runs: int, seconds: float | None, seed: int, out: Path, keep: bool
) -> Fuzzed:
    """In a process of its own, which libFuzzer ends itself."""
    with tempfile.TemporaryDirectory() as scratch:
        found = Path(scratch) / "found"
        found.mkdir()
        for number, data in enumerate(corpus(name)):
            (found / f"{number}").write_bytes(data)
        words = [f"-runs={runs}", f"-seed={seed or 1}", f"-max_len={SIZE_MAX}", "-close_fd_mask=1",
                 f"-artifact_prefix={out}/{name}-"]  # fmt: skip
        words += [f"-max_total_time={seconds:.0f}"] if seconds is not None else []
        begun_s = time.monotonic()
        text = _atheris(name, [str(found), *words])
        done = DONE.search(text)
        crash = next(iter(sorted(out.glob(f"{name}-crash-*"))), None) if done is None else None
        why = (
            ""
            if done
            else (re.findall(r"^\s*(\w*(?:Error|Exception)\b.*)$", text, re.M) or ["?"])[-1]
        )
        if keep and done is not None:  # each of these has reached something new
            keep_corpus(name, [path.read_bytes() for path in found.iterdir()])
        count, cpu_s = (int(done[1]), float(done[2])) if done else (0, time.monotonic() - begun_s)
        return Fuzzed(name, "atheris", count, cpu_s, str(crash or ("?" if not done else "")), why)


def _atheris(name: str, words: list[str]) -> str:
    command = [*module_command("tools.chaos.fuzz_atheris"), name, *words]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    return done.stderr + done.stdout


def every(names: list[str] | None, runs: int, seed: int, out: Path) -> Iterator[Fuzzed]:
    """For figures and tests: each target with the best engine there is."""
    engine = with_atheris if has_atheris() else plainly
    for name in names or TARGETS:
        yield engine(name, runs, None, seed, out, False)
