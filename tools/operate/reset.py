"""`headland release`: clear the stops that are shown, reset each machine, and start only if asked."""

import asyncio
import time
from pathlib import Path

from agent.interface.lifecycle import State
from agent.runtime.files.key_file import OPERATOR, RESERVE, KeyFile, KeyFileError, read
from agent.safety.stop_controller import COUNT_TOLD_MAX
from crdt.stops import StopDot
from protocol.authentication import Keyring
from protocol.frames.safety_frames import AllImplementsStop, Command, Switch
from protocol.operator_badges import ALL_ROLES, DAY_S, Role
from sim.files.strict_json import dumps
from tools.common.bus_address import AttachError, robots_of_launch
from tools.common.bus_attach import attach
from tools.common.exit_codes import wrong
from tools.common.launch_keys import own_keys
from tools.common.told_wait import told_wait
from tools.operate.device_keys import DeviceKeys
from tools.operate.estop import NOT_ALL, listen_to
from tools.operate.operator_device import KnownRobot, Operator

STILL_S = 3.0  # longest wait until robots have named 64 stops, four at a time
LISTEN_S = 0.7  # latched robots repeat the dots they know to those that beat without being stopped
CAUSE_S = 1.6  # a robot that stands tells one of its causes each 1 to 1.4 s
CAUSES_S = 8.0  # longest wait for the causes of one robot
STEP_S = 0.1
NAMES_EVERY = 4  # tries: a name that is cleared changes the sum of what is held
BLOCK_S = 5  # a block of reserved frames lasts longer than this
UNSURE = "robots hold more stops than they name, so nobody knows which of them were cleared"
NOT_SIGNED = (
    "NOT SIGNED: only a fleet without keys is released by this, and by any device on the bus"
)


def reset(
    interface: str, channel: str, bitrate: int, host: str, port: int, key: Path | None,
    start: bool, timeout: float, as_json: bool,
) -> int:  # fmt: skip
    """The exit code of `headland release`: 0 if every robot is reset (and started, with `start`)
    within `timeout` seconds, 1 if something holds one still, 2 if there is no bus or the key is
    no operator's."""
    key = key or own_keys(interface, host, port)
    try:
        return asyncio.run(
            _reset(interface, channel, bitrate, host, port, key, start, timeout, as_json)
        )
    except AttachError as problem:
        return wrong(problem)


async def _reset(
    interface: str, channel: str, bitrate: int, host: str, port: int, key: Path | None,
    start: bool, timeout_s: float, as_json: bool,
) -> int:  # fmt: skip
    keyring = operator_keyring(key, timeout_s, Role.RELEASE)
    bus = attach(interface, channel, bitrate, host, port)
    try:
        operator = Operator(bus, keyring)
        operator.expect(robots_of_launch(interface, host, port, key))
        operator.shown.ask()
        listen_to(bus, operator)
        await operator.listen(LISTEN_S, stops=True)
        operator.check_address()
        shown, _ = operator.shown.named
        summed = in_sum(operator)
        asked = operator.release_asked
        with told_wait("until no robot is stopped", timeout_s):
            left = await release(operator, start, timeout_s)
        if start and not left:
            with told_wait("until every robot has started", timeout_s):
                await started(operator, timeout_s)
        operator.check_address()
        still = await held_still(operator) if left else frozenset()
        await hear_causes(operator)
        cleared = [dot for dot in shown if dot not in still]
        silent = [robot.slot for robot in operator.silent]
        held = [r.slot for r in operator.live if start and (r.held or not r.started)]
        if as_json:
            print(dumps({
                "asked": asked, "cleared": [list(dot) for dot in cleared], "not_released": left,
                "not_heard": silent, "held": held,
                "stands": {str(r.slot): stands(operator, r) for r in operator.live},
                "signed": keyring is not None,
            }))  # fmt: skip
        else:
            for slot in asked:
                print(f"asked for at the terminal that robot {slot} serves")
            unsure = bool(left) and operator.shown.unnamed
            print(UNSURE if unsure else cleared_line(cleared, bool(shown), summed, left))
            for robot in operator.members:
                print(f"robot {robot.slot}: {word(operator, robot, start)}")
                for why in stands(operator, robot):
                    print(f"robot {robot.slot} stands: {why}")
            if keyring is None:
                print(NOT_SIGNED)
        return 0 if operator.live and not (left or silent or held) else NOT_ALL
    finally:
        bus.close()


def cleared_line(cleared: list[StopDot], shown: bool, summed: str, left: list[int]) -> str:
    """What was cleared. `summed`: what robots held in sum before; `left`: robots that stand latched."""
    named = ", ".join(".".join(map(str, dot)) for dot in cleared)
    if not shown and not left:
        named = summed
    if named:
        return f"stops cleared: {named}"
    if shown or summed:
        return "no stop was cleared: robots still hold what was shown"
    return "no stop was shown, so none was cleared"


async def held_still(operator: Operator) -> frozenset[StopDot]:
    """Stops that robots may hold after a release, by name: all that were shown, if robots do not name as
    many as they count."""
    shown = operator.shown
    shown.recount()
    await operator.listen(LISTEN_S, stops=True)
    end_s = operator.now_s + STILL_S
    while shown.unnamed and operator.now_s < end_s:
        operator.ask_stops()
        await asyncio.sleep(STEP_S)
        operator.now_s = asyncio.get_running_loop().time()
    named = frozenset(shown.recounted)
    return named | {StopDot(*dot) for dot in shown.near} if shown.unnamed else named


