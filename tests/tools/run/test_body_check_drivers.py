"""Drivers of a machine that is computed, in virtual time: what is wrong with each is found."""

import asyncio
from collections import deque
from collections.abc import Iterator
from math import cos, sin
from typing import Any

import pytest

from agent.interface.config import ACTUATOR_TTL_US, S
from agent.interface.effects import HALT, GatedDrive
from agent.interface.observation import Observation
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.runtime.robot_body import DeclaredMachine, RobotBody
from sim.fleet.virtual_clock import run_virtual
from tests.tools.launching import ROOT
from tools.run.body_check import (
    CHECKS,
    BodyTrial,
    WrongError,
    are_as_old_as_they_say,
    body_check,
    judged,
    orders_at,
)

STEP_US = 5000
ACCELERATION_M_S2 = 1.5
BEGINS_AT_US = 1000 * S  # no unit of time is mistaken for another one


@pytest.fixture(autouse=True)
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Checks measure with the clock of the loop, as robots do."""

    def now_us() -> int:
        return BEGINS_AT_US + round(asyncio.get_running_loop().time() * S)

    monkeypatch.setattr(BodyTrial, "now_us", staticmethod(now_us))
    yield


class Exact(RobotBody):
    """A mecanum body without noise, at first eastward, and a driver without a fault."""

    def __init__(self) -> None:
        self.place = [0.0, 0.0, 0.0]
        self.velocity = self.wanted = [0.0, 0.0, 0.0]
        self.moved_at_us, self.ends_at_us = BEGINS_AT_US, 0

    def sense(self, now_us: int) -> Observation | None:
        self._move(now_us)
        (x_m, y_m, heading_rad), (vx_m_s, vy_m_s, _) = self.place, self.velocity
        seen = Observation(x_m, y_m, heading_rad, vx_m_s, vy_m_s, sensed_at_us=self.moved_at_us)
        return seen._replace(position_accuracy_m=0.01)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self._move(now_us)
        self.wanted = [command.vx_m_s, command.vy_m_s, command.turn_rad_s]
        self.ends_at_us = now_us + ACTUATOR_TTL_US

    def close(self) -> None:
        self.wanted = [0.0, 0.0, 0.0]

    def _move(self, now_us: int) -> None:
        while self.moved_at_us + STEP_US <= now_us:
            wanted = self.wanted if self.moved_at_us < self.ends_at_us else [0.0, 0.0, 0.0]
            most = ACCELERATION_M_S2 * STEP_US / S
            pairs = zip(self.velocity, wanted, strict=True)
            self.velocity = [is_ + max(-most, min(most, to - is_)) for is_, to in pairs]
            pairs = zip(self.place, self.velocity, strict=True)
            self.place = [at + each * STEP_US / S for at, each in pairs]
            self.moved_at_us += STEP_US


def failed(body: RobotBody) -> dict[str, str]:
    """What all the checks say that do not pass."""
    trial = BodyTrial(body, Vehicle(drive=DriveTrain.MECANUM), None)
    findings = run_virtual(judged(trial, lambda finding: None))
    return {each.what: each.found for each in findings if each.ok is False}


def test_a_driver_without_a_fault_passes() -> None:
    assert failed(Exact()) == {} and len(CHECKS) == 10


class OfTheGrid(Exact):
    """Its metres are those of a national grid."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return seen and seen._replace(x_m=seen.x_m + 637_000.0, y_m=seen.y_m + 5_762_000.0)


def test_a_place_of_another_origin_is_found() -> None:
    """A driver passed whose robot would have stood for ever: frames cannot say its places."""
    assert "637000 m east and 5762000 m north of the origin" in failed(OfTheGrid())["accuracy"]


class Unknown(Exact):
    """It says -1 where it knows no accuracy."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return seen and seen._replace(position_accuracy_m=-1.0)


def test_an_accuracy_below_nothing_is_none() -> None:
    """The accuracy passed, and the check `stop` said that the body does not stop."""
    assert "accurate to -1.00 m" in failed(Unknown())["accuracy"]


class AlongItself(Exact):
    """Its velocity is ahead and left, as in ROS, not east and north."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        if seen is None:
            return None
        x_m_s, y_m_s, angle_rad = seen.vx_m_s, seen.vy_m_s, seen.heading_rad
        return seen._replace(
            vx_m_s=x_m_s * cos(angle_rad) + y_m_s * sin(angle_rad),
            vy_m_s=y_m_s * cos(angle_rad) - x_m_s * sin(angle_rad),
        )


