"""Robots run as processes with nothing of the simulator, and a robot file is refused in one line."""

import asyncio
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import pytest

from agent.interface.effects import GatedDrive
from agent.interface.observation import Observation
from agent.runtime import robot_process
from agent.runtime.peer_factory import NO_MISSION, MissionParts
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_body import DeclaredMachine, RobotBody
from agent.runtime.robot_file import AbsentError, Changes, RobotBusTable, RobotError, RobotFile
from agent.runtime.robot_process import opened_bus, run_robot
from agent.runtime.robot_work import work_of
from protocol.name import Name, fleet_name
from tests.multicast import reached
from tools.build.warmup import warm

SCRIPT, LIMIT_S = Path(__file__).with_name("robots_without_simulator.py"), 150
DEGREE_M = 111_320.0  # on the equator, where the field lies
MULTICAST = "239.74.163.11"


def field(folder: Path, half_x_m: float = 8.0, half_y_m: float = 6.0) -> None:
    x, y = half_x_m / DEGREE_M, half_y_m / DEGREE_M
    ring = [[-x, -y], [x, -y], [x, y], [-x, y], [-x, -y]]
    (folder / "tiny.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))


def begun(folder: Path, interface: str, channel: str, robots: int, *slots: int) -> Any:
    words = [str(folder), interface, channel, str(robots), *map(str, slots)]
    return subprocess.Popen(
        [sys.executable, "-P", str(SCRIPT), *words], stdout=subprocess.PIPE, text=True
    )


def ended(process: "subprocess.Popen[str]") -> dict[str, Any]:
    said, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, said
    found: dict[str, Any] = json.loads(said)
    return found


@pytest.fixture(scope="module")
def kernels() -> None:
    """Real time begins with the first frame, so kernels are compiled before."""
    warm(False)


@pytest.mark.slow
@pytest.mark.usefixtures("kernels")
def test_robots_on_a_virtual_bus_work_a_field_without_the_simulator(tmp_path: Path) -> None:
    field(tmp_path)
    found = ended(begun(tmp_path, "virtual", "tiny", 3, 0, 1, 2))
    assert found["foreign"] == []
    assert len(set(found["addresses"])) == 3 and None not in found["addresses"]
    assert found["members"] == [3, 3, 3]
    assert len(set(found["done"])) == 1 and found["done"][0] >= 1
    assert len(list(tmp_path.glob("robot*.sqlite"))) == 3


@pytest.fixture
def multicast() -> str:
    """A channel of datagrams that reach this machine itself."""
    return reached(MULTICAST)


@pytest.mark.slow
@pytest.mark.usefixtures("kernels")
def test_robots_in_processes_of_their_own_work_a_field(tmp_path: Path, multicast: str) -> None:
    field(tmp_path)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        field(tmp_path / folder)
    processes = [
        begun(tmp_path / folder, "udp_multicast", multicast, 2, slot)
        for slot, folder in enumerate(("a", "b"))
    ]
    try:
        first, second = map(ended, processes)
    finally:
        for process in processes:
            process.kill()
    assert first["foreign"] == second["foreign"] == []
    assert first["addresses"] != second["addresses"]
    assert first["done"] == second["done"]


GOOD: dict[str, Any] = {"name": "n", "robot": {"slot": 0}, "fleet": {"robots": 2}}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"robot": {"slot": 2}}, "robot.slot: 2 is not one of 2 robots"),
        ({"machine": [{"slot": 5}]}, "machine: slot 5 is not one of 2 robots (0 to 1)"),
        (
            {"robot": {"slot": 0, "jurnal": "x"}},
            "robot.jurnal: unknown key; did you mean 'journal'",
        ),
        ({"robot": {"slot": 0, "segment": 40_000}}, "robot.segment: "),
        ({"fleet": {"robots": 0}}, "fleet.robots: "),
        ({"fleet": {"speed_m_s": 1.0}}, "fleet.robots: is missing"),
        ({"field": {"file": "f"}, "mission": {"factory": "a:b"}}, "a robot has one work"),
        ({"name": ""}, "name: "),
        ({"device": {"device_class": 128}}, "device.device_class: "),
        ({"device": {"function": 129}}, "function 129 is that of operators' tools"),
        (
            {"robot": {"slot": 0, "segment": 1}, "device": {"manufacturer": 5}},
            "gateways of several segments know the default only",
        ),
    ],
)
def test_a_wrong_robot_file_is_one_line(change: dict[str, Any], says: str) -> None:
    with pytest.raises(RobotError) as problem:
        RobotFile.of({**GOOD, **change}, "r.toml", Path())
    assert says in str(problem.value) and "\n" not in str(problem.value)


