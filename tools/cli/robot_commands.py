"""Commands for real machines: a robot as a process, the checks of its driver, a machine to try it on."""

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.cli.panels import OPERATE, SET_UP
from tools.common.exit_codes import wrong
from tools.common.options import PORT_MAX, Drive, Foxglove, Json, Metrics
from tools.common.unused_options import refuse_unused

if TYPE_CHECKING:
    from agent.interface.vehicle import Vehicle

app = typer.Typer()
LATITUDE_MAX, LONGITUDE_MAX = 90.0, 180.0  # degrees


def _numbers(text: str, form: str) -> list[float]:
    try:
        values = [float(each) for each in text.split(",")]
    except ValueError:
        values = []
    if len(values) != form.count(",") + 1:
        raise typer.BadParameter(f"not {form}: {text!r}")
    if not all(map(isfinite, values)):
        raise typer.BadParameter(f"{text}: these have to be finite numbers")
    return values


def _place(text: str) -> tuple[float, float]:
    latitude, longitude = _numbers(text, "LATITUDE,LONGITUDE")
    if not (abs(latitude) <= LATITUDE_MAX and abs(longitude) <= LONGITUDE_MAX):
        raise typer.BadParameter(f"{text}: latitude is -90 to 90, longitude -180 to 180 degrees")
    return latitude, longitude


def _vehicle(
    drive: Drive, speed_m_s: float, acceleration_m_s2: float, wheelbase_m: float, track_m: float
) -> "Vehicle":
    """Within the limits of a robot file: a machine of speed 0 cannot be tried."""
    from pydantic import ValidationError

    from agent.runtime.declared_values import FleetTable, first_error

    try:
        fleet = FleetTable(
            drive=drive, speed_m_s=speed_m_s, acceleration_m_s2=acceleration_m_s2,
            wheelbase_m=wheelbase_m, track_m=track_m,
        )  # fmt: skip
    except ValidationError as problem:
        raise typer.BadParameter(first_error(problem, FleetTable)) from None
    return fleet.vehicle


@app.command(rich_help_panel=OPERATE)
def robot(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(help="The robot file, or that of the whole fleet (TOML).")
    ],
    slot: Annotated[
        int | None, typer.Option(min=0, help="Which robot of the fleet this machine is.")
    ] = None,
    interface: Annotated[
        str | None,
        typer.Option("-i", "--interface", help="python-can interface, instead of the file's."),
    ] = None,
    channel: Annotated[
        str | None, typer.Option("-c", "--channel", help="Channel, instead of the file's.")
    ] = None,
    body: Annotated[
        str | None,
        typer.Option(help="Body plug-in, instead of the file's: nmea, ros2, isobus, vda5050 ..."),
    ] = None,
    first_boot: Annotated[
        bool, typer.Option("--first-boot", help="A new machine: an empty memory is no loss.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Only tell what would run, and what is missing.")
    ] = False,
    dry: Annotated[
        bool, typer.Option("--dry", help="Take part, and drive nothing: the body stands.")
    ] = False,
    metrics: Metrics = None,
    foxglove: Foxglove = None,
    json: Annotated[
        bool, typer.Option("--json", help="Of --check: print JSON instead of text.")
    ] = False,
) -> None:
    """Run one robot on a machine: its bus, its body, its work and its memory from a file.

    Exit 0 after a farewell (Ctrl-C, SIGTERM), 2 if a person has to mend something first.
    Example: headland robot fleet.toml --slot 1 -i socketcan -c can0 --body nmea --check
    """
    from agent.runtime.ready_kernels import use_ready_kernels

    use_ready_kernels()  # before anything is imported that has kernels
    from agent.runtime.robot_file import Changes

    changes = Changes(slot, interface, channel, body)
    if json and not check:  # a script that forgot --check must not start a machine
        raise SystemExit(wrong("--json: does nothing without --check; add --check"))
    if check:
        told = {"file", "slot", "interface", "channel", "body", "metrics", "foxglove", "json"}
        refuse_unused(context, "--check", told)
    else:
        from tools.run.robot_command import robot as command

        raise SystemExit(
            command(
                file, changes, first_boot=first_boot, dry=dry, metrics=metrics, foxglove=foxglove
            )
        )
    from tools.run.robot_check import check as look

    raise SystemExit(look(file, changes, as_json=json, metrics=metrics, foxglove=foxglove))


