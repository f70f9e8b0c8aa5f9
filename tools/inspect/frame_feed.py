"""Frames for the screen: a log at a speed that can be changed, or a live bus until the end."""

import asyncio
from collections.abc import Awaitable, Callable, Iterable

from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from protocol.links.socketcand_link import SocketcandLink
from tools.common.bus_attach import connections_of
from tools.inspect.inspector import Inspector
from tools.inspect.log_frames import SILENCE_S
from tools.inspect.screen import Feed, InspectScreen
from tools.operate.operator_device import Operator

AT_ONCE = 500  # frames between two looks at the keyboard, at full speed
PERIOD_S = 0.05  # frames of a log are given in portions of this, times the speed
HEARD_S = 0.3  # by then we are on the bus


def from_log(frames: Iterable[tuple[int, Frame]], inspector: Inspector, at_once: bool) -> Feed:
    """`at_once`: show the end; else as it was, times the speed of the screen."""

    async def feed(screen: InspectScreen) -> None:
        log_s: float | None = None
        for number, (t_us, frame) in enumerate(frames):
            t_s = t_us / 1e6
            log_s = t_s if log_s is None else max(log_s, t_s - SILENCE_S)
            await screen.running.wait()
            if at_once and number % AT_ONCE == 0:
                await asyncio.sleep(0)
            while not at_once and t_s > log_s:
                await asyncio.sleep(PERIOD_S)
                await screen.running.wait()
                log_s += PERIOD_S * screen.speed
            inspector.hear(t_s, frame)

    return feed


def from_bus(
    open_bus: Callable[[], Awaitable[CanBus | SocketcandLink]], inspector: Inspector
) -> Feed:
    """`open_bus` is called inside of the loop that will drive the bus; it may raise AttachError."""

    async def feed(screen: InspectScreen) -> None:
        bus, loop = await open_bus(), asyncio.get_running_loop()
        begun_s = loop.time()
        try:
            bus.subscribe(lambda frame: inspector.hear(loop.time() - begun_s, frame))
            operator = Operator(bus, None)
            await operator.listen(HEARD_S)
            asked = -1
            while True:  # the screen ends it
                if asked != (asked := connections_of(bus)):
                    operator.ask_work()  # what was said before we came, and while the bus was away
                await asyncio.sleep(PERIOD_S)
                if inspector.first_s is not None:
                    inspector.now_s = loop.time() - begun_s  # quiet is time, too
        finally:
            bus.close()

    return feed
