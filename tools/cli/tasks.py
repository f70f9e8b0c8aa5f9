"""`headland task`: more parcels for a fleet that is at work, and what has become of them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.common.exit_codes import wrong
from tools.common.options import (
    PORT_MAX,
    Bitrate,
    Channel,
    Host,
    Interface,
    Json,
    OperatorKey,
    Port,
)

if TYPE_CHECKING:
    from agent.delivery.warehouse import Warehouse

Scenario = Annotated[
    str | None,
    typer.Option(help="Whose map has the places (none: of the newest live run or launch)."),
]
app = typer.Typer(help="Tasks of a delivering fleet.", no_args_is_help=True)


@app.command()
def add(
    pickup: Annotated[str | None, typer.Argument(help="Where the parcel is: X,Y in metres.")] = None,
    dropoff: Annotated[str | None, typer.Argument(help="Where it is to go: X,Y.")] = None,
    file: Annotated[Path | None, typer.Option(help="Instead: CSV or JSON lines.")] = None,
    scenario: Scenario = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", min=0, max=PORT_MAX, help="0: the newest live run or launch.")
    ] = 0,
    keys: OperatorKey = None, json: Json = False,
) -> None:  # fmt: skip
    """Order a transport, and wait until robots say that they know of it. Exit 0 only then.

    Example: headland task add 9.5,2.5 1.5,8.5
    """
    from tools.operate.transport_order import order

    where = (interface, channel, bitrate, host, port)
    raise SystemExit(order(pickup, dropoff, file, scenario, where, json, keys))


def _house(scenario: str | None, interface: str, host: str, port: int) -> "Warehouse | None":
    from sim.scenarios.delivery_scenario import load_warehouse
    from sim.scenarios.scenario import ScenarioError
    from tools.operate.transport_order import house_of, launched_warehouse

    try:
        scenario = scenario or launched_warehouse(interface, host, port)
        return None if scenario is None else house_of(load_warehouse(scenario))
    except ScenarioError as problem:
        raise SystemExit(wrong(problem)) from None


@app.command("list")
def list_tasks(
    scenario: Scenario = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, json: Json = False,
) -> None:  # fmt: skip
    """Say what has become of every transport: open, fetching, aboard, delivered or withdrawn.

    Example: headland task list --json
    """
    from tools.inspect.task_outcomes import list_tasks as command

    where = (interface, channel, bitrate, host, port)
    raise SystemExit(command(_house(scenario, interface, host, port), where, json))


@app.command()
def status(
    number: Annotated[int, typer.Argument(help="Of the task.")],
    wait: Annotated[float, typer.Option(help="Seconds to wait until it is delivered.")] = 0.0,
    scenario: Scenario = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, json: Json = False,
) -> None:  # fmt: skip
    """Say what has become of one transport, after up to `--wait` seconds. Exit 0 only if it is delivered.

    Example: headland task status 5 --wait 60
    """
    from tools.inspect.task_outcomes import status as command

    where = (interface, channel, bitrate, host, port)
    house = _house(scenario, interface, host, port)
    raise SystemExit(command(number, wait, house, where, json))
