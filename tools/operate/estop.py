"""`headland stop`: stop every robot on a bus, and say which robots have confirmed."""

import asyncio
import sys
from math import inf
from pathlib import Path
from typing import NamedTuple

from agent.runtime.files.key_file import KeyFileError
from protocol.frames.safety_frames import AllImplementsStop, Reason, Switch
from protocol.links.bus import CanBus
from protocol.links.socketcand_link import SocketcandLink
from sim.files.strict_json import dumps
from tools.common.bus_address import AttachError, robots_of_launch
from tools.common.bus_attach import attach, stay_attached
from tools.common.exit_codes import TRY_AGAIN, code_of, wrong
from tools.common.launch_keys import own_keys
from tools.common.told_wait import tell_meanwhile, told_wait
from tools.operate.device_keys import DeviceKeys
from tools.operate.operator_device import LIVE_S, KnownRobot, Operator

REPEAT_S = 0.005
LISTEN_S = 0.5  # ten beats: a robot that was not heard by then is absent
# If no robot has latched by then, the dot may be a cleared one: try another, and wait twice as long for
# each further one. On a bus that is a second behind, ten names were drawn, and 20 robots repeat each.
AGAIN_S = 0.1
SIGN_AGAIN_S = 0.5  # robots echo each dot once; if an echo was lost, a new dot gets a new echo
FIRST_STOP = 1  # count of stops in the standard frame, since this device was started
NOT_ALL = 1
AGAIN = "press again, or use --hold to press until all have confirmed"
ONLY_SHOWN = (
    "nothing is pressed, only shown; without --watch, or with --hold, every robot is stopped"
)
NOT_SIGNED = (
    "NOT SIGNED: a fleet without keys believes any device on the bus; one with keys only brakes"
)


def estop(
    interface: str, channel: str, bitrate: int, host: str, port: int, keys: Path | None,
    reason: str, timeout: float, watch: bool, as_json: bool, hold: bool = False,
) -> int:  # fmt: skip
    """The exit code of `headland stop`: 0 if every robot that is or was there has confirmed within
    `timeout` seconds, 1 if some have not, 2 if there is no bus or the reason is unknown.

    `hold`: after `timeout` it says which robots have not confirmed, and presses on until all have.
    """
    if reason not in Reason.__members__:
        known = ", ".join(Reason.__members__)
        return wrong(f"--reason {reason}: unknown; one of {known}")
    keys = keys or own_keys(interface, host, port)
    try:
        return asyncio.run(
            _estop(
                interface,
                channel,
                bitrate,
                host,
                port,
                keys,
                Reason[reason],
                timeout,
                watch,
                as_json,
                hold,
            )
        )
    except AttachError as problem:
        return wrong(problem)


async def _estop(
    interface: str, channel: str, bitrate: int, host: str, port: int, keys: Path | None,
    reason: Reason, timeout_s: float, watch: bool, as_json: bool, hold: bool,
) -> int:  # fmt: skip
    bus: CanBus | SocketcandLink
    if hold or watch:  # they go on without an end, also when the bus was away
        bus = await stay_attached(interface, channel, bitrate, host, port, "stop")
    else:
        bus = attach(interface, channel, bitrate, host, port)
    try:
        signing = stop_keys(keys)
        operator = Operator(bus, signing)
        operator.expect(robots_of_launch(interface, host, port, keys))
        listen_to(bus, operator)
        if watch and not hold:
            print(f"headland: {ONLY_SHOWN}", file=sys.stderr)
            return await _watch(operator, as_json)
        with told_wait("until every robot confirms the stop", timeout_s):
            late = await press(operator, reason, timeout_s, hold)
        return tell(operator, late, as_json, operator.keyring is not None)
    finally:
        bus.close()


def stop_keys(keys: Path | None) -> DeviceKeys | None:
    """Of a stop panel, which cannot release whatever file it has, or of an operator's device. None
    also where the counter of an operator's key has no room on a full disk: robots brake for a stop
    without a tag, too. Raises AttachError."""
    try:
        return None if keys is None else DeviceKeys(keys)
    except KeyFileError as problem:
        if code_of(problem) != TRY_AGAIN:
            raise AttachError(f"--keys {problem}") from None
        print(f"headland: --keys {problem}; the stop is said unsigned", file=sys.stderr)
        return None


def listen_to(bus: CanBus | SocketcandLink, operator: Operator) -> None:
    """Pass every frame of a bus to an operator, with the time of the loop."""
    loop = asyncio.get_running_loop()
    bus.subscribe(lambda frame: operator.hear(loop.time(), frame))


