"""A driver of a differential rover: NMEA 0183 in, wheel speeds out (docs/use/own_machine.md)."""

from typing import Any

from headland.agent.interface.effects import HALT, GatedDrive
from headland.agent.interface.observation import Observation
from headland.agent.motion.wheel_kinematics import WheelBase, WheelDrive
from headland.agent.runtime.bodies.line_port import LinePort
from headland.agent.runtime.bodies.nmea_body import in_field
from headland.agent.runtime.bodies.position_fixes import PositionFixes, ReceiverClock, course_rad
from headland.agent.runtime.bodies.wheel_sentences import WheelSentence, pack
from headland.agent.runtime.robot_body import DeclaredMachine, RobotBody
from pynmeagps import NMEAReader


class Rover(RobotBody):
    def __init__(self, slot: int, gnss: int = 5001, wheels: int = 5002) -> None:
        self.receiver = LinePort(f"tcp://127.0.0.1:{gnss}", self.take, receives=True)
        self.controller = LinePort(f"tcp://127.0.0.1:{wheels}", lambda line, at_us: None)
        self.clock = ReceiverClock(latency_us=20_000)  # a place takes this long at the shortest
        self.newest: Observation | None = None

    def declare(self, machine: DeclaredMachine) -> None:
        if machine.origin is None:
            raise ValueError("the origin is missing: --origin, or [field] of the robot file")
        self.fixes = PositionFixes(in_field(machine.origin), antenna_m=(0.0, 0.0))  # ahead, left
        self.wheel_drive = WheelDrive(WheelBase.of(machine.vehicle, wheel_radius_m=0.1))

    async def open(self) -> None:
        self.newest = None
        self.receiver.open()
        self.controller.open()

    def take(self, line: bytes, at_us: int) -> None:
        said: Any = NMEAReader.parse(line + b"\r\n")
        if said.msgID == "GGA" and said.quality in (1, 2, 4, 5):  # others are no fix
            t = said.time
            utc_us = (t.hour * 3600 + t.minute * 60 + t.second) * 1_000_000 + t.microsecond
            self.fixes.take_kind(said.quality, at_us)  # RTK, or metres off
            self.fixes.take_place(said.lon, said.lat, self.clock.sensed_at_us(utc_us, at_us))
        elif said.msgID == "GST":
            self.fixes.take_accuracy(max(said.stdLat, said.stdLong), at_us)
        elif said.msgID == "VTG":
            self.fixes.take_speed(said.sogk / 3.6, course_rad(said.cogt), at_us)
        elif said.msgID == "HDT":
            self.fixes.take_heading(course_rad(said.headingT), at_us)
        self.newest = self.fixes.whole(at_us) or self.newest

    def sense(self, now_us: int) -> Observation | None:
        return self.newest

    def drive(self, command: GatedDrive, now_us: int) -> None:
        if self.newest is not None:
            speeds = self.wheel_drive.speeds(command, self.newest.heading_rad)
            self.controller.write(pack(WheelSentence(0, 100, command.tool_on, speeds)))

    def close(self) -> None:
        self.drive(HALT, 0)
        self.receiver.close()
        self.controller.close()
