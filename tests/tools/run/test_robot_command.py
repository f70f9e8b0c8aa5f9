"""`headland robot` as a person calls it: what is missing, what runs, and nothing of the simulator."""

import gc
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
from typer.testing import CliRunner
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from agent.interface.effects import Persist
from agent.runtime.robot_body import RobotBody, named
from agent.runtime.robot_file import Changes, RobotFile
from agent.runtime.robot_work import work_of
from agent.runtime.sqlite_journal import SqliteJournal
from tests.tools.launching import ENVIRONMENT, ROOT
from tools.build.kernel_cache import is_kept
from tools.build.warmup import rehearse
from tools.cli.robot_commands import app
from tools.run import robot_check
from tools.run.needed_kernels import NEEDED, TURNS
from tools.run.robot_command import is_written, robot

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
        ((), "robot: is missing; say which robot of the fleet this machine is: --slot"),
        (("--check",), "robot: is missing; say which robot of the fleet this machine is: --slot"),
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


def test_a_start_that_failed_leaves_no_memory(tmp_path: Path) -> None:
    """`--check` said that there is one, and the next start without --first-boot did not say why it stays
    stopped."""
    journal, _ = SqliteJournal.opened(tmp_path / "robot0.sqlite")
    journal.close()
    assert (tmp_path / "robot0.sqlite").exists() and not is_written(tmp_path / "robot0.sqlite")
    journal, _ = SqliteJournal.opened(tmp_path / "robot0.sqlite")
    journal.write([Persist("place", b"\0")])
    journal.close()
    assert is_written(tmp_path / "robot0.sqlite")


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


MINE = """from agent.interface.observation import Observation
from agent.runtime.robot_body import StandingBody
class Mine(StandingBody):
"""


