"""`headland task add`: one more parcel for a fleet that is at work, or a file of them."""

import asyncio
import json as json_lines
import sys
from pathlib import Path
from typing import Annotated

import typer

from agent.cost_matrix import Carrier
from agent.task_book import Order
from agent.warehouse import Warehouse
from protocol.codec import Malformed, decode, encode
from protocol.frame import Frame
from sim.delivery_setting import floor_of
from sim.order_desk import OrderDesk
from sim.scenario import ScenarioError
from sim.warehouse_scenario import TaskRow, load_warehouse, read_tasks
from tools.attachment import TOOL_ADDRESS, AttachError, attach

app = typer.Typer(help="Tasks of a delivering fleet.", no_args_is_help=True)
LISTEN_S = 3.0  # robots tell which tasks they know, a bucket a second each
CONFIRM_S = 5.0
REFUSED, WRONG = 1, 2


@app.command()
def add(
    pickup: Annotated[str | None, typer.Argument(help="Where the parcel is: X,Y in metres.")] = None,
    dropoff: Annotated[str | None, typer.Argument(help="Where it is to go: X,Y.")] = None,
    file: Annotated[Path | None, typer.Option(help="Instead: CSV or JSON lines.")] = None,
    scenario: Annotated[str, typer.Option(help="Whose map says what is floor.")] = "warehouse",
    interface: Annotated[str, typer.Option("-i", "--interface")] = "socketcand",
    channel: Annotated[str, typer.Option("-c", "--channel")] = "can0",
    bitrate: Annotated[int, typer.Option("-b", "--bitrate")] = 250_000,
    host: Annotated[str, typer.Option("--host")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", help="0: the newest live run or launch.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:  # fmt: skip
    """Order a transport, and wait until robots say that they know of it. Exit 0 only then.

    Example: headland task add 9.5,2.5 1.5,8.5
    """
    try:
        rows = _rows(pickup, dropoff, file)
        house = _house(scenario)
        orders = [Order(_cell(house, row.pickup), _cell(house, row.dropoff)) for row in rows]
        known = asyncio.run(_order(orders, (interface, channel, bitrate, host, port)))
    except (ScenarioError, AttachError) as problem:
        print(f"headland: {problem}", file=sys.stderr)
        raise SystemExit(WRONG) from None
    for number, sure in known.items():
        line = {"task": number, "known": sure}
        plain = f"task {number}: " + ("known to the fleet" if sure else "nobody has confirmed it")
        print(json_lines.dumps(line) if json else plain)
    raise SystemExit(0 if all(known.values()) else REFUSED)


def _rows(pickup: str | None, dropoff: str | None, file: Path | None) -> list[TaskRow]:
    if file is not None:
        return read_tasks(file)
    if pickup is None or dropoff is None:
        raise ScenarioError("two places are needed: headland task add 9.5,2.5 1.5,8.5, or --file")
    return [TaskRow(_point(pickup), _point(dropoff))]


def _point(text: str) -> tuple[float, float]:
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError:
        raise ScenarioError(
            f"{text}: not a place; write X,Y in metres, for example 9.5,2.5"
        ) from None
    return x_m, y_m


def _house(name: str) -> Warehouse:
    return Warehouse(floor_of(load_warehouse(name)), Carrier(1.0, 0.0))


def _cell(house: Warehouse, at: tuple[float, float]) -> int:
    cell = house.cell(at)
    if cell is None:
        raise ScenarioError(f"{at[0]},{at[1]}: no floor where a robot can stand; look at the map")
    return cell


async def _order(orders: list[Order], where: tuple[str, str, int, str, int]) -> dict[int, bool]:
    """Task numbers, and whether two robots, or all there are, have said that they know them."""
    bus = attach(*where)
    desk = OrderDesk()

    def hear(frame: Frame) -> None:
        source, message = decode(frame)
        if not isinstance(message, Malformed):
            desk.hear(source, message)

    bus.subscribe(hear)
    loop = asyncio.get_running_loop()
    try:
        await asyncio.sleep(LISTEN_S)
        if not desk.robots:
            raise AttachError(
                "no delivering fleet is heard on this bus: headland run warehouse --live"
            )
        desk.order(orders)
        end_s = loop.time() + CONFIRM_S
        while loop.time() < end_s and desk.due():
            for order in desk.due():
                bus.send(encode(order, TOOL_ADDRESS))
            await asyncio.sleep(0.5)
        return {number: desk.confirmed(number) for number in desk.numbers}
    finally:
        bus.close()
