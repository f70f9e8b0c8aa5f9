"""`headland tc` among the other devices of its bus, in virtual time. Found by a review."""

from math import inf
from random import Random
from types import SimpleNamespace
from typing import Any, Final, cast

from agent.implements.task_controller import (
    ADDRESS,
    CLAIM_PGN,
    TaskController,
    controller_name,
)
from agent.interface.observation import Observation
from agent.peer.diagnostics import COMPONENT_PGN
from protocol.device_description import DeviceDescription
from protocol.extended_transport import ExtendedControl
from protocol.frames.codec import decode, encode
from protocol.frames.diagnostic_frames import DM1
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.network_frames import (
    Acknowledgment,
    AcknowledgmentControl,
    AddressClaimed,
    ExtendedTransportManagement,
    Request,
    TransportData,
    TransportManagement,
)
from protocol.frames.task_frames import PROCESS_DATA, ProcessData, WorkingSetMaster
from protocol.name import fleet_name
from protocol.task_client import JoinWorkingSet, SessionOutput, SessionState, TaskClient
from protocol.transport import Transport, TransportControl
from protocol.units import MS, S
from sim.rigs.implements_rig import CONDENSED_MAKER, SPRAYER, ControllerNode, RigBus, Sprayer

ROBOT: Final = 131


def controller(now_us: int, *quiet_for_us: int) -> TaskController:
    """One that gets no places."""
    ground, fixes = cast(Any, SimpleNamespace()), SimpleNamespace(take=lambda *given: None)
    return TaskController(
        controller_name(5), ground, cast(Any, fixes), 0.0, Random(1), now_us, *quiet_for_us
    )