def test_the_options_of_a_bus_are_not_those_of_another_interface() -> None:
    """The port of a hub became that of a multicast group, where no stop of an operator was heard."""
    options = {"host": "127.0.0.1", "port": 29636}
    bus = {"interface": "socketcand", "options": options}
    robot = RobotFile.of({**GOOD, "bus": bus}, "r.toml", Path())
    other = robot.changed(Changes(interface="udp_multicast", channel="239.74.163.2")).bus
    assert (other.interface, other.channel, other.options) == ("udp_multicast", "239.74.163.2", {})
    assert robot.changed(Changes(interface="socketcand", channel="can1")).bus.options == options


def test_a_hub_without_an_address_is_told_plainly() -> None:
    """The line ended with 'host'."""
    with pytest.raises(RobotError, match=r"bus\.options: socketcand needs host"):
        asyncio.run(opened_bus(RobotBusTable(interface="socketcand"), 0))


@pytest.mark.parametrize(
    ("host", "port", "said"),
    [
        ("127.0.0.1", 99999, "99999 is no port"),
        ("127.0.0.1", 0, "0 is no port"),
        ("127.0.0.1", "abc", "invalid literal"),
        ("robot..local", 29536, r"'robot\.\.local' is no name of a computer"),
        ("", 29536, "'' is no name of a computer"),
    ],
)
def test_a_server_that_can_never_answer_is_for_a_person_to_mend(
    host: str, port: object, said: str
) -> None:
    """A robot waited for its bus for ever, because the task that connects had ended."""
    table = RobotBusTable(interface="socketcand", options={"host": host, "port": port})
    with pytest.raises(RobotError, match=said) as raised:
        asyncio.run(opened_bus(table, 0, answer_for_s=0.5))
    assert raised.value.code == 2


