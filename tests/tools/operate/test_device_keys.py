"""Tools that run for hours with one key file: an open map, a conversation, a stop that is held."""

from pathlib import Path

import pytest

from agent.runtime.files.key_file import OPERATOR, RESERVE, counter, fresh, read, read_robot, write
from agent.runtime.files.key_folder import owned
from protocol.authentication import ASK_SPACING_US, Keyring
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import Command, EmergencyStop, OperatorCommand, Reason
from tools.livemap.stop_panel import Panel
from tools.operate.device_keys import DeviceKeys
from tools.operate.operator_device import Operator
from tools.operate.reset import operator_keys

OWNER = 249


class Line:
    """A bus that keeps the stops and orders that a tool signs."""

    def __init__(self) -> None:
        self.signed: list[EmergencyStop | OperatorCommand] = []

    def send(self, frame: Frame) -> bool:
        message = decode(frame)[1]
        if isinstance(message, EmergencyStop | OperatorCommand):
            self.signed.append(message)
        return True

    def subscribe(self, callback: object) -> None:
        """Nothing comes."""


class Fleet:
    """The folder of a fleet's keys, and what one robot of it believes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        write(folder / "fleet.json", folder / "operator.json", fresh(), OWNER, range(1))
        self.robot, self.now_us = Keyring(read_robot(folder, 0).keys, 0, b"robot"), 0

    def rotate(self) -> None:
        """The robot has other keys from now on, and so has the folder."""
        owner = owned(self.folder)
        begun = owner.begin()
        self.robot.rekey(begun.keys)
        owner.finish(begun)

    def believes(self, message: EmergencyStop | OperatorCommand, keyring: Keyring | None) -> bool:
        """Whether the robot takes this frame, if need be after it has asked for the counter."""
        assert keyring is not None
        self.now_us += 2 * ASK_SPACING_US
        if self.robot.verify(message, keyring.sender, self.now_us):
            return True
        question = self.robot.ask(keyring.sender, self.now_us)
        answer = None if question is None else keyring.answer(question, self.now_us)
        return answer is not None and self.robot.prove(answer, self.now_us)


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    return Fleet(tmp_path)


def test_a_map_that_is_open_over_a_rotation_stops_robots_with_their_new_keys(fleet: Fleet) -> None:
    """Robots only braked while it was pressed, and drove on."""
    line = Line()
    stopper = Panel(line, DeviceKeys(fleet.folder)).stopper  # type: ignore[arg-type]
    for rotated in (False, True, True):
        if rotated:
            fleet.rotate()
        stopper.begin_press()
        stopper.stop(stopper.new_stop(Reason.OPERATOR_INTERVENTION))
        assert fleet.robot.verify(line.signed[-1], stopper.slot, 0), "without a question"


def test_keys_that_are_rotated_during_a_press_are_used_by_it(fleet: Fleet) -> None:
    line = Line()
    stopper = Operator(line, DeviceKeys(fleet.folder))  # type: ignore[arg-type]
    stopper.begin_press()
    stop = stopper.new_stop(Reason.OPERATOR_INTERVENTION)
    stopper.stop(stop)
    fleet.rotate()
    stopper.stop(stop)
    assert fleet.robot.verify(line.signed[-1], stopper.slot, 0)


def test_a_conversation_is_believed_after_a_release_and_after_a_rotation(fleet: Fleet) -> None:
    """Another tool had signed with a later part of the counter, and robots took no stop from the
    conversation any more."""
    line = Line()
    say = Operator(line, operator_keys(fleet.folder))  # type: ignore[arg-type]
    release = read(fleet.folder, OPERATOR).keyring()
    assert fleet.believes(release.sign(OperatorCommand(Command.START, 0, OWNER)), release)
    for rotated in (False, True):
        if rotated:
            fleet.rotate()
        say.begin()
        say.stop(say.new_stop(Reason.OPERATOR_INTERVENTION))
        assert fleet.believes(line.signed[-1], say.keyring)
    before = counter(fleet.folder / "operator.json")
    say.begin()
    assert counter(fleet.folder / "operator.json") == before, "no other tool has signed since"


def test_a_stop_that_is_held_for_minutes_signs_only_what_is_reserved(fleet: Fleet) -> None:
    """`headland stop --hold` signs 200 frames a second. Their counters were used again later, and robots
    took no release with this file until it had counted on."""
    path, line = fleet.folder / "operator.json", Line()
    stopper = Operator(line, DeviceKeys(path))  # type: ignore[arg-type]
    stopper.begin_press()
    stop = stopper.new_stop(Reason.OPERATOR_INTERVENTION)
    for _ in range(RESERVE + 2):
        stopper.stop(stop)
    assert fleet.believes(line.signed[-1], stopper.keyring)
    assert stopper.keyring is not None and stopper.keyring.sent <= counter(path)
    release = read(path, OPERATOR).keyring()
    assert fleet.believes(release.sign(OperatorCommand(Command.START, 0, OWNER)), release)


def test_a_key_file_that_is_gone_or_damaged_leaves_a_panel_its_keys(fleet: Fleet) -> None:
    keys = DeviceKeys(fleet.folder)
    before = keys.begin()
    (fleet.folder / "panel.json").write_text("{")
    assert keys.begin() is keys.newest() is before
    (fleet.folder / "panel.json").unlink()
    assert keys.begin() is keys.newest() is before


def test_an_operator_that_can_count_no_further_stops_unsigned_and_goes_on_later(
    fleet: Fleet,
) -> None:
    path, line = fleet.folder / "operator.json", Line()
    stopper = Operator(line, DeviceKeys(path))  # type: ignore[arg-type]
    beside = fleet.folder / "operator.json.counter"
    beside.write_text("damaged")
    stopper.begin_press()
    stopper.stop(stopper.new_stop(Reason.OPERATOR_INTERVENTION))
    assert line.signed[-1].tag == 0 and stopper.keyring is None
    beside.write_text("8192")
    stopper.begin_press()
    stopper.stop(stopper.new_stop(Reason.OPERATOR_INTERVENTION))
    assert fleet.believes(line.signed[-1], stopper.keyring)
