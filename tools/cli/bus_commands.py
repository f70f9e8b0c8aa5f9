"""Commands that attach to the bus of a fleet as a device that is not a robot."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from tools.cli.panels import LOOK, OPERATE, SET_UP
from tools.common.bus_address import AttachError, find_launch
from tools.common.exit_codes import wrong
from tools.common.options import (
    PORT_MAX,
    Bitrate,
    Channel,
    Foxglove,
    Host,
    Interface,
    Json,
    KeyFile,
    MapOperatorKey,
    Metrics,
    OperatorKey,
    PagePort,
    PanelKey,
    Port,
    Timeout,
)

REASONS = (
    "OBSTACLE_DETECTED, OPERATOR_INTERVENTION, SYSTEM_FAULT, COLLISION_DETECTED, PERSON_IN_FIELD, "
    "EQUIPMENT_MALFUNCTION or MAINTENANCE_REQUIRED"
)
BY_A_PERSON = "OPERATOR_INTERVENTION"
HOLD = "Press on after --timeout, until all have confirmed (on a bus that is flooded, say)."
app = typer.Typer()


def _find_launch(interface: str, port: int, *given: object) -> None:
    """End with one line where the bus is that of a launch, and there is none.

    Called before a tool is imported, which takes longer than all else. `given`: files and words of the
    person. Where there is any, the tool looks at it first, and for the launch by itself.
    """
    if any(given):
        return
    try:
        find_launch(interface, port)
    except AttachError as problem:
        raise SystemExit(wrong(problem)) from None


def _no_bus(context: typer.Context, command: str, source: Path) -> None:
    """End with one line where words of a bus stand beside a file, which would be shown in its place.

    A default may be of python-can's own file, and is no word of the person."""
    words = ("interface", "channel", "bitrate", "host", "port")
    sources = ((word, context.get_parameter_source(word)) for word in words)
    given = [f"--{word}" for word, of in sources if of is not None and of.name == "COMMANDLINE"]
    if given:
        raise SystemExit(
            wrong(f"{command} {source}: a file needs no bus; leave out {', '.join(given)}")
        )


@app.command("stop", rich_help_panel=OPERATE)
@app.command("estop", hidden=True)
def stop(
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, keys: PanelKey = None,
    reason: Annotated[str, typer.Option(help=f"Why: {REASONS}.")] = BY_A_PERSON,
    timeout_s: Timeout = 2.0,
    hold: Annotated[bool, typer.Option("--hold", help=HOLD)] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Press nothing: keep showing which robots are stopped.")
    ] = False,
    json: Json = False,
) -> None:  # fmt: skip
    """Stop every robot on a bus, and say which have confirmed. Exit 0 only when all did
    that are or were there.

    Example: headland stop -i socketcan -c can0
    """
    _find_launch(interface, port, keys, reason != BY_A_PERSON)
    from tools.operate.estop import estop as command

    raise SystemExit(
        command(interface, channel, bitrate, host, port, keys, reason, timeout_s, watch, json, hold)
    )


@app.command("release", rich_help_panel=OPERATE)
@app.command("reset", hidden=True)
def release(
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, key: OperatorKey = None,
    start: Annotated[bool, typer.Option("--start/--no-start", help="And start the work.")] = False,
    timeout_s: Timeout = 5.0,
    json: Json = False,
) -> None:  # fmt: skip
    """Clear the stops that are shown, reset each machine, and (with --start) start the work again.

    Example: headland release --start
    """
    _find_launch(interface, port, key)
    from tools.operate.reset import reset as command

    raise SystemExit(command(interface, channel, bitrate, host, port, key, start, timeout_s, json))


@app.command("tc", rich_help_panel=OPERATE)
def task_controller(
    field: Annotated[Path, typer.Argument(help="The field: GeoJSON or ISO 11783-10 task data.")],
    feature: Annotated[str | None, typer.Option(help="Which field of the file.")] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0,
    slot: Annotated[int, typer.Option(help="Number of this machine, from 0.")] = 0,
    machines: Annotated[
        int, typer.Option(min=1, max=32, help="Task controllers that share the map.")
    ] = 1,
    share_host: Annotated[
        str, typer.Option(help="Host of a socketcand bus on which the map is shared.")
    ] = "127.0.0.1",
    share_port: Annotated[
        int, typer.Option(min=0, max=PORT_MAX, help="Its port; 0: the map is shared on this bus.")
    ] = 0,
    hitch: Annotated[
        float, typer.Option(help="Metres from the receiver forward to the hitch; negative: behind.")
    ] = 0.0,
    accuracy: Annotated[
        float, typer.Option(help="Metres, of places whose receiver does not say it.")
    ] = 0.05,
    keys: KeyFile = None,
    memory: Annotated[Path, typer.Option(help="Where the map is kept.")] = Path("runs/tc.sqlite"),
    json: Json = False,
) -> None:  # fmt: skip
    """Serve implements of any maker: their worked ground is shared, and sections over it go off.

    `--hitch` and `--accuracy` are in metres.

    Example: headland tc field.geojson -i socketcan -c can0 --hitch -2.1
    """
    from tools.run.task_controller import task_controller as command

    bus = (interface, channel, bitrate, host, port)
    raise SystemExit(
        command(
            field, feature, bus, (share_host, share_port), (slot, machines), hitch, accuracy, keys,
            memory, json,
        )
    )  # fmt: skip


