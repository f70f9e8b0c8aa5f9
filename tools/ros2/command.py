"""`headland ros2`: a fleet on a bus as topics of ROS 2, and stops from either side on both."""

import asyncio
import re
from importlib.util import find_spec
from pathlib import Path

from agent.delivery.warehouse import Warehouse
from agent.runtime.end_signals import on_end
from agent.runtime.files.key_file import KeyFileError
from agent.runtime.files.printable_text import printable
from protocol.frame_proofs import ToolProofs
from protocol.frames.frame import Frame
from sim.scenarios.delivery_scenario import load_warehouse
from sim.scenarios.scenario import ScenarioError
from tools.common.bus_address import (
    Attached,
    AttachError,
    robots_of_launch,
    scenario_of_launch,
)
from tools.common.bus_attach import stay_attached, while_attached
from tools.common.event_lines import EventLines
from tools.common.exit_codes import wrong
from tools.common.running_launch import running_launch, watch_intents
from tools.inspect.log_frames import SourceError
from tools.inspect.proven_work import UNPROVEN, ProvenWork, proven_work_of
from tools.livemap.command import check_operator_key, scene_beside, scene_named_by
from tools.livemap.stop_panel import Panel, PanelError, told_result
from tools.operate.estop import stop_keys
from tools.operate.order_proofs import proofs_of
from tools.operate.tool_address import DeviceAddress
from tools.operate.transport_order import house_of
from tools.ros2.graph import Graph

ASK_S = 0.2  # between looks whether something is to be asked
NODE = "headland"
NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?/?", re.ASCII)
NO_ROS = (
    "headland ros2 needs rclpy: a ROS 2 installation, or pip install 'headland[ros2]'. Without either: "
    "--zenoh"
)
NO_ZENOH = "headland ros2 --zenoh needs {}: pip install 'headland[ros,backbone]'"
NO_RELEASE = "no operator's key: start it with --operator-key, or release with headland release"


def serve(
    where: Attached, keys: Path | None, operator_key: Path | None, scenario: str | None,
    namespace: str, domain: int | None, seconds: float | None, zenoh: str | None = None,
    as_json: bool = False,
) -> int:  # fmt: skip
    """The exit code of `headland ros2`: 0 when it was ended, 2 for a wrong argument.

    `domain`: the number of the ROS graph. `seconds`: after which it ends. `zenoh`: the router of a graph
    that is joined without ROS; None: by rclpy.
    """
    missing = _missing(zenoh)
    if missing:
        return wrong(missing)
    try:
        check_operator_key(operator_key)
        _check_namespace(namespace)
        asyncio.run(
            _serve(where, keys, operator_key, scenario, namespace, domain, seconds, zenoh,
                   EventLines(as_json))
        )  # fmt: skip
    except (AttachError, SourceError, GraphError, OSError) as problem:
        return wrong(problem)
    return 0


class GraphError(Exception):
    """One line for the person: why a graph cannot be joined."""


def _check_namespace(namespace: str) -> None:
    """Raises GraphError."""
    if NAMESPACE.fullmatch(namespace) is None:
        raise GraphError(
            f"--namespace {printable(namespace)}: letters, digits and _, with / between the parts"
        )


def _missing(zenoh: str | None) -> str:
    """What has to be installed; empty: all is there."""
    if zenoh is None:
        return "" if find_spec("rclpy") else NO_ROS
    absent = [name for name in ("zenoh", "rosbags") if find_spec(name) is None]
    return NO_ZENOH.format(" and ".join(absent)) if absent else ""


async def _joined(namespace: str, domain: int | None, zenoh: str | None) -> Graph:
    """Raises GraphError and OSError."""
    if zenoh is None:
        try:
            from tools.ros2.dds_graph import DdsGraph
        except ImportError as problem:  # a ROS of another Python, or a part of one
            raise GraphError(f"rclpy cannot be loaded: {str(problem).splitlines()[0]}") from None
        return DdsGraph.joined(NODE, namespace, domain)
    from protocol.links.zenoh_link import LinkError
    from tools.ros2.zenoh_graph import ZenohGraph

    try:
        return await ZenohGraph.open(zenoh, NODE, namespace, domain)
    except (LinkError, ValueError) as problem:
        raise GraphError(str(problem)) from None


