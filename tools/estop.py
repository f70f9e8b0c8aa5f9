"""`headland estop`: stop every robot on a bus, and say who has confirmed."""

import asyncio
import json
import sys
from pathlib import Path

from protocol.authentication import Keyring
from protocol.bus import CanBus
from protocol.safety_frames import AllImplementsStop, Reason, Switch
from sim.key_file import KeyFileError, read
from tools.attachment import AttachError, attach
from tools.operator_device import Operator, Robot

REPEAT_S = 0.005
LISTEN_S = 0.5  # long enough for ten beats: who has not been heard by then is not there
AGAIN_S = 0.1  # nobody latched by then: the dot may have been used and cleared long ago; another
FIRST_STOP = 1  # stops that this device has said in the standard frame, since it was started
NOT_ALL, WRONG = 1, 2
NOT_SIGNED = (
    "NOT SIGNED: a fleet without keys believes anybody on the bus; one with keys only brakes"
)


def estop(
    interface: str, channel: str, bitrate: int, host: str, port: int, keys: Path | None,
    reason: str, timeout: float, watch: bool, as_json: bool,
) -> int:  # fmt: skip
    if reason not in Reason.__members__:
        known = ", ".join(Reason.__members__)
        print(f"headland: --reason {reason}: unknown; one of {known}", file=sys.stderr)
        return WRONG
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
            )
        )
    except AttachError as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG


async def _estop(
    interface: str, channel: str, bitrate: int, host: str, port: int, keys: Path | None,
    reason: Reason, timeout_s: float, watch: bool, as_json: bool,
) -> int:  # fmt: skip
    bus = attach(interface, channel, bitrate, host, port)
    try:
        operator = Operator(bus, keyring_of(keys))
        listen_to(bus, operator)
        if watch:
            return await _watch(operator)
        late = await press(operator, reason, timeout_s)
        return _tell(operator, late, as_json, keys is not None)
    finally:
        bus.close()


def keyring_of(keys: Path | None) -> Keyring | None:
    """Of a stop panel (the fleet's file) or an operator device; raises AttachError."""
    try:
        return None if keys is None else read(keys).keyring()
    except KeyFileError as problem:
        raise AttachError(f"--keys {problem}") from None


def listen_to(bus: CanBus, operator: Operator) -> None:
    loop = asyncio.get_running_loop()
    bus.subscribe(lambda frame: operator.hear(loop.time(), frame))


async def press(operator: Operator, reason: Reason, timeout_s: float) -> list[Robot]:
    """Repeat until every live robot stands stopped; returns those that do not."""
    loop = asyncio.get_running_loop()
    begun_s = dot_s = loop.time()
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
        late = [r for r in operator.live if not (r.stopped or r.echoed)]
        heard = bool(operator.live) and not operator.unknown
        if heard and not late and now_s - begun_s >= LISTEN_S:
            return []
        if now_s - begun_s >= timeout_s:
            return late
        nobody = operator.live and len(late) == len(operator.live) and now_s - dot_s >= AGAIN_S
        if nobody or stop[:3] in operator.shown.spent:
            stop, dot_s = operator.new_stop(reason), now_s
        if late or not heard:
            operator.stop(stop)
        if operator.unknown and round((now_s - begun_s) / REPEAT_S) % 20 == 0:
            operator.ask_who()


def _tell(operator: Operator, late: list[Robot], as_json: bool, signed: bool) -> int:
    live = operator.live
    if as_json:
        print(json.dumps({
            "stopped": [r.slot for r in live if r not in late], "not_stopped": [r.slot for r in late],
            "unknown_addresses": sorted(operator.unknown),
            "all_stopped": bool(live) and not late and not operator.unknown, "signed": signed,
        }))  # fmt: skip
    else:
        for robot in live:
            print(f"robot {robot.slot}: {'NOT STOPPED' if robot in late else 'stopped'}")
        for address in sorted(operator.unknown):
            print(f"address {address}: speaks, but has not said which robot it is")
        if not signed:
            print(NOT_SIGNED)
    if not live:
        print("headland: no robot was heard on this bus: nobody has confirmed", file=sys.stderr)
    return 0 if live and not late and not operator.unknown else NOT_ALL


async def _watch(operator: Operator) -> int:
    """A lamp: one line whenever it changes."""
    shown = ""
    operator.ask_who()
    while True:
        await asyncio.sleep(0.2)
        operator.now_s = asyncio.get_running_loop().time()
        live = operator.live
        stopped = [r.slot for r in live if r.stopped]
        lamp = (
            "ALL STOPPED" if live and len(stopped) == len(live) else "MOVING" if live else "NOBODY"
        )
        line = f"{lamp}  live {[r.slot for r in live]}  stopped {stopped}"
        if line != shown:
            shown = line
            print(line, flush=True)
