"""`headland inspect`: what a live bus, a log or a run folder tells of every robot."""

import asyncio
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress
from importlib.util import find_spec
from itertools import chain
from math import inf
from pathlib import Path
from typing import Any

from agent.interface.lifecycle import TABLE, State
from agent.peer.pgn_responder import LOG_PGN
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from protocol.links.socketcand_link import SocketcandLink
from protocol.state_machine import to_mermaid
from sim.files.strict_json import dumps
from tools.common.bus_address import AttachError
from tools.common.bus_attach import attach, connections_of, lost_of, stay_attached
from tools.common.exit_codes import code_of, wrong
from tools.common.told_wait import told_wait
from tools.inspect.inspector import Inspector
from tools.inspect.log_frames import SourceError, frames_of
from tools.inspect.robot_table import show

LISTEN_S = 3.0  # to a live bus, where nothing else is said
WATCH_S = 1.0  # between two lines of a watch
HEARD_S = 0.3  # by then we are on the bus


def inspect(
    source: Path | None, interface: str, channel: str, bitrate: int, host: str, port: int,
    seconds: float | None, mermaid: bool, why: str | None, as_json: bool, traces_of: int | None = None,
    plain: bool = False, speed: float = 0.0, picture: Path | None = None, watch: bool = False,
) -> int:  # fmt: skip
    """The exit code of `headland inspect`: 0; 1 if the section of `why`, or the traces, were not
    heard; 2 for a wrong argument, source or bus.

    `seconds`: how long a live bus is heard; None: 3, with `watch` until Ctrl-C. `watch`: what is heard so
    far, every second, as one line of JSON or as text. `traces_of`: slot of a robot that is asked for its
    traces. `speed`: of a log, times real time; 0 shows its end.
    """
    if mermaid:
        diagram = to_mermaid(TABLE, State.DISCONNECTED)
        print(dumps({"mermaid": diagram}) if as_json else diagram)
        return 0
    inspector = Inspector()
    for_s = seconds if seconds is not None or watch else LISTEN_S
    try:
        if watch and (source is not None or why is not None or traces_of is not None):
            raise SourceError("--watch: of a live bus, without a log, --why or --traces")
        if source is not None and (seconds is not None or traces_of is not None):
            raise SourceError(f"--seconds, --traces: of a live bus; leave out {source}")
        if source is None and speed:
            raise SourceError("--speed: of a log, and none is given")
        if source is None and seconds is not None and not seconds > 0.0:
            raise SourceError(f"--seconds {seconds:g}: a live bus is heard for longer than that")
        if traces_of is not None:
            asked_s = LISTEN_S if for_s is None else for_s
            return _traces(traces_of, interface, channel, bitrate, host, port, asked_s, as_json)
        section = _section(why)
        if picture is not None:
            return _draw(inspector, source, picture)
        if _screen_wanted(plain or as_json or watch or section is not None):
            bus = (interface, channel, bitrate, host, port)
            return _screen(inspector, source, lambda: stay_attached(*bus, "inspect"), speed)
        if source is not None:
            for t_us, frame in frames_of(source, inspector.hear_other):
                inspector.hear(t_us / 1e6, frame)
        else:
            tell = (_told_json if as_json else _told_text) if watch else None
            bus = (interface, channel, bitrate, host, port)
            told_s = 0.0 if watch or for_s is None else for_s  # a watch tells something each second
            # Ctrl-C is the usual end of a watch.
            with suppress(KeyboardInterrupt), told_wait("listening to the bus", told_s):
                asyncio.run(_listen(inspector, *bus, for_s, tell))
            if watch:
                return 0
    except (AttachError, SourceError) as problem:
        return wrong(problem)
    if section is not None:
        return _why(inspector, section, as_json)
    if as_json:
        print(dumps(inspector.to_dict()))
    else:
        show(inspector.to_dict())
    return 0


def _screen_wanted(text_wanted: bool) -> bool:
    """Only people at a terminal get a screen; scripts and pipes get text."""
    if text_wanted or not (sys.stdout.isatty() and sys.stdin.isatty()):
        return False
    if find_spec("textual") is None:
        print(
            "headland: text only: pip install 'headland[operator]' for the screen", file=sys.stderr
        )
        return False
    return True


def _draw(inspector: Inspector, source: Path | None, picture: Path) -> int:
    if source is None:
        raise SourceError("--picture needs a run folder or a log")
    if find_spec("textual") is None:
        raise SourceError("--picture needs textual: pip install 'headland[operator]'")
    from tools.inspect.frame_feed import from_log
    from tools.inspect.screen import InspectScreen, draw

    frames = list(frames_of(source))
    if picture.is_dir():
        raise SourceError(f"--picture {picture}: is a folder; give the name of a file")
    if not picture.absolute().parent.is_dir():  # said before the drawing
        raise SourceError(f"--picture {picture}: {picture.parent} is not a folder")
    try:
        draw(InspectScreen(inspector, str(source), from_log(frames, inspector, True)), picture)
    except OSError as problem:
        return wrong(f"--picture {picture}: {problem.strerror}", code_of(problem))
    return 0


