"""`headland compile`: makes what `tools/build/compiled_core.py` finds. Needs mypy and a C compiler."""

import io
import os
import shutil
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from agent.runtime.files.file_lock import lock
from sim.files.strict_json import dumps
from tools.build.compiled_core import FOLDER, SUFFIX, place
from tools.common.child_process import PREFIX
from tools.common.exit_codes import WRONG
from tools.common.fingerprint import ROOT

FAILED = 1
LEVEL = "2"  # of optimization
# Included before each C source of a module; not before those of mypyc's own library.
CACHES = Path(__file__).with_name("inline_caches.h")
CACHE = FOLDER.with_name("core_types")  # mypy's cache; that of `make check` has other options
# What turns and frames go through. Not: modules of kernels (numba has those), of constants and
# protocols alone, what is seldom called, and what mypyc refuses: constrained type variables, and
# `sim/chaos/scenario_judge.py`, on which mypyc 2 itself crashes. Not either: `agent/interface/mission.py`
# and `motion_controller.py`, because an interpreted class cannot inherit from a compiled one. None has a
# `cached_property`: mypyc calls it each time.
GROUP = {
    "crdt": "allocation claim_register clock digest progress",
    "protocol": "address extended_transport frame_proofs frames.codec frames.identifier links.bus "
    "state_machine sync.digest_comparison sync.replica sync.synchronizer task_client terminal_client "
    "transport",
    "agent": "avoidance.orca claims.claim_headway claims.standing_owners coverage.cell_map "
    "coverage.coverage_mission coverage.joint_course coverage.plan_agreement "
    "coverage.proximity_guard field.bar_swing field.displacement_detector field.field_mission "
    "field.field_obstructions field.fleet_plan field.parking field.section_choice "
    "field.section_shares field.steered_travel_times field.tractor_mission field.travel_times "
    "field.work_leg interface.effects interface.instants "
    "mapf.agreement_phase motion.bar_guard motion.deadlock_yield motion.holonomic_motion "
    "motion.implement_clearance motion.in_place_rotation motion.obstacle_detector "
    "motion.obstacle_stop motion.path_tracker motion.pushed_ahead motion.right_of_way "
    "motion.stopping_zone motion.swept_ground motion.tractor_motion pathfinding.goal_agreement "
    "pathfinding.goal_course pathfinding.pathfinding_mission peer.announcements "
    "peer.control_cycle peer.departure peer.diagnostic_broadcasts peer.diagnostics "
    "peer.durable_records peer.fleet_clock peer.fleet_summary peer.fleet_views "
    "peer.implement_check peer.key_renewal peer.leader_election peer.leader_votes "
    "peer.map_exchange peer.member_conflicts peer.member_discovery peer.member_reports "
    "peer.membership peer.mission_messages peer.name_discovery peer.network_join "
    "peer.obstacle_hold peer.operator_directive peer.part peer.peer peer.peer_lifecycle "
    "peer.peer_parts peer.pgn_responder peer.place_jumps peer.place_progress "
    "peer.progress_announcements peer.proven_frames peer.range_freshness peer.section_claims "
    "peer.section_work peer.self_check peer.self_health peer.sender_origins peer.sense_freshness "
    "peer.slot_discovery peer.stall_watchdog peer.state_sync peer.stop_reception "
    "peer.stop_release peer.task_reporting peer.terminal_service peer.told_causes "
    "peer.unknown_stop_sources peer.work_admission runtime.peer_runner "
    "safety.command_authentication safety.standard_stop safety.stop_controller "
    "segments.fleet_stops segments.remote_segments segments.segment_area",
    "sim": "can.can_wire can.frame_counter can.frame_timing can.simulated_bus "
    "chaos.durability_rules chaos.effect_observer chaos.protocol_rules chaos.unit_knowledge "
    "fleet.batched_runner fleet.contact_history fleet.event_loop fleet.sensor_faults "
    "fleet.simulated_disk fleet.simulated_fleet fleet.stop_monitor fleet.trace_recorder "
    "runs.delivery_fleet runs.exploration_fleet runs.grid_fleet world.checkers "
    "world.grid_world world.ground_truth world.protocol_world world.pymunk_engine world.robot_body "
    "world.world",
}  # fmt: skip


class CompileError(Exception):
    """One line for the person: what is wrong and what to do."""


class ToolMissingError(CompileError):
    """Nothing is wrong with the sources: this machine cannot compile."""


def files(group: dict[str, str]) -> list[str]:
    """Paths of the modules of a group, below the root of the repository."""
    return [
        f"{package}/{name.replace('.', '/')}.py"
        for package, names in group.items()
        for name in names.split()
    ]


