"""A robot and a task controller on one bus: log-in by the transport protocol, and its values."""

from collections.abc import Sequence
from random import Random

import numpy as np
import pytest

from agent.interface.config import MS, S
from agent.interface.effects import Drive, Effect, Send
from agent.interface.identity import Identity
from agent.interface.lifecycle import State
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.inputs import BusState, Received, Sensed, Timer
from agent.peer.notices import ImplementLowered
from agent.peer.peer import Peer
from agent.runtime.peer_factory import MissionParts, make_peer
from agent.safety.stop_cause import StopCause, sentence
from protocol.controller_health import Health
from protocol.device_description import DeviceDescription
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Standstill
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.network_frames import (
    Acknowledgment,
    AcknowledgmentControl,
    TransportData,
    TransportManagement,
)
from protocol.frames.task_frames import PROCESS_DATA, ProcessData, WorkingSetMaster
from protocol.name import fleet_name
from protocol.task_client import SessionState, TaskClient
from protocol.transport import Transport
from tests.agent.lone_peer import Eager
from tests.protocol.test_task_client import STATUS, Controller, parsed

SERVER = 247


class Bus:
    """One robot and one task controller; frames take no time."""

    def __init__(self, version: int, diagnostics: bool = True) -> None:
        identity = Identity(
            0, frozenset({0}), fleet_name("tc", 0), 1, started=True, first_boot=True,
            release="1.2.3", diagnostics=diagnostics, implement_width_mm=4000,
        )  # fmt: skip
        self.peer: Peer = make_peer(identity, Random(4), 0, {})
        self.controller, self.transport = Controller(version), Transport()
        self.now_us, self.heard = 0, list[Message]()

    @property
    def client(self) -> TaskClient:
        return self.peer.named.tasks.client

    @property
    def logged_in(self) -> bool:
        return self.client.state is SessionState.CONNECTED

    def tell(self, message: Message, destination: int | None = None) -> None:
        """The task controller sends to the robot."""
        to = self.peer.address if destination is None else destination
        assert to is not None
        self._take(self.peer.step(Received(encode(message, SERVER, to)), self.now_us))

    def _take(self, effects: Sequence[Effect]) -> None:
        for effect in effects:
            if not isinstance(effect, Send) or effect.destination not in (SERVER, GLOBAL_ADDRESS):
                continue
            message = effect.message
            self.heard.append(message)
            data = b""
            if isinstance(message, TransportManagement | TransportData):
                if effect.destination != SERVER:
                    continue
                out, arrived = self.transport.on_message(
                    self.peer.address or 0, SERVER, message, self.now_us
                )
                for each in out:
                    self.tell(each.message)
                data = b"" if arrived is None else arrived.data
            elif isinstance(message, ProcessData):
                data = message.body
            if data:
                for answer in self.controller.answers(data):
                    self.tell(ProcessData(answer))

    def until(self, until_us: int) -> None:
        """Time passes; the task controller says each 2 s that it is there."""
        while self.now_us < until_us:
            self.now_us += 10 * MS
            if self.now_us % (2 * S) == 0:
                self.tell(ProcessData(STATUS), GLOBAL_ADDRESS)
            self._take(self.peer.step(Timer(), self.now_us))


@pytest.mark.parametrize("version", [3, 4])
def test_a_robot_is_logged_in_three_seconds_after_a_task_controller_appears(version: int) -> None:
    bus = Bus(version)
    bus.until(5 * S)
    assert bus.logged_in
    assert WorkingSetMaster(1) in bus.heard
    device = parsed(bus.controller.stored, version)[0][1]
    assert device["name"] == bus.peer.identity.name.pack() and device["software"] == "1.2.3"
    expected = DeviceDescription(bus.peer.identity.name, "robot 0", "1.2.3", 4000)
    assert bus.controller.stored == expected.pool(version)


def test_its_values_are_those_of_its_work() -> None:
    bus = Bus(4)
    bus.until(5 * S)
    begin_us = bus.now_us
    bus.tell(ProcessData(bytes.fromhex("18008D0001000000")))  # work state on change
    bus.heard.clear()
    for step in range(100):  # ten seconds at 1.5 m/s, the implement down
        bus.now_us = begin_us + step * 100 * MS
        here = Observation(0.15 * step, 0.0, 0.0, 1.5, 0.0, sensed_at_us=bus.now_us)
        bus._take(bus.peer.step(Sensed(here), bus.now_us))
        if step == 0:
            bus.peer.named.tasks.at_work = True
        if bus.now_us % (2 * S) == 0:
            bus.tell(ProcessData(STATUS), GLOBAL_ADDRESS)
        bus._take(bus.peer.step(Timer(), bus.now_us))
    states = [m.body for m in bus.heard if isinstance(m, ProcessData) and m.body[2] == 0x8D]
    assert bytes.fromhex("13008D0001000000") in states
    bus.heard.clear()
    for ddi in ("7500", "7400", "7700", "8D01"):
        element = "02" if ddi == "8D01" else "12"
        bus.tell(ProcessData(bytes.fromhex(f"{element}00{ddi}00000000")))
    told = [
        (int.from_bytes(m.body[2:4], "little"), int.from_bytes(m.body[4:8], "little"))
        for m in bus.heard
        if isinstance(m, ProcessData)
    ]
    values = dict(told)
    assert values[397] == 1500 and values[119] == 9
    assert values[117] == pytest.approx(14_850, abs=160)  # mm
    assert values[116] == int(values[117] / 1000 * 4)  # m^2


