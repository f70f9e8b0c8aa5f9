"""Drivers on simulated machines in processes of their own: ours pass, and broken ones do not."""

import asyncio
import json
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from math import hypot, nan, pi
from operator import xor
from pathlib import Path
from typing import Any

import can
import pytest

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.interface.effects import Drive, GatedDrive
from agent.interface.observation import Observation
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.runtime.bodies.isobus_body import IsobusBody
from agent.runtime.bodies.nmea_body import NmeaBody
from agent.runtime.bodies.wheel_sentences import checked
from agent.runtime.robot_body import DeclaredMachine
from sim.machines.isobus_machine import IsobusMachine
from sim.machines.nmea_machine import Dimensions, WheeledBody
from tests.tools.launching import ENVIRONMENT, ROOT
from tools.run.body_check import (
    CHECKS,
    PAUSE_US,
    PAUSES_MAX,
    BodyTrial,
    WrongError,
    confirmed,
    hint_of,
    judged,
    rehearse,
    unit_of,
)
from tools.run.machine_command import order

EXAMPLE = ROOT / "examples" / "robot"
ORIGIN = (52.0, 5.0)
Machine = Callable[[str], dict[str, Any]]


@pytest.fixture
def machine() -> Iterator[Machine]:
    running: list[subprocess.Popen[str]] = []

    def start(drive: str) -> dict[str, Any]:
        process = subprocess.Popen(
            [sys.executable, "-m", "tools.cli.headland", "machine", "--drive", drive, "--gnss", "0",
             "--wheels", "0", "--orders", "0", "--place=-2,3,100", "--json"],
            cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        running.append(process)
        assert process.stdout is not None
        found: dict[str, Any] = json.loads(process.stdout.readline())
        return found

    yield start
    for process in running:
        process.terminate()
        process.wait()


def trial(
    ports: dict[str, Any], drive: str = "differential", body: type[NmeaBody] = NmeaBody
) -> BodyTrial:
    vehicle = Vehicle(drive=DriveTrain[drive.upper()])
    rehearse(vehicle)  # as the command does: a busy computer loads kernels for seconds
    gnss, wheels = (f"tcp://127.0.0.1:{ports[name]}" for name in ("gnss", "wheels"))
    made = body(0, gnss, wheels)
    made.declare(DeclaredMachine(vehicle, ORIGIN))
    return BodyTrial(made, vehicle, ("127.0.0.1", ports["orders"]))


def failed(tried: BodyTrial, names: Sequence[str] = ()) -> dict[str, str]:
    """What failed of these checks, or of all."""
    chosen = {name: check for name, check in CHECKS.items() if not names or name in names}
    findings = asyncio.run(judged(tried, lambda finding: None, chosen))
    return {each.what: each.found for each in findings if each.ok is not True}


def test_our_driver_opens_has_its_times_and_stops_with_its_commands(machine: Machine) -> None:
    assert failed(trial(machine("differential")), ("opens", "times", "life of a command")) == {}


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["mecanum", "differential", "ackermann"])
def test_our_driver_passes_all_ten(drive: str, machine: Machine) -> None:
    assert len(CHECKS) == 10 and failed(trial(machine(drive), drive)) == {}


async def tractor_tried(names: Sequence[str]) -> tuple[dict[str, str], IsobusMachine]:
    """What fails of these checks of the body `isobus` on a simulated tractor's bus, and the tractor."""
    bus = can.Bus("tractor", interface="virtual")
    tractor = IsobusMachine(WheeledBody(Dimensions("ackermann"), -2.0, 3.0, 1.7), ORIGIN, bus)
    port = await tractor.start_on_bus("127.0.0.1", 0)
    vehicle = Vehicle(drive=DriveTrain.ACKERMANN)
    body = IsobusBody(0, "tractor", "virtual", steering=True, speed=True)
    body.declare(DeclaredMachine(vehicle, ORIGIN))
    chosen = {name: check for name, check in CHECKS.items() if not names or name in names}
    found = await judged(
        BodyTrial(body, vehicle, ("127.0.0.1", port)), lambda finding: None, chosen
    )
    await tractor.stop()
    return {each.what: each.found for each in found if each.ok is not True}, tractor


@pytest.mark.slow
def test_the_body_isobus_opens_has_its_times_and_stops_with_its_commands() -> None:
    failed, tractor = asyncio.run(tractor_tried(("opens", "times", "life of a command")))
    assert failed == {} and tractor.curvatures > 10 and tractor.speeds > 10


@pytest.mark.slow
def test_the_body_isobus_passes_all_ten() -> None:
    failed, tractor = asyncio.run(tractor_tried(()))
    assert failed == {} and tractor.curvatures > 100 and tractor.speeds > 100


