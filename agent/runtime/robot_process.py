"""One robot as a process, without a simulator: bus, body, keys, work and memory from one file.

    python -m headland.agent.runtime.robot_process robot2.toml --first-boot    # a new machine
    python -m headland.agent.runtime.robot_process robot2.toml                 # later

It ends on SIGTERM, SIGHUP or Ctrl-C, with a farewell on the bus. `docs/use/robot.md` says how to add a
body.
"""

import argparse
import asyncio
import logging
import secrets
import sys
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from random import Random
from traceback import clear_frames
from typing import Any, TypeVar

from numpy import float32, integer

from agent.runtime.ready_kernels import use_ready_kernels

if __name__ == "__main__":
    use_ready_kernels()  # before anything is imported that has kernels

from agent.interface.effects import GatedDrive
from agent.interface.observation import Observation
from agent.interface.ports import Bus
from agent.peer.inputs import DateTold
from agent.peer.peer import Peer
from agent.runtime.body_plugins import made
from agent.runtime.end_signals import on_end
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.key_file import KeyFileError, read_robot
from agent.runtime.files.release_log import ReleaseLog, key_of, path_of
from agent.runtime.gc_tuning import free_planning_memory, freeze_gc
from agent.runtime.peer_factory import (
    NO_MISSION,
    clock_zero_at_s,
    identity_of,
    keyring_of,
    make_peer,
)
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_body import (
    DeclaredMachine,
    DryBody,
    FactoryError,
    OptionError,
    RobotBody,
    fault_text,
    named,
)
from agent.runtime.robot_file import (
    AbsentError,
    DriverError,
    RobotBusTable,
    RobotError,
    RobotFile,
)
from agent.runtime.robot_work import work_of
from agent.runtime.sqlite_journal import SqliteJournal
from agent.runtime.work_memory import TRANSPORTS, of_work
from agent.segments.segment_area import Area
from protocol.authentication import Keys
from protocol.links.bus import GONE, CanBus, open_bus
from protocol.links.socketcand_link import SocketcandLink

MULTICAST = "udp_multicast"  # the interface of python-can whose channel is a multicast address
TELL_AFTER_S = 2.0  # a person is told of a wait that is longer
GOODBYE_S = 0.2  # for the farewell frame to leave
DATE_EACH_S = 60.0  # between two looks at the computer's date
LOST_LOOK_S = 1.0  # between two looks whether the interface of the bus is gone
Opened = TypeVar("Opened")  # a body, or a bus
WRONG = RobotError.code  # exit code of an error that a person has to mend; one line says what it is