@app.command(rich_help_panel=OPERATE)
def order(
    robot: Annotated[int, typer.Argument(help="The robot's number.")],
    what: Annotated[
        str, typer.Argument(help="wait, continue, replan, stop, go-home, set-goal or start.")
    ],
    place: Annotated[
        str | None, typer.Argument(help="Of set-goal: metres east,north, as 12.5,-40.")
    ] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, key: OperatorKey = None,
    timeout_s: Timeout = 5.0,
    json: Json = False,
) -> None:  # fmt: skip
    """Answer a robot that has stopped before something, or direct it. It confirms, or exit 1.

    Example: headland order 2 replan
    """
    from tools.operate.order import order as command

    bus = (interface, channel, bitrate, host, port)
    raise SystemExit(command(robot, what, place, bus, key, timeout_s, json))


@app.command(rich_help_panel=OPERATE)
def say(
    phrase: Annotated[
        list[str] | None, typer.Argument(help="What you want, in words; none: a conversation.")
    ] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, key: OperatorKey = None,
    places: Annotated[
        Path | None, typer.Option(help="TOML with named places; none: the launch's.")
    ] = None,
    by: Annotated[str | None, typer.Option(help="Which robot answers questions, or any.")] = None,
    log: Annotated[
        Path | None, typer.Option(help="Ask a run folder or a log instead of a bus.")
    ] = None,
    read: Annotated[bool, typer.Option("--read", help="Only show how it is understood.")] = False,
    queue: Annotated[
        Path | None,
        typer.Option(help="Where goals wait for an idle robot; none: in the launch's folder."),
    ] = None,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Stay until what is queued was given.")
    ] = True,
    yes: Annotated[bool, typer.Option("--yes", help="Say yes to what is asked back.")] = False,
    endpoint: Annotated[
        str | None, typer.Option(help="OpenAI-compatible URL for what the grammar cannot read.")
    ] = None,
    model: Annotated[str, typer.Option(help="Of the endpoint.")] = "default",
    timeout_s: Timeout = 5.0,
    json: Json = False,
) -> None:  # fmt: skip
    """Tell or ask the fleet something in plain language. Ambiguous or unsafe: exit 3 and a question.

    Example: headland say "send the nearest robot to the gate"
    """
    _find_launch(interface, port, key, places, by, endpoint, log, read)
    from tools.language.say import say as command
    from tools.language.say_options import Options

    bus = (interface, channel, bitrate, host, port)
    options = Options(
        bus, key, places, queue, by, endpoint, model, timeout_s, wait, yes, read, log, json
    )
    raise SystemExit(command(phrase or [], options))


@app.command(rich_help_panel=SET_UP)
def hub(
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=PORT_MAX, help="0: any free one.")] = 29536,
    bitrate: Bitrate = 250_000,
    seed: Annotated[int, typer.Option(help="Of the wire's chance.")] = 1,
    beacon: Annotated[
        bool | None,
        typer.Option("--beacon/--no-beacon", help="Tell tools by UDP; default: on loopback only."),
    ] = None,
    errors: Annotated[bool, typer.Option("--errors", help="Tell clients error frames.")] = False,
    json: Json = False,
) -> None:
    """Run a simulated bus by itself: robots on it stand while it is gone, and reconnect by themselves.

    Example: headland hub, then in another terminal: headland launch small --hub 29536
    """
    from tools.cli.hub import hub as command

    raise SystemExit(command(host, port, bitrate, seed, json, beacon, errors))


