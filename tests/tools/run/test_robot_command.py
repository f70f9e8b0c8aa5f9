"""`headland robot` as a person calls it: what is missing, what runs, and nothing of the simulator."""

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from secrets import randbelow
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.tools.launching import ENVIRONMENT, ROOT

LIMIT_S = 60
FILE = """
name = "try"
[fleet]
robots = 3
[bus]
interface = "virtual"
channel = "try"
[[machine]]
slot = 2
body_options = { x_m = 5.0 }
"""
SPY = """
import atexit, sys
def tell():
    tops = {each.split(".")[0] for each in sys.modules}
    print("foreign", sorted(tops & {"sim", "pymunk"}), file=sys.stderr)
    print("for people", sorted(tops & {"typer", "rich"}), file=sys.stderr)
atexit.register(tell)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "fleet.toml").write_text(FILE)
    (tmp_path / "spy").mkdir()
    (tmp_path / "spy" / "sitecustomize.py").write_text(SPY)
    yield tmp_path


def begin(folder: Path, *words: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "headland", "robot", *words], cwd=folder,
        env={**ENVIRONMENT, "PYTHONPATH": f"{folder / 'spy'}:{ROOT}"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def end(process: "subprocess.Popen[str]") -> tuple[int, str, str]:
    out, err = process.communicate(timeout=LIMIT_S)
    return process.returncode, out, err


def test_check_says_what_would_run_and_what_is_missing(folder: Path) -> None:
    code, out, err = end(begin(folder, "fleet.toml", "--slot", "2", "--check", "--json"))
    found: dict[str, Any] = json.loads(out)
    said = {each["what"]: each["found"] for each in found["findings"]}
    assert code == 0 and found["ready"], (out, err)
    assert "robot 2 of 3" in said["file"] and "5.00 m east" in said["place"]
    assert "does not see people" in said["ranges"] and "--first-boot" in said["memory"]
    assert "foreign []" in err, "nothing of the simulator is imported"
    assert list(folder.glob("*.sqlite")) == [], "a check leaves nothing behind"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--slot", "3"), "robot.slot: 3 is not one of 3 robots (0 to 2)"),
        ((), "robot: is missing"),
        (
            ("--slot", "1", "--body", "nmae"),
            "no plug-in 'nmae'; there are isobus, nmea, replay, ros2, sim, standing, vda5050",
        ),
        (("--slot", "1", "--body", "nmea"), "body.plugin:"),
        (("--slot", "1", "-i", "sokketcan"), "bus: cannot open sokketcan try"),
    ],
)
def test_what_is_wrong_is_one_line(words: tuple[str, ...], said: str, folder: Path) -> None:
    code, _, err = end(begin(folder, "fleet.toml", *words))
    lines = [line for line in err.splitlines() if line.startswith("headland:")]
    assert code == 2 and said in lines[-1] and "Traceback" not in err, err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--body", "standing", "-i", "socketcan", "-c", "nocan"), "bus: cannot open socketcan"),
        ((), "body: tcp://127.0.0.1:9: Connection refused"),
    ],
)
def test_a_device_that_is_not_there_is_worth_another_start(
    words: tuple[str, ...], said: str, folder: Path
) -> None:
    """It ended with the code of a wrong file, so that the unit did not start a robot whose CAN adapter or
    receiver came a second later than the machine."""
    pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")
    nmea = '{ gnss = "tcp://127.0.0.1:9", wheels = "tcp://127.0.0.1:9", origin = [52.0, 5.0] }'
    text = f'{FILE}[body]\nplugin = "nmea"\noptions = {nmea}\n'
    (folder / "fleet.toml").write_text(text)
    code, _, err = end(begin(folder, "fleet.toml", "--slot", "0", "--first-boot", *words))
    lines = [line for line in err.splitlines() if line.startswith("headland:")]
    assert code == 75 and said in lines[-1] and "Traceback" not in err, err


def test_check_names_each_thing_that_is_not_ready(folder: Path) -> None:
    words = ("--slot", "1", "--body", "replay", "-i", "sokketcan", "--check")
    code, out, _ = end(begin(folder, "fleet.toml", *words))
    assert code == 2 and out.splitlines()[-1] == "not ready: bus, body", out


@pytest.mark.parametrize("dry", [(), ("--dry",)], ids=["driven", "dry"])
def test_it_takes_part_and_ends_with_a_farewell(dry: tuple[str, ...], folder: Path) -> None:
    process = begin(folder, "fleet.toml", "--slot", "0", "--first-boot", *dry)
    assert process.stdout is not None and process.stdout.readline() == "robot 0 is up\n"
    process.send_signal(signal.SIGTERM)
    code, _, err = end(process)
    assert code == 0 and "foreign []" in err and "for people []" in err, err
    assert (folder / "robot0.sqlite").exists()
    assert "headland: robot 0: NO KEYS: any device on the bus can stop and release it\n" in err


def test_a_driver_beside_the_robot_file_is_found(folder: Path) -> None:
    (folder / "machines").mkdir()
    place = folder / "machines"
    (place / "mine.py").write_text(
        "from agent.runtime.robot_body import StandingBody\n"
        "class Mine(StandingBody):\n    has_range_sensors = True\n"
    )
    (place / "fleet.toml").write_text(FILE + '[body]\nfactory = "mine:Mine"\n')
    code, out, _ = end(begin(folder, "machines/fleet.toml", "--slot", "1", "--check"))
    assert code == 0 and "mine:Mine" in out and "ranges  yes" in out, out


@pytest.mark.parametrize(("method", "arguments"), [("sense", "now_us"), ("close", "")])
def test_check_says_what_a_driver_raises(method: str, arguments: str, folder: Path) -> None:
    """It ended with a traceback and without a line on the rest."""
    (folder / "mine.py").write_text(
        "from agent.runtime.robot_body import StandingBody\n"
        "class Mine(StandingBody):\n"
        f"    def {method}(self, {arguments}):\n        raise KeyError('wheels')\n"
    )
    (folder / "fleet.toml").write_text(FILE + '[body]\nfactory = "mine:Mine"\n')
    code, out, err = end(begin(folder, "fleet.toml", "--slot", "1", "--check"))
    assert code == 2 and "not ready: body" in out and "Traceback" not in err, out + err
    assert "raised KeyError: 'wheels' (mine.py:4)" in " ".join(out.split()), out


def test_a_plugin_of_another_package_is_found(folder: Path) -> None:
    spy = folder / "spy"
    (spy / "rover_of_others.py").write_text(
        "from agent.runtime.robot_body import StandingBody as Rover\n"
    )
    metadata = spy / "rover-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rover\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[headland.body]\nrover = rover_of_others:Rover\n")
    code, out, _ = end(begin(folder, "fleet.toml", "--slot", "1", "--body", "rover", "--check"))
    assert code == 0 and "body    rover" in out, out


@pytest.mark.slow
def test_check_ends_where_no_bus_server_answers(folder: Path) -> None:
    """It waited for ever, and said nothing."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens there
        port = taken.getsockname()[1]
        options = f'options = {{ host = "127.0.0.1", port = {port} }}'
        bus = f'interface = "socketcand"\nchannel = "can0"\n{options}'
        told = FILE.replace('interface = "virtual"\nchannel = "try"', bus)
        (folder / "fleet.toml").write_text(told)
        code, out, _ = end(begin(folder, "fleet.toml", "--slot", "2", "--check"))
        assert code == 2 and f"no socketcand server answers at 127.0.0.1:{port}" in out
        robot = begin(folder, "fleet.toml", "--slot", "2", "--first-boot")
        assert robot.stderr is not None
        lines = iter(robot.stderr.readline, "")
        told = next(line for line in lines if "waits for its bus" in line)
        assert str(port) in told and "Ctrl-C" in told
        robot.send_signal(signal.SIGINT)
        assert end(robot)[0] in (0, 130)