async def press(
    operator: Operator, reason: Reason, timeout_s: float, hold: bool = False
) -> list[KnownRobot]:
    """Repeat until every member has confirmed; returns those that have not, silent ones among them.

    `hold`: after `timeout_s` a line says which have not confirmed, and the press goes on without an end.
    """
    loop = asyncio.get_running_loop()
    operator.begin_press()
    begun_s = dot_s = operator.now_s = loop.time()
    unlatched_s = AGAIN_S
    stop = operator.new_stop(reason)
    operator.stop(stop)
    operator.send(AllImplementsStop(FIRST_STOP, Switch.STOP))
    operator.ask_who()
    spoken_from = operator.device.address
    while True:
        await asyncio.sleep(REPEAT_S)
        if operator.device.address != spoken_from:
            # Devices of other makers hear a stop only from an address that was claimed.
            spoken_from = operator.device.address
            operator.send(AllImplementsStop(FIRST_STOP, Switch.STOP))
            operator.stop(stop)
        now_s = operator.now_s = loop.time()
        late = [r for r in operator.members if not operator.confirmed(r)]
        # A panel that runs for days has heard addresses that are long gone.
        unnamed = operator.unnamed(begun_s - LIVE_S)
        heard = bool(operator.live) and not unnamed
        if heard and not late and now_s - begun_s >= LISTEN_S:
            return []
        if now_s - begun_s >= timeout_s:
            if not hold:
                return late
            tell_meanwhile(f"headland: {_unconfirmed(operator, late)}; pressing on, Ctrl-C ends it")
            timeout_s = inf
        none_stopped = not any(r.stopped or r.echoed for r in operator.live)
        unsigned = operator.signs and any(not r.signed for r in operator.live)
        again_s = unlatched_s if none_stopped else max(SIGN_AGAIN_S, (now_s - begun_s) / 4)
        again = operator.live and (none_stopped or unsigned) and now_s - dot_s >= again_s
        if again or stop[:3] in operator.shown.spent:
            stop, dot_s = operator.new_stop(reason), now_s
            unlatched_s *= 2
        if late or not heard:
            operator.stop(stop)
        if unnamed and round((now_s - begun_s) / REPEAT_S) % 20 == 0:
            operator.ask_who()


def _all_stopped(operator: Operator, late: list[KnownRobot]) -> bool:
    return bool(operator.live) and not late and not operator.unknown


def _unconfirmed(operator: Operator, late: list[KnownRobot]) -> str:
    """Robots and addresses that have not confirmed, for one line."""
    names = [f"robot {robot.slot}" for robot in late]
    names += [f"address {address}" for address in sorted(operator.unknown)]
    return f"not confirmed by {', '.join(names)}" if names else "no robot was heard"


def tell(operator: Operator, late: list[KnownRobot], as_json: bool, signed: bool) -> int:
    """Print which robots have confirmed and which have not, `late`; returns the exit code of a press."""
    live = operator.live
    confirmed = [r for r in operator.members if r not in late]
    if as_json:
        print(dumps({
            "stopped": [r.slot for r in confirmed],
            "not_stopped": [r.slot for r in late if r in live],
            "not_heard": [r.slot for r in late if r not in live],
            "unknown_addresses": sorted(operator.unknown),
            "all_stopped": _all_stopped(operator, late), "signed": signed,
        }))  # fmt: skip
    else:
        for robot in operator.members:
            print(f"robot {robot.slot}: {_word(operator, robot, late)}")
        for address in sorted(operator.unknown):
            print(f"address {address}: speaks, but has not said which robot it is")
        if not signed:
            print(NOT_SIGNED)
    if not live:
        print("headland: no robot was heard on this bus, so none has confirmed", file=sys.stderr)
    if _all_stopped(operator, late):
        return 0
    if not as_json and (operator.unknown or any(r in live for r in late)):
        print(f"headland: {AGAIN}", file=sys.stderr)  # programs read `all_stopped`
    return NOT_ALL


def _word(operator: Operator, robot: KnownRobot, late: list[KnownRobot]) -> str:
    if robot not in late:
        return "stopped"
    if robot not in operator.live:
        return "NOT HEARD: it has not confirmed; go and look at it"
    if robot.stopped or robot.echoed:
        return "says that it is stopped, but has not signed it: NOT CONFIRMED"
    return "NOT STOPPED"


class StopStatus(NamedTuple):
    """Whether all robots that are heard stand stopped, and which do; by their numbers."""

    says: str
    live: list[int]
    stopped: list[int]
    not_heard: list[int]

    def told(self, as_json: bool) -> str:
        """As one line."""
        if as_json:
            return dumps(self._asdict())
        missed = f"  not heard {self.not_heard}" if self.not_heard else ""
        return f"{self.says}  live {self.live}  stopped {self.stopped}{missed}"


def stop_status(operator: Operator) -> StopStatus:
    """What the robots say now."""
    live, silent = operator.live, [r.slot for r in operator.silent]
    stopped = [r.slot for r in live if r.stopped]
    # An address from which nobody has spoken lately is no robot that could move.
    unnamed = operator.unnamed(operator.now_s - LIVE_S)
    says = "ALL STOPPED"
    if len(stopped) < len(live):
        says = "MOVING"
    elif not live:
        says = "NOBODY"
    elif silent or unnamed:
        says = "NOT ALL HEARD"
    return StopStatus(says, [r.slot for r in live], stopped, silent)


async def _watch(operator: Operator, as_json: bool) -> int:
    """The status of the stop: one line whenever it changes."""
    shown = ""
    operator.ask_who()
    while True:
        await asyncio.sleep(0.2)
        operator.now_s = asyncio.get_running_loop().time()
        line = stop_status(operator).told(as_json)
        if line != shown:
            shown = line
            print(line, flush=True)
