"""The course that a pose tells: where the robot drives to, and where it points while it stands."""

from math import pi

import pytest

from agent.interface.config import MS
from agent.interface.effects import Send
from agent.interface.lifecycle import State
from agent.interface.observation import Observation
from agent.peer.inputs import BusState, Sensed, Timer
from protocol.controller_health import Health
from protocol.frames.fleet_frames import Pose
from tests.agent.lone_peer import peer_in


@pytest.mark.parametrize(
    ("vx_m_s", "vy_m_s", "told_rad"), [(0.0, 0.0, 1.0), (0.01, 0.0, 1.0), (0.0, 2.0, pi / 2)]
)
def test_a_pose_tells_the_heading_of_a_robot_that_stands_and_the_course_of_one_that_drives(
    vx_m_s: float, vy_m_s: float, told_rad: float
) -> None:
    peer, said = peer_in(State.IDLE, None), list[Pose]()
    for now_us in range(0, 1_000 * MS, 50 * MS):
        peer.step(BusState(Health.ACTIVE, True, now_us), now_us)
        place = 2.0 + vx_m_s * now_us / 1e6, 3.0 + vy_m_s * now_us / 1e6
        seen = Observation(*place, 1.0, vx_m_s, vy_m_s, sensed_at_us=now_us, under_way=False)
        peer.step(Sensed(seen), now_us)
        sends = [each for each in peer.step(Timer(), now_us) if isinstance(each, Send)]
        said += [send.message for send in sends if isinstance(send.message, Pose)]
    assert said and said[-1].speed_m_s < 3.0, "its place is known"
    assert said[-1][:2] == pytest.approx(place, abs=0.2)
    assert said[-1][2] == pytest.approx(told_rad)
