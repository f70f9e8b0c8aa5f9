"""Options that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

import typer

PORT_MAX = 65535
PAGE_PORT = 8700  # of the map's page
Drive = Literal["mecanum", "differential", "ackermann"]
Silence = Literal["stop", "slow", "continue"]
Robots = Annotated[int | None, typer.Option(help="Instead of the scenario's number.")]
Seed = Annotated[int | None, typer.Option(help="Instead of the scenario's seed.")]
# The variables are python-can's own; its configuration file is read in tools/cli/panels.py.
Interface = Annotated[
    str,
    typer.Option(
        "-i",
        "--interface",
        envvar="CAN_INTERFACE",
        help="python-can interface, as for can_logger.",
    ),
]
Channel = Annotated[
    str,
    typer.Option("-c", "--channel", envvar="CAN_CHANNEL", help="Channel of the interface."),
]
BITRATE_MIN = (
    1_000  # bit/s, a tenth of the slowest of CiA 301: a frame takes 0.13 s, more than two beats
)
Bitrate = Annotated[
    int,
    typer.Option(
        "-b", "--bitrate", min=BITRATE_MIN, envvar="CAN_BITRATE", help="Bit rate of the bus, bit/s."
    ),
]
Host = Annotated[str, typer.Option("--host", help="Host of a socketcand interface.")]
Port = Annotated[
    int,
    typer.Option(
        "--port", min=0, max=PORT_MAX, help="Port of a socketcand interface (0: the newest launch)."
    ),
]
Timeout = Annotated[float, typer.Option("--timeout", help="Seconds to wait for the robots.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
Cluster = Annotated[
    str, typer.Option(help="Address of a Dask scheduler; none: processes of this machine.")
]
KeyFile = Annotated[
    Path | None, typer.Option("--keys", help="The fleet's key file, or its folder.")
]
PanelKey = Annotated[
    Path | None, typer.Option("--keys", help="panel.json of the fleet's keys, or its folder.")
]
OperatorKey = Annotated[
    Path | None, typer.Option("--keys", help="The operator's key file, or its folder.")
]
MapOperatorKey = Annotated[
    Path | None,
    typer.Option(
        "--operator-key",
        help="The operator's key file: the map's page may release and start with it.",
    ),
]
Metrics = Annotated[
    str | None,
    typer.Option(
        "--metrics",
        metavar="PORT",
        help="Serve figures for Prometheus on this port of loopback, or on HOST:PORT.",
    ),
]
Foxglove = Annotated[
    int | None,
    typer.Option(
        "--foxglove",
        metavar="PORT",
        min=0,
        max=PORT_MAX,
        help="Let Foxglove or Lichtblick look, on this port of loopback (theirs is 8765).",
    ),
]
Map = Annotated[bool, typer.Option("--map", help="Show it in a browser.")]
PagePort = Annotated[
    int,
    typer.Option(
        "--page-port",
        min=0,
        max=PORT_MAX,
        help="Port of the map's page, on loopback (0: any free one).",
    ),
]
