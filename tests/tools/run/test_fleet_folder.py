"""A launch that was killed is continued: journals, stops, work and logs of the fleet are kept."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from math import cos, sin
from pathlib import Path
from random import Random
from socket import socket

import can
import pytest

from agent.interface.config import S
from agent.interface.effects import Drive
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.work_frames import TaskClaim
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from sim.world.parcel_truth import Parcels
from sim.world.robot_body import SimulatedBody
from sim.world.world_memory import TRACK_DIGITS, WorldMemory
from tests.tools.complaint import Complaints
from tests.tools.launching import ENVIRONMENT, WAIT_S, call, robots_up, said, start, states
from tools.common.bus_address import CHANNEL
from tools.common.bus_attach import attach
from tools.common.run_folder import QUEUE, FolderError, folder_for
from tools.run import robot_lock
from tools.run.fleet_folder import FleetFolder, _put_away, begin_fleet, end_fleet, fleet_folder
from tools.run.launch import STRAIGHT_M

EPOCH_2020_S = 1_577_836_800
# Holds the locks of robots 2 and 11 of a folder until its input ends.
HOLDS = """
import sys; from pathlib import Path; from tools.run.robot_lock import hold
held = [hold(Path(sys.argv[1]), slot) for slot in (2, 11)]
print("held", flush=True); sys.stdin.read()
"""


@pytest.mark.slow
def test_e2_a_latched_fleet_stays_latched_after_kill_9_and_the_same_command(tmp_path: Path) -> None:
    async def story() -> None:
        launch = await start(tmp_path, "launch", "small", "--robots", "2")
        try:
            await robots_up(launch, 2)
            fleet = json.loads((tmp_path / "runs/launch/fleet.json").read_text())
            assert fleet["begun"] is True, "before any robot has a journal, too"
            code, text = await call(tmp_path, "estop", "--json")
            assert code == 0, text
        finally:
            launch.kill()
            await launch.wait()
        folder = (tmp_path / "runs/launch").resolve()
        first = (folder / "can.log").read_bytes()
        again = await start(tmp_path, "launch", "small", "--robots", "2")
        try:
            await said(again, r"(continuing the fleet in runs/small-1)")
            await said(again, r"(\d+/\d+ sections  0:EMERGENCY_STOP 1:EMERGENCY_STOP)")
            assert set((await states(tmp_path)).values()) == {"EMERGENCY_STOP"}
            assert (tmp_path / "runs/launch").resolve() == folder
            assert (tmp_path / "runs/latest").resolve() == folder
            kept = (folder / "launch-1" / "can.log").read_bytes()
            assert kept.startswith(first) and (folder / "launch-1" / "robot0.log").exists()
            code, text = await call(tmp_path, "reset", "--start", "--json")
            assert code == 0, text
            again.terminate()
            async with asyncio.timeout(WAIT_S):
                await again.wait()
        finally:
            if again.returncode is None:
                again.kill()
                await again.wait()
        report = json.loads((folder / "report.json").read_text())
        assert report["launches"] == 2 and not report["finished"]
        # A15: the time of day, on every topic.
        times = [m.timestamp for m in can.LogReader(folder / "can.log")]
        assert times and min(times) > EPOCH_2020_S
        await _mcap_has_one_clock(folder / "run.mcap", min(times))

    asyncio.run(story())


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(signal, "SIGSTOP"), reason="no process can be paused on this system"
)
def test_a_launch_waits_for_the_robots_of_a_killed_one(tmp_path: Path) -> None:
    """Found: their journals were still open, so that the new robots ended, and the launch went on."""

    async def story() -> None:
        launch = await start(tmp_path, "launch", "small", "--robots", "2")
        pids: list[int] = []
        try:
            pids = await robots_up(launch, 2)
            os.kill(pids[1], signal.SIGSTOP)
        finally:
            launch.kill()
            await launch.wait()
        try:
            again = await start(tmp_path, "launch", "small", "--robots", "2")
        except BaseException:
            os.kill(pids[1], signal.SIGKILL)
            raise
        try:
            await said(again, r"(waits for robots (0 )?1 of the launch before)")
            os.kill(pids[1], signal.SIGCONT)
            await robots_up(again, 2)
        finally:
            again.terminate()
            async with asyncio.timeout(WAIT_S):
                await again.wait()

    asyncio.run(story())


@pytest.mark.slow
def test_t3_a_launch_is_judged_by_the_ground_not_by_what_robots_say(tmp_path: Path) -> None:
    """DONE of every section, forged in the name of a robot, ends a launch: not with exit 0."""

    async def story() -> None:
        launch = await start(tmp_path, "launch", "small", "--robots", "2", "--no-keys")
        try:
            await robots_up(launch, 2)
            where = json.loads((tmp_path / "runs/launch/bus.json").read_text())
            bus = attach("socketcand", CHANNEL, 250_000, "127.0.0.1", where["port"])
            addresses: set[int] = set()
            bus.subscribe(lambda frame: addresses.add(frame.identifier & 0xFF))
            async with asyncio.timeout(WAIT_S):
                while launch.returncode is None:
                    for section in range(_setting().section_count):
                        for source in addresses & {128, 129}:
                            forged = TaskClaim(section, 0, int(Phase.DONE), 0, 60_000, source - 128)
                            bus.send(encode(forged, source))
                    await asyncio.wait({asyncio.ensure_future(launch.wait())}, timeout=0.2)
            bus.close()
            assert launch.stdout is not None
            text = (await launch.stdout.read()).decode()
        finally:
            if launch.returncode is None:
                launch.kill()
                await launch.wait()
        report = json.loads((tmp_path / "runs/launch/report.json").read_text())
        assert launch.returncode == 1, text
        assert report["finished"] and report["coverage"] < 0.9
        assert report["difference"].startswith("robots say 100 %, the ground says"), report
        assert report["difference"] in text

    asyncio.run(story())


async def _mcap_has_one_clock(path: Path, begun_s: float) -> None:
    """A15: no topic begins at 0, or in another clock."""
    reading = pytest.importorskip("mcap.reader", reason="the extra `operator` is not installed")
    with path.open("rb") as file:
        at_s = [m.log_time / 1e9 for _, _, m in reading.make_reader(file).iter_messages()]
    assert at_s and min(at_s) > begun_s - 60 and max(at_s) < begun_s + 600


def _setting(robots: int = 2) -> FieldSetup:
    return FieldSetup(load("small").changed(robots=robots))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_e2_a_launch_goes_on_until_its_work_is_done_or_it_is_told_otherwise(folder: Path) -> None:
    def begin(robots: int = 2, fresh: bool = False, out: Path | None = None) -> tuple[str, bool]:
        fleet = fleet_folder(out, _setting(robots), fresh)
        (fleet.folder / "robot0.sqlite").write_text("memory")
        (fleet.folder / "can.log").write_text(f"launch {fleet.launches}")
        _close(fleet)
        return str(fleet.folder), fleet.continues

    assert begin() == ("runs/small-1", False)
    assert begin() == ("runs/small-1", True)
    assert begin() == ("runs/small-1", True)
    assert Path("runs/small-1/launch-2/can.log").read_text() == "launch 2"
    assert begin(fresh=True) == ("runs/small-2", False)
    assert begin(robots=3) == ("runs/small-3", False), "another fleet"
    fleet = fleet_folder(None, _setting(3), False)
    assert fleet.continues
    end_fleet(fleet, _setting(3))
    _close(fleet)
    assert begin(robots=3) == ("runs/small-4", False), "its work was done"
    out = Path("mine")
    assert begin(out=out) == ("mine", False)
    (out / QUEUE).write_text("[]")
    assert begin(out=out) == ("mine", True)
    assert (out / QUEUE).exists(), "what an operator wants of a fleet outlives its launch"
    with pytest.raises(FolderError, match="--fresh"):
        begin(robots=3, out=out)
    assert begin(robots=3, fresh=True, out=out) == ("mine", False)
    assert (out / "launch-2" / "robot0.sqlite").exists(), "memory is put away, never deleted"
    assert not (out / QUEUE).exists() and (out / "launch-2" / QUEUE).exists(), "of the last fleet"
    with pytest.raises(FolderError, match="journals"), folder_for(out, "small"):
        pass


@pytest.mark.parametrize("left", [None, "", '{"fleet": "0123'])
def test_f5_a_fleet_whose_file_is_lost_is_not_replaced_in_silence(
    folder: Path, left: str | None
) -> None:
    """A latched fleet moved after a power cut had emptied this file: the same command began a new one."""
    first = fleet_folder(None, _setting(), False)
    _close(first)
    (first.folder / "robot0.sqlite").write_text("memory of a stop")
    file = first.folder / "fleet.json"
    file.unlink() if left is None else file.write_text(left)
    with pytest.raises(FolderError, match=r"runs/small-1 holds .*fleet\.json .*--fresh"):
        fleet_folder(None, _setting(), False)
    begun = fleet_folder(None, _setting(), True)
    _close(begun)
    assert begun.folder == Path("runs/small-2") and not begun.continues
    begin_fleet(begun, _setting())
    again = fleet_folder(None, _setting(), False)
    _close(again)
    assert again.folder == begun.folder and again.continues, "its robots may have moved"


def test_a_launch_that_was_refused_leaves_no_fleet_to_continue(folder: Path) -> None:
    """A port was taken. The next launch said that it continued a fleet, and robots that had never run
    waited for a person, because they had lost what they never wrote."""
    with socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        words = ["launch", "small", "--robots", "2", "--port", str(taken.getsockname()[1])]
        refused = subprocess.run(
            [sys.executable, "-m", "tools.cli.headland", *words],
            cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, timeout=WAIT_S,
        )  # fmt: skip
    assert refused.returncode not in (0, 1) and "in use" in refused.stderr, refused
    assert Path("runs/small-1/fleet.json").exists()
    first = fleet_folder(None, _setting(), False)
    assert first.folder == Path("runs/small-1") and not first.continues and not first.said
    begin_fleet(first, _setting())
    _close(first)
    again = fleet_folder(None, _setting(), False)
    _close(again)
    assert again.continues


def test_a_fleet_is_continued_when_its_old_robots_have_ended(folder: Path) -> None:
    first = fleet_folder(None, _setting(), False)
    _close(first)
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(first.folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=ENVIRONMENT,
    ) as robots:  # fmt: skip
        assert robots.stdin is not None and robots.stdout is not None
        assert robots.stdout.readline() == b"held\n"
        lines: list[str] = []

        def told(line: str) -> None:
            lines.append(line)
            assert robots.stdin is not None
            robots.stdin.close()

        again = fleet_folder(None, _setting(), False, told)
    _close(again)
    assert again.folder == first.folder
    assert lines == ["waits for robots 2 11 of the launch before, which was killed"]


def test_robots_that_do_not_end_are_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = fleet_folder(None, _setting(), False)
    _close(first)
    monkeypatch.setattr(robot_lock, "LEFT_WITHIN_S", 0.0)
    with (
        robot_lock.hold(first.folder, 1),
        pytest.raises(FolderError, match=r"robots 1 of an earlier .*--out"),
    ):
        fleet_folder(None, _setting(), False, lambda _: None)
    _close(fleet_folder(None, _setting(), False))


def _close(fleet: FleetFolder) -> None:
    for lock in fleet.locks:
        lock.close()


def test_e2_the_world_goes_on_where_it_was_killed(folder: Path) -> None:
    path = folder / "truth.jsonl"
    setting = _setting()
    world = setting.world()
    memory = WorldMemory(path, world)
    assert memory.now_us == 0
    world.place(world.robots[1], 3.0, 4.0, 0.5)
    for k in (1, 2, 3):
        world.advance(k * S)
        memory.look()
    memory.close()
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"t_us": 4000000, "poses"')  # killed while it wrote
    again = setting.world()
    kept = WorldMemory(path, again)
    assert kept.now_us == again.now_us == world.now_us
    assert path.read_bytes() == whole
    for slot, body in world.robots.items():
        assert again.robots[slot].position == pytest.approx(body.position)
        assert _places(again.robots[slot]) == _places(body)
    again.advance(4 * S)
    kept.look()
    kept.close()
    third = setting.world()
    WorldMemory(path, third).close()
    assert len(third.robots[0].track) == len(again.robots[0].track)


@pytest.mark.slow
def test_f_the_truth_of_a_launch_grows_by_megabytes_a_day(folder: Path) -> None:
    """Two looks a second of ten robots, each of which stayed, were 100 MB a day."""
    path, seconds, seed = folder / "truth.jsonl", 300, 24
    world = FieldSetup(load("oxted").changed(10, seed, None)).world()
    for body in world.robots.values():
        body.track.straight_m = STRAIGHT_M
    memory, rng = WorldMemory(path, world), Random(seed)
    wanted = dict.fromkeys(world.robots, Drive(0.0, 0.0))
    for look in range(2 * seconds):
        for slot in world.robots:
            if look % 40 == 0:  # a turn each 20 s
                turn = rng.uniform(-0.3, 0.3)
                wanted[slot] = Drive(0.6 * cos(turn), 0.6 * sin(turn), 0.0, look % 80 == 0)
        for part in range(5):  # commands expire
            for slot, body in world.robots.items():
                body.drive(wanted[slot], (5 * look + part) * S // 10)
        world.advance((look + 1) * S // 2)
        memory.look()
    assert all(body.track.driven_m > 0.3 * seconds for body in world.robots.values())
    memory.close()
    a_day = path.stat().st_size * 86_400 / seconds
    assert a_day < 12e6, f"seed {seed}: {a_day / 1e6:.0f} MB a day"
    again = FieldSetup(load("oxted").changed(10, seed, None)).world()
    WorldMemory(path, again).close()
    for slot, body in world.robots.items():
        assert _places(again.robots[slot]) == _places(body)


def _places(body: SimulatedBody) -> list[tuple[int, float, float]]:
    """Its track as a launch keeps it."""
    return [
        (t_us, round(x_m, TRACK_DIGITS), round(y_m, TRACK_DIGITS))
        for t_us, x_m, y_m, _ in body.track
    ]


def test_e2_a_world_that_is_launched_three_times_keeps_all_of_its_track(folder: Path) -> None:
    """The newest point of a life may still have moved; the next life tells it again."""
    path = folder / "truth.jsonl"
    for life in range(3):
        world = _setting().world()
        memory = WorldMemory(path, world)
        assert (memory.now_us > 0) == (life > 0)
        world.advance(world.now_us + 25 * S)
        memory.look()
        world.advance(world.now_us + 3 * S)
        memory.look()
        memory.close()
        told = [_places(body) for body in world.robots.values()]
    last = _setting().world()
    WorldMemory(path, last).close()
    assert [_places(body) for body in last.robots.values()] == told


def test_e2_parcels_go_on_where_they_lay(folder: Path) -> None:
    from sim.scenarios.delivery_scenario import load_warehouse
    from sim.scenarios.delivery_setup import DeliverySetup

    setting = DeliverySetup(load_warehouse("warehouse"))
    parcels, path = setting.parcels(), folder / "truth.jsonl"
    world = setting.world()
    memory = WorldMemory(path, world, parcels)
    parcels.appear(900, (1.0, 2.0), (5.0, 5.0), 7)
    parcels.handle(0, 900, (1.0, 2.0), 9)
    world.advance(S)
    memory.look()
    memory.close()
    again: Parcels = setting.parcels()
    WorldMemory(path, setting.world(), again).close()
    assert again.aboard == {0: 900} and again.dropoff == parcels.dropoff
    assert again.to_plain() == parcels.to_plain() and again.flaws == parcels.flaws


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_new_fleet_begins_without_the_book_of_a_master(tmp_path: Path, goes_on: bool) -> None:
    """Found: with --out and --fresh the orders of the last fleet were carried again."""
    (tmp_path / "vda5050.jsonl").write_text("")
    _put_away(tmp_path, journals=not goes_on)
    assert (tmp_path / "vda5050.jsonl").exists() is goes_on
    assert (tmp_path / "launch-1" / "vda5050.jsonl").exists() is not goes_on


def test_m22_faults_in_a_launch_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    text = 'name = "x"\n[field]\nfile = "small.geojson"\n[[fault]]\nkind = "heal"\nat_s = 1\n'
    (folder / "x.toml").write_text(text)
    said = Complaints(monkeypatch, capfd).of("launch x.toml", folder)
    assert said.code == 2 and "fault" in said.line and "headland run" in said.line