class AttendedBody(RobotBody):
    """A body whose failures end its robot with one line.

    Each call raises AbsentError for an OSError of the driver, as for an absent device, so that a
    supervisor starts the robot again, and DriverError for any other exception."""

    def __init__(self, body: RobotBody, slot: int) -> None:
        self.body, self.slot = body, slot
        self._failed = False

    def sense(self, now_us: int) -> Observation | None:
        """The newest reading of the body."""
        try:
            seen: object = self.body.sense(now_us)
        except Exception as problem:  # drivers raise what they like
            raise self._failure("sense", problem) from problem
        if seen is None:
            return None
        if isinstance(seen, Observation):
            wrong = wrong_kind(seen)
            if not wrong:
                return seen
        else:
            wrong = f"no Observation but {type(seen).__name__}"
        self._failed = True
        driver = type(driver_of(self.body))
        code = getattr(driver.sense, "__code__", None)  # none of a compiled driver
        where = f"{Path(code.co_filename).name}:{code.co_firstlineno}" if code else driver.__name__
        raise DriverError(f"robot {self.slot}: body: sense returned {wrong} ({where})")

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Let the body obey."""
        try:
            self.body.drive(command, now_us)
        except Exception as problem:  # drivers raise what they like
            raise self._failure("drive", problem) from problem

    async def watch(self, peer: Peer) -> None:
        """Run what the body runs beside the robot. A failure of it is told, and the robot goes on."""
        try:
            await self.body.watch(peer)
        except Exception as problem:  # drivers raise what they like
            told = driver_error(self.slot, "watch", self.body, problem)
            print(f"headland: {told}; the robot goes on without it", file=sys.stderr)

    def close(self) -> None:
        """Let the body stand. After another failure, one of this call says nothing new."""
        try:
            self.body.close()
        except Exception as problem:  # drivers raise what they like
            if not self._failed:
                raise self._failure("close", problem) from problem

    def _failure(self, call: str, problem: Exception) -> RobotError:
        self._failed = True
        if isinstance(problem, OSError):
            said = f"{call}: {problem.strerror or said_by(problem)}"
            return AbsentError(f"robot {self.slot}: body: {said}")
        return driver_error(self.slot, call, self.body, problem)


NUMBERS = (
    "x_m", "y_m", "heading_rad", "vx_m_s", "vy_m_s", "battery", "sensed_at_us", "health",
    "position_accuracy_m", "heading_accuracy_rad",
)  # fmt: skip


def wrong_kind(seen: Observation) -> str:
    """Which value of an observation no robot can compute with; empty if there is none."""
    for name in NUMBERS:
        value: object = getattr(seen, name)
        if not _is_number(value):
            return f"{name} = {value!r}, which is no number"
    ranges_m: object = seen.ranges_m
    if not isinstance(ranges_m, tuple | list) or not all(map(_is_number, ranges_m)):
        return "ranges_m that are no tuple of numbers"
    return ""


def _is_number(value: object) -> bool:
    """Whether kernels can compute with it. A fraction is a number, too, and they know none."""
    return isinstance(value, int | float | float32 | integer)


def said_by(problem: Exception) -> str:
    """What an error says; its kind where it says nothing, as TimeoutError()."""
    return str(problem) or type(problem).__name__


def driver_of(body: RobotBody) -> RobotBody:
    """The body of a person, without one of ours round it."""
    return body.body if isinstance(body, DryBody) else body


def driver_error(slot: int, call: str, body: RobotBody | None, problem: Exception) -> DriverError:
    """What an exception of a driver is for the person who has to mend it."""
    module = None if body is None else sys.modules.get(type(driver_of(body)).__module__)
    raised = fault_text(problem, getattr(module, "__file__", None))
    return DriverError(f"robot {slot}: body: {call} raised {raised}")


def keys_of(robot: RobotFile) -> Keys | None:
    """The keys of its fleet; None without any. Raises RobotError."""
    if robot.fleet.keys is None:
        return None
    try:
        return read_robot(robot.folder / robot.fleet.keys, robot.robot.slot).keys
    except KeyFileError as problem:
        raise RobotError(f"robot {robot.robot.slot}: fleet.keys: {problem}") from None


def _journal(robot: RobotFile) -> tuple[SqliteJournal, Mapping[str, bytes]]:
    """Its durable memory, and the records in it. Raises RobotError."""
    slot = robot.robot.slot
    path = robot.folder / robot.robot.journal / f"robot{slot}.sqlite"
    try:
        journal, recalled = SqliteJournal.opened(path)
    except OSError as problem:
        raise RobotError(f"robot {slot}: its journal cannot be opened: {problem}") from None
    if said := str(journal.narrowed):
        print(f"headland: robot {slot}: {said}", file=sys.stderr)
    return journal, recalled


def _of_work(
    robot: RobotFile, journal: SqliteJournal, recalled: Mapping[str, bytes], field_hash: int
) -> Mapping[str, bytes]:
    """What it remembers of this work; what it did elsewhere is put by. Raises RobotError."""
    slot, work = robot.robot.slot, TRANSPORTS if robot.warehouse is not None else field_hash
    try:
        found, put_by = of_work(journal, recalled, work)
    except OSError as problem:
        raise RobotError(f"robot {slot}: its journal cannot be written: {problem}") from None
    if put_by:
        print(
            f"headland: robot {slot}: its memory is of other work: {put_by} records wait until it comes "
            "back to that", file=sys.stderr,
        )  # fmt: skip
    return found


async def opened_bus(table: RobotBusTable, slot: int, answer_for_s: float | None = None) -> Bus:
    """The bus; one behind a socketcand server reconnects by itself. Raises RobotError.

    `answer_for_s`: until when the server has to answer; None: it is waited for, and a line says so."""
    options = table.options
    if table.interface == MULTICAST and not _is_group(table.channel):
        raise RobotError(
            f"robot {slot}: bus.channel: {table.channel!r} is no multicast address, as 239.74.163.2 is"
        )
    if table.interface == "socketcand" and not {"host", "port"} <= options.keys():
        raise RobotError(f"robot {slot}: bus.options: socketcand needs host and port")
    try:
        if table.interface != "socketcand":
            return open_bus(table.interface, table.channel, table.bitrate, **options)
        rng = Random(f"line of robot {slot}")
        host, port = _server(str(options["host"]), int(options["port"]))
        link = SocketcandLink(host, port, table.channel, rng)
    except Exception as problem:  # python-can interfaces raise what they like
        _forget_half_opened(problem)
        reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        where = f"{table.interface} {table.channel}"
        # OSError: an adapter that is not plugged in, a link that is down. Of a multicast group it is the
        # cause of another error.
        gone = getattr(problem.__cause__, "errno", None) in GONE
        kind = AbsentError if gone or isinstance(problem, OSError) else RobotError
        raise kind(f"robot {slot}: bus: cannot open {where}: {reason}") from None
    unanswered = f"no socketcand server answers at {host}:{port}"
    try:
        try:
            async with asyncio.timeout(TELL_AFTER_S if answer_for_s is None else answer_for_s):
                await link.up()
        except TimeoutError:
            if answer_for_s is not None:
                raise AbsentError(f"robot {slot}: bus: {unanswered}") from None
            print(f"robot {slot}: waits for its bus, {unanswered}; Ctrl-C ends it", file=sys.stderr)
            await link.up()
    except (RobotError, asyncio.CancelledError):
        link.close()
        raise
    return link


def _server(host: str, port: int) -> tuple[str, int]:
    """Host and port of a server. Raises ValueError for what no computer has: no server answers there."""
    if not 0 < port < 1 << 16:
        raise ValueError(f"{port} is no port")
    try:
        named = host.encode("idna")
    except UnicodeError:
        named = b""
    if not named:
        raise ValueError(f"{host!r} is no name of a computer")
    return host, port


def _is_group(channel: str) -> bool:
    """Whether it is a multicast address."""
    try:
        return ip_address(channel).is_multicast
    except ValueError:
        return False


def _forget_half_opened(problem: Exception) -> None:
    """Free a bus that could not be opened, without python-can's line that nobody has closed it."""
    log = logging.getLogger("can.bus")
    disabled, log.disabled = log.disabled, True
    try:
        clear_frames(problem.__traceback__)
    finally:
        log.disabled = disabled