def test_a_robot_file_without_its_fleet_is_refused() -> None:
    alone = {key: value for key, value in GOOD.items() if key != "fleet"}
    with pytest.raises(RobotError, match="fleet: is missing"):
        RobotFile.of(alone, "r.toml", Path())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[body]\nfactory = "nowhere:Body"', "body.factory: 'nowhere:Body' cannot be imported"),
        ('[body]\nfactory = "random:Random"', "body.factory: 'random:Random' makes no RobotBody"),
        ('[field]\nfile = "none.geojson"', "field.file: "),
        ('[mission]\nfactory = "pathlib:Path"', "mission.factory: "),
        ('[bus]\ninterface = "none"', "bus: cannot open none can0"),
    ],
)
def test_a_robot_that_cannot_start_says_so_in_one_line(
    text: str, says: str, tmp_path: Path
) -> None:
    bus = "" if "[bus]" in text else '[bus]\ninterface = "virtual"\n'
    path = tmp_path / "robot.toml"
    path.write_text(f'name = "n"\n[robot]\nslot = 0\n[fleet]\nrobots = 2\n{bus}{text}\n')
    done = subprocess.run(
        [sys.executable, "-P", "-m", "agent.runtime.robot_process", str(path)],
        capture_output=True, text=True, check=False, timeout=LIMIT_S,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert says in done.stderr and done.stderr.count("\n") == 1, done.stderr


def with_rows(slot: int, robots: int, now_us: int, rows: int) -> MissionParts:
    if rows < 1:
        raise ValueError(f"rows = {rows}: one row or more")
    return NO_MISSION


def test_a_mission_that_refuses_its_options_says_so_in_one_line() -> None:
    """A ValueError of its factory was a traceback."""
    mission = {"factory": f"{__name__}:with_rows", "options": {"rows": 0}}
    robot = RobotFile.of({**GOOD, "mission": mission}, "r.toml", Path())
    with pytest.raises(RobotError) as problem:
        work_of(robot, 0, {})
    assert str(problem.value).endswith("with_rows': rows = 0: one row or more")


def test_the_name_of_a_robot_is_that_of_its_file() -> None:
    """The default is an honest utility vehicle; on commit d1aa422d every robot was a tractor."""
    plain = fleet_name("n", 0, RobotFile.of(GOOD, "r.toml", Path()).device.fields)
    assert (plain.manufacturer, plain.device_class, plain.function) == (1407, 24, 128)
    device = {"manufacturer": 555, "device_class": 6, "function": 132, "function_instance": 3,
              "ecu_instance": 2, "device_class_instance": 1}  # fmt: skip
    told = RobotFile.of({**GOOD, "device": device}, "r.toml", Path())
    name = Name.unpack(fleet_name("n", 0, told.device.fields).pack())
    assert {field: getattr(name, field) for field in device} == device
    assert (name.identity, name.industry_group) == (plain.identity, 2)


class Unplugged(RobotBody):
    """Its serial adapter is pulled out while the robot runs."""

    def __init__(self, slot: int) -> None:
        self.asked = 0

    def declare(self, machine: DeclaredMachine) -> None:
        pass

    async def open(self) -> None:
        pass

    def sense(self, now_us: int) -> Observation | None:
        self.asked += 1
        if self.asked > 3:
            raise OSError("device disconnected")
        return Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_driver_that_loses_its_device_ends_a_robot_that_may_be_restarted(tmp_path: Path) -> None:
    """It ended with the code at which a supervisor does not restart it."""
    robot = RobotFile.of(
        {
            "name": "n", "robot": {"slot": 0, "journal": str(tmp_path)},
            "fleet": {"robots": 1, "radius_m": 0.3, "speed_m_s": 1.0},
            "coverage": {"map": "@@@@\n@..@\n@..@\n@@@@", "cell_m": 2.0},
            "bus": {"interface": "virtual", "channel": "unplugged"},
            "body": {"factory": f"{__name__}:Unplugged"},
        },
        "r.toml", tmp_path,
    )  # fmt: skip

    async def run() -> None:
        async with asyncio.timeout(LIMIT_S):
            await run_robot(robot, asyncio.Event(), first_boot=True)

    with pytest.raises(AbsentError, match="robot 0: body: sense: device disconnected"):
        asyncio.run(run())


@pytest.mark.parametrize("dry", [False, True])
def test_a_robot_that_is_not_driven_does_no_work(dry: bool, tmp_path: Path) -> None:
    """It claimed a section, and took its place for frozen. The next start stood until a person came."""
    field(tmp_path, 20.0, 15.0)
    document = {
        "name": "n", "robot": {"slot": 0, "journal": str(tmp_path)}, "fleet": {"robots": 1},
        "field": {"file": "tiny.geojson", "implement_width_m": 4.0},
        "bus": {"interface": "virtual", "channel": f"dry {dry}"}, "body": {"plugin": "standing"},
    }  # fmt: skip
    robot, runners = RobotFile.of(document, "r.toml", tmp_path), list[PeerRunner]()

    async def run() -> None:
        end = asyncio.Event()

        def started(runner: PeerRunner) -> None:
            runners.append(runner)
            end.set()

        async with asyncio.timeout(LIMIT_S):
            await run_robot(robot, end, first_boot=True, dry=dry, started=started)

    asyncio.run(run())
    (runner,) = runners
    assert (runner.peer.mission is None) == dry and (runner.peer.motion is None) == dry


class NotThere(Unplugged):
    """Its device does not answer."""

    waits: ClassVar[asyncio.Event]
    closed = False

    async def open(self) -> None:
        self.waits.set()
        await asyncio.Event().wait()

    def close(self) -> None:
        type(self).closed = True


def test_a_robot_that_waits_for_its_body_ends_when_it_is_told_to(tmp_path: Path) -> None:
    """Ctrl-C and SIGTERM did nothing until `open` of the driver returned, perhaps never."""
    document = {
        "name": "n", "robot": {"slot": 0, "journal": str(tmp_path)}, "fleet": {"robots": 1},
        "bus": {"interface": "virtual", "channel": "not-there"},
        "body": {"factory": f"{__name__}:NotThere"},
    }  # fmt: skip

    async def run() -> None:
        end, NotThere.waits = asyncio.Event(), asyncio.Event()
        running = asyncio.create_task(
            run_robot(RobotFile.of(document, "r.toml", tmp_path), end, first_boot=True)
        )
        async with asyncio.timeout(LIMIT_S):
            await NotThere.waits.wait()
            end.set()
            await running

    asyncio.run(run())
    assert NotThere.closed


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGHUP")
def test_a_terminal_that_is_closed_ends_a_robot_with_its_farewell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the command line the signal killed the process, and the fleet stood for a silent member."""

    async def told_to_end(robot: RobotFile, end: asyncio.Event, **_: Any) -> None:
        assert signal.getsignal(signal.SIGHUP) != signal.SIG_DFL, "it kills the process"
        signal.raise_signal(signal.SIGHUP)
        async with asyncio.timeout(LIMIT_S):
            await end.wait()

    monkeypatch.setattr(robot_process, "run_robot", told_to_end)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        asyncio.run(robot_process.until_told(RobotFile.of(GOOD, "r.toml", Path())))
    finally:
        signal.signal(signal.SIGHUP, before)
