"""A device that fails while its robot runs ends it as an absent one does, so that it is started again."""

import asyncio
from errno import ENODEV
from fractions import Fraction
from math import inf
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest
from numpy import float32, int64

from agent.interface.effects import HALT, GatedDrive
from agent.interface.observation import Observation
from agent.peer.peer import Peer
from agent.runtime import robot_process
from agent.runtime.robot_body import StandingBody
from agent.runtime.robot_file import AbsentError, DriverError, RobotFile
from agent.runtime.robot_process import AttendedBody, opened_body, run_robot

EX_TEMPFAIL = 75  # `headland@.service` starts a robot again after this


class Unplugged(StandingBody):
    """A body whose device is gone from one call on."""

    def __init__(self, slot: int, call: str) -> None:
        super().__init__(slot)
        self.call = call

    def _reach(self, call: str) -> None:
        if call == self.call:
            raise OSError(5, "Input/output error")

    def sense(self, now_us: int) -> Observation | None:
        self._reach("sense")
        return super().sense(now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self._reach("drive")

    def close(self) -> None:
        self._reach("close")


@pytest.fixture
def robot(tmp_path: Path) -> Any:
    def made(call: str) -> RobotFile:
        path = tmp_path / "robot.toml"
        path.write_text(
            f'name = "{call}"\n[fleet]\nrobots = 1\n[bus]\ninterface = "virtual"\n'
            f'channel = "failing-{call}"\n[robot]\nslot = 0\njournal = "."\n'
            f'[body]\nfactory = "{__name__}:Unplugged"\noptions = {{ call = "{call}" }}\n'
        )
        return RobotFile.read(path)

    return made


@pytest.mark.parametrize("call", ["sense", "drive"])
def test_a_driver_whose_device_fails_ends_the_robot_with_code_75(robot: Any, call: str) -> None:
    """The code was 2, after which systemd does not start a robot again."""
    with pytest.raises(AbsentError, match=f"robot 0: body: {call}: Input/output error") as ended:
        asyncio.run(run_robot(robot(call), asyncio.Event(), first_boot=True))
    assert ended.value.code == EX_TEMPFAIL


class Waits(StandingBody):
    """A body whose device does not answer in time."""

    async def open(self) -> None:
        raise TimeoutError

    def sense(self, now_us: int) -> Observation | None:
        raise TimeoutError


def test_a_device_that_says_nothing_of_its_fault_is_told_by_the_kind(robot: Any) -> None:
    """The line ended with "body: " and "body: sense: "."""
    with pytest.raises(AbsentError, match=r"robot 0: body: sense: TimeoutError$"):
        AttendedBody(Waits(0), 0).sense(0)
    waits = robot("none")
    table = waits.body.model_copy(update={"factory": f"{__name__}:Waits", "options": {}})
    with pytest.raises(AbsentError, match=r"robot 0: body: TimeoutError$"):
        asyncio.run(opened_body(waits.model_copy(update={"body": table})))


class Watches(StandingBody):
    """A body whose display fails."""

    async def watch(self, peer: Peer) -> None:
        raise KeyError("lamp")


def test_what_fails_beside_a_robot_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing was said, and a body that reads there where parcels lie saw no new ones."""
    asyncio.run(AttendedBody(Watches(0), 0).watch(Mock(Peer)))
    assert "robot 0: body: watch raised KeyError: 'lamp' (test_fail" in capsys.readouterr().err


class Says(StandingBody):
    """A body one of whose values is of another kind."""

    def __init__(self, slot: int, **values: Any) -> None:
        super().__init__(slot)
        self.values = values

    def sense(self, now_us: int) -> Observation | None:
        seen = super().sense(now_us)
        return seen and seen._replace(**self.values)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"x_m": "3"}, "x_m = '3', which is no number"), ({"health": None}, "health = None"),
        ({"sensed_at_us": None}, "sensed_at_us = None"), ({"ranges_m": None}, "ranges_m that are no"),
        ({"ranges_m": ("1",)}, "ranges_m that are no"), ({"x_m": Fraction(1, 3)}, r"x_m = Fraction"),
        ({"ranges_m": (Fraction(1, 3),)}, "ranges_m that are no"),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_is_a_fault_of_the_driver(
    values: dict[str, Any], said: str
) -> None:
    """It ended the robot in its core, with a traceback that names no driver."""
    with pytest.raises(DriverError, match=rf"robot 0: body: sense returned {said}.*py:"):
        AttendedBody(Says(0, **values), 0).sense(0)
    assert AttendedBody(
        Says(0, ranges_m=(float32(1.0), inf), x_m=float32(1.0), y_m=int64(1)), 0
    ).sense(0)


def test_what_a_device_that_failed_says_when_it_is_closed_hides_nothing() -> None:
    body = AttendedBody(Unplugged(0, "close"), 0)
    with pytest.raises(AbsentError, match="body: close"):
        body.close()
    body = AttendedBody(Unplugged(0, "drive"), 0)
    with pytest.raises(AbsentError, match="body: drive"):
        body.drive(HALT, 0)
    assert isinstance(body.body, Unplugged)
    body.body.call = "close"
    body.close()


def test_a_bus_whose_interface_is_gone_ends_the_robot_with_code_75(
    robot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An adapter that was unplugged and plugged in again left its robot standing for ever."""
    monkeypatch.setattr("protocol.links.bus.LOST_S", 0.0)
    monkeypatch.setattr(robot_process, "LOST_LOOK_S", 0.0)

    def gone(bus: can.BusABC, *said: Any, **options: Any) -> None:
        raise can.CanOperationError("Failed to transmit: No such device or address", 6)

    monkeypatch.setattr("can.interfaces.virtual.VirtualBus.send", gone)
    with pytest.raises(AbsentError, match="robot 0: bus: the interface is gone") as ended:
        asyncio.run(run_robot(robot("never"), asyncio.Event(), first_boot=True))
    assert ended.value.code == EX_TEMPFAIL


def test_a_receiver_whose_interface_is_gone_fails_to_sense(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")
    from agent.runtime.bodies.nmea_body import BusReceiver, NmeaBody

    monkeypatch.setattr("protocol.links.bus.LOST_S", 0.0)

    async def play() -> None:
        body = NmeaBody(0, "can:virtual:gone-receiver", "tcp://127.0.0.1:1")
        receiver = body.gnss
        assert isinstance(receiver, BusReceiver)
        receiver.open()
        try:
            assert body.sense(0) is None
            assert receiver._bus is not None
            receiver._bus.errors.add(can.CanOperationError("No such device", ENODEV))
            with pytest.raises(OSError, match="can:virtual:gone-receiver: the interface is gone"):
                body.sense(0)
        finally:
            receiver.close()

    asyncio.run(play())
