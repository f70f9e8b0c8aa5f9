"""`headland replay`: a log through the inspector, and onto a bus if wanted."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.live import Live

from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from sim.files.strict_json import dumps
from sim.record.recording import FramesDigest
from tools.common.bus_address import AttachError
from tools.common.bus_attach import attach
from tools.common.exit_codes import wrong
from tools.inspect.inspector import Inspector
from tools.inspect.log_frames import SILENCE_S, SourceError, frames_of
from tools.inspect.robot_table import table_of
from tools.livemap.command import show_map

LOOK_S = 0.25  # time of the recording between two updates of the screen
PICTURES_A_SECOND = 8


def replay(
    log: Path, speed: float, interface: str, channel: str, bitrate: int, host: str, port: int,
    as_json: bool, page_port: int | None = None,
) -> int:  # fmt: skip
    """The exit code of `headland replay`: 2 where the log or the bus is wrong; a SourceError
    becomes a line.

    `speed`: a factor of real time; 0: as fast as it goes. `page_port`: of the same log in the map.
    """
    if page_port is not None:
        return show_map(
            log, interface, channel, bitrate, host, port, None, None, page_port, as_json, speed
        )
    console, inspector, digest = Console(stderr=as_json), Inspector(), FramesDigest()
    try:
        if speed < 0:
            raise SourceError(f"--speed {speed:g}: 0 for at once, 1 for the recorded speed")
        with Live(console=console, refresh_per_second=PICTURES_A_SECOND, transient=True) as live:

            def look() -> None:
                live.update(table_of(inspector.to_dict()))

            def hear(t_us: int, frame: Frame) -> None:
                inspector.hear(t_us / 1e6, frame)
                digest.write(t_us, frame)

            asyncio.run(
                _play(hear, log, speed, _opener(interface, channel, bitrate, host, port), look)
            )
    except (AttachError, SourceError) as problem:
        return wrong(problem)
    if as_json:
        print(dumps({**inspector.to_dict(), "log_hash": digest.hex}))
    else:
        console.print(table_of(inspector.to_dict()))
        console.print(f"hash of the frames: {digest.hex}", highlight=False)
    return 0


def _opener(
    interface: str, channel: str, bitrate: int, host: str, port: int
) -> Callable[[], CanBus | None]:
    """Opened inside of the loop that will drive it."""
    return lambda: attach(interface, channel, bitrate, host, port) if interface else None


async def _play(
    hear: Callable[[int, Frame], None],
    log: Path,
    speed: float,
    open_bus: Callable[[], CanBus | None],
    look: Callable[[], None],
) -> None:
    loop, bus = asyncio.get_running_loop(), open_bus()
    due_s, before_s, looked_s = loop.time(), None, 0.0
    try:
        for t_us, frame in frames_of(log):
            t_s = t_us / 1e6
            step_s = 0.0 if before_s is None else t_s - before_s
            if before_s is None or not -SILENCE_S <= step_s <= 0.0:
                before_s = t_s
            if speed > 0:
                # A clock that was set, forward or back, is no time that passed on the bus.
                due_s += min(max(step_s, 0.0), SILENCE_S) / speed
                await asyncio.sleep(max(0.0, due_s - loop.time()))
            hear(t_us, frame)
            if bus is not None:
                bus.send(frame)
            if abs(t_s - looked_s) >= LOOK_S * max(speed, 1.0):
                looked_s = t_s
                if speed > 0:
                    look()
    finally:
        if bus is not None:
            bus.close()
