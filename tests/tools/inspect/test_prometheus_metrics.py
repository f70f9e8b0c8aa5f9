"""The figures of `--metrics`, read by promtool and by a Prometheus of the distribution."""

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
from pathlib import Path
from socket import socket

import pytest

pytest.importorskip("prometheus_client", reason="the extra `metrics` is not installed")

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.messages import Message
from protocol.frames.safety_frames import EmergencyStop, Reason
from protocol.frames.work_frames import WorkProgress
from tests.tools.launching import WAIT_S, call, said, start
from tools.bench.prometheus_server import FILES, Alert, PrometheusServer, page
from tools.inspect.inspector import SILENT_S
from tools.inspect.measured_inspector import MeasuredInspector
from tools.inspect.metrics_address import MetricsError, metrics_address
from tools.inspect.prometheus_metrics import FleetCollector, GatewayCollector, RobotProcesses

PANEL = 247  # source address of a device that is no robot
needs_promtool = pytest.mark.skipif(
    shutil.which("promtool") is None, reason="promtool is not installed (apt install prometheus)"
)
needs_prometheus = pytest.mark.skipif(
    shutil.which("prometheus") is None,
    reason="prometheus is not installed (apt install prometheus)",
)


class Fleet:
    """Frames of two robots, at times that the test chooses."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.now_s = 10.0
        self.inspector = MeasuredInspector(frozenset(range(4)))
        FleetCollector(self.inspector, lambda: self.now_s, self.registry)
        for slot in range(2):
            self.say(128 + slot, Member(slot, 1, 7))
            self.pose(slot, 1.5)

    def say(self, source: int, message: Message) -> None:
        self.inspector.hear(self.now_s, encode(message, source))

    def pose(self, slot: int, speed_m_s: float, state: State = State.WORKING) -> None:
        self.say(128 + slot, Pose(0.0, 0.0, 0.0, speed_m_s, state, speed_m_s == 0.0, 0))

    def value(self, name: str, **labels: str) -> float | None:
        return self.registry.get_sample_value(name, labels)


def test_a_stop_is_timed_to_the_echo_and_to_the_stand() -> None:
    fleet, press = Fleet(), EmergencyStop(200, 1, 1, Reason.OPERATOR_INTERVENTION)
    fleet.say(PANEL, press)
    fleet.now_s += 0.004
    fleet.say(128, press._replace(echo=True))
    fleet.now_s += 0.004
    fleet.say(129, press._replace(echo=True))
    fleet.say(128, press._replace(echo=True))  # each robot counts once
    fleet.now_s += 0.6
    fleet.pose(0, 0.0, State.EMERGENCY_STOP)
    assert fleet.value("headland_stop_echo_seconds_count") == 2
    assert fleet.value("headland_stop_echo_seconds_bucket", le="0.005") == 1
    assert fleet.value("headland_stop_standstill_seconds_count") == 1
    assert fleet.value("headland_stop_standstill_seconds_bucket", le="0.5") == 0
    assert fleet.value("headland_stop_standstill_seconds_bucket", le="0.75") == 1
    assert fleet.value("headland_stops_latched") == 1


def test_an_echo_of_a_stop_that_nobody_heard_pressed_is_not_timed() -> None:
    """A listener that comes late would tell 0 s."""
    fleet = Fleet()
    late = EmergencyStop(200, 1, 1, Reason.OPERATOR_INTERVENTION, echo=True)
    fleet.say(128, late)
    fleet.say(PANEL, late._replace(echo=False))  # still repeated
    fleet.say(129, late)
    assert fleet.value("headland_stop_echo_seconds_count") == 0


def test_silence_states_and_work_by_robot() -> None:
    fleet = Fleet()
    fleet.now_s += 3.0
    fleet.pose(0, 1.0)
    fleet.say(128, WorkProgress(2, 0, 0b111))
    assert fleet.value("headland_robot_silence_seconds", robot="1") == 3.0
    assert fleet.value("headland_robot_silence_seconds", robot="0") == 0.0
    assert fleet.value("headland_robot_state", robot="0", state="WORKING") == 1.0
    assert fleet.value("headland_robot_transitions_total", robot="0", state="WORKING") == 1.0
    assert fleet.value("headland_sections", phase="FREE") == 4.0
    assert fleet.value("headland_worked_units") == 3.0
    assert fleet.value("headland_frames_total", kind="POSE") == 3.0
    assert fleet.value("headland_robots") == 2.0


def test_a_robot_that_is_silent_or_has_left_has_no_speed() -> None:
    """It kept the last one that it had told."""
    fleet, name = Fleet(), "headland_robot_speed_metres_per_second"
    assert [fleet.value(name, robot=slot) for slot in "01"] == [1.5, 1.5]
    fleet.now_s += SILENT_S + 0.1
    fleet.pose(0, 1.0)
    assert [fleet.value(name, robot=slot) for slot in "01"] == [1.0, None]
    fleet.say(128, Heartbeat(1, State.IDLE, False, False, True, True, 1.0, 0, 0))
    assert fleet.value("headland_robot_left", robot="0") == 1.0
    assert fleet.value(name, robot="0") is None


@pytest.mark.parametrize("keyed", [False, True])
def test_a_fleet_without_keys_is_a_figure(keyed: bool) -> None:
    fleet = Fleet()
    assert fleet.value("headland_robot_keyed", robot="0") is None, "it has not said so yet"
    beat = Heartbeat(0, State.IDLE, False, False, True, False, 1.0, 0, 0, keyed)
    fleet.say(128, beat)
    assert fleet.value("headland_robot_keyed", robot="0") == keyed


def test_groups_of_others_are_one_kind() -> None:
    """A device that makes up groups must not make up series."""
    fleet = Fleet()
    heard = encode(Member(0, 1, 7), PANEL)
    for group in range(0x10000, 0x10100):
        fleet.inspector.hear(11.0, heard._replace(identifier=6 << 26 | group << 8 | PANEL))
    kinds = {
        sample.labels["kind"]
        for family in fleet.registry.collect() for sample in family.samples
        if sample.name == "headland_frames_total"
    }  # fmt: skip
    assert kinds == {"MEMBER", "POSE", "other"}


@pytest.mark.parametrize("word", ["here", "70000", "-1", "", "localhost:", "9" * 5000, "９"])
def test_a_wrong_port_is_one_line(word: str) -> None:
    with pytest.raises(MetricsError, match=r"a port from 0 to 65535, or HOST:PORT"):
        metrics_address(word)


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(MetricsError, match="choose another"):
            metrics_address(str(taken.getsockname()[1]))


@needs_promtool
def test_promtool_finds_nothing_to_say_about_the_metrics() -> None:
    fleet = Fleet()
    fleet.say(PANEL, EmergencyStop(200, 1, 1, Reason.OPERATOR_INTERVENTION))
    status = {"leads": True, "bus": "ACTIVE", "reached": [2]}
    GatewayCollector(lambda: status, fleet.registry)
    done = subprocess.run(
        ["promtool", "check", "metrics"], input=generate_latest(fleet.registry),
        capture_output=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


@needs_promtool
@pytest.mark.parametrize(
    "words",
    [
        ("check", "rules", "alerts.yml"),
        ("test", "rules", "alerts_test.yml"),
        ("check", "config", "prometheus.yml"),
    ],
)
def test_promtool_accepts_rules_and_configuration(words: tuple[str, ...]) -> None:
    done = subprocess.run(
        ["promtool", *words], cwd=FILES, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_page_says_how_many_alerts_there_are() -> None:
    told = re.search(r"\| (\d+) alerts;", (FILES.parents[1] / "docs/use/monitoring.md").read_text())
    assert told and int(told[1]) == (FILES / "alerts.yml").read_text().count("- alert: ")


def test_the_dashboard_asks_for_metrics_that_exist() -> None:
    board = json.loads((FILES / "grafana.json").read_text())
    asked = "".join(t["expr"] for panel in board["panels"] for t in panel["targets"])
    asked += (FILES / "alerts.yml").read_text()
    fleet = Fleet()
    RobotProcesses(lambda: [0], lambda: {0: os.getpid()}, fleet.registry)
    GatewayCollector(lambda: {"leads": True, "bus": "ACTIVE", "reached": []}, fleet.registry)
    known = {family.name for family in fleet.registry.collect()}
    asks = set(re.findall(r"headland_\w+", asked)) - {"headland_robots"}
    assert len(asks) > 15
    for name in asks:
        assert re.sub(r"_(total|bucket)$", "", name) in known, name


def names_of(text: bytes) -> set[str]:
    return {family.name for family in text_string_to_metric_families(text.decode())}


@pytest.mark.slow
@needs_prometheus
def test_prometheus_alerts_on_a_killed_robot_of_a_launch(tmp_path: Path) -> None:
    """Launch, map and Prometheus are processes; the robot is killed while it works."""

    async def story() -> None:
        launch = await start(tmp_path, "launch", "small", "--metrics", "0")
        url = await said(launch, r"metrics: (http://\S+)")
        victim = int(await said(launch, r"robot 1: process (\d+)"))
        await said(launch, r"1:(WORKING)")
        shown = await start(tmp_path, "map", "--page-port", "0", "--metrics", "0")
        map_url = await said(shown, r"metrics: (http://\S+)")
        server = await PrometheusServer.start(tmp_path, url)
        try:
            before = await server.firing() or set()
            assert "HeadlandRobotProcessEnded" not in {name for name, _ in before}
            os.kill(victim, signal.SIGKILL)
            wanted: set[Alert] = {("HeadlandRobotSilent", "1"), ("HeadlandRobotProcessEnded", "1")}
            assert await server.fires(wanted, WAIT_S) <= WAIT_S
            code, text = await call(tmp_path, "stop")
            assert code in (0, 1), text
            told = (await asyncio.to_thread(page, url)).decode()
            assert told == told.strip() + "\n" and "headland_stops_latched 0.0" not in told
            count = [
                x for x in told.splitlines() if x.startswith("headland_stop_echo_seconds_count")
            ]
            assert float(count[0].split()[1]) >= 2, count
            of_map = names_of(await asyncio.to_thread(page, map_url))
            assert {"headland_robots", "headland_sections", "headland_bus_load_ratio"} <= of_map
        finally:
            await server.end()
            for process in (shown, launch):
                if process.returncode is None:
                    process.terminate()
                    await process.communicate()

    asyncio.run(story())


@pytest.mark.slow
def test_a_watch_is_a_stream_of_lines(tmp_path: Path) -> None:
    async def story() -> None:
        hub = await start(tmp_path, "hub", "--port", "0", "--json")
        port = await said(hub, r'"port": ?(\d+)')
        try:
            words = ("inspect", "--watch", "--json", "--seconds", "2.5", "--port", port)
            code, out = await call(tmp_path, *words)
            lines = [json.loads(line) for line in out.splitlines()]
            assert code == 0 and len(lines) >= 2 and lines[0]["robots"] == []
        finally:
            hub.terminate()
            await hub.communicate()

    asyncio.run(story())
