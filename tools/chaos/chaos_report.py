"""`headland chaos --report FOLDER`: results of campaigns, bug searches and fuzzing, from their files.

The folder holds the JSON files that `headland chaos` and `headland fuzz` have written, under any names.
A file may hold a list of such results, as those of a campaign that was played in parts.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

HOURS_WANTED, BUGS_WANTED = 20_000, 20  # robot-hours of DRILLS, planted bugs
DRILLS = ("protocol",)
KEYED = ("forged", "forged_field", "stolen")  # fleets with keys, and attackers on the bus
ATTACKED = "+forger"  # at the end of the name of any profile: the same with keys and an attacker
DRAWN_SHAPE = "+drawn"  # at the end of the name of a profile of fields: the same on drawn fields
KEYED_HOURS_WANTED = 5_000
RUNS_WANTED = 10_000_000  # of decoders
PLACED = {"profile", "seeds"}  # of a campaign; `headland chaos --scenario --json` prints no seeds
TOLD = {"runs", "cpu_s", "failed", "broken", "faults", "code", "hash"}  # of a campaign too
Result = dict[str, Any]
Kept = dict[tuple[str, int], str]  # profile and seed: code of the checkers that found nothing


class ReportError(ValueError):
    """One line for the person: what is wrong with the results."""


def report(folder: Path) -> str:
    """Markdown. Raises ReportError."""
    results = list(_results(folder))
    files = len({path for path, _ in results})
    hunts = [result for _, result in results if "mutants" in result]
    fuzzed = [row for _, result in results for row in result.get("fuzzed", [])]
    campaigns, kept = _judged(results)
    parts = [
        "# Chaos: what was found, and what was not",
        f"Written by `headland chaos --report {folder.name}` from {files} result files; nothing "
        "here is typed in. What the words mean: [chaos.md](../how/chaos.md).",
        *_campaigns(campaigns, kept), *_hunts(hunts), *_fuzzed(fuzzed),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def figures(folder: Path) -> dict[str, Any]:
    """What the report says, as plain values. Raises ReportError."""
    results = list(_results(folder))
    campaigns, kept = _judged(results)
    told = [{"profile": c["profile"], **b} for c in campaigns for b in c["broken"]]
    faults: Counter[str] = Counter()
    for c in campaigns:
        faults.update(c["faults"])
    keys = ("profile", "seeds", "runs", "robot_hours", "cpu_s", "failed", "code", "hash")
    rows = [row for _, result in results for row in result.get("fuzzed", [])]
    return {
        "campaigns": [{key: c[key] for key in keys} for c in campaigns],
        "robot_hours": round(sum(c["robot_hours"] for c in campaigns), 2),
        "runs": sum(c["runs"] for c in campaigns), "faults": dict(faults.most_common()),
        "broken": [b for b in told if (b["profile"], b["seed"]) not in kept],
        "false_alarms": [b for b in told if (b["profile"], b["seed"]) in kept],
        "planted_bugs": [
            {**row, "code": result["code"]}
            for _, result in results if "mutants" in result for row in result["mutants"]
        ],
        "fuzzed": [row._asdict() for row in _targets(rows)],
    }  # fmt: skip


def is_keyed(profile: str) -> bool:
    """Whether the fleets of a profile have keys, and there is an attacker on the bus."""
    return profile.removesuffix(DRAWN_SHAPE) in KEYED or profile.endswith(ATTACKED)


class Survived(NamedTuple):
    """What the campaigns of a folder were judged by."""

    robot_hours: float
    runs: int
    faults: Counter[str]  # injected, by kind
    broken: int  # rules


def survived(folder: Path) -> Survived:
    """The sum of all campaigns, without false alarms that were judged again. Raises ReportError."""
    campaigns, kept = _judged(_results(folder))
    faults: Counter[str] = Counter()
    for campaign in campaigns:
        faults.update(campaign["faults"])
    told = [(c["profile"], b["seed"]) for c in campaigns for b in c["broken"]]
    return Survived(
        sum(c["robot_hours"] for c in campaigns), sum(c["runs"] for c in campaigns), faults,
        sum(run not in kept for run in told),
    )  # fmt: skip


def judged_hours(
    folder: Path, robots: str, counts: Callable[[str], bool] = DRILLS.__contains__
) -> tuple[float, int]:
    """Robot-hours of profiles that count, that these robots were judged by, and how many rules they
    broke. Raises ReportError."""
    campaigns, kept = _judged(_results(folder))
    theirs = [c for c in campaigns if counts(c["profile"]) and c.get("robots") == robots]
    broken = [b for c in theirs for b in c["broken"] if (c["profile"], b["seed"]) not in kept]
    return sum(c["robot_hours"] for c in theirs), len(broken)


def _results(folder: Path) -> Iterable[tuple[Path, Result]]:
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise ReportError(f"no results in {folder}: headland chaos --out {folder} makes some")
    for path in paths:
        try:
            found = json.loads(path.read_text())
            for result in found if isinstance(found, list) else [found]:
                yield path, dict(result)
        except (ValueError, TypeError):
            raise ReportError(
                f"{path} is not a result of headland chaos or headland fuzz"
            ) from None


def _judged(results: Iterable[tuple[Path, Result]]) -> tuple[list[Result], Kept]:
    told = [(path, result) for path, result in results if "robot_hours" in result]
    for path, result in told:
        if not result.keys() >= PLACED:
            raise ReportError(
                f"{path} is of one scenario, not of a campaign: take it out of the folder"
            )
    campaigns, kept = _judged_again([result for _, result in told])
    _no_seed_twice(campaigns)
    for path, result in told:
        if lacks := sorted(TOLD - result.keys()):
            raise ReportError(f"{path} is not a whole result of headland chaos: no {lacks[0]}")
    return campaigns, kept


def _judged_again(campaigns: list[Result]) -> tuple[list[Result], Kept]:
    """The campaigns proper; and of the seeds that failed in them those that the same robots were judged
    by again, in a result of their own, and kept every rule: a checker was mended in between."""
    failed: dict[tuple[str, int], Result] = {}
    for c in sorted(campaigns, key=lambda c: c["seeds"][0] - c["seeds"][1]):  # the longest first
        for seed in c.get("failed", ()):
            failed.setdefault((c["profile"], seed), c)
    proper, kept = list[Result](), Kept()
    for c in campaigns:
        runs = [(c["profile"], seed) for seed in range(*c["seeds"])]
        if any(failed.get(run, c) is c for run in runs):
            proper.append(c)
        elif not c.get("failed"):
            same = [run for run in runs if failed[run].get("robots") == c.get("robots", "")]
            kept.update((run, str(c["code"])) for run in same)
    return proper, kept


def _no_seed_twice(campaigns: list[Result]) -> None:
    """Hours are not counted twice."""
    seen: set[tuple[str, int]] = set()
    for campaign in campaigns:
        first, end = campaign["seeds"]
        runs = {(campaign["profile"], seed) for seed in range(first, end)}
        if seen & runs:
            raise ReportError(f"seed {min(seen & runs)[1]} of {campaign['profile']} is there twice")
        seen |= runs


def _campaigns(campaigns: list[Result], kept: Kept) -> Iterable[str]:
    hours: Counter[str] = Counter()
    for c in campaigns:
        hours[c["profile"]] += c["robot_hours"]
    rows = [_row(parts) for parts in _in_a_row(campaigns)]
    total, drills = sum(hours.values()), sum(hours[profile] for profile in DRILLS)
    keyed = sum(spent for profile, spent in hours.items() if is_keyed(profile))
    runs = sum(c["runs"] for c in campaigns)
    told = [((c["profile"], b["seed"]), b) for c in campaigns for b in c["broken"]]
    broken = [b for run, b in told if run not in kept]
    alarms = [(b["seed"], b["rule"], b["what"], kept[run]) for run, b in told if run in kept]
    verdict = "reached" if drills >= HOURS_WANTED and not broken else "**missed**"
    yield "## Campaigns"
    yield (
        f"{total:.1f} robot-hours judged in {runs} runs, {drills:.1f} of them "
        f"protocol only (wanted: {HOURS_WANTED}, {verdict}); {len(broken)} rules broken."
    )
    if keyed:
        attacked = [c for c in campaigns if is_keyed(c["profile"])]
        theirs = sum((c["profile"], b["seed"]) not in kept for c in attacked for b in c["broken"])
        verdict = "reached" if keyed >= KEYED_HOURS_WANTED and not theirs else "**missed**"
        yield (
            f"{keyed:.1f} robot-hours are of fleets with keys and attackers on their bus (wanted: "
            f"{KEYED_HOURS_WANTED}, {verdict}); {theirs} rules broken in them."
        )
    yield _table(
        ("profile", "seeds", "runs", "robot-hours", "CPU hours", "failed", "code", "hash"), rows
    )
    if broken:
        yield _table(("seed", "rule", "at s", "what"),
                     [(b["seed"], b["rule"], b["t_s"], b["what"]) for b in broken])  # fmt: skip
    if alarms:
        yield (
            "False alarms of checkers, mended since; the same robots kept every rule when the seed was "
            "judged again:"
        )
        yield _table(("seed", "rule", "what was said", "judged again by"), alarms)
    faults: Counter[str] = Counter()
    for c in campaigns:
        faults.update(c["faults"])
    yield f"### Faults injected: {sum(faults.values())}"
    yield _table(("kind", "times"), faults.most_common())
    if total and not broken:
        yield (
            f"No broken rule in {total:.0f} hours bounds their rate at {3 / total:.1e} an hour with 95 % "
            "confidence (rule of three), under this mix of faults only."
        )


def _in_a_row(campaigns: list[Result]) -> list[list[Result]]:
    """Results of one profile and code together whose seeds follow each other."""
    found: list[list[Result]] = []
    for c in campaigns:
        before = found[-1][-1] if found else None
        if before is not None and (before["profile"], before["code"], before["seeds"][1]) == (
            c["profile"], c["code"], c["seeds"][0],
        ):  # fmt: skip
            found[-1].append(c)
        else:
            found.append([c])
    return found


def _row(parts: list[Result]) -> tuple[Any, ...]:
    first, last = parts[0], parts[-1]
    told = first["hash"] if len(parts) == 1 else f"{len(parts)} parts, each with its own"
    hours, cpu_s = (sum(c[key] for c in parts) for key in ("robot_hours", "cpu_s"))
    return (
        first["profile"], f"{first['seeds'][0]} to {last['seeds'][1] - 1}",
        sum(c["runs"] for c in parts), f"{hours:.1f}", f"{cpu_s / 3600:.2f}",
        sum(len(c["failed"]) for c in parts), first["code"], told,
    )  # fmt: skip


def _hunts(hunts: list[Result]) -> Iterable[str]:
    yield "## Planted bugs"
    for first in sorted({row["first"] for hunt in hunts for row in hunt["mutants"]}):
        yield from _hunted_from(first, hunts)


def _hunted_from(first: int, hunts: list[Result]) -> Iterable[str]:
    rows = [
        (row, hunt["code"]) for hunt in hunts for row in hunt["mutants"] if row["first"] == first
    ]
    found = sum(row["found"] for row, _ in rows)
    verdict = "reached" if found >= BUGS_WANTED else "**missed**"
    yield f"### Seeds from {first} on"
    yield f"{found} of {len(rows)} found (wanted: {BUGS_WANTED} of {BUGS_WANTED}, {verdict})."
    order = sorted(rows, key=lambda pair: (not pair[0]["found"], pair[0]["cpu_s"]))
    yield _table(
        ("bug", "what", "profile", "found by", "runs", "CPU s", "code"),
        [(r["mutant"], r["about"], r["profile"], r["rule"] or _missed(r), r["runs"], r["cpu_s"],
          code) for r, code in order],
    )  # fmt: skip


def _missed(row: Result) -> str:
    return "**not found**" if row["runs"] else "not hunted"


class FuzzedTarget(NamedTuple):
    """What all results of a folder say of one decoder."""

    target: str
    executions: int
    cpu_s: float
    broken: int  # promises


def _targets(fuzzed: list[Result]) -> list[FuzzedTarget]:
    """The most executions first."""
    runs, cpu_s, crashes = Counter[str](), Counter[str](), Counter[str]()
    for row in fuzzed:
        runs[row["target"]] += row["executions"]
        cpu_s[row["target"]] += row["cpu_s"]
        crashes[row["target"]] += bool(row["crash"])
    return [FuzzedTarget(t, n, round(cpu_s[t], 1), crashes[t]) for t, n in runs.most_common()]


def _fuzzed(fuzzed: list[Result]) -> Iterable[str]:
    found = _targets(fuzzed)
    total, broken = sum(t.executions for t in found), sum(t.broken for t in found)
    verdict = "reached" if total >= RUNS_WANTED and not broken else "**missed**"
    yield "## Decoders"
    yield f"{total} executions (wanted: {RUNS_WANTED}, {verdict}); {broken} broken promises."
    rows = [(t.target, t.executions, f"{t.cpu_s:.0f}", t.broken) for t in found]
    yield _table(("target", "executions", "CPU s", "broken"), rows)


def _table(head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)