async def _before(end: asyncio.Event, opened: Coroutine[Any, Any, Opened]) -> Opened | None:
    """The device that is opened; None where the robot is ended while it waits for it.

    Raises RobotError."""
    opening = asyncio.create_task(opened)
    ending = asyncio.create_task(end.wait())
    await asyncio.wait({opening, ending}, return_when=asyncio.FIRST_COMPLETED)
    ending.cancel()
    if opening.done():
        return await opening
    opening.cancel()
    await asyncio.wait({opening})
    return None


def origin_of(robot: RobotFile) -> tuple[float, float] | None:
    """Latitude and longitude, degrees, of the origin of its field; None without a field.

    Raises RobotError."""
    if robot.field is None:
        return None
    try:
        return read_boundary(robot.folder / robot.field.file, robot.field.feature).origin
    except FieldFileError as problem:
        raise RobotError(f"robot {robot.robot.slot}: field.file: {problem}") from None


async def opened_body(robot: RobotFile, *, dry: bool = False) -> RobotBody:
    """Its body, connected; with `dry` one that is never driven. Raises RobotError."""
    slot, call = robot.robot.slot, "declare"
    body: RobotBody | None = None
    try:
        _check_class(robot)
        body = made(robot.body.plugin, robot.body.factory, slot, robot.body.options)
        body = DryBody(body) if dry else body
        body.declare(DeclaredMachine(robot.fleet.vehicle, origin_of(robot), robot.folder))
        call = "open"
        await body.open()
    except asyncio.CancelledError:
        with suppress(Exception):  # of a driver that was not open yet
            if body is not None:
                body.close()
        raise
    except RobotError:
        raise
    except OptionError as problem:
        own = any(
            each.slot == slot and problem.option in each.body_options for each in robot.machine
        )
        where = "body_options" if own else "body.options"
        raise RobotError(f"robot {slot}: {where}: {problem}") from None
    except FactoryError as problem:
        key = "plugin" if robot.body.factory is None else "factory"
        raise RobotError(f"robot {slot}: body.{key}: {problem}") from problem
    except OSError as problem:
        raise AbsentError(f"robot {slot}: body: {said_by(problem)}") from None
    except ValueError as problem:
        raise RobotError(f"robot {slot}: body: {said_by(problem)}") from problem
    except Exception as problem:  # drivers raise what they like
        raise driver_error(slot, call, body, problem) from problem
    return body


def _check_class(robot: RobotFile) -> None:
    """Raises FactoryError where the factory of a body is a class of something else."""
    factory = robot.body.factory
    if factory is None:
        return
    make = named(factory)
    if isinstance(make, type) and not issubclass(make, RobotBody):
        raise FactoryError(f"{factory!r} makes no RobotBody")


