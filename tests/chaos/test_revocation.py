"""New keys for a fleet at work: it goes on, and a revoked robot is no longer a member."""

from pathlib import Path

import pytest

from agent.interface.lifecycle import State
from agent.runtime.files.key_file import fresh, write
from agent.safety.stop_cause import StopCause
from protocol.rekeying import NOBODY, Rekeying, own_key, seal
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse
from sim.scenarios.scenario import load
from tests.chaos.at_work import Done, Story, at_work

SECRET = bytes(range(16))


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    return tmp_path / "fleet.json"


def play(keys: Path, story: Story) -> None:
    at_work(load("small").changed(3, 5, keys), story)


async def give(cluster: Cluster, new: Rekeying, *slots: int) -> None:
    root = cluster.setting.root
    assert root is not None
    for slot in slots:
        for part in seal(new, own_key(root, slot), slot):
            cluster.inject(part)
    await elapse(0.5)


def generations(cluster: Cluster) -> list[int]:
    return [robot.peer.named.keys.generation for robot in cluster.running]


def test_keys_are_rotated_while_the_fleet_works(keys: Path) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        for number in (1, 2):
            new = Rekeying(number, SECRET, NOBODY)
            await give(cluster, new, 0, 1, 2)
            assert generations(cluster) == [number - 1] * 3, "nobody uses them before they are told"
            cluster.inject(new._replace(secret=bytes(16)).switch())
            await elapse(0.2)
            assert generations(cluster) == [number - 1] * 3, "a forger cannot tell them"
            cluster.inject(new.switch())
            await elapse(0.2)
            assert generations(cluster) == [number] * 3
            await elapse(3.0)
            assert {r.peer.state for r in cluster.running} <= {State.WORKING, State.IDLE}
            assert all(r.peer.membership.live == {0, 1, 2} for r in cluster.running)
        cluster.press(1)
        await elapse(0.2)
        assert {r.peer.state for r in cluster.running} == {State.EMERGENCY_STOP}

    play(keys, story)


def test_a_revoked_robot_is_no_member_and_the_others_go_on(keys: Path) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        new = Rekeying(1, SECRET, 2)
        await give(cluster, new, 0, 1)
        cluster.inject(new.switch())
        await elapse(5.0)
        for robot in cluster.running[:2]:
            assert robot.peer.membership.live == {0, 1} and robot.peer.named.keys.generation == 1
            # The body of the revoked one is a thing like any other, and may stand in the way.
            causes = {cause for cause, _ in robot.peer.safety.causes}
            assert causes <= {StopCause.OBSTACLE_AHEAD}, causes
            assert robot.peer.state in (State.WORKING, State.IDLE)
        cluster.press(
            2
        )  # signed with keys that nobody believes: it brakes, and latches nobody else
        await elapse(1.0)
        assert not any(r.peer.safety.latched for r in cluster.running[:2])

    play(keys, story)


def test_new_keys_outlive_a_restart(keys: Path) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        new = Rekeying(1, SECRET, 2)
        await give(cluster, new, 0, 1)
        cluster.inject(new.switch())
        await elapse(1.0)
        cluster.kill(2)
        cluster.kill(1)
        await elapse(0.5)
        cluster.boot(1)
        await elapse(3.0)
        robot = cluster.robots[1].peer
        assert robot.named.keys.generation == 1 and 2 not in robot.membership.standing
        assert cluster.robots[0].peer.membership.live == {0, 1}

    play(keys, story)