def _screen(
    inspector: Inspector, source: Path | None,
    open_bus: Callable[[], Awaitable[CanBus | SocketcandLink]], speed: float,
) -> int:  # fmt: skip
    from tools.inspect.frame_feed import from_bus, from_log
    from tools.inspect.screen import InspectScreen

    if source is None:
        asyncio.run(_try(open_bus))  # a wrong address is one line, before the screen
        feed, title = from_bus(open_bus, inspector), "live bus"
    else:
        frames = frames_of(source)
        first = next(frames, None)  # a file that is no log is one line, too
        rest = chain([] if first is None else [first], frames)
        feed, title = from_log(rest, inspector, speed == 0), str(source)
    InspectScreen(inspector, title, feed, speed or 1.0).run()
    return 0


async def _try(open_bus: Callable[[], Awaitable[CanBus | SocketcandLink]]) -> None:
    (await open_bus()).close()


def _section(why: str | None) -> int | None:
    if why is None:
        return None
    digits = why.lstrip("Ss")
    if not digits.isdecimal() or len(digits) > 5 or int(digits) > 0xFFFF:
        raise SourceError(f"--why {why[:40]}: a section is written S7")
    return int(digits)


async def _listen(
    inspector: Inspector,
    interface: str,
    channel: str,
    bitrate: int,
    host: str,
    port: int,
    seconds: float | None,
    tell: Callable[[Inspector], None] | None,
) -> None:
    from tools.operate.operator_device import Operator

    where = (interface, channel, bitrate, host, port)
    bus = attach(*where) if tell is None else await stay_attached(*where, "inspect")
    loop = asyncio.get_running_loop()
    begun_s = loop.time()  # of a clock with an arbitrary zero
    try:
        bus.subscribe(lambda frame: inspector.hear(loop.time() - begun_s, frame))
        operator = Operator(bus, None)
        asked = connections_of(bus)
        loop.call_later(HEARD_S, operator.ask_work)
        end_s = inf if seconds is None else loop.time() + seconds
        while (left_s := end_s - loop.time()) > 0:
            await operator.listen(left_s if tell is None else min(left_s, WATCH_S))
            if asked != (asked := connections_of(bus)):
                operator.ask_work()  # what was said while the bus was away
            if tell is not None:
                if inspector.first_s is not None:
                    inspector.now_s = loop.time() - begun_s  # quiet is time, too
                tell(inspector)
                if (why := lost_of(bus)) is not None:
                    raise AttachError(why)
    finally:
        bus.close()


def _told_json(inspector: Inspector) -> None:
    print(dumps(inspector.to_dict()), flush=True)


def _told_text(inspector: Inspector) -> None:
    show(inspector.to_dict())


def _traces(
    slot: int, interface: str, channel: str, bitrate: int, host: str, port: int, seconds: float,
    as_json: bool,
) -> int:  # fmt: skip
    """What a robot on a live bus has to tell of its last decisions, by the transport protocol."""
    with told_wait(f"the answer of robot {slot}", seconds):
        text = asyncio.run(_ask_traces(slot, interface, channel, bitrate, host, port, seconds))
    if text is None:
        print(f"headland: robot {slot} did not answer within {seconds:g} s", file=sys.stderr)
        return 1
    lines = text.splitlines()
    print(dumps({"robot": slot, "traces": lines}) if as_json else text)
    return 0


async def _ask_traces(
    slot: int, interface: str, channel: str, bitrate: int, host: str, port: int, seconds: float
) -> str | None:
    from tools.operate.operator_device import Operator
    from tools.operate.pgn_client import PgnClient

    bus = attach(interface, channel, bitrate, host, port)
    loop = asyncio.get_running_loop()
    try:
        operator = Operator(bus, None)
        pgn_client = PgnClient(bus, operator.device)

        def heard(frame: Frame) -> None:
            operator.hear(loop.time(), frame)
            pgn_client.hear(loop.time(), frame)

        bus.subscribe(heard)
        await operator.listen(HEARD_S)
        robot = operator.robots.get(slot)
        if robot is None:
            known = " ".join(map(str, sorted(operator.robots))) or "none"
            raise SourceError(f"no robot {slot} on this bus; heard: {known}")
        return await pgn_client.ask(LOG_PGN, robot.address, seconds)
    finally:
        bus.close()


def _why(inspector: Inspector, section: int, as_json: bool) -> int:
    found = list(inspector.why(section))
    if as_json:
        print(dumps(found))
    elif found:
        print(f"S{section}: {found[-1]['text']}")
        steps = {(step["t_s"], step["data"]): n for n, step in enumerate(found, 1)}
        for number, step in enumerate(found, 1):
            print(f"{number:3}. {_frame_line(step)}{_again(step)}")
            for cause in step["because"]:
                print(f"       because {_cause(cause, steps)}")
            for rival in step["rivals"]:
                print(f"       against {_frame_line(rival)}")
    if not found:
        print(f"headland: nothing was heard of S{section}", file=sys.stderr)
    return 0 if found else 1


def _frame_line(heard: dict[str, Any]) -> str:
    who = "a device" if heard["said_by"] is None else f"robot {heard['said_by']}"
    frame = f"{heard['id']}#{heard['data']}"
    return f"{heard['t_s']:.6f} s  {who:8}  {heard['frame']} {frame}  {heard['text']}"


def _cause(heard: dict[str, Any], steps: dict[tuple[float, str], int]) -> str:
    number = steps.get((heard["t_s"], heard["data"]))
    if number is None:
        return _frame_line(heard)
    return f"of {number}., and {heard['text'].rsplit('; now ', 1)[-1]}"


def _again(step: dict[str, Any]) -> str:
    return f" (said {step['again']} times more)" if step["again"] else ""
