"""`headland vda5050`: what the command line says, and the end of it."""

import asyncio
from pathlib import Path

from agent.runtime.end_signals import on_end
from agent.runtime.files.printable_text import printable
from agent.runtime.vda5050.broker_link import Broker, BrokerError, is_level
from sim.scenarios.delivery_scenario import load_warehouse
from sim.scenarios.scenario import ScenarioError
from tools.common.bus_address import Attached, AttachError
from tools.common.bus_attach import stay_attached, while_attached
from tools.common.event_lines import EventLines
from tools.common.exit_codes import wrong
from tools.common.launch_keys import own_keys
from tools.inspect.proven_work import UNPROVEN, proven_work_of
from tools.operate.task_numbers import LISTEN_S
from tools.operate.transport_order import house_of
from tools.vda5050.master_gateway import FleetNames, MasterGateway
from tools.vda5050.order_book import BookError, OrderBook


def serve(
    broker: str, scenario: str, book: Path, where: Attached, keys: Path | None, interface: str,
    manufacturer: str, version: str, seconds: float | None, as_json: bool = False,
) -> int:  # fmt: skip
    """The exit code of `headland vda5050`: 0 when it was ended, 2 for a wrong argument."""
    keys = keys or own_keys(where[0], where[3], where[4])
    try:
        asyncio.run(
            _serve(
                _named(broker, interface, manufacturer),
                scenario,
                book,
                where,
                keys,
                interface,
                manufacturer,
                version,
                seconds,
                EventLines(as_json),
            )
        )
    except (BrokerError, ScenarioError, AttachError, BookError) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"--book {book}: {problem.strerror or problem}")
    return 0


def _named(url: str, interface: str, manufacturer: str) -> Broker:
    """The broker, if it and the topics have names that can be used. Raises BrokerError."""
    broker = Broker.read(url)
    for option, word, deeper in (
        ("--topics", interface, True), ("--manufacturer", manufacturer, False),
    ):  # fmt: skip
        if not is_level(word, deeper):
            raise BrokerError(f"{option} {printable(word)}: a level of a topic, without + and #")
    return broker


async def _serve(
    broker: Broker, scenario: str, path: Path, where: Attached, keys: Path | None, interface: str,
    manufacturer: str, version: str, seconds: float | None, lines: EventLines,
) -> None:  # fmt: skip
    warehouse = load_warehouse(scenario)
    house = house_of(warehouse)
    end, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end(loop, end.set)
    if seconds is not None:
        loop.call_later(seconds, end.set)
    bus = await stay_attached(*where, "vda5050")
    try:
        book = OrderBook(path)  # behind what may be refused: it makes a file
    except (BookError, OSError):
        bus.close()
        raise
    try:
        named = FleetNames(
            interface, manufacturer, warehouse.name, warehouse.fleet.vehicle, version
        )
        proven = proven_work_of(keys, round(loop.time() * 1e6))
        if keys is not None and proven is None:
            lines.note(UNPROVEN.format(keys))
        gateway = MasterGateway(bus, house, book, broker, named, keys, lines, proven)
        bus.subscribe(gateway.hear)
        lines.say("ready", f"the fleet is at {broker} within {LISTEN_S:.0f} s   (Ctrl-C ends it)",
                  broker=str(broker), topics=interface)  # fmt: skip
        await gateway.operator.listen(LISTEN_S)
        await while_attached(gateway.run(end), bus)
    finally:
        bus.close()
        book.close()