MULTICAST = 'interface = "udp_multicast"\nchannel = '


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("", '[body]\nfactory = "my_rover"', "body.factory: 'my_rover' is not MODULE:CLASS"),
        ("", '[body]\nfactory = "json:"', "body.factory: 'json:' is not MODULE:CLASS"),
        ("", '[body]\nfactory = "pathlib:Path"', "'pathlib:Path' makes no RobotBody"),
        (
            "", '[body]\nplugin = "standing"\noptions = { x_n = 1.0 }',
            "robot 2: body.options: 'agent.runtime.robot_body:StandingBody' takes no option 'x_n'; "
            "did you mean 'x_m'?",
        ),
        ("x_m = 5.0", "x_n = 5.0", "robot 2: body_options: "),
        (
            'interface = "virtual"\nchannel = "try"', f'{MULTICAST}"10.1.1.1"',
            "robot 2: bus.channel: '10.1.1.1' is no multicast address, as 239.74.163.2 is",
        ),
        (
            'interface = "virtual"\nchannel = "try"',
            f'{MULTICAST}"239.74.163.2"\noptions = {{ hop_limit = "x" }}',
            "bus: cannot open udp_multicast 239.74.163.2: ",
        ),
    ],
)  # fmt: skip
def test_a_wrong_word_of_the_file_is_one_line(
    old: str, new: str, said: str, folder: Path, capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Some were the words of Python, and python-can added that a bus was not shut down."""
    text = FILE.replace(old, new) if old else f"{FILE}{new}\n"
    (folder / "fleet.toml").write_text(text)
    assert robot(folder / "fleet.toml", Changes(slot=2), first_boot=True, dry=False) == 2
    gc.collect()
    err = capfd.readouterr().err
    lines = [line for line in err.splitlines() if "does not see people" not in line]
    assert [line for line in lines if "NO KEYS" not in line and said not in line] == [], err
    assert sum(said in line for line in lines) == 1, err


def test_python_can_says_nothing_of_a_bus_that_could_not_be_opened(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bus = f'{MULTICAST}"239.74.163.2"\noptions = {{ hop_limit = "x" }}'
    text = FILE.replace('interface = "virtual"\nchannel = "try"', bus)
    (folder / "fleet.toml").write_text(text)
    assert robot(folder / "fleet.toml", Changes(slot=2), first_boot=True, dry=False) == 2
    gc.collect()
    assert "shut down" not in caplog.text


def test_an_empty_body_is_told_plainly(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It was `body: value error, a body has ...`."""
    (folder / "fleet.toml").write_text(FILE + "[body]\n")
    assert robot(folder / "fleet.toml", Changes(slot=2), first_boot=True, dry=False) == 2
    assert "fleet.toml: body: a body has either plugin or factory" in capsys.readouterr().err


def test_check_says_once_that_the_field_is_missing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = checked(folder, FILE + '[field]\nfile = "gone.geojson"\n', capsys)
    assert code == 2 and found["work"][0] is False and "gone.geojson" in found["work"][1]
    assert "body" not in found


@pytest.mark.parametrize(
    ("fleet", "noted"),
    [
        ('drive = "differential"\nradius_m = 0.1\ntrack_m = 1.0', True),
        ('drive = "differential"\nradius_m = 0.5\ntrack_m = 1.0', False),
        ('drive = "mecanum"\nradius_m = 0.1\ntrack_m = 1.0', False),
    ],
)
def test_check_notes_a_hull_that_is_narrower_than_the_wheels(
    fleet: str, noted: bool, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = checked(folder, FILE.replace("robots = 3", f"robots = 3\n{fleet}"), capsys)
    assert code == 0 and ("hull" in found) == noted


@pytest.mark.parametrize("command", ["body-check standing", "machine"])
@pytest.mark.parametrize(
    ("origin", "wanted"),
    [("52,500", "-90 to 90"), ("91,5", "-90 to 90"), ("nan,5", "finite")],
)
def test_an_origin_that_is_no_place_on_earth_is_refused(
    command: str, origin: str, wanted: str
) -> None:
    result = CliRunner().invoke(app, [*command.split(), "--origin", origin])
    assert result.exit_code == 2 and wanted in result.output


@pytest.mark.parametrize("dry", [False, True])
@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("def broken(:", 2, "body.factory: 'mine:Mine' cannot be imported: SyntaxError: "),
        ("raise KeyError('no')", 2, "cannot be imported: KeyError: 'no' (mine.py:1)"),
        (
            MINE + "    def __init__(self, slot):\n        {}['port']\n", 2,
            "body.factory: 'mine:Mine' raised KeyError: 'port' (mine.py:5)",
        ),
        (
            MINE + "    def __init__(self, slot):\n        None + 1\n", 2,
            "'mine:Mine': TypeError: unsupported operand type(s) for +: 'NoneType' and 'int' (mine.py:5)",
        ),
        (
            MINE + "    async def open(self):\n        {}['port']\n", 1,
            "body: open raised KeyError: 'port' (mine.py:5)",
        ),
        (
            MINE + "    def sense(self, now_us):\n        import json; json.loads(3)\n", 1,
            "body: sense raised TypeError: the JSON object must be str, bytes or bytearray, not int "
            "(mine.py:5)",
        ),
        (
            MINE + "    def sense(self, now_us):\n        return 1.0, 2.0, 0.0\n", 1,
            "body: sense returned no Observation but tuple (mine.py:4)",
        ),
        (
            MINE + "    def drive(self, command, now_us):\n        {}['port']\n", 1,
            "body: drive raised KeyError: 'port' (mine.py:5)",
        ),
    ],
)  # fmt: skip
def test_a_fault_of_a_driver_is_one_line_that_says_where(
    text: str, code: int, said: str, dry: bool, folder: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """It was a traceback, and the exit code was 1 for what a person has to mend."""
    (folder / "mine.py").write_text(text)
    (folder / "fleet.toml").write_text(FILE + '[body]\nfactory = "mine:Mine"\n')
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    assert robot(folder / "fleet.toml", Changes(slot=0), first_boot=True, dry=dry) == code
    lines = [line for line in capsys.readouterr().err.splitlines() if "robot 0: body" in line]
    assert len(lines) == 1 and said in lines[0], lines
    _, found = checked(folder, (folder / "fleet.toml").read_text(), capsys)
    if "def drive" not in text:  # a check drives nothing
        assert found["body"][0] is False and said in found["body"][1]


def test_the_traceback_of_a_driver_is_told_with_v(folder: Path) -> None:
    (folder / "mine.py").write_text(MINE + "    async def open(self):\n        {}['port']\n")
    (folder / "fleet.toml").write_text(FILE + '[body]\nfactory = "mine:Mine"\n')
    words = ("fleet.toml", "--slot", "0", "--first-boot")
    for more, told in ((), False), (("-v",), True):
        code, _, err = end(begin(folder, *words, *more))
        assert code == 1 and ("Traceback" in err and "{}['port']" in err) == told, err
        assert err.count("headland: robot 0: body: open raised KeyError: 'port' (mine.py:5)") == 1


def test_the_log_of_a_launch_keeps_the_traceback_of_its_body(folder: Path) -> None:
    (folder / "mine.py").write_text(MINE + "    async def open(self):\n        {}['port']\n")
    order = {
        "first_boot": True,
        "robot": {
            "name": "try", "fleet": {"robots": 1}, "body": {"factory": "mine:Mine"},
            "robot": {"slot": 0, "journal": str(folder)},
        },
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "tools.run.robot"], input=json.dumps(order) + "\n", cwd=folder,
        env={**ENVIRONMENT, "PYTHONPATH": f"{folder}:{ROOT}"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1 and "Traceback" in done.stderr, done.stderr
    assert "DriverError: robot 0: body: open raised KeyError: 'port' (mine.py:5)" in done.stderr


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
        waits = begin(folder, "fleet.toml", "--slot", "2", "--first-boot")
        assert waits.stderr is not None
        lines = iter(waits.stderr.readline, "")
        told = next(line for line in lines if "waits for its bus" in line)
        assert str(port) in told and "Ctrl-C" in told
        waits.send_signal(signal.SIGINT)
        assert end(waits)[0] in (0, 130)


@pytest.mark.slow
def test_figures_and_viewers_are_served_beside_the_robot_and_end_with_it(folder: Path) -> None:
    """Also where it is killed: nobody then closes the process that serves."""
    pytest.importorskip("prometheus_client", reason="the extra `metrics` is not installed")
    pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
    group = f"239.74.163.{1 + randbelow(250)}"
    words = ("fleet.toml", "--slot", "0", "-i", "udp_multicast", "-c", group, "--first-boot")
    serving = begin(folder, *words, "--metrics", "0", "--foxglove", "0")
    try:
        assert serving.stdout is not None
        said: dict[str, str] = {}
        while {"metrics", "foxglove"} - set(said):
            name, _, rest = serving.stdout.readline().strip().partition(": ")
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
        serving.kill()
    serving.communicate(timeout=LIMIT_S)  # the process beside it holds the pipes until it ends
    with pytest.raises(OSError):
        urlopen(said["metrics"], timeout=LIMIT_S)


def test_a_port_that_is_taken_is_said_before_the_robot_starts(folder: Path) -> None:
    pytest.importorskip("prometheus_client", reason="the extra `metrics` is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        code, _, err = end(begin(folder, "fleet.toml", "--slot", "0", "--metrics", port))
    assert code == 2 and f"--metrics {port}: Address already in use" in err
    assert list(folder.glob("*.sqlite")) == []


def test_check_says_that_a_port_of_viewers_is_taken(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It said `ready`, and the robot ended with code 2."""
    pytest.importorskip("prometheus_client", reason="the extra `metrics` is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        code = robot_check.check(folder / "fleet.toml", Changes(slot=0), True, metrics=port)
    found = {each["what"]: each for each in json.loads(capsys.readouterr().out)["findings"]}
    assert code == 2 and found["viewers"]["ok"] is False and port in found["viewers"]["found"]


FIELD = """{"type": "Feature", "properties": {"name": "yard"}, "geometry": {"type": "Polygon",
"coordinates": [[[5.0, 52.0], [5.001, 52.0], [5.001, 52.001], [5.0, 52.001], [5.0, 52.0]]]}}"""
LATE = """
from agent.runtime.robot_body import StandingBody
class Late(StandingBody):
    def __init__(self, slot, late_for_us=0, accuracy_m=0.0, none=False):
        super().__init__(slot)
        self.none = none
        self.late_for_us, self.accuracy_m = late_for_us, accuracy_m
    def sense(self, now_us):
        seen = super().sense(now_us)
        return seen._replace(
            sensed_at_us=now_us - self.late_for_us, position_accuracy_m=self.accuracy_m,
            x_m=float("nan") if self.none else seen.x_m,
        )
"""


def checked(
    folder: Path, text: str, capsys: pytest.CaptureFixture[str], slot: int = 0
) -> tuple[int, dict[str, tuple[bool | None, str]]]:
    """The exit code of the check of a file, and each finding: whether it is well, and its text."""
    (folder / "checked.toml").write_text(text)
    code = robot_check.check(folder / "checked.toml", Changes(slot=slot), True)
    said = json.loads(capsys.readouterr().out)
    return code, {each["what"]: (each["ok"], each["found"]) for each in said["findings"]}


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ('plugin = "standing"\noptions = { x_m = 500.0 }', "m outside its field"),
        ('factory = "late_body:Late"\noptions = { none = true }', "not a number"),
        ('factory = "late_body:Late"\noptions = { late_for_us = -456000 }', "in the future"),
        ('factory = "late_body:Late"\noptions = { late_for_us = 456000 }', ": sensed 456 ms ago"),
        (
            'factory = "late_body:Late"\noptions = { late_for_us = 0, accuracy_m = 0.4 }',
            "accurate to 0.40 m, needed",
        ),
    ],
)
def test_a_place_by_which_the_robot_would_not_drive_is_not_ready(
    body: str, wrong: str, folder: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """All of them were `ready`."""
    monkeypatch.setattr(robot_check, "FIRST_PLACE_FOR_US", 0)
    (folder / "late_body.py").write_text(LATE)
    (folder / "yard.geojson").write_text(FIELD)
    text = f'{FILE}[field]\nfile = "yard.geojson"\n[body]\n'
    code, found = checked(folder, text + body, capsys)
    assert code == 2 and found["place"][0] is False and wrong in found["place"][1], found
    code, found = checked(folder, text + 'plugin = "standing"', capsys)
    assert code == 0 and found["place"][0] is True, found


def test_check_notes_what_the_file_leaves_out(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = checked(folder, FILE, capsys)
    assert code == 0
    assert found["body"][0] is None and "no [body] is declared" in found["body"][1]
    assert found["slot"] == (None, "no [[machine]] of slot 0: body and bus are the fleet's")
    _, found = checked(folder, FILE, capsys, slot=2)
    assert found["body"] == (True, "standing") and "slot" not in found


@pytest.mark.parametrize(("robots", "ok"), [(1, None), (3, True)])
def test_check_notes_that_a_robot_alone_stands_where_no_frame_is_confirmed(
    robots: int, ok: bool | None, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = f'interface = "udp_multicast"\nchannel = "239.74.163.{1 + randbelow(250)}"'
    text = FILE.split("[[machine]]")[0].replace("robots = 3", f"robots = {robots}")
    code, found = checked(
        folder, text.replace('interface = "virtual"\nchannel = "try"', bus), capsys
    )
    assert code == 0 and found["bus"][0] is ok, found
    assert ("UNHEARD" in found["bus"][1]) == (robots == 1)


def test_check_says_that_the_disk_of_the_memory_is_full(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_check, "MEMORY_FREE_BYTES", 1 << 62)
    code, found = checked(folder, FILE, capsys)
    assert code == 2 and found["memory"][0] is False and "is full" in found["memory"][1], found


@pytest.mark.parametrize(
    ("journal", "said"),
    [
        ("state", "there is no folder {}: make it (mkdir -p {})"),
        ("fleet.toml", "{} is no folder"),
        ("/proc", "the folder /proc cannot be written"),
    ],
)
def test_a_memory_that_cannot_be_kept_is_one_line(
    journal: str, said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder that was not there got a line on --first-boot and then one on its journal. Of one that
    cannot be written the check said that its disk is full."""
    if journal == "/proc" and not Path(journal).is_dir():
        pytest.skip("no /proc on this system")
    place = folder / journal
    text = f'{FILE}[robot]\nslot = 0\njournal = "{journal}"\n'
    (folder / "kept.toml").write_text(text)
    code = robot(folder / "kept.toml", Changes(slot=0), first_boot=False, dry=False)
    lines = capsys.readouterr().err.splitlines()
    wrong = said.replace("{}", str(place))
    assert code == 2 and len(lines) == 1
    assert lines[0].startswith(f"headland: robot 0: robot.journal: {wrong}"), lines
    code, found = checked(folder, text, capsys)
    assert code == 2 and found["memory"][0] is False and found["memory"][1].startswith(wrong)


KERNELS = """
from pathlib import Path
import numpy as np
from agent.mapf.linear_assignment import assigned
from agent.runtime.robot_file import Changes, RobotFile
from tools.run import robot_check
from tools.run.needed_kernels import TURNS, missing_kernels
from tools.run.robot_command import lacks_kernels
works = RobotFile.read(Path("field.toml"), Changes(slot=0))
assert lacks_kernels(works)
assert not lacks_kernels(RobotFile.read(Path("member.toml"), Changes(slot=0)))
assert not set(TURNS) & set(missing_kernels(works)), "a mecanum body plans no turns"
steers = works.model_copy(update={"fleet": works.fleet.model_copy(update={"drive": "ackermann"})})
assert set(TURNS) < set(missing_kernels(steers))
assigned(np.ones((2, 3)))
assert list(Path("cache").rglob("*.nbi")), "one kernel is compiled"
assert lacks_kernels(works), "and the others are not"
(note,) = robot_check.kernels(works)
assert note.ok is None and "compiling kernels" in note.found
"""


def test_a_robot_says_that_it_has_to_compile_kernels_first(folder: Path) -> None:
    """It was silent as soon as the cache had any kernel, also one of other work."""
    pytest.importorskip("numba", reason="the extra `robot` is not installed")
    (folder / "yard.geojson").write_text(FIELD)
    (folder / "field.toml").write_text(f'{FILE}[field]\nfile = "yard.geojson"\n')
    (folder / "member.toml").write_text(FILE)
    environment = {**ENVIRONMENT, "NUMBA_CACHE_DIR": str(folder / "cache"), "HEADLAND_NUMBA": "1"}
    subprocess.run([sys.executable, "-c", KERNELS], cwd=folder, env=environment, check=True)


def test_check_judges_kernels_before_it_compiles_some(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It never said that kernels are missing: the look at the work had compiled six."""
    order: list[str] = []

    def lacks(declared: RobotFile) -> bool:
        order.append("kernels")
        return True

    def work(*given: Any) -> Any:
        order.append("work")
        return work_of(*given)

    monkeypatch.setattr(robot_check, "lacks_kernels", lacks)
    monkeypatch.setattr(robot_check, "work_of", work)
    _, found = checked(folder, FILE, capsys)
    assert order[0] == "kernels" and "work" in order and "kernels" in found


@pytest.mark.slow
def test_nothing_is_missing_where_all_kernels_are_compiled() -> None:
    """`headland compile --kernels` runs these rehearsals."""
    rehearse()
    names = {name for each in NEEDED.values() for name in each} | {*TURNS}
    assert [name for name in sorted(names) if not is_kept(named(name))] == []


def test_check_states_the_limits_of_this_body(folder: Path) -> None:
    """2.5 m/s for 0.15 s, and 2.08 m of braking with 1.5 m/s2."""
    code, out, _ = end(begin(folder, "fleet.toml", "--slot", "1", "--check", "--json"))
    (said,) = (each["found"] for each in json.loads(out)["findings"] if each["what"] == "limits")
    assert code == 0 and "for 0.1 s" in said and "from 2.5 m/s it stands after 2.5 m" in said


def test_a_robot_that_runs_is_not_ready_and_its_devices_are_left_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was "ready", and the check told the wheels of the robot that drove to stand."""
    touched: list[str] = []

    async def opened(robot: RobotFile, *, dry: bool) -> RobotBody:
        touched.append("body")
        raise OSError

    monkeypatch.setattr(robot_check, "opened_body", opened)
    path, file = folder / "robot0.sqlite", folder / "fleet.toml"
    running = SqliteJournal(path)
    running.write([Persist("kept", b"1")])
    assert robot_check.check(file, Changes(slot=0), False) == 2 and touched == []
    said = capsys.readouterr().out
    assert "this robot may already run" in said.replace("\n", " ") and "not ready: memory" in said
    running.close()
    robot_check.check(file, Changes(slot=0), False)
    assert touched == ["body"] and "already run" not in capsys.readouterr().out
    again, recalled = SqliteJournal.opened(path)
    again.close()
    assert recalled == {"kept": b"1"}