@pytest.mark.slow
def test_figures_and_viewers_are_served_beside_the_robot_and_end_with_it(folder: Path) -> None:
    """Also where it is killed: nobody then closes the process that serves."""
    pytest.importorskip("prometheus_client", reason="the extra `metrics` is not installed")
    pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
    group = f"239.74.163.{1 + randbelow(250)}"
    words = ("fleet.toml", "--slot", "0", "-i", "udp_multicast", "-c", group, "--first-boot")
    robot = begin(folder, *words, "--metrics", "0", "--foxglove", "0")
    try:
        assert robot.stdout is not None
        said: dict[str, str] = {}
        while {"metrics", "foxglove"} - set(said):
            name, _, rest = robot.stdout.readline().strip().partition(": ")
            assert rest or name == "robot 0 is up", "it ended before it served"
            said[name] = rest
        wanted = (
            'headland_robot_process_up{robot="0"} 1.0',
            'headland_robot_state{robot="0",state="IDLE"}',
        )
        ends_at_s, page = time.monotonic() + LIMIT_S, ""
        while not all(line in page for line in wanted):
            assert time.monotonic() < ends_at_s, page
            with urlopen(said["metrics"], timeout=LIMIT_S) as answer:
                page = answer.read().decode()
        with connect(said["foxglove"], subprotocols=[Subprotocol("foxglove.sdk.v1")]) as viewer:
            topics: set[str] = set()
            while not topics >= {"/tf", "/fleet", "/can/HEARTBEAT"}:
                told = json.loads(viewer.recv(timeout=LIMIT_S))
                topics |= {channel["topic"] for channel in told.get("channels", ())}
    finally:
        robot.kill()
    robot.communicate(timeout=LIMIT_S)  # the process beside it holds the pipes until it ends
    with pytest.raises(OSError):
        urlopen(said["metrics"], timeout=LIMIT_S)


def test_a_port_that_is_taken_is_said_before_the_robot_starts(folder: Path) -> None:
    pytest.importorskip("prometheus_client", reason="the extra `metrics` is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        code, _, err = end(begin(folder, "fleet.toml", "--slot", "0", "--metrics", port))
    assert code == 2 and f"--metrics {port}: Address already in use" in err
    assert list(folder.glob("*.sqlite")) == []


def test_check_states_the_limits_of_this_body(folder: Path) -> None:
    """2.5 m/s for 0.15 s, and 2.08 m of braking with 1.5 m/s2."""
    code, out, _ = end(begin(folder, "fleet.toml", "--slot", "1", "--check", "--json"))
    (said,) = (each["found"] for each in json.loads(out)["findings"] if each["what"] == "limits")
    assert code == 0 and "for 0.1 s" in said and "from 2.5 m/s it stands after 2.5 m" in said
