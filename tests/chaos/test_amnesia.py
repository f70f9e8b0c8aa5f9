"""Robots that lose power, their disk, or what is on it; the real peers, judged from outside.

A robot without its memory must not pass for the one that had it: it takes a new incarnation, stands
latched until a person has looked, and says so over any further restart.
"""

from collections.abc import Iterable
from random import Random

import pytest

from agent.interface.effects import Persist, Send
from agent.interface.lifecycle import State
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import HOLD_KEY, LATCHED
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.messages import Message
from protocol.frames.safety_frames import Command, EmergencyReset, EmergencyStop, OperatorCommand
from sim.chaos.durability_rules import lost
from sim.fleet.simulated_disk import Disk, LogJournal, MemoryJournal, PowerCut
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.fleet.virtual_clock import elapse
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Crash, Fault, Reset, Restart, load
from tests.chaos.at_work import Done, Story, at_work


def play(story: Story, seed: int = 3) -> None:
    at_work(load("small").changed(3, seed), story, disks=True)


def lose_power(cluster: Cluster, slot: int, rng: Random) -> None:
    journal = cluster.journals[slot]
    assert isinstance(journal, LogJournal)
    cluster.kill(slot)
    cluster.journals[slot] = LogJournal(journal.disk.after_cut(rng))


def lose_disk(cluster: Cluster, slot: int) -> None:
    cluster.kill(slot)
    cluster.journals[slot] = LogJournal(Disk())


def press(cluster: Cluster, slot: int) -> None:
    cluster.press(slot)


async def release(cluster: Cluster, start: bool = True) -> None:
    for dot in sorted({d for r in cluster.running for d in r.peer.safety.stops.active}):
        cluster.order(EmergencyReset(*dot, OPERATOR))
    await elapse(0.1)
    cluster.order(OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR))
    await elapse(1.0)
    if start:
        cluster.order(OperatorCommand(Command.START, 255, OPERATOR))
        await elapse(0.2)


def stopped(cluster: Cluster) -> list[bool]:
    return [robot.peer.state is State.EMERGENCY_STOP for robot in cluster.running]


def said(seen: Iterable[Done], slot: int) -> list[Message]:
    return [e.message for s, e in seen if s == slot and isinstance(e, Send)]


def incarnations(seen: Iterable[Done], slot: int) -> list[int]:
    """As said on the bus, without repetitions, in order."""
    return list(dict.fromkeys(m.incarnation for m in said(seen, slot) if isinstance(m, Member)))


@pytest.mark.parametrize("seed", range(3))
def test_a_power_cut_keeps_the_latch_and_the_identity(seed: int) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        press(cluster, 1)
        await elapse(0.2)
        assert all(stopped(cluster))
        for slot in range(3):  # the whole fleet, at once
            lose_power(cluster, slot, Random(f"{seed}/{slot}"))
        await elapse(0.1)
        for slot in range(3):
            cluster.boot(slot)
        await elapse(2.0)
        assert all(stopped(cluster)) and len(incarnations(seen, 1)) == 1, f"seed {seed}"
        assert all(len(r.peer.safety.stops.active) == 1 for r in cluster.running)
        await release(cluster)
        assert not any(stopped(cluster))
        assert all(r.peer.safety.may_move for r in cluster.running)

    play(story, seed)


def test_a_restart_is_neither_a_reset_nor_a_start() -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        press(cluster, 0)
        await elapse(0.2)
        for dot in cluster.robots[1].peer.safety.stops.active:
            cluster.order(EmergencyReset(*dot, OPERATOR))
        await elapse(0.2)
        lose_power(cluster, 1, Random(1))
        robot = cluster.boot(1)
        await elapse(1.0)
        assert robot.peer.safety.latched, "the stop is cleared; nobody reset it"
        await release(cluster, start=False)
        assert robot.peer.state is State.IDLE and not robot.peer.safety.may_move
        lose_power(cluster, 1, Random(2))
        robot = cluster.boot(1)
        await elapse(1.0)
        assert not robot.peer.safety.latched and not robot.peer.safety.may_move, "nobody started it"

    play(story)