@app.command("body-check", rich_help_panel=SET_UP)
def body_check(
    body: Annotated[str, typer.Argument(help="A body plug-in, or MODULE:CLASS of your own.")],
    option: Annotated[
        list[str] | None, typer.Option(help="KEY=VALUE for the body; may be repeated.")
    ] = None,
    drive: Annotated[Drive, typer.Option(help="Its drive train.")] = "differential",
    speed: Annotated[float, typer.Option(help="Its top speed, m/s.")] = 2.5,
    acceleration: Annotated[float, typer.Option(help="m/s2.")] = 1.5,
    wheelbase: Annotated[float, typer.Option(help="Front to rear axle, m.")] = 1.2,
    track: Annotated[float, typer.Option(help="Left to right wheel, m.")] = 1.0,
    origin: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Of (0, 0), degrees.")
    ] = None,
    machine: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Orders of a simulated machine.")
    ] = None,
    json: Json = False,
) -> None:
    """Try a driver with ten checks. The machine drives some metres in every direction.

    Exit 0 if no check failed, 1 if one did.
    Example: headland body-check rover:Rover --origin 52,5 --machine 127.0.0.1:5003
    """
    from tools.run.body_check import body_check as command

    vehicle = _vehicle(drive, speed, acceleration, wheelbase, track)
    raise SystemExit(
        command(body, option or [], vehicle, _place(origin) if origin else None, machine, json)
    )


@app.command(rich_help_panel=SET_UP)
def machine(
    context: typer.Context,
    drive: Annotated[Drive, typer.Option(help="Its drive train.")] = "differential",
    origin: Annotated[str, typer.Option(metavar="LAT,LON", help="Of (0, 0), degrees.")] = "52,5",
    place: Annotated[
        str, typer.Option(metavar="X,Y,DEGREES", help="Metres east and north, degrees from east.")
    ] = "0,0,0",
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    gnss: Annotated[int, typer.Option(min=0, max=PORT_MAX, help="0: any free one.")] = 5001,
    wheels: Annotated[int, typer.Option(min=0, max=PORT_MAX, help="0: any free one.")] = 5002,
    orders: Annotated[int, typer.Option(min=0, max=PORT_MAX, help="0: any free one.")] = 5003,
    rate: Annotated[float, typer.Option(min=1.0, max=50.0, help="Of the receiver, Hz.")] = 20.0,
    bus: Annotated[
        str | None,
        typer.Option(
            metavar="INTERFACE:CHANNEL", help="A tractor on this CAN bus, with orders only."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of its noise.")] = 1,
    tell: Annotated[
        str | None,
        typer.Option(metavar="WORDS", help="Tell the machine of --orders this, and begin none."),
    ] = None,
    json: Json = False,
) -> None:
    """A simulated machine: a GNSS receiver and a wheel controller on TCP ports.

    --tell makes one fail that runs: muted 3, frozen 3, jumped 2 0 3, late 0.5 3, deaf 3; where.
    With --bus it is a tractor on a CAN bus, for the body `isobus`.
    Exit 2 if a port is taken.
    Example: headland machine --drive ackermann --origin 52.1,5.2
    Example: headland machine --tell "muted 3"
    """
    from math import radians

    from tools.run.machine_command import machine as command
    from tools.run.machine_command import order

    if tell is not None:
        refuse_unused(context, "--tell", {"host", "orders"})
        raise SystemExit(order(tell, host, orders))
    if bus is not None and (drive != "ackermann" or ":" not in bus):
        raise typer.BadParameter("--bus INTERFACE:CHANNEL needs --drive ackermann")
    if bus is not None:
        refuse_unused(
            context, "--bus", {"drive", "origin", "place", "host", "orders", "rate", "seed", "json"}
        )
    x_m, y_m, heading_deg = _numbers(place, "X,Y,DEGREES")
    raise SystemExit(
        command(
            drive, _place(origin), (x_m, y_m, radians(heading_deg)), (gnss, wheels, orders), host, seed,
            rate, json, bus,
        )
    )  # fmt: skip
