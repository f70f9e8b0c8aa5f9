"""`headland chaos`: thousands of runs with faults, judged from outside; shrinks the first failure."""

import itertools
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from hashlib import sha256
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from agent.runtime.gc_tuning import freeze_gc
from sim.chaos.fault_profiles import DRAWN_SHAPE, FORGER, PROFILES, draw, is_profile
from sim.chaos.golden_story import difference, golden_path, tell
from sim.chaos.planted_bugs import MUTANTS
from sim.chaos.shrink import shrink
from sim.chaos.verdict import RULES, Verdict, judge
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.scenarios.scenario import SEED_MAX, ScenarioError, load
from sim.scenarios.toml_writer import to_toml
from tools.chaos.campaign import ClusterError, room, workers
from tools.chaos.chaos_report import ReportError, figures, report
from tools.chaos.planted_bug_hunt import hunt_all
from tools.common.exit_codes import code_of, wrong
from tools.common.fingerprint import fingerprint, robots_fingerprint
from tools.common.gc_collector import patient
from tools.common.progress import shows_progress

FAILED = 1
DIGITS_MAX, SHOWN = 99, 40  # of a seed that is read, and of a wrong one that is printed
KEEP_S = 30.0  # interval at which results are written: at most this much is lost with a process


def chaos(
    seeds: str, profile: str, jobs: int, seconds: float | None, out: Path, mutants: bool,
    as_json: bool, cluster: str = "", only: Sequence[str] = (),
) -> int:  # fmt: skip
    """The exit code of `headland chaos`: 0 if every rule was kept (or every planted bug found), 1
    if not, 2 for a wrong argument, whose ValueError becomes a line."""
    console = Console(stderr=as_json)
    try:
        numbers = _range(seeds)
        for name in only:
            if name not in MUTANTS:
                raise ValueError(f"no planted bug {name}: choose of {', '.join(MUTANTS)}")
        if not is_profile(profile):
            names = ", ".join(PROFILES)
            raise ValueError(
                f"no profile {profile}: choose one of {names}; each also with {FORGER}, "
                f"and those with bodies with {DRAWN_SHAPE}"
            )
        out.mkdir(parents=True, exist_ok=True)
    except (ValueError, OSError) as problem:
        return wrong(problem, code_of(problem))
    runs = len(MUTANTS) if mutants else numbers.stop - numbers.start
    jobs = min(jobs or os.cpu_count() or 1, runs)  # all of them are started at once
    freeze_gc()  # and the workers inherit it
    if mutants:
        try:
            rows = hunt_all(console, only, jobs, seconds, out, as_json, numbers.start)
        except ClusterError as problem:
            return wrong(problem)
        found = sum(row["found"] for row in rows)
        console.print(f"{found} of {len(rows)} planted bugs found")
        return 0 if found == len(rows) else FAILED

    def keep(verdicts: list[Verdict], cpu_s: float) -> dict[str, Any]:
        told = _report(verdicts, profile)
        told |= {
            "seeds": _played(verdicts, numbers.start),
            "code": fingerprint(),
            "robots": robots_fingerprint(),
            "cpu_s": round(cpu_s, 1),
        }
        _write(out, told)
        return told

    try:
        verdicts, cpu_s = _campaign(console, numbers, profile, jobs, seconds, cluster, keep)
    except ClusterError as problem:
        return wrong(problem)
    if not verdicts:
        return wrong(f"--seconds {seconds:g}: over before the first run, so nothing was judged")
    told = keep(verdicts, cpu_s)
    failed = [verdict for verdict in verdicts if not verdict.ok]
    if failed:
        told["reproduction"] = _reproduce(console, failed[0], profile, out)
        _write(out, told)
    if as_json:
        print(dumps(told))
    else:
        _show(console, told)
    return FAILED if failed else 0


def _write(out: Path, told: dict[str, Any]) -> None:
    write_whole(out / "chaos.json", dumps(told, indent=1) + "\n")


def _in_a_row(verdicts: list[Verdict], first: int) -> list[Verdict]:
    """From the first seed on, without the runs that were quicker than one before them."""
    done = {verdict.seed: verdict for verdict in verdicts}
    return [done[seed] for seed in itertools.takewhile(done.__contains__, itertools.count(first))]


def _played(verdicts: list[Verdict], first: int) -> tuple[int, int]:
    """Seeds are handed out in order, from the first: it, and one after the last."""
    return first, max((verdict.seed + 1 for verdict in verdicts), default=first)


def tell_report(folder: Path, as_json: bool = False) -> int:
    """Print the report of a folder of results; the exit code is 2 where these contradict each
    other."""
    try:
        print(dumps(figures(folder)) + "\n" if as_json else report(folder), end="")
    except ReportError as problem:
        return wrong(problem)
    return 0


def judge_file(path: Path, as_json: bool, golden: bool = False) -> int:
    """A scenario of its own, with faults written by hand or found by a campaign.

    `golden`: its golden text is written beside it, and has to be the same from now on. Without that,
    a difference from the text that is there is printed.
    """
    try:
        verdict, played = tell(load(str(path)))
    except ScenarioError as problem:
        return wrong(problem)
    kept = golden_path(path)
    if golden and verdict.ok:
        write_whole(kept, played)
    elif kept.exists() and (changed := difference(kept.read_text(), played, kept.name)):
        print(f"{changed}\nheadland: played differently than {kept} says", file=sys.stderr)
    if as_json:
        print(dumps(_report([verdict], str(path))))
    else:
        for broken in verdict.broken:
            print(f"{broken.rule} at {broken.t_s:.3f} s: {broken.what} ({RULES[broken.rule]})")
        if verdict.ok:
            print(f"every rule kept in {verdict.simulated_s:.0f} s; trace {verdict.trace_hash}")
    return 0 if verdict.ok else FAILED


