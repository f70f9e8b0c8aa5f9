"""The options of `headland bridge`; what it does is in `tools/bridge.py`."""

from pathlib import Path
from typing import Annotated

import typer

from tools.options import Bitrate, Channel, Host, Interface, Json, Port


def bridge(
    segment: Annotated[int, typer.Option(help="Number of this segment, from 1.")],
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0,
    zenoh: Annotated[
        list[str] | None, typer.Option(help="Connect to the backbone: tcp/HOST:PORT or tls/...")
    ] = None,
    listen: Annotated[
        list[str] | None, typer.Option(help="Let others connect here: tcp/HOST:PORT or tls/...")
    ] = None,
    mode: Annotated[str, typer.Option(help="Of Zenoh: peer, client or router.")] = "",
    config: Annotated[
        Path | None, typer.Option(help="Zenoh's configuration: TLS, access control.")
    ] = None,
    area: Annotated[Path | None, typer.Option(help="Sections shared with neighbours.")] = None,
    arena: Annotated[
        str, typer.Option(help="Arena of which all segments make one map: file, or name.")
    ] = "",
    fleet: Annotated[str, typer.Option(help="Fleets of other names do not meet.")] = "fleet",
    seconds: Annotated[float | None, typer.Option(help="End after this long.")] = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Join a bus to the rest of the fleet. Stops pass first and always; start two for each bus.

    Example: headland bridge --segment 2 -i socketcan -c can0 --zenoh tcp/10.0.0.1:7447
    """
    from tools.bridge import bridge as command

    raise SystemExit(
        command(segment, interface, channel, bitrate, host, port, fleet, zenoh or [], listen or [],
                mode, config, area, seconds, json, arena)
    )  # fmt: skip
