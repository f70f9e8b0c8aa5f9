"""What a runner does with effects: nothing is said that the disk did not take."""

from collections.abc import Iterable, Mapping

import can

from agent.interface.effects import HALT, Drive, GatedDrive, Persist, Send
from agent.interface.lifecycle import State
from agent.runtime.peer_runner import ON_DISK_FIRST, PeerRunner
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member, Pose
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.work_frames import TaskClaim, WorkProgress
from protocol.links.bus import CanBus
from tests.agent.lone_peer import peer_in

ADDRESS = 128


class FullDisk:
    """A journal that can be read and accepts no write but the first ones."""

    def __init__(self, accepted: int) -> None:
        self.accepted = accepted

    def load(self) -> Mapping[str, bytes]:
        return {}

    def write(self, records: Iterable[Persist]) -> None:
        self.accepted -= 1
        if self.accepted < 0:
            raise OSError("no space left on device")


def test_a_robot_with_a_full_disk_says_nothing_that_would_have_to_be_on_it() -> None:
    """Found by `headland chaos`, profile claims, seed 940435: it answered a question with units that
    it had worked after the disk was full, and a restart forgot them."""
    peer = peer_in(State.WORKING, None)
    with (
        can.Bus("full-disk", interface="virtual") as ours,
        can.Bus("full-disk", interface="virtual") as theirs,
    ):
        runner = PeerRunner(peer, CanBus(ours), None, FullDisk(1), clock=lambda: 0)
        runner.perform([Persist("incarnation", b"1")])
        runner.perform([Persist("unit", b"1"), Send(WorkProgress(1, 0, 1))])
        said: list[Message] = [
            WorkProgress(1, 0, 1),
            TaskClaim(1, 0, Phase.CLAIMED, 3, 1, 0),
            Pose(0.0, 0.0, 0.0, 0.0, State.EMERGENCY_STOP, True, 255),
            EmergencyStop(0, 1, 1, 1),
        ]
        for message in said:
            runner.perform([Send(message, source=ADDRESS)])
        heard = []
        while (frame := theirs.recv(0.0)) is not None:
            heard.append((frame.arbitration_id, bytes(frame.data)))
        for message in said:
            frame_of = encode(message, ADDRESS)
            sent = (frame_of.identifier, frame_of.data) in heard
            assert sent is not isinstance(message, ON_DISK_FIRST), message


def test_a_robot_whose_disk_is_full_at_its_start_does_not_join() -> None:
    """Found by `headland chaos`, profile crash, seed 103000061: it told its fleet an incarnation that a
    restart forgot. A restart would use it again, for other stops."""
    peer = peer_in(State.WORKING, None)
    with (
        can.Bus("full-at-start", interface="virtual") as ours,
        can.Bus("full-at-start", interface="virtual") as theirs,
    ):
        runner = PeerRunner(peer, CanBus(ours), None, FullDisk(0), clock=lambda: 0)
        runner.perform([Persist("incarnation", b"1"), Send(AddressClaimed(1), source=ADDRESS)])
        runner.perform([Send(Member(0, 1, 1), source=ADDRESS)])
        runner.perform([Send(Pose(0.0, 0.0, 0.0, 0.0, State.IDLE, False, 255), source=ADDRESS)])
        assert theirs.recv(0.0) is None
        runner.perform([Send(EmergencyStop(0, 1, 1, 1), source=ADDRESS)])
        assert theirs.recv(0.0) is not None


class Wheels:
    """A body that notes what it was told."""

    def __init__(self) -> None:
        self.told: list[Drive] = []

    def sense(self, now_us: int) -> None:
        return None

    def drive(self, drive: Drive, now_us: int) -> None:
        self.told.append(drive)


def test_no_command_follows_the_halt_of_a_disk_that_failed() -> None:
    """The other effects of that turn go on, and the drive that was decided before was among them."""
    peer, wheels = peer_in(State.WORKING, None), Wheels()
    with can.Bus("failed-disk", interface="virtual") as ours:
        runner = PeerRunner(peer, CanBus(ours), wheels, FullDisk(0), clock=lambda: 0)
        runner.perform([Persist("unit", b"1"), GatedDrive(Drive(2.0, 0.0, 0.0, True))])
        runner.perform([GatedDrive(Drive(2.0, 0.0, 0.0, True))])
    assert wheels.told and set(wheels.told) == {HALT}
