"""`headland robot --check`: what would run on this machine, and what is missing."""

import asyncio
import json
import os
import shutil
from pathlib import Path

from rich.console import Console
from shapely.geometry import Point

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.observation import Observation
from agent.interface.ports import Confirming
from agent.interface.vehicle import DriveTrain
from agent.peer.place_jumps import AGE_MAX_US, JUMP_M, POSITION_ACCURACY_M
from agent.peer.sense_freshness import blind_way_m, unusable
from agent.runtime.declared_values import FleetTable
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_body import RobotBody, fault_text
from agent.runtime.robot_file import WORKS, Changes, RobotError, RobotFile
from agent.runtime.robot_process import WRONG, AttendedBody, keys_of, opened_body, opened_bus
from agent.runtime.robot_work import work_of
from agent.runtime.sqlite_journal import InUseError, SqliteJournal
from tools.build.kernel_cache import WAIT
from tools.common.counted import counted
from tools.common.exit_codes import wrong
from tools.common.findings import Finding, print_findings
from tools.run.robot_command import (
    BLIND,
    declared_in,
    import_from,
    is_written,
    lacks_kernels,
    memory,
    memory_wrong,
    sees,
)

ANSWER_FOR_S = 3.0  # a bus server answers within milliseconds
FIRST_PLACE_FOR_US = 3 * S  # a body that is open senses within this
# A memory grows to less than a megabyte. SQLite's log beside it is emptied at four.
MEMORY_FREE_BYTES = 8 << 20
UNCONFIRMED = "no frame is confirmed, so a robot that is alone stands for ever (UNHEARD)"


def check(
    file: Path, changes: Changes, as_json: bool, metrics: str | None = None, foxglove: int | None = None
) -> int:  # fmt: skip
    """What would run and what is missing; nothing is sent and nothing driven. 0: all is there, 2: a
    person has to mend something first. `metrics`, `foxglove`: ports of the robot, as it is told them."""
    import_from(file.parent)
    try:
        declared = declared_in(file, changes)
        return asyncio.run(_check(declared, as_json, _viewers(metrics, foxglove)))
    except RobotError as problem:
        return wrong(problem)


def _viewers(metrics: str | None, foxglove: int | None) -> list[Finding]:
    """Whether the ports of figures and viewers are free; without such ports there is nothing to say."""
    if metrics is None and foxglove is None:
        return []
    from tools.run.robot_viewers import check_viewers

    try:
        check_viewers(metrics, foxglove)
    except RobotError as problem:
        return [Finding("viewers", False, str(problem))]
    return [Finding("viewers", True, "their ports are free")]


async def _check(declared: RobotFile, as_json: bool, viewers: list[Finding]) -> int:
    runs = _runs(declared)
    findings = [
        _file(declared),
        *_machine(declared),
        *_hull(declared),
        _keys(declared),
        *kernels(declared),  # before the work, which compiles some
        _work(declared),
        _limits(declared),
        *([runs] if runs else [_journal(declared), await _bus(declared), *await _body(declared)]),
        *viewers,
    ]
    findings = _once(findings)
    bad = [finding for finding in findings if finding.ok is False]
    if as_json:
        said = {"ready": not bad, "findings": [finding._asdict() for finding in findings]}
        print(json.dumps(said, allow_nan=False))  # as `sim.files.strict_json`, which a robot lacks
    else:
        console = Console(highlight=False)
        print_findings(console, findings)
        console.print("ready" if not bad else f"not ready: {', '.join(f.what for f in bad)}")
    return WRONG if bad else 0


def _once(findings: list[Finding]) -> list[Finding]:
    """Without what an earlier finding says: a field that is missing is missed by the body as well."""
    said: set[str] = set()
    kept = []
    for finding in findings:
        if finding.ok is not False or finding.found not in said:
            kept.append(finding)
        if finding.ok is False:
            said.add(finding.found)
    return kept


def _hull(declared: RobotFile) -> list[Finding]:
    """A word where the body that is kept clear of others has less width than its wheels."""
    vehicle, radius_m = declared.fleet.vehicle, declared.fleet.radius_m
    if vehicle.drive is DriveTrain.MECANUM or vehicle.track_m <= 2 * radius_m:
        return []
    text = (
        f"radius_m {radius_m:g}: the hull is narrower than the wheels (track_m {vehicle.track_m:g}), "
        "so others come too near"
    )
    return [Finding("hull", None, text)]


def _file(declared: RobotFile) -> Finding:
    fleet: FleetTable = declared.fleet
    text = f"robot {declared.robot.slot} of {fleet.robots} in {declared.name!r}, {fleet.drive}"
    return Finding("file", True, text)


def _machine(declared: RobotFile) -> list[Finding]:
    """A word where the file names machines and this one is not among them."""
    slot = declared.robot.slot
    if not declared.machine or any(machine.slot == slot for machine in declared.machine):
        return []
    return [Finding("slot", None, f"no [[machine]] of slot {slot}: body and bus are the fleet's")]


def _keys(declared: RobotFile) -> Finding:
    try:
        keys = keys_of(declared)
    except RobotError as problem:
        return Finding("keys", False, str(problem))
    if keys is None:
        return Finding("keys", None, "none: every device on the bus can reset and order it")
    return Finding("keys", True, str(declared.fleet.keys))


def _work(declared: RobotFile) -> Finding:
    try:
        work = work_of(declared, 0, {})
    except RobotError as problem:
        return Finding("work", False, str(problem))
    if declared.field is not None:
        return Finding(
            "work", True, f"{declared.field.file}: {counted(work.sections, '{} section{s}')}"
        )
    if declared.mission is not None:
        return Finding("work", True, declared.mission.factory)
    kind = next((name for name in WORKS if getattr(declared, name) is not None), None)
    if kind is not None:
        return Finding("work", True, kind)
    return Finding("work", None, "none: a member that is stopped like the others")


