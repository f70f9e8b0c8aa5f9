"""A robot for which no address is left is no member: it stands, and says why."""

from math import hypot, pi

from agent.interface.config import MS, S
from agent.interface.effects import Drive
from agent.interface.lifecycle import State
from agent.peer.inputs import BusState, Heard, Sensed, Timer
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.fleet_frames import Pose
from protocol.frames.network_frames import AddressClaimed
from tests.agent.lone_peer import held_by, introduce, peer_in

ADDRESSES = range(128, 248)  # that a robot may claim
BESIDE = 100


def test_a_robot_without_an_address_stands_and_says_why() -> None:
    """Another one comes towards it. It gives way to nobody, because nobody knows where it is."""
    peer = peer_in(State.DISCONNECTED, None)
    fastest_m_s = 0.0
    for now_us in range(0, 12 * S, 50 * MS):
        for address in ADDRESSES:
            peer.step(Heard(address, AddressClaimed(0)), now_us)
        if not now_us:
            introduce(peer, BESIDE, 1)
        x_m = max(1.5, 6.0 - now_us / S)
        peer.step(Heard(BESIDE, Pose(x_m, 0.1, pi, 1.0, State.WORKING, False, 0)), now_us)
        peer.step(BusState(Health.ACTIVE, True, now_us), now_us)
        assert peer.here is not None
        peer.step(Sensed(peer.here._replace(sensed_at_us=now_us)), now_us)
        for effect in peer.step(Timer(), now_us):
            if isinstance(effect, Drive):
                fastest_m_s = max(fastest_m_s, hypot(effect.vx_m_s, effect.vy_m_s))
    assert peer.address is None and peer.state is State.DISCONNECTED
    assert StopCause.ADDRESS_LOST in held_by(peer)
    assert fastest_m_s == 0.0