class Mirrored(Exact):
    """The north of its velocity is south."""

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return seen and seen._replace(vy_m_s=-seen.vy_m_s)


def test_a_velocity_of_wrong_axes_is_found_on_a_machine_that_began_eastward() -> None:
    """Both passed all checks: eastward such a velocity is right."""
    assert "points 120 degrees to the right of its course" in failed(Mirrored())["sides"]
    said = failed(AlongItself())["acceleration"]
    assert "34 degrees to the right" in said and "along the body, not east and north?" in said


class TimesOut(Exact):
    """Its port waits, and raises after a second."""

    def __init__(self, call: str) -> None:
        super().__init__()
        self.call = call

    async def open(self) -> None:
        if self.call == "open":
            raise TimeoutError("the read operation timed out")

    def sense(self, now_us: int) -> Observation | None:
        if self.call == "sense" and now_us > BEGINS_AT_US + S:
            raise TimeoutError("the read operation timed out")
        return super().sense(now_us)


class Silent(Exact):
    """It never has a place."""

    def sense(self, now_us: int) -> Observation | None:
        return None


def test_a_driver_that_times_out_is_told_so() -> None:
    """Its checks said "no place in 10 s", after one."""
    assert failed(TimesOut("open"))["opens"] == "the read operation timed out"
    assert failed(TimesOut("sense"))["times"].startswith("sense raised TimeoutError: the read")
    assert failed(Silent())["opens"] == "no place in 10 s"


class Older(Exact):
    """Its places are older than they say."""

    def __init__(self, periods: int) -> None:
        super().__init__()
        self.before: deque[Observation] = deque(maxlen=1 + periods)

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        assert seen is not None
        self.before.append(seen)
        return self.before[0]._replace(sensed_at_us=seen.sensed_at_us)


class OnMachine(BodyTrial):
    """The machine of the body says where it truly is."""

    async def order(self, line: str) -> Any:
        assert line == "where" and isinstance(self.body, Exact)
        Exact.sense(self.body, self.now_us())
        (x_m, y_m, angle_rad), (vx_m_s, vy_m_s, _) = self.body.place, self.body.velocity
        return {
            "x_m": x_m, "y_m": y_m, "heading_rad": angle_rad,
            "ahead_m_s": vx_m_s * cos(angle_rad) + vy_m_s * sin(angle_rad),
            "left_m_s": vy_m_s * cos(angle_rad) - vx_m_s * sin(angle_rad),
            "is_told_to_move": self.body.moved_at_us < self.body.ends_at_us and any(self.body.wanted),
        }  # fmt: skip


@pytest.mark.parametrize(("periods", "hidden_ms"), [(0, 0), (2, 100), (3, 150)])
def test_places_that_are_always_a_little_late_are_found_beside_the_truth(
    periods: int, hidden_ms: int
) -> None:
    """Drivers whose places were up to 0.2 s older than they said passed all checks."""
    body = Older(periods)
    body.place[2] = 0.7  # neither eastward nor northward
    trial = OnMachine(body, Vehicle(drive=DriveTrain.MECANUM), None)
    if not hidden_ms:
        assert run_virtual(are_as_old_as_they_say(trial)) == "times right to 0 ms"
        return
    with pytest.raises(WrongError, match="ms older than they say") as raised:
        run_virtual(are_as_old_as_they_say(trial))
    assert int(str(raised.value).split()[2]) == pytest.approx(hidden_ms, abs=5)


class Waiting(Exact):
    """Four commands wait in its queue, 0.2 s."""

    def __init__(self) -> None:
        super().__init__()
        self.queue: deque[GatedDrive] = deque(maxlen=5)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self.queue.append(command)
        super().drive(self.queue[0], now_us)


class StandsBetween(Exact):
    """It passes each fourth command on as one to stand."""

    told = 0

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self.told += 1
        super().drive(command if self.told % 4 else HALT, now_us)


class LargeWheels(Exact):
    """Its wheels are larger than it believes, by a fifth."""

    def drive(self, command: GatedDrive, now_us: int) -> None:
        faster = command._replace(vx_m_s=command.vx_m_s * 1.2, vy_m_s=command.vy_m_s * 1.2)
        super().drive(GatedDrive(faster), now_us)


