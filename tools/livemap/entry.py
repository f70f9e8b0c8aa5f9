"""The options of `headland map`; what it needs is imported when it is called."""

from pathlib import Path
from typing import Annotated

import typer

from tools.options import Bitrate, Channel, Host, Interface, Json, KeyFile, PagePort, Port


def show_map(
    source: Annotated[Path | None, typer.Argument(help="Run folder or log; none: a live bus.")] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, keys: KeyFile = None,
    scenario: Annotated[
        str | None, typer.Option(help="Whose field to draw, where the source does not say.")
    ] = None,
    page_port: PagePort = 8700,
    json: Json = False,
) -> None:  # fmt: skip
    """Show a fleet in a browser: the newest launch, any bus, or a recorded run.

    Example: headland map runs/run, or on a real bus: headland map -i socketcan -c can0
    """
    from tools.livemap.command import show_map as command

    raise SystemExit(
        command(source, interface, channel, bitrate, host, port, keys, scenario, page_port, json)
    )