async def run_robot(
    robot: RobotFile,
    end: asyncio.Event,
    *,
    first_boot: bool = False,
    dry: bool = False,
    started: Callable[[PeerRunner], None] | None = None,
) -> None:
    """Run one robot until `end` is set; then it leaves the fleet with a farewell.

    `first_boot`: a new machine. Otherwise an empty memory counts as lost, and the robot stays latched
    until a person resets it. `dry`: its body is never driven, and it does no work. `started`: called
    once, when it takes part. Raises RobotError before it takes part, AbsentError where a device of its
    body or its bus fails later, DriverError where the driver of its body does, and whatever else ends
    its peer.
    """
    slot, keys = robot.robot.slot, keys_of(robot)
    journal, recalled = _journal(robot)
    try:
        found = await _before(end, opened_body(robot, dry=dry))
        if found is None:
            return
        body = AttendedBody(found, slot)
        try:
            bus = await _before(end, opened_bus(robot.bus, slot))
            if bus is None:
                return
            try:
                now_us, lot = PeerRunner.now_us(), secrets.token_bytes(16)
                work = work_of(robot, now_us, recalled)
                if work.parts.mission is not None:
                    recalled = _of_work(robot, journal, recalled, work.field_hash)
                # A body that is not driven does no work. Its place would seem frozen, and the next start
                # would stand until a person looks.
                parts = NO_MISSION if dry else work.parts
                identity = identity_of(
                    robot.name, slot, robot.fleet.robots, work.field_hash,
                    robot.fleet.silence_policy, first_boot=first_boot, diagnostics=True,
                    implement_width_m=robot.field.implement_width_m if robot.field else 0.0,
                    device=robot.device.fields,
                )  # fmt: skip
                segment = robot.robot.segment
                peer = make_peer(
                    identity, Random(lot), PeerRunner.now_us(), recalled, parts,
                    keyring=keyring_of(keys, slot, lot.hex().encode(), clock_zero_at_s(now_us)),
                    area=Area(segment, work.sections) if segment else None,
                )  # fmt: skip
                memory = robot.folder / robot.robot.journal
                kept = ReleaseLog(path_of(memory, slot), slot, key_of(keys, slot))
                runner = PeerRunner(peer, bus, body, journal, kept.keep)
                await _take_part(runner, body, bus, end, started)
            finally:
                bus.close()
        finally:
            body.close()
    finally:
        journal.close()


async def _until_lost(bus: Bus) -> str:
    """Returns why the interface of a bus does not come back by itself; a supervisor reopens it."""
    while not isinstance(bus, CanBus) or bus.lost is None:
        await asyncio.sleep(LOST_LOOK_S)
    return bus.lost


async def tell_date(runner: PeerRunner) -> None:
    """Tell the date again and again: a computer without a battery learns it after the start."""
    while True:
        runner.operate(DateTold(clock_zero_at_s(PeerRunner.now_us())))
        await asyncio.sleep(DATE_EACH_S)


async def _take_part(
    runner: PeerRunner,
    body: RobotBody,
    bus: Bus,
    end: asyncio.Event,
    started: Callable[[PeerRunner], None] | None,
) -> None:
    """From the first frame to the farewell."""
    freeze_gc()
    free_planning_memory()
    running = asyncio.create_task(runner.run())
    watching = asyncio.create_task(body.watch(runner.peer))
    ending = asyncio.create_task(end.wait())
    losing = asyncio.create_task(_until_lost(bus))
    dating = asyncio.create_task(tell_date(runner))
    if started is not None:
        started(runner)
    await asyncio.wait({running, ending, losing}, return_when=asyncio.FIRST_COMPLETED)
    if losing.done():
        running.cancel()
    elif not running.done():
        await runner.leave()
        await asyncio.sleep(GOODBYE_S)
        running.cancel()
    lost = losing.result() if losing.done() else None
    for task in (ending, watching, losing, dating):
        task.cancel()
    (failure,) = await asyncio.gather(running, return_exceptions=True)
    if isinstance(failure, OSError):  # the body or the bus: it may be there at the next start
        raise AbsentError(f"robot {runner.peer.slot}: a device failed: {failure}") from failure
    if lost is not None:
        raise AbsentError(f"robot {runner.peer.slot}: bus: {lost}")
    if isinstance(failure, BaseException) and not isinstance(failure, asyncio.CancelledError):
        raise failure


async def until_told(robot: RobotFile, *, first_boot: bool = False, dry: bool = False) -> None:
    """Run until SIGTERM, SIGHUP or SIGINT. Raises RobotError."""
    end, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end(loop, end.set)

    def started(runner: PeerRunner) -> None:
        print(f"robot {runner.peer.slot} is up", flush=True)

    await run_robot(robot, end, first_boot=first_boot, dry=dry, started=started)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m headland.agent.runtime.robot_process",
        description="Run one robot from a robot file.",
    )
    parser.add_argument("file", type=Path, help="the robot file (TOML)")
    parser.add_argument(
        "--first-boot", action="store_true",
        help="a new machine, for which an empty memory is no loss",
    )  # fmt: skip
    options = parser.parse_args()
    try:
        asyncio.run(until_told(RobotFile.read(options.file), first_boot=options.first_boot))
    except RobotError as problem:
        print(problem, file=sys.stderr)
        sys.exit(problem.code)


if __name__ == "__main__":
    main()
