"""`headland hub`: a simulated bus as a process of its own, which may end and be started again.

Robots of `headland launch --hub PORT`, python-can's own tools and ours attach to it. Robots on it
stand while it is gone, and reconnect by themselves.
"""

import asyncio
import os
import socket
import sys

from rich.console import Console

from agent.runtime.end_signals import on_end
from agent.runtime.gc_tuning import freeze_gc
from sim.can.simulated_bus import segment
from sim.can.socketcand_beacon import announce
from sim.can.socketcand_server import Hub
from sim.files.strict_json import dumps
from tools.common.bus_address import CHANNEL
from tools.common.exit_codes import INTERRUPTED, wrong
from tools.common.loopback_host import is_loopback

OPEN = (
    "headland: WARNING: everybody who reaches this address over the network can drive and stop the "
    "robots on this bus; socketcand has no passwords"
)


async def _serve(
    host: str,
    port: int,
    bitrate: int,
    seed: int,
    as_json: bool,
    announced: bool,
    errors: bool = False,
) -> None:
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    on_end(loop, end.set)
    served = Hub(segment(f"hub {os.getpid()}", bitrate, seed), CHANNEL, errors)
    await served.start(host, port)
    where = {"host": host, "port": served.port, "channel": CHANNEL, "pid": os.getpid()}
    if as_json:
        print(dumps(where), flush=True)
    else:
        Console(highlight=False, soft_wrap=True).print(
            f"bus: socketcand {host}:{served.port} channel {CHANNEL}; Ctrl-C ends it. Robots on it: "
            f"headland launch --hub {served.port}"
        )
        sys.stdout.flush()
    if not is_loopback(host):
        print(OPEN, file=sys.stderr)
    freeze_gc()
    saying = asyncio.create_task(announce(host, served.port, CHANNEL)) if announced else None
    await end.wait()
    if saying is not None:
        saying.cancel()
    await served.stop()


def hub(
    host: str,
    port: int,
    bitrate: int,
    seed: int,
    as_json: bool,
    announced: bool | None = None,
    errors: bool = False,
) -> int:
    """Serve a bus until Ctrl-C. The exit code is 2 if the port is taken.

    `announced`: by socketcand's beacon; None: where only this machine can hear it. `errors`: clients
    are told error frames.
    """
    if 1_000_000 % bitrate:
        return wrong(
            f"--bitrate {bitrate}: the simulated bus has bits of whole microseconds, as at 125000, "
            "250000, 500000 and 1000000 bit/s"
        )
    says = is_loopback(host) if announced is None else announced
    try:
        asyncio.run(_serve(host, port, bitrate, seed, as_json, says, errors))
    except socket.gaierror as problem:
        return wrong(f"--host {host}: {problem.strerror}; name an address of this machine")
    except OSError as problem:
        return wrong(
            f"--port {port}: {problem.strerror or problem}; choose another or 0 for any free one"
        )
    return INTERRUPTED
