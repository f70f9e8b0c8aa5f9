"""Commands that try the fleet: bad luck, any bytes, and figures measured again."""

from pathlib import Path
from typing import Annotated

import typer

from tools.cli.panels import DEVELOP
from tools.common.exit_codes import wrong
from tools.common.options import Cluster, Json
from tools.common.told_wait import told_loading
from tools.common.unused_options import refuse_unused

# The names of `sim.chaos.fault_profiles.PROFILES`, whose import takes a second; a test compares them.
PROFILES = (
    "all, bus, crash, stop, body, senses, fixes, stalls, rays, implement, corners, shapes, steered, "
    "apart, protocol, press, devices, strangers, claims, split, flood, traffic, forged, forged_field or "
    "stolen."
)
ENDINGS = (
    "With +forger at its end: in a fleet with keys, with an attacker on the bus. With +drawn, where "
    "there are bodies: on fields that the seeds draw."
)
JOBS_MAX = 1024  # more than one machine has cores
app = typer.Typer()


@app.command(rich_help_panel=DEVELOP)
def chaos(
    context: typer.Context,
    seeds: Annotated[
        str, typer.Option(help="FIRST:END, or one seed. Hunts for planted bugs begin at FIRST.")
    ] = "0:20",
    profile: Annotated[str, typer.Option(help=f"{PROFILES} {ENDINGS}")] = "all",
    jobs: Annotated[
        int, typer.Option(min=0, max=JOBS_MAX, help="Processes at a time (0: one a core).")
    ] = 0,
    seconds: Annotated[float | None, typer.Option(help="Begin no run after this long.")] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Folder for results and reproductions.")
    ] = Path("runs/chaos"),
    mutants: Annotated[
        bool, typer.Option("--mutants", help="Look for planted bugs instead: all must be found.")
    ] = False,
    scenario: Annotated[
        Path | None,
        typer.Option(help="Judge this scenario file instead, written by hand or found."),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="With --mutants: this planted bug; may be repeated.")
    ] = None,
    golden: Annotated[
        bool, typer.Option("--golden", help="With --scenario: write its golden text beside it.")
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(help="Print a report of the results in this folder, in Markdown or JSON."),
    ] = None,
    cluster: Cluster = "",
    json: Json = False,
) -> None:
    """Give a fleet bad luck, judge from outside whether it kept the rules. Exit 0 when it did.

    The first failing seed is made small and saved as a scenario.
    Example: headland chaos --seeds 0:1000 --profile stop --jobs 2
    """
    if only and not mutants:
        raise SystemExit(wrong("--only: does nothing without --mutants; add --mutants"))
    if golden and scenario is None:
        raise SystemExit(wrong("--golden: does nothing without --scenario; add --scenario FILE"))
    if report is not None:
        refuse_unused(context, "--report", {"json"})
    elif scenario is not None:
        refuse_unused(context, "--scenario", {"json", "golden"})
    elif mutants:
        refuse_unused(
            context, "--mutants", {"seeds", "jobs", "seconds", "out", "only", "cluster", "json"}
        )
    from tools.build.compiled_core import use

    if not mutants:  # no bug can be planted in machine code
        use()
    with told_loading():
        from tools.chaos.chaos import chaos as command
        from tools.chaos.chaos import judge_file, tell_report

    if report is not None:
        raise SystemExit(tell_report(report, json))
    if scenario is not None:
        raise SystemExit(judge_file(scenario, json, golden))
    raise SystemExit(
        command(seeds, profile, jobs, seconds, out, mutants, json, cluster, only or ())
    )


@app.command(rich_help_panel=DEVELOP)
def fuzz(
    context: typer.Context,
    targets: Annotated[list[str] | None, typer.Argument(help="Decoders; none: all.")] = None,
    files: Annotated[
        bool, typer.Option("--files", help="Only what reads somebody else's files.")
    ] = False,
    runs: Annotated[int, typer.Option(min=1, help="Executions of each target.")] = 100_000,
    seconds: Annotated[float | None, typer.Option(help="At most this long for each target.")] = None,
    seed: Annotated[int, typer.Option(help="Of what is tried.")] = 1,
    engine: Annotated[str, typer.Option(help="auto, plain or atheris (pip install atheris).")] = "auto",
    keep: Annotated[bool, typer.Option("--keep", help="New inputs join the corpus.")] = False,
    again: Annotated[Path | None, typer.Option("--input", help="Run one input again.")] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Folder for what breaks something.")
    ] = Path("runs/fuzz"),
    json: Json = False,
) -> None:  # fmt: skip
    """Any bytes into every decoder, from a corpus in the tree. Exit 0 when no promise was broken.

    Example: headland fuzz frame sync --runs 1000000
    """
    from tools.chaos.fuzz import fuzz as command
    from tools.chaos.fuzz import replay as once

    if again is not None:
        if len(targets or ()) != 1:
            raise SystemExit(wrong("--input needs one target: headland fuzz TARGET --input FILE"))
        refuse_unused(context, "--input", {"targets", "again"})
        raise SystemExit(once((targets or [""])[0], again))
    named = list(targets or [])
    if files:
        from sim.chaos.fuzz_targets import FILES

        named += [target.__name__ for target in FILES]
    raise SystemExit(command(named, runs, seconds, seed, engine, keep, out, json))


@app.command(rich_help_panel=DEVELOP)
def bench(
    name: Annotated[
        str,
        typer.Argument(help="Which one, or all; none: a list of them, and nothing is measured."),
    ] = "",
    quick: Annotated[bool, typer.Option("--quick", help="Less than a minute each.")] = False,
    seed: Annotated[int, typer.Option(help="Where chance takes part.")] = 1,
    cluster: Cluster = "",
    seconds: Annotated[
        float | None, typer.Option(min=10.0, help="How long, of a bench by the clock (leaks).")
    ] = None,
    json: Json = False,
) -> None:
    """Measure again what the documents claim. Exit 0 when every target holds.

    Without a name it lists what can be measured.

    Example: headland bench wire --quick --json
    """
    try:
        from tools.bench.command import bench as command
    except ModuleNotFoundError as problem:
        if not str(problem.name).endswith("tools.bench"):
            raise
        raise SystemExit(
            wrong("the benches are in a checkout (git clone), not in a wheel")
        ) from None

    raise SystemExit(command(name, quick, seed, json, cluster, seconds))