def test_a_running_machine_is_told_to_fail(
    machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    port = machine("differential")["orders"]
    assert order("muted 0.1", "127.0.0.1", port) == 0 and capsys.readouterr().out == "ok\n"
    assert order("where", "127.0.0.1", port) == 0
    assert json.loads(capsys.readouterr().out)["x_m"] == pytest.approx(-2.0)
    assert order("wrong 3", "127.0.0.1", port) == 2 and "it is one of" in capsys.readouterr().out
    assert order("where", "127.0.0.1", 1) == 2 and "no machine answers" in capsys.readouterr().err


def test_the_driver_of_the_tutorial_is_short() -> None:
    assert len((EXAMPLE / "rover.py").read_text().splitlines()) <= 60


@pytest.mark.parametrize("quality", [0, 6, 7, 8])
def test_the_driver_of_the_tutorial_takes_no_place_that_is_no_fix(quality: int) -> None:
    """It passed on places that were estimated, entered by hand, or simulated."""
    spec = spec_from_file_location("rover", EXAMPLE / "rover.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    rover = module.Rover(0)
    rover.declare(DeclaredMachine(Vehicle(drive=DriveTrain.DIFFERENTIAL), (52.0, 5.0)))
    for kind, clock in ((4, "120000.00"), (quality, "120000.05")):
        rover.newest = None
        for body in (
            f"GNGGA,{clock},5200.0,N,00500.0,E,{kind},12,0.7,10.0,M,46.0,M,1.0,0001",
            "GNHDT,90.0,T",
        ):
            rover.take(checked(body.encode()).strip(), 1_000_000)
        assert (rover.newest is None) is (kind != 4)


class NewTimes(NmeaBody):
    """It says that every place is of now."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return None if seen is None else seen._replace(sensed_at_us=now_us)


class LateTimes(NmeaBody):
    """It has a clock of its own."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return None if seen is None else seen._replace(sensed_at_us=seen.sensed_at_us + 10**6)


class OldOnce(NmeaBody):
    """This computer had other work once, when it had the twentieth place."""

    asked = 0

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        self.asked += seen is not None
        late_us = 500_000 if self.asked == 20 else 0
        return None if seen is None else seen._replace(sensed_at_us=seen.sensed_at_us - late_us)


class OldOften(NmeaBody):
    """Each twentieth place is old."""

    asked = 0

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        self.asked += seen is not None
        late_us = 0 if self.asked % 20 else 500_000
        return None if seen is None else seen._replace(sensed_at_us=seen.sensed_at_us - late_us)


class Bearings(NmeaBody):
    """It takes bearings for headings."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return None if seen is None else seen._replace(heading_rad=pi / 2 - seen.heading_rad)


class Kilometres(NmeaBody):
    """It takes metres a second for kilometres an hour."""

    def drive(self, command: GatedDrive, now_us: int) -> None:
        slower = command._replace(vx_m_s=command.vx_m_s / 3.6, vy_m_s=command.vy_m_s / 3.6)
        super().drive(GatedDrive(slower), now_us)


class Mirrored(NmeaBody):
    """North is south."""

    def drive(self, command: GatedDrive, now_us: int) -> None:
        super().drive(GatedDrive(command._replace(vy_m_s=-command.vy_m_s)), now_us)


class NeverPivots(NmeaBody):
    """It turns to a course only, as out of a corner it cannot."""

    def drive(self, command: GatedDrive, now_us: int) -> None:
        super().drive(GatedDrive(command._replace(turn_rad_s=0.0)), now_us)


class Boastful(NmeaBody):
    """It says an accuracy that it does not have."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return None if seen is None else seen._replace(position_accuracy_m=0.001)


class KeepsOn(NmeaBody):
    """It repeats the last command by itself."""

    last = Drive(0.0, 0.0)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self.last = command
        super().drive(command, now_us)

    def sense(self, now_us: int) -> Observation | None:
        if hypot(self.last.vx_m_s, self.last.vy_m_s):
            super().drive(GatedDrive(self.last), now_us)
        return super().sense(now_us)


class Unsaid(NmeaBody):
    """Its places are 400 ms late, and pass for new."""

    def __init__(self, slot: int, gnss: str, wheels: str) -> None:
        super().__init__(slot, gnss, wheels)
        self.before: deque[Observation] = deque(maxlen=9)

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        if seen is None:
            return None
        self.before.append(seen)
        return self.before[0]._replace(sensed_at_us=seen.sensed_at_us)


class Queued(NmeaBody):
    """What its receiver says waits for 0.1 s in a queue, and counts as having arrived then."""

    def __init__(self, slot: int, gnss: str, wheels: str) -> None:
        super().__init__(slot, gnss, wheels)
        self.queue: deque[tuple[bytes, int]] = deque()

    def _take(self, line: bytes, at_us: int) -> None:
        self.queue.append((line, at_us))
        while at_us - self.queue[0][1] >= 100_000:
            super()._take(self.queue.popleft()[0], at_us)


class Exact(NmeaBody):
    """It leaves out the accuracy."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return None if seen is None else seen._replace(position_accuracy_m=0.0)


class HoldsOn(NmeaBody):
    """It repeats the last command for 400 ms, as a thread of its own would."""

    last, told_at_us = GatedDrive(Drive(0.0, 0.0)), 0

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self.last, self.told_at_us = command, now_us
        super().drive(command, now_us)

    def sense(self, now_us: int) -> Observation | None:
        if 50_000 <= now_us - self.told_at_us < 400_000:
            super().drive(self.last, now_us)
        return super().sense(now_us)


class HeldOnOnce(NmeaBody):
    """This computer paused when the command was to expire, once."""

    last, told_at_us, paused = GatedDrive(Drive(0.0, 0.0)), 0, False

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self.last, self.told_at_us = command, now_us
        super().drive(command, now_us)

    def sense(self, now_us: int) -> Observation | None:
        silent_for_us = now_us - self.told_at_us if hypot(*self.last[:2]) else 0
        self.paused |= silent_for_us > 450_000
        if silent_for_us >= 70_000 and not self.paused:
            super().drive(self.last, now_us)
        return super().sense(now_us)


class Filtered(NmeaBody):
    """Its filter believes a new place by a twentieth."""

    kept: tuple[float, float] | None = None

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        if seen is None:
            return None
        x_m, y_m = self.kept or seen[:2]
        self.kept = x_m + (seen.x_m - x_m) / 20, y_m + (seen.y_m - y_m) / 20
        return seen._replace(x_m=self.kept[0], y_m=self.kept[1])


@pytest.mark.parametrize("paused_for_us", [0, 2 * PAUSE_US])
def test_a_trial_in_which_this_program_paused_does_not_count(paused_for_us: int) -> None:
    """Three trials beside other work said that the body `isobus` drives on for 317 ms."""
    made = NmeaBody(0, "tcp://127.0.0.1:1", "tcp://127.0.0.1:1")
    tried, trials = BodyTrial(made, Vehicle(), None), 0

    async def stops(trial: BodyTrial) -> str:
        nonlocal trials
        trials += 1
        if trials == PAUSES_MAX:
            return "stood"
        trial.paused_for_us = paused_for_us
        raise WrongError("drives on")

    if paused_for_us:
        assert asyncio.run(confirmed(tried, "stop", stops)) == "stood"
    else:
        with pytest.raises(WrongError, match="drives on"):
            asyncio.run(confirmed(tried, "stop", stops))
        assert trials == 2


class NoNumber(NmeaBody):
    """Its place is no number while it drives."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        drives = seen is not None and hypot(seen.vx_m_s, seen.vy_m_s) > 0.2
        return seen._replace(x_m=nan) if seen is not None and drives else seen


class Raises(NmeaBody):
    """Its code has a fault."""

    def sense(self, now_us: int) -> Observation | None:
        raise KeyError("receiver")


class Seconds(NmeaBody):
    """Its times are seconds."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return None if seen is None else seen._replace(sensed_at_us=seen.sensed_at_us // 1_000_000)


class StandsAgain(NmeaBody):
    """It connects once only, and keeps the last place."""

    last: Observation | None = None
    opened = False

    async def open(self) -> None:
        if not self.opened:
            await super().open()
        self.opened = True

    def sense(self, now_us: int) -> Observation | None:
        self.last = super().sense(now_us) or self.last
        return None if self.last is None else self.last._replace(sensed_at_us=now_us)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "check", "says"),
    [
        (Unsaid, "stop", "later than they say"), (Exact, "missing places", "inaccurate: the place"),
        (HoldsOn, "life of a command", "after the last command"),
        (Queued, "missing places", "ms older than they say"),
        (Filtered, "missing places", "by steps of"), (NoNumber, "ahead", "x_m is nan"),
        (Raises, "opens", "sense raised KeyError: 'receiver' (test_body_check.py:"),
        (Seconds, "times", "in seconds"), (StandsAgain, "restart", "opened again"),
    ],
)  # fmt: skip
def test_a_driver_that_passed_or_ended_the_checks_is_told_what_is_wrong(
    driver: type[NmeaBody], check: str, says: str, machine: Machine
) -> None:
    """Places that were late, filtered or no numbers passed, and an exception ended all checks."""
    names = ("opens", "stop", check) if check == "life of a command" else ("opens", check)
    assert says in failed(trial(machine("differential"), body=driver), names)[check]


@pytest.mark.slow
def test_one_long_way_of_a_busy_computer_is_measured_again(machine: Machine) -> None:
    """A test run failed because the only way that was measured was 340 ms long, on a busy computer."""
    tried = trial(machine("differential"), body=HeldOnOnce)
    chosen = {name: CHECKS[name] for name in ("opens", "stop", "life of a command")}
    findings = asyncio.run(judged(tried, lambda finding: None, chosen))
    assert all(each.ok for each in findings) and "is this computer busy?" in findings[-1].found


def test_a_wrong_course_and_a_wrong_time_say_what_they_look_like() -> None:
    assert "y (north)" in hint_of(0.7, -0.7) and "x (east)" in hint_of(0.7, pi - 0.7)
    assert "bearings" in hint_of(0.3, pi / 2 - 0.3) and hint_of(0.4, 0.9) == ""
    now_us = 5_000_000_000
    assert "in milliseconds" in unit_of(now_us / 1000, now_us) and unit_of(now_us, now_us) == ""
    assert "in nanoseconds" in unit_of(now_us * 1000, now_us)


@pytest.mark.slow
def test_one_old_place_is_the_computers_and_many_are_the_drivers(machine: Machine) -> None:
    """A computer that was busy for 130 ms failed a good driver."""
    ports, names = machine("differential"), ("opens", "times")
    assert failed(trial(ports, body=OldOnce), names) == {}
    assert "ms stop a robot" in failed(trial(ports, body=OldOften), names)["times"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "check"),
    [
        (NewTimes, "missing places"), (LateTimes, "times"), (Bearings, "ahead"),
        (Kilometres, "ahead"), (Mirrored, "sides"), (Boastful, "accuracy"),
        (KeepsOn, "life of a command"), (NeverPivots, "sides"),
    ],
)  # fmt: skip
def test_a_broken_driver_fails(driver: type[NmeaBody], check: str, machine: Machine) -> None:
    assert check in failed(trial(machine("differential"), body=driver), ("opens", check))


@pytest.mark.slow
def test_the_example_passes_all_ten_by_the_command_of_its_tutorial(machine: Machine) -> None:
    ports = machine("differential")
    folder = ROOT / "examples" / "robot"
    assert sum(bool(line.strip()) for line in (folder / "rover.py").read_text().splitlines()) <= 60
    done = subprocess.run(
        [sys.executable, "-m", "headland", "body-check", "rover:Rover", "--origin", "52,5",
         "--option", f"gnss={ports['gnss']}", "--option", f"wheels={ports['wheels']}",
         "--machine", f"127.0.0.1:{ports['orders']}"],
        cwd=folder, env={**ENVIRONMENT, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0 and "10 of 10 checks passed" in done.stdout, (
        done.stdout + done.stderr
    )


@pytest.mark.slow
def test_what_cannot_be_imported_is_one_line(tmp_path: Path) -> None:
    for name in ("nowhere:Body", "nmae", "random:Random"):
        done = subprocess.run(
            [sys.executable, "-m", "tools.cli.headland", "body-check", name],
            cwd=tmp_path, env={**ENVIRONMENT, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
            check=False, timeout=60,
        )  # fmt: skip
        assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr


def sentence(body: str) -> bytes:
    check = reduce(xor, body.encode())
    return f"${body}*{check:02X}".encode()


def test_the_driver_of_the_tutorial_believes_places_after_midnight_and_with_clocks_that_drift(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It kept the least difference of two clocks for ever, so that all places were old after half an
    hour of 50 ppm, and from midnight on."""
    monkeypatch.syspath_prepend(EXAMPLE)
    rover = import_module("rover").Rover(0)
    rover.declare(DeclaredMachine(Vehicle(drive=DriveTrain.DIFFERENTIAL), (52.0, 5.0)))
    begun_s = 23 * 3600  # an hour before midnight
    for passed_s in range(0, 7200, 10):
        utc_s = (begun_s + passed_s) % 86_400
        at_us = round(passed_s * 1e6 * (1 + 50e-6)) + 1_000_000
        clock = f"{utc_s // 3600:02}{utc_s // 60 % 60:02}{utc_s % 60:02}.00"
        rover.take(sentence(f"GNGGA,{clock},5200.0,N,00500.0,E,4,12,0.8,0,M,0,M,,"), at_us)
        rover.take(sentence("GNHDT,90.0,T"), at_us)
        assert rover.newest.sensed_at_us == pytest.approx(at_us - 20_000, abs=10_000), clock
