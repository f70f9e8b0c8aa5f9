"""A robot that begins on a bus that was up before: it learns the NAME of its receiver by asking."""

import asyncio
from typing import Any

import can
import pytest

from agent.interface.vehicle import DriveTrain, Vehicle
from agent.runtime.bodies.isobus_body import IsobusBody
from agent.runtime.bodies.nmea_body import NmeaBody
from agent.runtime.robot_body import DeclaredMachine
from protocol.frames.frame import Frame
from protocol.frames.identifier import Identifier

RECEIVER, ORIGIN = 28, (0.0, 0.0)
OURS, OTHER = 0xA0_00_00_00_00_00_00_02, 0xA0_00_00_00_00_00_00_01
CLAIMS_WANTED = 0x18EAFFFE  # a request for a group, to all, from the null address
HEADING = (0x09F1121C, bytes.fromhex("01 0000 FF7F FF7F FC"))


def claim(address: int, name: int) -> tuple[int, bytes]:
    return Identifier(6, 0xEE00, 255, address).pack(), name.to_bytes(8, "little")


def place(latitude_bits: int) -> tuple[int, bytes]:
    return 0x09F8011C, latitude_bits.to_bytes(4, "little") + bytes(4)


def of_kind(kind: str) -> tuple[Any, Vehicle]:
    if kind == "isobus":
        body: Any = IsobusBody(1, kind, "virtual", accuracy_m=0.02, origin=ORIGIN)
        return body, Vehicle(drive=DriveTrain.ACKERMANN)
    wheels = "udp://127.0.0.1:15028"
    return NmeaBody(0, f"can:virtual:{kind}", wheels, accuracy_m=0.02, origin=ORIGIN), Vehicle()


@pytest.mark.parametrize("kind", ["isobus", "nmea"])
def test_another_device_that_takes_the_address_of_the_receiver_is_not_taken_for_it(
    kind: str,
) -> None:
    """No claim had been heard, so the first one was believed to be the receiver's."""

    async def story() -> None:
        body, vehicle = of_kind(kind)
        body.declare(DeclaredMachine(vehicle, None))
        with can.Bus(kind, interface="virtual") as bus:

            def send(*frames: tuple[int, bytes]) -> None:
                for identifier, data in frames:
                    bus.send(can.Message(arbitration_id=identifier, data=data))

            opening, asked = asyncio.create_task(body.open()), 0
            fixes = body.fixes if kind == "isobus" else body.frames
            async with asyncio.timeout(10.0):
                while not opening.done() or fixes.receiver.name is None:
                    send(place(0), HEADING)
                    message = await asyncio.to_thread(bus.recv, 0.01)
                    if message is not None and message.arbitration_id == CLAIMS_WANTED:
                        assert bytes(message.data) == b"\x00\xee\x00"
                        asked += 1
                        send(claim(RECEIVER, OURS))
            await opening
            assert asked == 1
            # An implement with a receiver of its own takes the address, and is a hundred metres off.
            for each in (claim(RECEIVER, OTHER), place(9000), HEADING):
                body._heard(Frame(*each))
            assert body.sense(0).y_m == pytest.approx(0.0, abs=0.01)
            body.close()

    asyncio.run(story())