def build(folder: Path, group: dict[str, str] = GROUP) -> Iterator[tuple[str, int, int]]:
    """Make a core of these modules in `folder`. Yields each step: what, how many are done, of how many.

    Raises CompileError.
    """
    if PREFIX:
        raise ToolMissingError("a compiled core is made in a checkout (git clone), not in a wheel")
    try:
        from mypyc.build import mypycify
        from setuptools._distutils.errors import CCompilerError
    except ImportError as problem:
        raise ToolMissingError(f"{problem.name} is needed: pip install mypy setuptools") from None
    compiler = _compiler()
    scratch = folder.with_suffix(".making")
    shutil.rmtree(scratch, ignore_errors=True)
    try:
        scratch.mkdir(parents=True)
        yield "types and C", 0, 0
        modules = _translated(mypycify, files(group), scratch / "c")
        yield from _machine_code(compiler, modules, scratch)
        shutil.rmtree(folder, ignore_errors=True)
        (scratch / "core").rename(folder)
    except (CCompilerError, OSError) as problem:
        raise CompileError(f"the core was not made: {problem}") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _compiler() -> Any:
    """As Python itself was compiled. Raises ToolMissingError."""
    from setuptools._distutils.ccompiler import new_compiler
    from setuptools._distutils.sysconfig import customize_compiler

    compiler: Any = new_compiler()
    customize_compiler(compiler)
    name = compiler.compiler_so[0]
    if shutil.which(name) is None:
        raise ToolMissingError(f"no C compiler {name}: apt-get install gcc")
    headers = sysconfig.get_paths()["include"]
    if not Path(headers, "Python.h").exists():
        raise ToolMissingError(f"no Python.h in {headers}: apt-get install python3-dev")
    compiler.add_include_dir(headers)
    return compiler


def _machine_code(
    compiler: Any, modules: list[Any], scratch: Path
) -> Iterator[tuple[str, int, int]]:
    """Each extension under `scratch`/core, its objects under `scratch`/o."""

    def compiled(module: Any, source: str) -> tuple[str, str]:
        ours = Path(source).name.startswith("__native")
        (file,) = compiler.compile(
            [source], output_dir=f"{scratch}/o", include_dirs=module.include_dirs,
            extra_postargs=[*module.extra_compile_args, *(["-include", str(CACHES)] * ours)],
        )  # fmt: skip
        return source, file

    total, done = sum(len(module.sources) for module in modules), 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for module in modules:
            objects: list[str] = []
            for source, file in pool.map(partial(compiled, module), module.sources):
                objects.append(file)
                done += 1
                yield Path(source).stem.removeprefix("__native_").replace("___", "."), done, total
            target = scratch / "core" / (module.name.replace(".", "/") + SUFFIX)
            compiler.link_shared_object(objects, str(target))


def _translated(mypycify: Callable[..., list[Any]], sources: list[str], folder: Path) -> list[Any]:
    """The C sources, as extensions. What mypyc says is told only where it refuses."""
    said = io.StringIO()
    try:
        with chdir(ROOT), redirect_stdout(said), redirect_stderr(said):
            return mypycify(
                [f"--cache-dir={CACHE}", *sources],
                opt_level=LEVEL, debug_level="0", multi_file=True, target_dir=str(folder),
            )  # fmt: skip
    except SystemExit:
        wrong = [line for line in said.getvalue().splitlines() if " error: " in line]
        raise CompileError(f"mypyc refuses the sources: {(wrong or ['?'])[0]}") from None


def compile_core(remove: bool, as_json: bool = False) -> int:
    """The exit code of `headland compile`: compile all groups, or with `remove` delete what was
    compiled. 1 where mypy or the compiler fails, 2 where one is missing. `as_json`: then the lines for
    people go to standard error."""
    console = Console(stderr=as_json)
    if remove:
        there = any(path.is_dir() for path in FOLDER.glob("*"))
        for folder in (FOLDER, CACHE):
            shutil.rmtree(folder, ignore_errors=True)
        console.print(f"removed {FOLDER}" if there else "there was no compiled core")
        _print_json(as_json, {"removed": there})
        return 0
    if PREFIX:  # nothing is compiled, so nothing is written
        return _compile_core(console, as_json)
    try:
        FOLDER.mkdir(parents=True, exist_ok=True)
        file = (FOLDER / "lock").open("w")
    except OSError as problem:
        print(f"headland: the core was not made: {problem}", file=sys.stderr)
        return FAILED
    with file:
        if not lock(file, wait=False):
            console.print("another headland compile is at work: waiting for it")
            lock(file)
        return _compile_core(console, as_json)


def _compile_core(console: Console, as_json: bool) -> int:
    """While no other process compiles."""
    folder, begun_s = place(), time.monotonic()
    if folder.is_dir():
        console.print(f"there is one of these sources: {folder}")
        _print_json(as_json, {"folder": str(folder), "compiled": False})
        return 0
    try:
        with console.status("") as status:
            for name, done, total in build(folder):
                status.update(f"compiling {name} ... {done} of {total or '?'}")
    except CompileError as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG if isinstance(problem, ToolMissingError) else FAILED
    for other in FOLDER.iterdir():  # of other sources: never found again
        if other != folder:
            shutil.rmtree(other, ignore_errors=True)
    size_mb = sum(file.stat().st_size for file in folder.glob("**/*.so")) / 1e6
    spent_s = time.monotonic() - begun_s
    console.print(f"{len(files(GROUP))} modules, {size_mb:.1f} MB, {spent_s:.0f} s: {folder}")
    _print_json(as_json, {
        "folder": str(folder), "compiled": True, "modules": len(files(GROUP)),
        "size_mb": round(size_mb, 1), "spent_s": round(spent_s, 1),
    })  # fmt: skip
    return 0


def _print_json(asked: bool, found: dict[str, object]) -> None:
    if asked:
        print(dumps(found))
