"""`headland machine`: a simulated machine, to which drivers connect."""

import asyncio
import socket
import sys

from agent.runtime.end_signals import on_end
from sim.files.strict_json import dumps
from sim.machines.isobus_machine import IsobusMachine, opened
from sim.machines.nmea_machine import Dimensions, NmeaMachine, WheeledBody
from tools.common.exit_codes import WRONG, wrong

SHOWN_S = 1.0
ANSWER_FOR_S = 3.0  # a machine answers within milliseconds


def machine(
    drive: str, origin: tuple[float, float], place: tuple[float, float, float],
    ports: tuple[int, int, int], host: str, seed: int, rate_hz: float, as_json: bool,
    bus: str | None = None,
) -> int:  # fmt: skip
    """The exit code of `headland machine`: 0 after Ctrl-C or SIGTERM, 2 if a port is taken.

    `place`: metres east, metres north, radians. `ports`: of receiver, controller and orders. `bus`: of a
    tractor, as python-can's INTERFACE:CHANNEL.
    """
    body = WheeledBody(Dimensions(drive, rate_hz=rate_hz), *place)
    try:
        if bus is not None:
            try:
                on_bus = opened(bus)
            except OSError as problem:
                return wrong(problem)
            made = IsobusMachine(body, origin, on_bus, seed)
            asyncio.run(_serve_on_bus(made, host, ports[2], as_json))
            return 0
        asyncio.run(_serve(body, origin, ports, host, seed, as_json))
    except BrokenPipeError:
        raise  # of what is printed, which no port mends
    except OSError as problem:
        why = f"{problem.strerror or problem}; choose other ports, or 0 for any free one"
        return wrong(f"{host}: {why}")
    return 0


async def _serve_on_bus(made: IsobusMachine, host: str, port: int, as_json: bool) -> None:
    orders = await made.start_on_bus(host, port)
    end = asyncio.Event()
    on_end(asyncio.get_running_loop(), end.set)
    print(
        dumps({"orders": orders}) if as_json else f"orders {host}:{orders}\nCtrl-C ends it",
        flush=True,
    )
    await end.wait()
    await made.stop()


def order(words: str, host: str, port: int) -> int:
    """Print what a running machine answers. 0: it obeys; 2: it does not, or is not there."""
    try:
        with (
            socket.create_connection((host, port), ANSWER_FOR_S) as line,
            line.makefile("rw", encoding="ascii", errors="backslashreplace") as text,
        ):
            text.write(words + "\n")
            text.flush()
            answer = text.readline().strip()
    except OSError as problem:
        why = problem.strerror or problem
        return wrong(f"no machine answers at {host}:{port}: {why}")
    refused = answer.startswith("not understood")
    if answer != "ok" and not answer.startswith("{") and not refused:
        return wrong(f"what answers at {host}:{port} takes no orders of a machine")
    print(answer)
    return WRONG if refused else 0


async def _serve(
    body: WheeledBody, origin: tuple[float, float], ports: tuple[int, int, int], host: str,
    seed: int, as_json: bool,
) -> None:  # fmt: skip
    made = NmeaMachine(body, origin, seed)
    gnss, wheels, orders = await made.start(host, *ports)
    end, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end(loop, end.set)
    if as_json:
        print(dumps({"gnss": gnss, "wheels": wheels, "orders": orders}), flush=True)
    else:
        print(
            f"gnss tcp://{host}:{gnss}  wheels tcp://{host}:{wheels}  orders {host}:{orders}\n"
            "Ctrl-C ends it",
            flush=True,
        )
    live = not as_json and sys.stdout.isatty()
    while not end.is_set():
        if live:
            truth = made.truth()
            print(
                f"\r{truth.x_m:9.2f} m east {truth.y_m:9.2f} m north  {truth.ahead_m_s:5.2f} m/s  "
                f"{made.sentences} sentences ",
                end="",
                flush=True,
            )
        try:
            async with asyncio.timeout(SHOWN_S):
                await end.wait()
        except TimeoutError:
            continue
    if live:
        print()
    await made.stop()
