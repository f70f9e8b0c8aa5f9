"""`headland robot`: one robot as a process on a machine, or what it would need to be one."""

import asyncio
import json
import os
import sys
from pathlib import Path

from rich.console import Console

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.runtime.body_plugins import plugins
from agent.runtime.declared_values import FleetTable
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_body import FactoryError, RobotBody, named
from agent.runtime.robot_file import WORKS, Changes, RobotError, RobotFile
from agent.runtime.robot_process import (
    WRONG,
    keys_of,
    opened_body,
    opened_bus,
    until_told,
)
from agent.runtime.robot_work import work_of
from tools.common.findings import Finding, print_findings
from tools.run.robot_viewers import check_viewers, viewers_beside

BLIND = (
    "no range sensors: it does not see people, animals, or anything else that is not a member; "
    "fences and members it keeps clear of"
)
INTERRUPTED = 130
ANSWER_FOR_S = 3.0  # a bus server answers within milliseconds
FIRST_PLACE_FOR_US = 3 * S  # a body that is open senses within this


def robot(
    file: Path, changes: Changes, *, first_boot: bool, check: bool, dry: bool, as_json: bool,
    metrics: str | None = None, foxglove: int | None = None,
) -> int:  # fmt: skip
    """The exit code of `headland robot`: 0 after a farewell or if all is there, 1 if the robot failed,
    2 if a person has to mend something first.

    `metrics`: PORT or HOST:PORT of figures for Prometheus. `foxglove`: a port for viewers."""
    import_from(file.parent)
    try:
        declared = RobotFile.read(file, changes)
        if check:
            return asyncio.run(_check(declared, as_json))
        check_viewers(metrics, foxglove)
        if not first_boot and not _memory(declared).exists():
            print(
                f"headland: robot {declared.robot.slot} has no memory in {_memory(declared).parent}; "
                "it stays stopped until a reset. A new machine starts with --first-boot",
                file=sys.stderr,
            )
        if not _sees(declared):
            print(f"headland: robot {declared.robot.slot}: {BLIND}", file=sys.stderr)
        with viewers_beside(declared, metrics, foxglove):
            asyncio.run(until_told(declared, first_boot=first_boot, dry=dry))
    except RobotError as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0


def import_from(folder: Path) -> None:
    """Modules of a driver are found beside the robot file and in the working folder."""
    for place in (str(folder.resolve()), str(Path.cwd())):
        if place not in sys.path:
            sys.path.insert(0, place)


def _memory(declared: RobotFile) -> Path:
    return declared.folder / declared.robot.journal / f"robot{declared.robot.slot}.sqlite"


def _sees(declared: RobotFile) -> bool:
    """Whether its body has range sensors, as far as its class is known before it is opened."""
    body = declared.body
    factory = body.factory if body.plugin is None else plugins().get(body.plugin)
    try:
        made = named(factory or "")
    except FactoryError:
        return True  # what is wrong is told when it is opened
    return bool(getattr(made, "has_range_sensors", True))


async def _check(declared: RobotFile, as_json: bool) -> int:
    """What would run and what is missing; nothing is sent and nothing driven."""
    findings = [
        _file(declared),
        _keys(declared),
        _work(declared),
        _journal(declared),
        await _bus(declared),
        *await _body(declared),
    ]
    bad = [finding for finding in findings if finding.ok is False]
    if as_json:
        said = {"ready": not bad, "findings": [finding._asdict() for finding in findings]}
        strict = json.dumps(
            said, allow_nan=False
        )  # as `sim.files.strict_json`, which a robot lacks
        print(strict)
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
        return Finding("keys", None, "none: who is on the bus can reset and order it")
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


def _journal(declared: RobotFile) -> Finding:
    path = _memory(declared)
    if path.exists():
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
    except RobotError as problem:
        return [Finding("body", False, str(problem))]
    try:
        return [Finding("body", True, name), await _place(body), _ranges(declared)]
    finally:
        body.close()


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
    return Finding("ranges", True, "yes") if _sees(declared) else Finding("ranges", None, BLIND)
