"""`headland robot --check`: what would run on this machine, and what is missing."""

import asyncio
import json
import os
import sys
import traceback
from pathlib import Path

from rich.console import Console

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.peer.place_jumps import AGE_MAX_US, JUMP_M, POSITION_ACCURACY_M
from agent.peer.sense_freshness import blind_way_m
from agent.runtime.declared_values import FleetTable
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_body import RobotBody
from agent.runtime.robot_file import WORKS, Changes, RobotError, RobotFile
from agent.runtime.robot_process import WRONG, keys_of, opened_body, opened_bus
from agent.runtime.robot_work import work_of
from tools.common.findings import Finding, print_findings
from tools.run.robot_command import BLIND, import_from, is_written, memory, sees

ANSWER_FOR_S = 3.0  # a bus server answers within milliseconds
FIRST_PLACE_FOR_US = 3 * S  # a body that is open senses within this


def check(file: Path, changes: Changes, as_json: bool) -> int:
    """What would run and what is missing; nothing is sent and nothing driven. 0: all is there, 2: a
    person has to mend something first."""
    import_from(file.parent)
    try:
        return asyncio.run(_check(RobotFile.read(file, changes), as_json))
    except RobotError as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG


async def _check(declared: RobotFile, as_json: bool) -> int:
    findings = [
        _file(declared),
        _keys(declared),
        _work(declared),
        _limits(declared),
        _journal(declared),
        await _bus(declared),
        *await _body(declared),
    ]
    bad = [finding for finding in findings if finding.ok is False]
    if as_json:
        said = {"ready": not bad, "findings": [finding._asdict() for finding in findings]}
        print(json.dumps(said, allow_nan=False))  # as `sim.files.strict_json`, which a robot lacks
    else:
        console = Console(highlight=False)
        print_findings(console, findings)
        console.print("ready" if not bad else f"not ready: {', '.join(f.what for f in bad)}")
    return WRONG if bad else 0


def _file(declared: RobotFile) -> Finding:
    fleet: FleetTable = declared.fleet
    text = f"robot {declared.robot.slot} of {fleet.robots} in {declared.name!r}, {fleet.drive}"
    return Finding("file", True, text)


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
        return Finding("work", True, f"{declared.field.file}: {work.sections} sections")
    if declared.mission is not None:
        return Finding("work", True, declared.mission.factory)
    kind = next((name for name in WORKS if getattr(declared, name) is not None), None)
    if kind is not None:
        return Finding("work", True, kind)
    return Finding("work", None, "none: a member that is stopped like the others")


def _limits(declared: RobotFile) -> Finding:
    """What stops it, and how far it has then driven."""
    vehicle = declared.fleet.vehicle
    try:
        mission = work_of(declared, 0, {}).parts.mission
    except RobotError:
        mission = None  # said above
    needed_m = POSITION_ACCURACY_M
    if mission is not None:
        needed_m = min(needed_m, mission.position_accuracy_max_m)
    text = (
        f"stands without a place for {AGE_MAX_US / S:.2g} s, with one worse than {needed_m:.2g} m, or "
        f"one that jumps {JUMP_M:.2g} m further than wheels drive; from {vehicle.speed_m_s:g} m/s it "
        f"stands after {blind_way_m(vehicle.limits):.1f} m"
    )
    return Finding("limits", True, text)


def _journal(declared: RobotFile) -> Finding:
    path = memory(declared)
    if is_written(path):
        return Finding("memory", os.access(path, os.W_OK), str(path))
    if path.parent.is_dir() and os.access(path.parent, os.W_OK):
        return Finding("memory", None, f"none yet in {path.parent}: --first-boot")
    return Finding("memory", False, f"no folder {path.parent} that can be written")


async def _bus(declared: RobotFile) -> Finding:
    where = f"{declared.bus.interface} {declared.bus.channel}"
    try:
        bus = await opened_bus(declared.bus, declared.robot.slot, answer_for_s=ANSWER_FOR_S)
    except RobotError as problem:
        return Finding("bus", False, str(problem))
    bus.close()
    return Finding("bus", True, where)


async def _body(declared: RobotFile) -> list[Finding]:
    name = declared.body.plugin or str(declared.body.factory)
    try:
        body = await opened_body(declared, dry=True)
        try:
            findings = [Finding("body", True, name), await _place(body), _ranges(declared)]
        finally:
            body.close()
    except RobotError as problem:
        return [Finding("body", False, str(problem))]
    except Exception as problem:  # drivers raise what they like
        frame = traceback.extract_tb(problem.__traceback__)[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        said = f"{name} raised {type(problem).__name__}: {problem} ({where})"
        return [Finding("body", False, said)]
    return findings


async def _place(body: RobotBody) -> Finding:
    ends_at_us = PeerRunner.now_us() + FIRST_PLACE_FOR_US
    while (seen := body.sense(PeerRunner.now_us())) is None:
        if PeerRunner.now_us() > ends_at_us:
            return Finding("place", False, "nothing is sensed")
        await asyncio.sleep(CONTROL_PERIOD_US / S)
    now_us = PeerRunner.now_us()
    text = (
        f"{seen.x_m:.2f} m east, {seen.y_m:.2f} m north, accurate to {seen.position_accuracy_m:.3f} m, "
        f"sensed {(now_us - seen.sensed_at_us) / 1000:.0f} ms ago"
    )
    return Finding("place", True, text)


def _ranges(declared: RobotFile) -> Finding:
    return Finding("ranges", True, "yes") if sees(declared) else Finding("ranges", None, BLIND)