def _range(text: str) -> range:
    first, colon, end = text.partition(":")
    if not first.isdecimal() or (colon and not end.isdecimal()):
        raise ValueError(f"--seeds {text}: a seed, or FIRST:END as in 0:1000")
    if max(len(first), len(end)) > DIGITS_MAX or max(int(first), int(end or 0) - 1) > SEED_MAX:
        raise ValueError(f"--seeds {text[:SHOWN]}: the greatest seed is {SEED_MAX}")
    seeds = range(int(first), int(end) if colon else int(first) + 1)
    if not seeds:
        raise ValueError(f"--seeds {text}: there is no seed from {first} to before {end}")
    return seeds


def judged(seed: int, profile: str) -> Verdict:
    """Draw the scenario of a seed, play it and judge it."""
    with patient():
        return judge(draw(seed, profile))


def _timed(seed: int, profile: str) -> tuple[Verdict, float]:
    """And the CPU seconds that it took."""
    begun_s = time.process_time()
    return judged(seed, profile), time.process_time() - begun_s


def _campaign(
    console: Console, seeds: range, profile: str, jobs: int, seconds: float | None, cluster: str,
    keep: Callable[[list[Verdict], float], object],
) -> tuple[list[Verdict], float]:  # fmt: skip
    """Verdicts in order of seeds, and their CPU seconds; stops handing out work when the time is over."""
    verdicts, cpu_s = list[Verdict](), 0.0
    count = seeds.stop - seeds.start  # `len` has a limit that seeds have not
    kept_s = time.monotonic()
    end_s = kept_s + (seconds if seconds is not None else float("inf"))
    with (
        Progress(TextColumn("{task.description}"), TimeElapsedColumn(), console=console,
                 transient=True, disable=not shows_progress(console)) as progress,
        workers(jobs, cluster) as pool,
    ):  # fmt: skip
        bar = progress.add_task("")
        todo: Iterator[int] = iter(seeds)
        running: set[Future[tuple[Verdict, float]]] = set()
        while True:
            while len(running) < room(jobs, cluster) and time.monotonic() < end_s:
                seed = next(todo, None)
                if seed is None:
                    break
                running.add(pool.submit(_timed, seed, profile))
            if not running:
                break
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                verdict, spent_s = future.result()
                verdicts.append(verdict)
                cpu_s += spent_s
            if time.monotonic() - kept_s > KEEP_S:
                kept_s = time.monotonic()
                keep(_in_a_row(verdicts, seeds.start), cpu_s)
            bad = sum(not verdict.ok for verdict in verdicts)
            text = f"{profile}: {len(verdicts)} of {count} seeds, {bad} failed"
            progress.update(bar, description=text)
    return sorted(verdicts, key=lambda verdict: verdict.seed), cpu_s


def campaign_hash(verdicts: list[Verdict]) -> str:
    """Of every run's trace and of every rule it broke: equal wherever the runs ran."""
    told = [(v.seed, v.trace_hash, [(b.rule, b.what) for b in v.broken]) for v in verdicts]
    return sha256(repr(told).encode()).hexdigest()[:16]


def _report(verdicts: list[Verdict], profile: str) -> dict[str, Any]:
    faults: Counter[str] = sum((v.faults for v in verdicts), Counter())
    hours = sum(v.robots * v.simulated_s for v in verdicts) / 3600
    return {
        "profile": profile, "hash": campaign_hash(verdicts), "runs": len(verdicts),
        "robot_hours": round(hours, 2),
        "faults": dict(faults.most_common()), "failed": [v.seed for v in verdicts if not v.ok],
        "broken": [
            {"seed": v.seed, "rule": b.rule, "t_s": round(b.t_s, 3), "what": b.what}
            for v in verdicts for b in v.broken
        ],
    }  # fmt: skip


def _reproduce(console: Console, verdict: Verdict, profile: str, out: Path) -> str:
    """The first failure with as little as it takes, as a scenario that can be run again."""
    rule = verdict.broken[0].rule
    console.print(
        f"seed {verdict.seed} breaks {rule}: {verdict.broken[0].what}; making it small ..."
    )
    small, runs = shrink(
        draw(verdict.seed, profile), lambda s: any(b.rule == rule for b in judge(s).broken)
    )
    path = out / f"{profile}-{verdict.seed}-{rule}.toml"
    write_whole(path, f"# breaks {rule}: {verdict.broken[0].what}\n{to_toml(small)}")
    faults = len(small.fault)
    console.print(
        f"{faults} faults with the mending, {small.fleet.robots} robots ({runs} runs): {path}"
    )
    see = "" if small.mission in ("drill", "sprint") else f"; see it with: headland run {path}"
    console.print(
        f"judge it again with: headland chaos --seeds {verdict.seed} --profile {profile}, "
        f"or made small: headland chaos --scenario {path}{see}"
    )
    return str(path)


def _show(console: Console, report: dict[str, Any]) -> None:
    table = Table(title=f"{report['runs']} runs, {report['robot_hours']} robot-hours")
    table.add_column("fault")
    table.add_column("injected", justify="right")
    for kind, count in report["faults"].items():
        table.add_row(kind, str(count))
    console.print(table)
    for broken in report["broken"]:
        console.print(
            f"[red]seed {broken['seed']}: {broken['rule']} at {broken['t_s']} s: {broken['what']}"
        )
    if not report["broken"]:
        console.print("every rule kept")