def kernels(declared: RobotFile) -> list[Finding]:
    """A word where the robot has to compile kernels before it works."""
    if not lacks_kernels(declared):
        return []
    return [Finding("kernels", None, f"{WAIT} (headland compile --kernels)")]


def _needed_m(declared: RobotFile) -> float:
    """The standard deviation of a place with which it drives, metres."""
    try:
        mission = work_of(declared, 0, {}).parts.mission
    except RobotError:
        mission = None  # said with the work
    if mission is None:
        return POSITION_ACCURACY_M
    return min(POSITION_ACCURACY_M, mission.position_accuracy_max_m)


def _limits(declared: RobotFile) -> Finding:
    """What stops it, and how far it has then driven."""
    vehicle, needed_m = declared.fleet.vehicle, _needed_m(declared)
    text = (
        f"stands without a place for {AGE_MAX_US / S:.2g} s, with one worse than {needed_m:.2g} m, or "
        f"one that jumps {JUMP_M:.2g} m further than wheels drive; from {vehicle.speed_m_s:g} m/s it "
        f"stands after {blind_way_m(vehicle.limits):.1f} m"
    )
    return Finding("limits", True, text)


def _runs(declared: RobotFile) -> Finding | None:
    """Whether this robot runs already. Its devices are in use then. A body that is closed tells wheels
    to stand, and of a serial port each reader takes what the other one misses."""
    path = memory(declared)
    if not path.exists():
        return None
    try:
        SqliteJournal(path).close()
    except InUseError as problem:
        return Finding("memory", False, f"{problem}; bus and body are not looked at")
    except OSError:
        return None  # said with the memory, or when the robot starts
    return None


def _journal(declared: RobotFile) -> Finding:
    path = memory(declared)
    if wrong := memory_wrong(declared):
        return Finding("memory", False, wrong)
    try:
        disk = shutil.disk_usage(path.parent)
    except OSError as problem:
        return Finding("memory", False, f"{path.parent}: {problem.strerror}")
    if disk.total and disk.free < MEMORY_FREE_BYTES:  # no total: a file system without a limit
        needed = f"{disk.free / 1e6:.1f} MB are free, {MEMORY_FREE_BYTES / 1e6:.1f} MB are needed"
        return Finding("memory", False, f"the disk of {path.parent} is full: {needed}")
    if is_written(path):
        return Finding("memory", os.access(path, os.W_OK), str(path))
    return Finding("memory", None, f"none yet in {path.parent}: --first-boot")


async def _bus(declared: RobotFile) -> Finding:
    where = f"{declared.bus.interface} {declared.bus.channel}"
    try:
        bus = await opened_bus(declared.bus, declared.robot.slot, answer_for_s=ANSWER_FOR_S)
    except RobotError as problem:
        return Finding("bus", False, str(problem))
    confirms = isinstance(bus, Confirming) and bus.sent is not None
    bus.close()
    if declared.fleet.robots == 1 and not confirms:
        return Finding("bus", None, f"{where}: {UNCONFIRMED}")
    return Finding("bus", True, where)


async def _body(declared: RobotFile) -> list[Finding]:
    name = declared.body.plugin or str(declared.body.factory)
    try:
        body = AttendedBody(await opened_body(declared, dry=True), declared.robot.slot)
        try:
            if "body" in declared.model_fields_set:
                found = Finding("body", True, name)
            else:
                found = Finding("body", None, f"{name}: no [body] is declared, so nothing drives")
            findings = [found, await _place(declared, body), _ranges(declared)]
        finally:
            body.close()
    except RobotError as problem:
        return [Finding("body", False, str(problem))]
    except Exception as problem:  # drivers raise what they like
        return [Finding("body", False, f"{name} raised {fault_text(problem)}")]
    return findings


async def _place(declared: RobotFile, body: RobotBody) -> Finding:
    """The first place by which it would drive, or what is wrong with the last one."""
    ends_at_us = PeerRunner.now_us() + FIRST_PLACE_FOR_US
    needed_m = _needed_m(declared)
    while True:
        seen = body.sense(PeerRunner.now_us())
        now_us = PeerRunner.now_us()
        wrong = "nothing is sensed" if seen is None else unusable(seen, needed_m, now_us)
        if not wrong or now_us > ends_at_us:
            break
        await asyncio.sleep(CONTROL_PERIOD_US / S)
    if seen is None:
        return Finding("place", False, wrong)
    wrong = wrong or _outside(declared, seen)
    text = (
        f"{seen.x_m:.2f} m east, {seen.y_m:.2f} m north, accurate to {seen.position_accuracy_m:.3f} m, "
        f"sensed {(now_us - seen.sensed_at_us) / 1000:.0f} ms ago"
    )
    return Finding("place", not wrong, f"{text}: {wrong}" if wrong else text)


def _outside(declared: RobotFile, seen: Observation) -> str:
    """Why a robot at this place cannot begin its work; empty if it can. From beyond a fence it finds
    no way in, however near it is; beside one it drives off."""
    if declared.field is None:
        return ""
    try:
        outline = read_boundary(
            declared.folder / declared.field.file, declared.field.feature
        ).polygon
    except FieldFileError:
        return ""  # said with the work
    here = Point(seen.x_m, seen.y_m)
    if outline.contains(here):
        return ""
    return f"{outline.distance(here):.1f} m outside its field, where it finds no way in"


def _ranges(declared: RobotFile) -> Finding:
    return Finding("ranges", True, "yes") if sees(declared) else Finding("ranges", None, BLIND)
