"""A robot of the coverage mission that is put down beside its map, or whose place is not believed."""

from collections.abc import Callable
from math import inf
from pathlib import Path
from random import Random

from agent.coverage.coverage_mission import GridWork
from agent.interface.config import S
from agent.interface.effects import HALT, Drive, Send
from agent.interface.observation import Observation
from agent.peer.inputs import BusState, Hold, Sensed, Start, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import identity_of, make_peer
from agent.runtime.robot_file import RobotFile
from agent.runtime.robot_work import work_of
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from tests.agent.lone_peer import held_by

MAP = "\n".join(["@" * 12, *["@..........@"] * 6, "@" * 12])
WALL = "\n".join(["@" * 12, *["@.....@....@"] * 5, "@..........@", "@" * 12])
Place = Callable[[int, float, float], tuple[float, float]]


def robot(cells: str = MAP) -> Peer:
    file = RobotFile.of(
        {
            "name": "n", "robot": {"slot": 0},
            "fleet": {"robots": 2, "radius_m": 0.3, "speed_m_s": 1.0},
            "coverage": {"map": cells, "cell_m": 2.0},
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


def test_a_robot_that_is_moved_across_a_wall_does_not_drive_through_it() -> None:
    """It drove straight back to the cell that it had been on its way to, through the wall."""
    peer = robot(WALL)
    mission = peer.mission
    assert isinstance(mission, GridWork)
    told: set[str] = set()
    beyond: list[tuple[float, float]] = []

    def moved(now_us: int, x_m: float, y_m: float) -> tuple[float, float]:
        """People hold the robot, push it slowly across the wall, and start it."""
        for name, at_us, command in (("hold", 8 * S, Hold()), ("start", 22 * S, Start())):
            if now_us >= at_us and name not in told:
                told.add(name)
                peer.step(command, now_us)
        by_m = 0.8 * min(max(now_us - 9 * S, 0), 12 * S) / S
        if now_us > 22 * S:
            beyond.append((x_m - by_m, y_m))
        return x_m - by_m, y_m

    drive(peer, moved, 45 * S)
    assert not held_by(peer)
    assert all(mission.ground.at(x_m, y_m) >= 0 for x_m, y_m in beyond)
    ends = [x_m for x_m, _ in beyond]
    assert max(ends) < 1.0 and max(ends) - min(ends) > 4.0, "it works on, on that side"