class RobotNode:
    """A robot as it logs in at a task controller."""

    def __init__(self) -> None:
        self.name = fleet_name("north", 3)
        self.client = TaskClient(DeviceDescription(self.name, "robot 3", "1", 3000))
        self.transport = Transport()
        self.claimed = False

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame; returns the answers."""
        source, message = decode(frame)
        if Identifier.unpack(frame.identifier).destination not in (ROBOT, 255):
            return []
        if isinstance(message, ProcessData):
            return self._sent(self.client.on_message(source, message.body, {}, now_us), now_us)
        if isinstance(message, TransportManagement | TransportData):
            out, _ = self.transport.on_message(source, ROBOT, message, now_us)
            return [encode(each.message, ROBOT, each.destination) for each in out]
        return [self._claim()] if isinstance(message, Request) else []

    def turns(self, now_us: int) -> list[Frame]:
        """Send what is due."""
        frames = [] if self.claimed else [self._claim()]
        self.claimed = True
        out = self.transport.on_tick(now_us)
        frames += [encode(each.message, ROBOT, each.destination) for each in out]
        return frames + self._sent(self.client.on_timer({}, now_us), now_us)

    def _claim(self) -> Frame:
        return encode(AddressClaimed(self.name.pack()), ROBOT)

    def _sent(self, said: list[SessionOutput], now_us: int) -> list[Frame]:
        frames = []
        for each in said:
            server = self.client.server or 0
            if isinstance(each, JoinWorkingSet):
                frames.append(encode(WorkingSetMaster(1), ROBOT))
            elif len(each.data) == PROCESS_DATA.length:
                frames.append(encode(ProcessData(each.data), ROBOT, server))
            else:
                out = self.transport.send(PROCESS_DATA.pgn, each.data, server, now_us) or ()
                frames += [encode(one.message, ROBOT, one.destination) for one in out]
        return frames


def no_cells(row: int, columns: tuple[int, ...]) -> None:
    """Nothing is worked here."""


def test_an_implement_logs_in_at_a_task_controller_that_was_started_again() -> None:
    """It had missed no status, so it took the new one for the one before, and was served by none."""
    bus, sprayer = RigBus(1), Sprayer(CONDENSED_MAKER, 7)
    node = ControllerNode(controller(0, 0), no_cells)
    bus.attach(node)
    bus.attach(sprayer)
    bus.run(0, 5 * S)
    assert sprayer.phase == "in" and list(node.controller.implements) == [SPRAYER]
    node.controller = controller(6 * S)
    bus.run(6 * S, 20 * S)
    assert list(node.controller.implements) == [SPRAYER] and sprayer.log_ins == 2


def test_a_robot_that_logs_in_is_not_switched() -> None:
    """Its implement was up for good, as the task controller took it for one on the hitch."""
    bus, robot, sprayer = RigBus(1), RobotNode(), Sprayer(CONDENSED_MAKER, 7)
    node = ControllerNode(controller(0, 0), no_cells)
    for each in (node, robot, sprayer):
        bus.attach(each)
    bus.run(0, 10 * S)
    assert robot.client.state is SessionState.CONNECTED
    assert not robot.client.section_off and not robot.client.setpoints
    assert list(node.controller.implements) == [SPRAYER] and sprayer.automatic


def test_broadcasts_of_other_devices_keep_no_implement_out() -> None:
    """Their faults go by BAM. Eight at a time took all sessions, and a description was refused."""
    bus, sprayer = RigBus(1), Sprayer(CONDENSED_MAKER._replace(sections=8), 7)
    node = ControllerNode(controller(0, 0), no_cells)
    bus.attach(node)
    bus.attach(sprayer)
    node.turns(0)
    for step in range(1000):
        for source in range(1, 13):
            faults = TransportManagement(TransportControl.BAM, bytes((14, 0, 2, 0xFF)), DM1.pgn)
            node.hears(encode(faults, source), 10 * MS * step)
        bus.run(10 * MS * step, 10 * MS * (step + 1))
    assert list(node.controller.implements) == [SPRAYER] and sprayer.log_ins == 1


def test_a_group_that_it_does_not_have_is_refused() -> None:
    """A device that asks it alone waited for an answer; ISO 11783-3 wants a refusal."""
    node = ControllerNode(controller(0, 0), no_cells)
    for step in range(1000):
        node.turns(step * MS)
    address = node.controller.claim.address
    assert address == ADDRESS
    for asked, refuses in ((address, True), (GLOBAL_ADDRESS, False), (address + 1, False)):
        answers = node.hears(encode(Request(COMPONENT_PGN), ROBOT, asked), 2 * S)
        refusal = Acknowledgment(AcknowledgmentControl.NACK, 0xFF, ROBOT, COMPONENT_PGN)
        assert answers == ([encode(refusal, address)] if refuses else [])


def test_it_asks_once_who_is_there() -> None:
    """The receiver had claimed its address before, so another device that took it passed for it."""
    node, asked = (
        ControllerNode(controller(0, 0), no_cells),
        encode(Request(CLAIM_PGN), NULL_ADDRESS),
    )
    sent = [frame for step in range(1000) for frame in node.turns(step * MS)]
    assert sent.count(asked) == 1


def test_a_long_message_to_all_opens_no_session() -> None:
    """ISO 11783-3 has none. Four such frames took all sessions, and each was answered."""
    node = ControllerNode(controller(0, 0), no_cells)
    for step in range(1000):
        node.turns(step * MS)
    announced = ExtendedTransportManagement(
        ExtendedControl.RTS, (5000).to_bytes(4, "little"), PROCESS_DATA.pgn
    )
    assert node.hears(encode(announced, ROBOT, GLOBAL_ADDRESS), S) == []
    assert node.hears(encode(announced, ROBOT, ADDRESS), S) != []


def test_a_place_without_a_fix_is_no_place() -> None:
    """Ground was taken for worked at places that the receiver itself said to be none."""
    seen = [Observation(0.0, 0.0, 0.0, 1.0, 0.0, sensed_at_us=0, position_accuracy_m=inf)]
    fixes = SimpleNamespace(take=lambda *given: seen.pop())
    control = TaskController(
        controller_name(5), cast(Any, SimpleNamespace()), cast(Any, fixes), 0.0, Random(1), 0
    )
    control.on_frame(encode(Request(CLAIM_PGN), 7), S)
    assert control.here is None
    seen.append(Observation(0.0, 0.0, 0.0, 1.0, 0.0, sensed_at_us=S, position_accuracy_m=0.4))
    control.on_frame(encode(Request(CLAIM_PGN), 7), S)
    assert control.here is not None