@pytest.mark.parametrize("seed", range(3))
def test_a_lost_disk_is_a_new_identity_that_stands_until_a_person_came(seed: int) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        for _ in range(3):  # restarts in between do not make it forget that it has forgotten
            lose_disk(cluster, 1)
            for _ in range(2):
                robot = cluster.boot(1)
                await elapse(2.0)
                assert robot.peer.state is State.EMERGENCY_STOP, f"seed {seed}"
                recalled = cluster.journals[1].load()
                assert recalled[HOLD_KEY] == LATCHED and not robot.peer.safety.may_move
                lose_power(cluster, 1, Random(seed))
        cluster.boot(1)
        await elapse(2.0)
        assert len(incarnations(seen, 1)) == 4, f"seed {seed}"
        assert [slot for slot, r in cluster.robots.items() if not r.peer.safety.latched] == [0, 2]
        await release(cluster)
        assert not any(stopped(cluster))

    play(story, seed)


def test_a_robot_that_forgot_a_stop_is_told_of_it() -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        press(cluster, 1)
        await elapse(0.2)
        (dot,) = cluster.robots[0].peer.safety.stops.active
        lose_disk(cluster, 1)
        robot = cluster.boot(1)
        await elapse(2.0)
        assert dot in robot.peer.safety.stops.active
        cluster.order(OperatorCommand(Command.MANUAL_RESET, 1, OPERATOR))
        await elapse(0.5)
        assert robot.peer.state is State.EMERGENCY_STOP, "the stop it pressed itself still stands"

    play(story)


def test_a_dot_that_was_used_before_stops_everybody_all_the_same() -> None:
    """The worst lot: the new incarnation is the old one, and its first dot was cleared long ago."""

    async def story(cluster: Cluster, seen: list[Done]) -> None:
        press(cluster, 1)
        await elapse(0.2)
        await release(cluster)
        cluster.kill(1)
        forged = MemoryJournal()
        forged.write([Persist("incarnation", b"\1\0")])
        cluster.journals[1] = forged
        cluster.boot(1)
        await elapse(2.0)
        assert not any(stopped(cluster))
        press(cluster, 1)
        await elapse(0.3)
        assert all(stopped(cluster))

    play(story)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("step", range(1, 9))
def test_nothing_is_said_that_a_failing_disk_did_not_take(step: int) -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        journal, peer = cluster.journals[2], cluster.robots[2].peer
        assert isinstance(journal, LogJournal)
        written = lost(said(seen, 2), journal.load())
        assert not written, written
        journal.disk.fail_at = journal.disk.steps + step
        press(cluster, 2 if step % 2 else 0)
        await elapse(0.2)
        await release(cluster)
        await elapse(10.0)
        assert StopCause.DISK_ERROR in dict(peer.safety.causes) and not peer.safety.may_move
        not_stops = [
            m for m in said(seen, 2) if not isinstance(m, EmergencyStop | Pose | Heartbeat)
        ]
        assert not lost(not_stops, LogJournal(Disk(journal.disk.read())).load())
        steps = journal.disk.steps
        cluster.order(OperatorCommand(Command.START, 255, OPERATOR))
        await elapse(0.5)
        press(cluster, 2)
        await elapse(0.2)
        assert all(stopped(cluster)), "a robot without a disk still stops the others"
        assert journal.disk.steps == steps, "a disk that has failed is not asked again"

    play(story)


def test_a_power_cut_in_the_middle_of_a_write_ends_the_robot_and_nobody_else() -> None:
    async def story(cluster: Cluster, seen: list[Done]) -> None:
        journal = cluster.journals[2]
        assert isinstance(journal, LogJournal)
        journal.disk.cut_at = journal.disk.steps + 1
        press(cluster, 0)
        await elapse(0.2)
        task = cluster.robots[2].task
        assert task is not None
        with pytest.raises(PowerCut):
            task.check()
        lose_power(cluster, 2, Random(4))
        robot = cluster.boot(2)
        await elapse(2.0)
        assert robot.peer.state is State.EMERGENCY_STOP, "told again by those that remember"

    play(story)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("disk", ["kept", "lost"])
def test_what_a_robot_held_before_its_restart_is_worked_by_somebody(disk: str) -> None:
    faults: list[Fault] = [
        Crash(at_s=10.0, kind="crash", robot=1),
        Restart.model_validate({"at_s": 26.0, "kind": "restart", "robot": 1, "disk": disk}),
        Reset(at_s=30.0, kind="reset"),
    ]
    scenario = load("small").model_copy(update={"fault": faults})
    outcome = FieldRun(FieldSetup(scenario)).run()
    assert outcome.success, outcome