def _proofs(operator_key: Path | None, lines: EventLines) -> ToolProofs | None:
    """None also for a key that allows no transports: it may still release."""
    try:
        return proofs_of(operator_key, lines.note)
    except KeyFileError as problem:
        lines.say("no-transports", f"transports are not accepted: {problem}", why=str(problem))
        return None


def _house(scenario: str | None) -> Warehouse | None:
    """The floor on which a fleet delivers; None: it does not."""
    try:
        return None if scenario is None else house_of(load_warehouse(scenario))
    except ScenarioError:
        return None


async def _serve(
    where: Attached, keys: Path | None, operator_key: Path | None, scenario: str | None,
    namespace: str, domain: int | None, seconds: float | None, zenoh: str | None,
    lines: EventLines,
) -> None:  # fmt: skip
    from tools.ros2.goal_desk import GoalDesk
    from tools.ros2.ros2_feed import Ros2Feed
    from tools.ros2.transport_desk import TransportDesk

    interface, channel, bitrate, host, port = where
    launch = running_launch() if interface == "socketcand" and port == 0 else None
    if launch is not None:
        host, port, channel = launch.host, launch.port, launch.channel
        if keys is None and operator_key is None:
            keys = operator_key = launch.keys
    folder = Path() if launch is None else launch.folder
    scene = scene_beside(folder) if scenario is None else scene_named_by(scenario)
    end, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end(loop, end.set)
    if seconds is not None:
        loop.call_later(seconds, end.set)
    bus = await stay_attached(interface, channel, bitrate, host, port, "ros2")
    robots = robots_of_launch(interface, host, port, keys)
    panel, trusted = Panel(bus, stop_keys(keys), operator_key, robots), keys or operator_key
    proven = proven_work_of(trusted, round(loop.time() * 1e6))
    if trusted is not None and proven is None:
        lines.note(UNPROVEN.format(trusted))

    async def stop() -> tuple[bool, str]:
        return told_result(await panel.stop())

    async def release() -> tuple[bool, str]:
        if not panel.releases:
            return False, NO_RELEASE
        try:
            return told_result(await panel.release(keyless=False, reset=True, start=True))
        except PanelError as problem:
            return False, str(problem)

    graph = await _joined(namespace, domain, zenoh)
    feed = Ros2Feed(graph, scene, stop, release)
    feed.proven = proven
    device = panel.stopper.device
    goals = GoalDesk(bus, device, operator_key, feed, graph, lines)
    house = _house(scenario or scenario_of_launch(interface, host, port))
    carriers: TransportDesk | None = None
    if house is not None:
        device.proofs = _proofs(operator_key, lines)
        carriers = TransportDesk(bus, device, house, feed, graph, lines)

    def heard(frame: Frame) -> None:
        if end.is_set():
            return  # it was under way when the node went
        now_s = loop.time()
        feed.hear(now_s, frame)
        panel.hear(now_s, frame)
        goals.hear(now_s, frame)
        if carriers is not None:
            carriers.hear(now_s, frame)

    bus.subscribe(heard)
    beside = [loop.create_task(panel.keep_asking()), loop.create_task(goals.run())]
    if proven is not None:
        beside.append(loop.create_task(_ask(proven, device)))
    if carriers is not None:
        beside.append(loop.create_task(carriers.run()))
    if launch is not None and launch.bodies is not None:
        watching = watch_intents(launch.bodies, lambda intent: feed.intend(loop.time(), intent))
        beside.append(loop.create_task(watching))
    node = f"/{namespace.strip('/')}/{NODE}"
    lines.say("ready", f"ROS 2: node {node}   (Ctrl-C ends it)", node=node)
    try:
        await while_attached(end.wait(), bus)
    finally:
        for task in beside:
            task.cancel()
        bus.close()
        feed.close()


async def _ask(proven: ProvenWork, device: DeviceAddress) -> None:
    """What it has to know for verifying what robots say."""
    loop = asyncio.get_running_loop()
    while True:
        for question in proven.questions(round(loop.time() * 1e6)):
            device.send(question)
        await asyncio.sleep(ASK_S)
