"""`headland task add`: one more parcel for a fleet that is at work, or a file of them."""

from pathlib import Path
from typing import Annotated

import typer

from tools.common.options import PORT_MAX, Bitrate, Channel, Host, Interface, Json

app = typer.Typer(help="Tasks of a delivering fleet.", no_args_is_help=True)


@app.command()
def add(
    pickup: Annotated[str | None, typer.Argument(help="Where the parcel is: X,Y in metres.")] = None,
    dropoff: Annotated[str | None, typer.Argument(help="Where it is to go: X,Y.")] = None,
    file: Annotated[Path | None, typer.Option(help="Instead: CSV or JSON lines.")] = None,
    scenario: Annotated[str, typer.Option(help="Whose map says what is floor.")] = "warehouse",
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", min=0, max=PORT_MAX, help="0: the newest live run or launch.")
    ] = 0,
    json: Json = False,
) -> None:  # fmt: skip
    """Order a transport, and wait until robots say that they know of it. Exit 0 only then.

    Example: headland task add 9.5,2.5 1.5,8.5
    """
    from tools.operate.transport_order import order

    where = (interface, channel, bitrate, host, port)
    raise SystemExit(order(pickup, dropoff, file, scenario, where, json))