@pytest.mark.parametrize(
    ("driver", "said"),
    [
        (Exact, ""), (Waiting, "a command to stand reaches the machine after"),
        (StandsBetween, "lets the machine stand"), (LargeWheels, "truly drove 0.60 m/s"),
    ],
)  # fmt: skip
def test_commands_that_reach_the_machine_late_or_changed_are_found(
    driver: type[Exact], said: str
) -> None:
    """A driver that passed commands on late passed all ten checks, and so did the others."""
    trial = OnMachine(driver(), Vehicle(drive=DriveTrain.MECANUM), ("127.0.0.1", 1))
    chosen = {name: CHECKS[name] for name in ("opens", "stop")}
    _, stop = run_virtual(judged(trial, lambda finding: None, chosen))
    assert said in stop.found and stop.ok is not bool(said), stop.found


class Slow(OnMachine):
    """The computer of the machine is busy: its answers take 30 ms."""

    async def order(self, line: str) -> Any:
        loop = asyncio.get_running_loop()
        answered = loop.create_future()
        loop.call_later(0.03, answered.set_result, await super().order(line))
        return await answered


def test_a_machine_that_answers_slowly_says_nothing_of_a_driver() -> None:
    trial = Slow(Older(0), Vehicle(drive=DriveTrain.MECANUM), None)
    assert run_virtual(are_as_old_as_they_say(trial)).endswith("this computer is busy")


class Says(Exact):
    """One value is not as a robot needs it."""

    def __init__(self, **values: Any) -> None:
        super().__init__()
        self.values = values

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return seen and seen._replace(**self.values)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"sensed_at_us": 1e9}, "sensed_at_us is 1000000000.0, not a whole number"),
        ({"battery": 87.0}, "battery is 87.0, not a share"),
        ({"health": None}, "health is None, not a share"),
        ({"ranges_m": None}, "ranges_m is not a tuple"),
        ({"ranges_m": [1.0, 2.0]}, "ranges_m is not a tuple"),
        ({"implement_down": "up"}, "implement_down is 'up', not True, False or None"),
    ],
)
def test_what_ends_a_robot_or_passes_for_full_is_found(values: dict[str, Any], said: str) -> None:
    """A compiled robot ended at a time that is no whole number, and 87 percent were a full battery."""
    assert said in failed(Says(**values))["opens"]


async def _answers(answer: bytes, line: str) -> object:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    orders = server.sockets[0].getsockname()
    async with server:
        return await BodyTrial(Exact(), Vehicle(), orders).order(line)


@pytest.mark.parametrize("answer", [b"{\n", b"\xff\xfe\n"])
def test_what_is_no_machine_is_told_so(answer: bytes) -> None:
    with pytest.raises(WrongError, match="is no machine"):
        asyncio.run(_answers(answer, "where"))


@pytest.mark.parametrize("machine", ["5003", ":5003", "127.0.0.1:", "127.0.0.1:99999", "a:b"])
def test_an_address_of_orders_is_a_host_and_a_port(machine: str) -> None:
    """A port of 99999 ended the checks with a traceback, after half a minute of driving."""
    with pytest.raises(ValueError, match="it is HOST:PORT"):
        orders_at(machine)
    assert orders_at("[::1]:5003") == ("::1", 5003) and orders_at("::1:5003") == ("::1", 5003)


class Undeclared(Exact):
    """Its `declare` has a fault; it takes the slot, as bodies do."""

    def __init__(self, slot: int) -> None:
        super().__init__()

    def declare(self, machine: DeclaredMachine) -> None:
        raise KeyError("origin")


def test_a_driver_that_cannot_be_declared_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert body_check(f"{__name__}:Undeclared", [], Vehicle(), None, None, False) == 2
    assert capsys.readouterr().err.startswith("headland: declare raised KeyError: 'origin' (test_")


def test_the_driver_of_the_tutorial_says_that_it_needs_an_origin(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`headland body-check rover:Rover` ended with a traceback of an assertion."""
    pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")
    monkeypatch.syspath_prepend(ROOT / "examples" / "robot")
    assert body_check("rover:Rover", [], Vehicle(), None, None, False) == 2
    assert "the origin is missing: --origin" in capsys.readouterr().err
