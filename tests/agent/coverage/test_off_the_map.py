"""A robot of the coverage mission that is put down beside its map, or whose place is not believed."""

from collections.abc import Callable
from math import inf
from pathlib import Path
from random import Random

from agent.interface.config import S
from agent.interface.effects import HALT, Drive, Send
from agent.interface.observation import Observation
from agent.peer.inputs import BusState, Sensed, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import identity_of, make_peer
from agent.runtime.robot_file import RobotFile
from agent.runtime.robot_work import work_of
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from tests.agent.lone_peer import held_by

MAP = "\n".join(["@" * 12, *["@..........@"] * 6, "@" * 12])
Place = Callable[[int, float, float], tuple[float, float]]


def robot() -> Peer:
    file = RobotFile.of(
        {
            "name": "n", "robot": {"slot": 0},
            "fleet": {"robots": 2, "radius_m": 0.3, "speed_m_s": 1.0},
            "coverage": {"map": MAP, "cell_m": 2.0},
        },
        "r.toml", Path(),
    )  # fmt: skip
    work = work_of(file, 0, {})
    identity = identity_of("n", 0, 2, work.field_hash, file.fleet.silence_policy, first_boot=True)
    return make_peer(identity, Random(1), 0, {}, work.parts)


def drive(peer: Peer, place: Place, until_us: int) -> float:
    """The metres that it drives; `place`: what it senses at a time and a true place."""
    now_us, told, sent, x_m, y_m, way_m = 0, HALT, 0, 5.0, 5.0, 0.0
    while now_us < until_us:
        then_us = max(now_us + 1, peer.due_at_us)
        passed_for_s = (then_us - now_us) / S
        x_m, y_m = x_m + told.vx_m_s * passed_for_s, y_m + told.vy_m_s * passed_for_s
        way_m += (abs(told.vx_m_s) + abs(told.vy_m_s)) * passed_for_s
        now_us = then_us
        peer.step(BusState(Health.ACTIVE, True, sent), now_us)
        if peer.wants_observation(now_us):
            seen = Observation(
                *place(now_us, x_m, y_m), 0.0, told.vx_m_s, told.vy_m_s, (inf,) * 36,
                sensed_at_us=now_us,
            )  # fmt: skip
            peer.step(Sensed(seen), now_us)
        for effect in peer.step(Timer(), now_us):
            sent += isinstance(effect, Send)
            told = effect if isinstance(effect, Drive) else told
    return way_m


def covered(peer: Peer) -> int:
    return sum(peer.progress.bits(s, b).bit_count() for s in peer.progress.units for b in range(4))


def test_a_robot_beside_the_map_stands_and_goes_on_living() -> None:
    peer = robot()
    assert drive(peer, lambda now_us, x_m, y_m: (500.0, 500.0), 5 * S) == 0.0
    assert covered(peer) == 0


def test_a_place_that_is_not_believed_covers_nothing() -> None:
    def jumping(now_us: int, x_m: float, y_m: float) -> tuple[float, float]:
        if now_us < 3 * S:
            return x_m, y_m
        cell = (now_us - 3 * S) // S
        return -9.0 + 2.0 * (cell % 10), -5.0 + 2.0 * (cell // 10 % 6)

    peer = robot()
    drive(peer, jumping, 30 * S)
    assert StopCause.PLACE_LOST in held_by(peer)
    assert covered(peer) <= 2