def test_it_logs_in_again_after_the_controller_was_away() -> None:
    bus = Bus(4)
    bus.until(5 * S)
    silent = bus.now_us + 7 * S
    while bus.now_us < silent:
        bus.now_us += 10 * MS
        bus._take(bus.peer.step(Timer(), bus.now_us))
    assert bus.client.server is None
    bus.until(silent + 4 * S)
    assert bus.logged_in and bus.client.sessions == 2


def test_it_logs_in_again_at_a_controller_that_knows_it_no_more() -> None:
    """AgIsoStack refuses what a client says that has not logged in since it was started."""
    bus = Bus(4)
    bus.until(5 * S)
    robot, group = bus.peer.address or 0, PROCESS_DATA.pgn
    nack, ack = AcknowledgmentControl.NACK, AcknowledgmentControl.ACK
    for other in (
        Acknowledgment(nack, 0xFF, robot + 1, group), Acknowledgment(ack, 0xFF, robot, group),
        Acknowledgment(nack, 0xFF, robot, group + 0x100),
    ):  # fmt: skip
        bus.tell(other)
        assert bus.logged_in
    bus.tell(Acknowledgment(nack, 0xFF, robot, group))
    assert bus.client.server is None
    bus.until(bus.now_us + 4 * S)
    assert bus.logged_in and bus.client.sessions == 2


def test_a_simulated_fleet_does_not_answer_task_controllers() -> None:
    bus = Bus(4, diagnostics=False)
    bus.until(5 * S)
    assert bus.client.server is None
    assert not any(isinstance(m, ProcessData | WorkingSetMaster) for m in bus.heard)


def test_the_part_listens_to_the_implement() -> None:
    bus = Bus(4)
    assert ImplementLowered in bus.peer.named.tasks.listens


def set_to(bus: Bus, ddi: int, number: int) -> None:
    """The task controller sets a value of the implement."""
    bus.tell(ProcessData(b"\x13\x00" + ddi.to_bytes(2, "little") + number.to_bytes(4, "little")))


def test_a_robot_whose_work_is_off_stands_and_says_why() -> None:
    bus = Bus(4)
    bus.until(5 * S)
    safety = bus.peer.safety
    set_to(bus, 289, 0)
    assert (StopCause.WORK_OFF, f"address {SERVER}") in safety.causes and not safety.may_move
    assert "address 247" in sentence(StopCause.WORK_OFF.number, SERVER)
    bus.heard.clear()
    bus.until(bus.now_us + 2 * S)
    told = [m.cause for m in bus.heard if isinstance(m, Standstill)]
    assert StopCause.WORK_OFF.number in told
    set_to(bus, 289, 1)
    assert not safety.holds(StopCause.WORK_OFF)
    set_to(bus, 289, 0)
    silent = bus.now_us + 7 * S
    while bus.now_us < silent:
        bus.now_us += 10 * MS
        bus._take(bus.peer.step(Timer(), bus.now_us))
    assert not safety.holds(StopCause.WORK_OFF), "it ends with the session"


def test_a_section_that_is_off_raises_the_implement_and_the_robot_drives_on() -> None:
    class Watched(Eager):
        raised = 0

        def on_implement_raised(self) -> None:
            self.raised += 1

    mission = Watched()
    bus = Bus(4)
    motion = HolonomicMotion(0, BodyLimits(0.8, 2.5, 1.5), np.empty((0, 4)))
    bus.peer = make_peer(bus.peer.identity, Random(4), 0, {}, MissionParts(mission, motion))
    x_m = 0.0

    def drives(until_us: int) -> Drive:
        nonlocal x_m
        drive = Drive(0.0, 0.0)
        while bus.now_us < until_us:
            bus.now_us += 10 * MS
            x_m += drive.vx_m_s * 0.01
            here = Observation(x_m, 0.0, 0.0, drive.vx_m_s, 0.0, sensed_at_us=bus.now_us)
            if bus.peer.wants_observation(bus.now_us):
                bus._take(bus.peer.step(Sensed(here), bus.now_us))
            if bus.now_us % (2 * S) == 0:
                bus.tell(ProcessData(STATUS), GLOBAL_ADDRESS)
            bus.peer.step(BusState(Health.ACTIVE, True, bus.now_us), bus.now_us)
            effects = bus.peer.step(Timer(), bus.now_us)
            drive = next((e for e in effects if isinstance(e, Drive)), drive)
            bus._take(effects)
        return drive

    drives(5 * S)
    bus.peer.claims.current, bus.peer.lifecycle.machine.state = 0, State.WORKING
    held = bus.peer.safety.causes
    assert bus.logged_in and drives(bus.now_us + S).tool_on, held
    assert bus.peer.named.tasks.at_work
    set_to(bus, 160, 1)
    set_to(bus, 290, 0xFFFF_FFFC)
    mission.raised = 0
    drive = drives(bus.now_us + S)
    assert not drive.tool_on and drive.vx_m_s > 0.5 and mission.raised
    assert not bus.peer.named.tasks.at_work
    set_to(bus, 290, 0xFFFF_FFFD)
    assert drives(bus.now_us + S).tool_on
