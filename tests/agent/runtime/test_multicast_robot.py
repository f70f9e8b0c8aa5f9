"""A robot on UDP multicast, which returns its own frames to it."""

import asyncio
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from secrets import randbelow

import can
import pytest

from agent.peer.inputs import Press
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_file import RobotFile
from agent.runtime.robot_process import run_robot
from agent.safety.stop_cause import StopCause
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import AllImplementsStop, Reason, Switch
from tests.multicast import reached

INTERFACE, LIMIT_S, LOOK_S = "udp_multicast", 30.0, 0.01
BUTTON = 200  # behind the addresses of robots, so that a robot that holds is named first
EX_TEMPFAIL = 75  # `headland@.service` starts a robot again after this


@pytest.fixture
def group() -> str:
    """A channel of datagrams that reach this machine itself."""
    return reached(f"239.74.166.{1 + randbelow(250)}")


@pytest.fixture
def plain(group: str) -> Iterator[can.BusABC]:
    """Another device in the group."""
    with can.Bus(group, INTERFACE) as bus:
        yield bus


def document(group: str, folder: Path) -> RobotFile:
    return RobotFile.of(
        {
            "name": "multicast", "robot": {"slot": 0}, "fleet": {"robots": 1},
            "bus": {"interface": INTERFACE, "channel": group},
        }, "robot.toml", folder,
    )  # fmt: skip


def test_a_robot_does_not_take_its_own_stop_frame_for_the_button_of_another_maker(
    group: str, plain: can.BusABC, tmp_path: Path
) -> None:
    """It stood for `IMPLEMENTS_STOP with address 128`, its own address. Another machine at that
    address still stops it."""

    async def main() -> None:
        end, runners, loop = asyncio.Event(), list[PeerRunner](), asyncio.get_running_loop()
        robot = document(group, tmp_path)
        running = asyncio.create_task(
            run_robot(robot, end, first_boot=True, started=runners.append)
        )

        async def turn() -> None:
            assert not running.done(), running.result()
            turn = loop.create_future()
            loop.call_later(LOOK_S, turn.set_result, None)
            await turn

        async def held_by() -> str:
            while (cause := StopCause.IMPLEMENTS_STOP) not in (found := dict(peer.safety.causes)):
                await turn()
            return found[cause]

        def says(frame: Frame) -> None:
            plain.send(can.Message(arbitration_id=frame.identifier, data=frame.data))

        async with asyncio.timeout(LIMIT_S):
            while not runners or runners[0].peer.address is None:
                await turn()
            peer = runners[0].peer
            runners[0].operate(Press(Reason.PERSON_IN_FIELD))
            stop = encode(AllImplementsStop(1, Switch.STOP), peer.address or 0)
            while (heard := plain.recv(0.0)) is None or heard.arbitration_id != stop.identifier:
                if heard is None:
                    await turn()
            assert bytes(heard.data) == stop.data
            says(encode(AllImplementsStop(1, Switch.STOP), BUTTON))
            assert await held_by() == f"address {BUTTON}"
            says(encode(AllImplementsStop(2, Switch.PERMIT), BUTTON))
            says(stop)
            while await held_by() != f"address {peer.address}":
                await turn()
            end.set()
            await running

    asyncio.run(main())


def test_a_robot_that_is_started_before_its_network_interface_is_there_ends_with_code_75(
    tmp_path: Path,
) -> None:
    """The code was 2, after which systemd does not start a robot again."""
    namespace = ["unshare", "-rn"]
    if shutil.which("unshare") is None or subprocess.run([*namespace, "true"]).returncode:
        pytest.skip("no network of its own can be made here")
    file = tmp_path / "robot.toml"
    file.write_text(
        'name = "absent"\n[fleet]\nrobots = 1\n[robot]\nslot = 0\njournal = "."\n'
        f'[bus]\ninterface = "{INTERFACE}"\nchannel = "239.74.166.1"\n'
    )
    module = ["-P", "-m", "agent.runtime.robot_process", str(file), "--first-boot"]
    found = subprocess.run(
        [*namespace, sys.executable, *module], capture_output=True, text=True, timeout=120
    )
    assert found.returncode == EX_TEMPFAIL, found.stderr
    assert "robot 0: bus: cannot open udp_multicast 239.74.166.1" in found.stderr
