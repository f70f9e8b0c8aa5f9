"""Ordering a transport over the bus, and hearing that the fleet knows of it."""

import asyncio
from math import isfinite
from pathlib import Path

from agent.delivery.cost_matrix import Carrier
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.runtime.files.key_file import KeyFileError
from protocol.frame_proofs import ToolProofs
from protocol.frames.codec import Malformed, decode
from protocol.frames.frame import Frame
from sim.files.strict_json import dumps
from sim.fleet.transport_orders import NumbersSpentError, TransportClient
from sim.scenarios.delivery_scenario import (
    DeliveryScenario,
    TaskRow,
    load_warehouse,
    read_tasks,
)
from sim.scenarios.delivery_setup import floor_of
from sim.scenarios.scenario import ScenarioError
from sim.scenarios.scenario_kind import Kind, named
from tools.common.bus_address import AttachError, scenario_of_launch
from tools.common.bus_attach import attach
from tools.common.exit_codes import wrong
from tools.common.kind_words import KIND_WORDS
from tools.common.launch_keys import own_keys
from tools.common.told_wait import told_wait
from tools.operate.order_proofs import proofs_of
from tools.operate.task_numbers import LISTEN_S, learn_numbers
from tools.operate.tool_address import CROWDED_OUT, DeviceAddress

CONFIRM_S = 5.0
SHIPPED = "warehouse"  # whose map is taken where nothing says which
REFUSED = 1


def order(
    pickup: str | None, dropoff: str | None, file: Path | None, scenario: str | None,
    where: tuple[str, str, int, str, int], as_json: bool, keys: Path | None = None,
) -> int:  # fmt: skip
    """Exit code 0 only where robots say that they know of all. `scenario`: whose map has the places;
    None: that of the launch on this bus, else the warehouse that ships. `keys`: the operator's key
    file; None: that of the launch on this bus, if it is the caller's."""
    interface, _, _, host, port = where
    try:
        rows = _rows(pickup, dropoff, file)
        scenario = scenario or launched_warehouse(interface, host, port) or SHIPPED
        house = house_of(load_warehouse(scenario))
        orders = [
            TransportTask(_cell(house, row.pickup, scenario), _cell(house, row.dropoff, scenario))
            for row in rows
        ]
        keys = keys or own_keys(interface, host, port)
        with told_wait("until two robots know of it", LISTEN_S + CONFIRM_S):
            known = asyncio.run(_order(orders, where, proofs_of(keys)))
    except (ScenarioError, AttachError, KeyFileError) as problem:
        return wrong(problem)
    if as_json:
        print(dumps([{"task": number, "known": sure} for number, sure in known.items()]))
    else:
        for number, sure in known.items():
            told = "known to the fleet" if sure else "no robot has confirmed it"
            print(f"task {number}: {told}")
    return 0 if all(known.values()) else REFUSED


def _rows(pickup: str | None, dropoff: str | None, file: Path | None) -> list[TaskRow]:
    if file is not None and pickup is not None:
        raise ScenarioError(f"--file {file}: {pickup} is a place already; order it by itself")
    if file is not None:
        rows = read_tasks(file)
        if not rows:
            raise ScenarioError(f"{file}: no task in it")
        return rows
    if pickup is None or dropoff is None:
        raise ScenarioError("two places are needed: headland task add 9.5,2.5 1.5,8.5, or --file")
    return [TaskRow(_point(pickup), _point(dropoff))]


def _point(text: str) -> tuple[float, float]:
    try:
        x_m, y_m = (float(part) for part in text.split(","))
        if not (isfinite(x_m) and isfinite(y_m)):
            raise ValueError
    except ValueError:
        raise ScenarioError(
            f"{text}: not a place; write X,Y in metres, for example 9.5,2.5"
        ) from None
    return x_m, y_m


def launched_warehouse(interface: str, host: str, port: int) -> str | None:
    """The scenario of the newest launch in this folder; None: another bus. Raises ScenarioError where
    that launch has no tasks."""
    name = scenario_of_launch(interface, host, port)
    if name is None or (Path(name).is_absolute() and not Path(name).exists()):
        return name  # its loader says what is wrong
    kind = named(name).kind
    if kind is not Kind.DELIVERY:
        raise ScenarioError(
            f"the newest launch, {Path(name).name}, is {KIND_WORDS[kind.value]} and has no tasks; "
            "launch a warehouse first, or name one with --scenario"
        )
    return name


def house_of(scenario: DeliveryScenario) -> Warehouse:
    """The floor of a scenario, on which places are cells. Raises ScenarioError."""
    return Warehouse(floor_of(scenario), Carrier(1.0, 0.0))


def _cell(house: Warehouse, at: tuple[float, float], scenario: str) -> int:
    cell = house.cell(at)
    if cell is None:
        raise ScenarioError(
            f"{at[0]:g},{at[1]:g}: no floor of {Path(scenario).name} where a robot can stand; "
            "look at its map"
        )
    return cell


async def _order(
    orders: list[TransportTask], where: tuple[str, str, int, str, int], proofs: ToolProofs | None
) -> dict[int, bool]:
    """Task numbers, and whether two robots, or all there are, have said that they know them."""
    bus = attach(*where)
    desk, device = TransportClient(), DeviceAddress(bus, proofs=proofs)
    loop = asyncio.get_running_loop()

    def hear(frame: Frame) -> None:
        device.hear(loop.time(), frame)
        source, message = decode(frame)
        if not isinstance(message, Malformed):
            desk.hear(source, message)

    bus.subscribe(hear)
    try:
        await learn_numbers(device)
        if device.crowded_out:
            raise AttachError(CROWDED_OUT)
        if not desk.robots:
            raise AttachError(
                "no delivering fleet is heard on this bus: headland run warehouse --live"
            )
        try:
            desk.order(orders)
        except NumbersSpentError as spent:
            raise AttachError(str(spent)) from None
        end_s = loop.time() + CONFIRM_S
        while loop.time() < end_s and desk.due():
            for order in desk.due():
                device.send(order)
            await asyncio.sleep(0.5)
        return {number: desk.confirmed(number) for number in desk.numbers}
    finally:
        bus.close()