@app.command(rich_help_panel=LOOK)
def inspect(
    context: typer.Context,
    source: Annotated[Path | None, typer.Argument(help="Run folder or log; none: a live bus.")] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0,
    seconds: Annotated[
        float | None, typer.Option(help="Listen this long to a live bus (3; with --watch: for ever).")
    ] = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Of a live bus, what is heard so far, every second.")
    ] = False,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Print the state machine.")] = False,
    why: Annotated[str | None, typer.Option(help="How a section (S7) came to its owner.")] = None,
    traces: Annotated[int | None, typer.Option(help="Ask this robot for its newest traces.")] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Text, also at a terminal.")] = False,
    speed: Annotated[float, typer.Option(help="Of a log on the screen; 0: show its end.")] = 0.0,
    picture: Annotated[Path | None, typer.Option(help="Write the screen as an SVG.")] = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Show each robot's state, peers, sections, vector clock, and the path of states that led there.

    At a terminal this is a screen (`q` ends it); otherwise, and with --plain, text.

    Example: headland inspect runs/latest --why S7
    """
    if source is not None:
        _no_bus(context, "inspect", source)
    _find_launch(interface, port, source, mermaid, why, picture, traces)
    from tools.inspect.inspection import inspect as command

    bus = (interface, channel, bitrate, host, port)
    raise SystemExit(
        command(source, *bus, seconds, mermaid, why, json, traces, plain, speed, picture, watch)
    )


@app.command("map", rich_help_panel=LOOK)
def show_map(
    context: typer.Context,
    source: Annotated[Path | None, typer.Argument(help="Run folder or log; none: a live bus.")] = None,
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, keys: PanelKey = None,
    scenario: Annotated[
        str | None, typer.Option(help="Whose field to draw, where the source does not say.")
    ] = None,
    page_port: PagePort = 8700,
    operator_key: MapOperatorKey = None,
    metrics: Metrics = None,
    foxglove: Foxglove = None,
    json: Json = False,
    ends_with_input: Annotated[bool, typer.Option("--ends-with-input", hidden=True)] = False,
) -> None:  # fmt: skip
    """Show a fleet in a browser: the newest launch, any bus, or a recorded run.

    Example: headland map runs/latest, or on a real bus: headland map -i socketcan -c can0
    """
    if ends_with_input:  # as a launch starts it
        from tools.common.child_process import end_with_input as begin

        begin()
    if source is not None:
        _no_bus(context, "map", source)
    _find_launch(interface, port, source, keys, scenario, operator_key, metrics, foxglove)
    from tools.livemap.command import show_map as command

    raise SystemExit(
        command(
            source,
            interface,
            channel,
            bitrate,
            host,
            port,
            keys,
            scenario,
            page_port,
            json,
            operator_key=operator_key,
            metrics=metrics,
            foxglove=foxglove,
        )
    )


@app.command(rich_help_panel=SET_UP)
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
    metrics: Metrics = None,
    keys: Annotated[
        Path | None, typer.Option(help="panel.json or its folder: without it work is not believed.")
    ] = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Join a bus to the rest of the fleet. Stops pass first and always; start two for each bus.

    Example: headland bridge --segment 2 -i socketcan -c can0 --zenoh tcp/10.0.0.1:7447
    """
    from tools.cli.bridge import bridge as command

    raise SystemExit(
        command(segment, interface, channel, bitrate, host, port, fleet, zenoh or [], listen or [],
                mode, config, area, seconds, json, arena, metrics, keys)
    )  # fmt: skip


@app.command(rich_help_panel=SET_UP)
def vda5050(
    broker: Annotated[str, typer.Option(help="mqtt://[user:password@]host[:port], or mqtts.")],
    scenario: Annotated[str, typer.Option(help="Whose map says what is floor.")] = "warehouse",
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, keys: OperatorKey = None,
    book: Annotated[
        Path, typer.Option(help="Where it keeps which order became which task.")
    ] = Path("runs/launch/vda5050.jsonl"),
    topics: Annotated[str, typer.Option(help="First level of all topics.")] = "uagv",
    manufacturer: Annotated[str, typer.Option(help="Of the vehicles, in all topics.")] = "Headland",
    standard: Annotated[
        Literal["2.0.0", "2.1.0"], typer.Option(help="Version that messages say; they are the same.")
    ] = "2.0.0",
    seconds: Annotated[float | None, typer.Option(help="End after this time.")] = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Show a delivering fleet to a VDA 5050 master control as its vehicles, and take its orders.

    Example: headland vda5050 --broker mqtt://127.0.0.1
    """
    from tools.vda5050.command import serve

    where = (interface, channel, bitrate, host, port)
    raise SystemExit(
        serve(broker, scenario, book, where, keys, topics, manufacturer, standard, seconds, json)
    )


@app.command(rich_help_panel=SET_UP)
def ros2(
    interface: Interface = "socketcand", channel: Channel = "can0", bitrate: Bitrate = 250_000,
    host: Host = "127.0.0.1", port: Port = 0, keys: PanelKey = None,
    operator_key: Annotated[
        Path | None, typer.Option(help="By which ROS may release. Without it ROS may only stop.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(help="What stands there; none: that of a launch.")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Of all topics.")] = "headland",
    domain: Annotated[
        int | None, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID; none: of the environment.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="End after this time.")] = None,
    zenoh: Annotated[
        str | None,
        typer.Option(metavar="ENDPOINT", help="Without ROS: by this router of rmw_zenoh, tcp/HOST:7447."),
    ] = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Show a fleet to ROS 2: odometry, states, plans, maps, diagnostics. Stops go both ways.

    `domain` is that of the ROS graph, `seconds` ends it. Topics: docs/use/ros2.md.
    Example: headland ros2 --domain 7
    """
    from tools.ros2.command import serve

    where = (interface, channel, bitrate, host, port)
    raise SystemExit(
        serve(where, keys, operator_key, scenario, namespace, domain, seconds, zenoh, json)
    )