def in_sum(operator: Operator) -> str:
    """Of stops that are cleared without their names; empty if no robot shows one."""
    most = max((held.stops for held in operator.shown.told.values()), default=0)
    count = f"{most} or more" if most >= COUNT_TOLD_MAX else f"{most}"
    return f"all {count} that hold a robot" if most else ""


async def hear_causes(operator: Operator) -> None:
    """Why robots stand, as they report it from now on; all reasons, if they come soon."""
    held = [robot for robot in operator.live if robot.held or robot.stopped]
    for robot in operator.robots.values():
        robot.causes.forget()
    if not held:
        return
    end_s = operator.now_s + CAUSES_S
    await operator.listen(CAUSE_S)
    while operator.now_s < end_s and any(_untold(operator, robot) for robot in held):
        await operator.listen(STEP_S)


def _untold(operator: Operator, robot: KnownRobot) -> bool:
    return robot.causes.missing(round(operator.now_s * 1e6)) > 0


def stands(operator: Operator, robot: KnownRobot) -> list[str]:
    """The causes that it has reported lately, and what a person can do about each."""
    return robot.causes.sentences(round(operator.now_s * 1e6))


def word(operator: Operator, robot: KnownRobot, start: bool) -> str:
    """What a robot is doing now, or what holds it and what a person can do about it."""
    if robot not in operator.live:
        return (
            "NOT HEARD: what it does is unknown; see that it stands, is switched on and on this bus"
        )
    if robot.stopped or robot.state is State.EMERGENCY_STOP:
        if operator.keyring is None:
            return "NOT RELEASED: it holds a stop or a fault; a fleet with keys needs --keys"
        return (
            "NOT RELEASED: it holds a stop that was not cleared, or a fault at the machine; again"
        )
    if robot.state is State.DISCONNECTED:
        return "NOT RELEASED: it has no address on the bus yet; wait, or restart it"
    if not robot.started:
        return f"{robot.state.name}, not started" + ("" if not start else ": START WAS NOT TAKEN")
    if robot.held and stands(operator, robot):
        return f"{robot.state.name}, HELD: the causes are named below"
    if robot.held:
        return (
            f"{robot.state.name}, HELD by something else: headland inspect --traces {robot.slot} "
            "asks it what"
        )
    return robot.state.name


async def started(operator: Operator, timeout_s: float) -> None:
    """Until every live robot says that it has been started and that nothing holds it."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + timeout_s
    while loop.time() < end_s:
        if all(robot.started and not robot.held for robot in operator.live):
            return
        operator.command(Command.START)
        await asyncio.sleep(STEP_S)
        operator.now_s = loop.time()


def operator_keyring(key: Path | None, timeout_s: float, role: Role = ALL_ROLES) -> Keyring | None:
    """With frames enough for this long. `role`: one of these must be in the key's badge. Raises
    AttachError."""
    if key is None:
        return None
    try:
        file = _operator_file(key, role)
        return file.keyring((1 + round(timeout_s) // BLOCK_S) * RESERVE)
    except KeyFileError as problem:
        raise AttachError(f"--keys {problem}") from None


def operator_keys(key: Path | None) -> DeviceKeys | None:
    """Of a tool that gives orders for hours. Raises AttachError."""
    if key is None:
        return None
    try:
        _operator_file(key, ALL_ROLES)
        return DeviceKeys(key, OPERATOR)
    except KeyFileError as problem:
        raise AttachError(f"--keys {problem}") from None


def _operator_file(key: Path, role: Role) -> KeyFile:
    """Raises KeyFileError, and AttachError where it does not allow what needs one of these roles."""
    file = read(key, OPERATOR)
    why = file.may(role, int(time.time()) // DAY_S)
    if why is not None:
        raise AttachError(f"--keys {why}")
    return file


def clear_named(operator: Operator) -> None:
    """So that a robot that has missed a stop does not latch by a late echo of it."""
    named, far_named = operator.shown.named
    for dot in named:
        operator.clear(dot)
    for far in far_named:
        operator.clear_far(far)


async def release(operator: Operator, start: bool, timeout_s: float) -> list[int]:
    """Clear, reset machine by machine, and start; returns the robots that still stand latched."""
    loop = asyncio.get_running_loop()
    begun_s = loop.time()
    operator.shown.release()
    tries = 1
    while True:
        for digest in operator.shown.sums:
            operator.clear_held(digest)
        if not operator.shown.sums or tries % NAMES_EVERY == 0:
            clear_named(operator)
        tries += 1
        operator.shown.ask_again()
        operator.ask_stops()
        operator.send(AllImplementsStop(0, Switch.PERMIT))
        await asyncio.sleep(STEP_S)
        for robot in operator.live:
            if robot.state is State.EMERGENCY_STOP:
                operator.command(Command.MANUAL_RESET, robot.slot)
        await asyncio.sleep(STEP_S)
        operator.now_s = loop.time()
        latched = operator.shown.still_latched  # a beat is a word without a tag
        left = [
            r.slot
            for r in operator.live
            if r.stopped or r.state is State.DISCONNECTED or r.slot in latched
        ]
        if not left or loop.time() - begun_s >= timeout_s:
            break
    clear_named(operator)
    # On a bus that carries nothing a start would wait in the adapter, and arrive after a later stop.
    if start and operator.live and not left:
        for _ in range(3):  # repeated, because a lost start means another call of the command
            operator.command(Command.START)
            await asyncio.sleep(STEP_S)
    return left
