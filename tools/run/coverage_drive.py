"""`headland coverage drive`: faults from words, one run of whole peers, and its figures."""

import sys
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console

from agent.coverage.team import TURN_COST_MAX
from agent.interface.config import PEERS_MAX
from agent.runtime.declared_values import first_error
from sim.files.grid_map import GridFileError, Instance
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.runs.coverage_run import CoverageOutcome, CoverageRun
from sim.scenarios.coverage_setup import STEP_S, CoverageSetup
from sim.scenarios.scenario import Crash, Fault, Heal, Join, Partition, Scenario
from tools.common.result_table import fact_table
from tools.run.coverage_report import closed_off
from tools.run.run_mission import ProgressBar, next_commands
from tools.run.run_recorder import RunRecorder

LOSS_MAX = 0.9
LIMIT_FACTOR = 4.0  # multiple of the least time of one robot alone, plus a minute
SILENCE = ("stop", "slow", "continue")


def faults_of(
    die: Sequence[str], join: Sequence[str], split: Sequence[str], robots: int
) -> list[Fault]:
    """GridFileError where a word is not what it should be."""
    faults: list[Fault] = []
    for word in die:
        (robot,), (at_s,) = _parts(word, "--die ROBOT@SECOND", robots, 1)
        faults.append(Crash(at_s=at_s, kind="crash", robot=robot))
    for word in join:
        (robot,), (at_s,) = _parts(word, "--join ROBOT@SECOND", robots, 1)
        faults.append(Join(at_s=at_s, kind="join", robot=robot))
    for word in split:
        cut, times = _parts(word, "--split ROBOT,...@SECOND-SECOND", robots, 2)
        rest = sorted(set(range(robots)) - set(cut))
        if times[0] >= times[1]:
            raise GridFileError(f"{word!r}: a split ends after it begins")
        faults.append(Partition(at_s=times[0], kind="partition", islands=[rest, cut]))
        faults.append(Heal(at_s=times[1], kind="heal"))
    late = {fault.robot for fault in faults if fault.kind == "join"}
    if len(late) >= robots:
        raise GridFileError("--join: somebody has to begin")
    return faults


def _parts(word: str, form: str, robots: int, times: int) -> tuple[list[int], list[float]]:
    try:
        who, _, when = word.partition("@")
        slots, at_s = [int(w) for w in who.split(",")], [float(w) for w in when.split("-")]
    except ValueError:
        raise GridFileError(f"{word!r} is not {form}") from None
    if (
        len(at_s) != times
        or (times == 1 and len(slots) != 1)
        or not all(0 <= t < 1e5 for t in at_s)
    ):
        raise GridFileError(f"{word!r} is not {form}")
    if not all(0 <= slot < robots for slot in slots):
        raise GridFileError(f"{word!r}: robots are 0 to {robots - 1}")
    return slots, at_s


def setting_of(
    instance: Instance,
    seed: int,
    faults: Sequence[Fault],
    loss: float,
    silence: str,
    turn_cost: float,
) -> CoverageSetup:
    """A setup from the words of the command line. `loss` is a share of all frames from 0 to 0.9,
    `turn_cost` steps a quarter turn. Raises GridFileError if there are more robots than
    addresses."""
    if len(instance.starts) > PEERS_MAX:
        raise GridFileError(f"{len(instance.starts)} robots: a bus has addresses for {PEERS_MAX}")
    if silence not in SILENCE:
        raise GridFileError(f"--silence is one of {', '.join(SILENCE)}")
    if not 0.0 <= turn_cost <= TURN_COST_MAX:
        raise GridFileError(f"--turn-cost is 0 to {TURN_COST_MAX:.0f} steps")
    if not 0.0 <= loss <= LOSS_MAX:
        raise GridFileError(f"--loss is 0 to {LOSS_MAX:g}")
    cells = int((~instance.walls).sum())
    last_s = max((fault.at_s for fault in faults), default=0.0)
    limit_s = min(60.0 + last_s + LIMIT_FACTOR * cells * STEP_S, 86_400.0)
    try:
        return CoverageSetup.made(
            instance, seed=seed, faults=faults, loss=loss, silence=silence, turn_cost=turn_cost,
            time_limit_s=limit_s,
        )  # fmt: skip
    except ValidationError as problem:
        raise GridFileError(first_error(problem, Scenario)) from None
    except ValueError as error:
        raise GridFileError(f"{instance.name}: {error}") from None


def driven(
    setting: CoverageSetup, out: Path | None, as_json: bool, cells_left: int = 0,
    reachable_only: bool = False,
) -> int:  # fmt: skip
    """`cells_left`: free cells that are not connected with any start."""
    run = CoverageRun(setting, out)
    recorder = None if out is None else RunRecorder(setting, out)
    run.attach = recorder
    try:
        with ProgressBar(Console(stderr=True), setting.instance.name, run, "cells"):
            outcome = run.run()
    finally:
        if recorder is not None:
            recorder.close()
    report = {
        **outcome.to_dict(), "step_s": STEP_S, "unreached_cells": cells_left,
        "faults": run.told_faults,
    }  # fmt: skip
    if out is not None:
        write_whole(out / "report.json", dumps(report, indent=1) + "\n")
    if as_json:
        print(dumps(report))
    else:
        _print(outcome)
        if out is not None and recorder is not None:
            print(f"report.json, trace.jsonl, {recorder.logs} are in {out}")
            print(next_commands(out))
    closed = closed_off(cells_left, reachable_only)
    if closed:
        print(closed, file=sys.stderr)
    return 0 if outcome.success and not closed else 1


def _print(outcome: CoverageOutcome) -> None:
    rows = {
        "without a flaw": "yes" if outcome.success else "no",
        "makespan": f"{outcome.makespan_s:.1f} s = {outcome.makespan_s / STEP_S:.0f} steps",
        "over the lower bound": f"{outcome.ratio:.3f}",
        "uncovered": f"{outcome.uncovered}",
        "planned again": f"{outcome.replanned + outcome.redone}",
        "contacts, closest": f"{outcome.contacts}, {outcome.closest_m:.2f} m",
        "rounds of agreement": f"{outcome.rounds}",
        "sections done": f"{outcome.sections_done} of {outcome.sections}",
        "replicas": "equal" if outcome.replicas_equal else "differ",
        "bus load, worst stuffing": f"{outcome.bus_load_worst_case:.1%}",
        "frames": ", ".join(f"{n} {kind}" for kind, n in list(outcome.frames.items())[:5]),
        "finished": "yes" if outcome.finished else "no",
    }
    Console().print(fact_table(f"{outcome.robots} peers on {outcome.map}", rows.items()))
