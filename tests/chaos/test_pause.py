"""Something that is no robot in the way of a working robot: it stops, asks, and obeys every answer."""

import asyncio
from collections.abc import Awaitable, Callable
from math import dist, hypot
from pathlib import Path
from random import Random

import pytest

from agent.field.field_mission import FieldMission
from agent.interface.lifecycle import State
from agent.motion.obstacle_stop import ObstacleStop, QuestionState
from agent.motion.path_tracker import PathTracker
from agent.runtime.files.key_file import fresh, write
from agent.safety.stop_cause import StopCause
from protocol.frames.codec import decode_once
from protocol.frames.frame import Frame
from protocol.frames.operator_frames import OperatorReport, ReportKind, goal_check, goal_frames
from protocol.frames.safety_frames import Command, OperatorCommand
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Scenario, load
from sim.world.temporary_obstacles import random_temporary_obstacle_generator, schedule
from tests.chaos.broad import broad

Reports = list[tuple[int, OperatorReport]]
Story = Callable[[Cluster, Reports], Awaitable[None]]
ROBOT = 1
LIMIT_S = 500


def play(story: Story, scenario: Scenario) -> Cluster:
    reports: Reports = []

    async def main() -> Cluster:
        cluster = Cluster(FieldSetup(scenario), f"pause {id(story)}")

        def tap(t_us: int, frame: Frame) -> None:
            _, message = decode_once(frame)
            if isinstance(message, OperatorReport):
                reports.append((t_us, message))

        cluster.segment.taps.append(tap)
        cluster.boot_all()
        try:
            await story(cluster, reports)
            cluster.check()
        finally:
            await cluster.close()
        assert cluster.world.contacts == [] and not cluster.stops.violations
        return cluster

    return run_virtual(main())


def put_box_before(cluster: Cluster, slot: int, ahead_m: float, side_m: float = 1.0) -> int:
    """Right across the way of a robot that drives; returns the box."""
    world = cluster.world
    x_m, y_m = world.body(slot).position
    vx_m_s, vy_m_s = world.motion[world.body(slot).index, 3:5].tolist()
    speed_m_s = hypot(vx_m_s, vy_m_s)
    at = x_m + vx_m_s / speed_m_s * ahead_m, y_m + vy_m_s / speed_m_s * ahead_m
    return world.add_box(*at, side_m)


async def until_at_work(cluster: Cluster, slot: int, after_s: float = 12.0) -> None:
    """On a swath, at speed, with room straight ahead."""
    loop = asyncio.get_running_loop()
    await elapse(after_s)
    while loop.time() < LIMIT_S:
        peer = cluster.robots[slot].peer
        mission = peer.mission
        assert isinstance(mission, FieldMission)
        tracker = mission.tracker
        if peer.state is State.WORKING and tracker is not None and mission.leg.units:
            left_m = tracker.total_m - tracker.along_m
            if isinstance(tracker, PathTracker):
                corner_m = dist(tracker.next_corner, cluster.world.body(slot).position)
                left_m = min(left_m, corner_m)
            if left_m > 12.0 and cluster.world.body(slot).speed_m_s > 2.0:
                return
        await elapse(0.05)
    raise AssertionError("never at work")


async def asked(cluster: Cluster, slot: int) -> None:
    """The question comes while the robot brakes, and it comes to stand."""
    peer = cluster.robots[slot].peer
    await elapse(4.0)
    assert StopCause.OBSTACLE_AHEAD in dict(peer.safety.causes)
    assert cluster.world.body(slot).speed_m_s == 0.0


async def finished(cluster: Cluster) -> None:
    loop = asyncio.get_running_loop()
    while loop.time() < LIMIT_S and not cluster.finished:
        await elapse(1.0)
        cluster.check()
    assert cluster.finished


def matters(reports: Reports, slot: int = ROBOT) -> list[ReportKind]:
    """What was told, repetitions left out."""
    told: list[ReportKind] = []
    for _, report in reports:
        if report.slot == slot and told[-1:] != [report.matter]:
            told.append(report.matter)
    return told


def order(cluster: Cluster, command: Command, argument: int = 0, slot: int = ROBOT) -> None:
    cluster.order(OperatorCommand(command, slot, OPERATOR, argument))


@pytest.mark.slow
def test_a_robot_stops_asks_and_goes_on_when_the_way_is_free() -> None:
    """Then once more, where it is told to wait: it stands without asking again."""

    async def story(cluster: Cluster, reports: Reports) -> None:
        await until_at_work(cluster, ROBOT)
        box = put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        question = reports[-1][1]
        assert question.matter is ReportKind.ASKING and question.number == 1
        assert 0.3 < question.distance_m < 3.0 and 0.3 < question.radius_m < 2.0
        await elapse(5.0)
        asks_us = [t for t, r in reports if r.matter is ReportKind.ASKING]
        assert len(asks_us) >= 8, "said again for operators that come later"
        cluster.world.remove_box(box)
        await elapse(1.5)
        assert cluster.robots[ROBOT].peer.safety.may_move
        assert matters(reports) == [ReportKind.ASKING, ReportKind.GONE]
        reports.clear()

        await until_at_work(cluster, ROBOT)
        box = put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        order(cluster, Command.WAIT, reports[-1][1].number)
        await elapse(20.0)
        assert cluster.world.body(ROBOT).speed_m_s == 0.0
        cluster.world.remove_box(box)
        await finished(cluster)
        assert matters(reports) == [ReportKind.ASKING, ReportKind.WAITING, ReportKind.GONE]
        assert cluster.robots[ROBOT].peer.progress.fraction() == 1.0

    play(story, broad())


@pytest.mark.sampled(1)
@pytest.mark.parametrize("command", [Command.CONTINUE, Command.REPLAN])
def test_going_round(command: Command) -> None:
    async def story(cluster: Cluster, reports: Reports) -> None:
        peer = cluster.robots[ROBOT].peer
        await until_at_work(cluster, ROBOT)
        box = put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        section = peer.claims.current
        assert section is not None
        order(cluster, command, reports[-1][1].number)
        loop = asyncio.get_running_loop()
        again = command is Command.REPLAN  # it comes back to what the box stands on, and asks again
        asked_by = {(ROBOT, 1)}
        while loop.time() < LIMIT_S and not cluster.finished:
            await elapse(0.5)
            for slot, number in {(r.slot, r.number) for _, r in reports} - asked_by:
                asked_by.add((slot, number))
                if not again or slot != ROBOT:  # others may come to the box from another side
                    order(cluster, command, number, slot)
            if again and (ROBOT, 2) in asked_by:
                assert peer.claims.current == section
                cluster.world.remove_box(box)
                break
        await finished(cluster)
        assert matters(reports)[:2] == [ReportKind.ASKING, ReportKind.GOING_ROUND]
        fraction = peer.progress.fraction()
        assert fraction == 1.0 if command is Command.REPLAN else 0.9 < fraction < 1.0

    play(story, broad())


@pytest.mark.slow
def test_stop_gives_the_work_back_and_stands_until_a_start() -> None:
    async def story(cluster: Cluster, reports: Reports) -> None:
        peer = cluster.robots[ROBOT].peer
        await until_at_work(cluster, ROBOT)
        box = put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        order(cluster, Command.STOP)
        await elapse(10.0)
        assert peer.claims.current is None and peer.state is State.IDLE
        assert cluster.world.body(ROBOT).speed_m_s == 0.0 and not peer.safety.may_move
        cluster.world.remove_box(box)
        order(cluster, Command.START)
        await finished(cluster)
        assert peer.progress.fraction() == 1.0
        assert ReportKind.STOPPED in matters(reports)

    play(story, broad())


@pytest.mark.slow
def test_being_sent_elsewhere() -> None:
    """Home; from there on with the work; then to a place in the field, and on again."""

    async def sent(cluster: Cluster, reports: Reports, command: Command) -> None:
        peer = cluster.robots[ROBOT].peer
        goal = (20.0, -10.0) if command is Command.SET_GOAL else cluster.setting.starts[ROBOT]
        await until_at_work(cluster, ROBOT)
        box = put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        frames = goal_frames(ROBOT, OPERATOR, *goal)
        for frame in frames if command is Command.SET_GOAL else ():
            cluster.order(frame)
        order(cluster, command, goal_check(frames[0].value, frames[1].value))
        loop, end_at_s = asyncio.get_running_loop(), asyncio.get_running_loop().time() + 90
        while loop.time() < end_at_s and ReportKind.ARRIVED not in matters(reports):
            await elapse(0.5)
        assert matters(reports)[-1] is ReportKind.ARRIVED
        x_m, y_m = cluster.world.body(ROBOT).position
        assert hypot(x_m - goal[0], y_m - goal[1]) < 1.0 and peer.claims.current is None
        cluster.world.remove_box(box)
        order(cluster, Command.CONTINUE)
        reports.clear()

    async def story(cluster: Cluster, reports: Reports) -> None:
        await sent(cluster, reports, Command.GO_HOME)
        await sent(cluster, reports, Command.SET_GOAL)
        await finished(cluster)
        assert cluster.robots[ROBOT].peer.progress.fraction() == 1.0

    play(story, broad())


def test_answers_to_another_question_and_mixed_up_places_do_nothing() -> None:
    async def story(cluster: Cluster, reports: Reports) -> None:
        await until_at_work(cluster, ROBOT)
        put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        order(cluster, Command.CONTINUE, reports[-1][1].number + 1)
        old, new = goal_frames(ROBOT, OPERATOR, 1.0, 2.0), goal_frames(ROBOT, OPERATOR, 30.0, 9.0)
        cluster.order(old[0])
        cluster.order(new[1])
        order(cluster, Command.SET_GOAL, goal_check(new[0].value, new[1].value))
        for at in ((3000.0, 0.0), (0.0, 3000.0)):  # not in the field
            frames = goal_frames(ROBOT, OPERATOR, *at)
            for frame in frames:
                cluster.order(frame)
            order(cluster, Command.SET_GOAL, goal_check(frames[0].value, frames[1].value))
        await elapse(3.0)
        assert cluster.world.body(ROBOT).speed_m_s == 0.0
        assert StopCause.OBSTACLE_AHEAD in dict(cluster.robots[ROBOT].peer.safety.causes)
        assert set(matters(reports)) == {ReportKind.ASKING, ReportKind.REFUSED}

    play(story, broad())


def test_a_latched_robot_takes_no_order() -> None:
    async def story(cluster: Cluster, reports: Reports) -> None:
        await until_at_work(cluster, ROBOT)
        put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        cluster.press(0)
        await elapse(0.1)
        section = cluster.robots[ROBOT].peer.claims.current
        for command in (Command.CONTINUE, Command.REPLAN, Command.GO_HOME, Command.STOP):
            order(cluster, command)
            await elapse(0.5)
            assert cluster.robots[ROBOT].peer.state is State.EMERGENCY_STOP
            assert cluster.robots[ROBOT].peer.claims.current == section

    play(story, broad())


def test_with_keys_only_an_operator_is_obeyed(tmp_path: Path) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)

    async def story(cluster: Cluster, reports: Reports) -> None:
        await until_at_work(cluster, ROBOT)
        put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        for _ in range(10):
            cluster.inject(OperatorCommand(Command.REPLAN, ROBOT, OPERATOR))
            cluster.inject(OperatorCommand(Command.GO_HOME, ROBOT, OPERATOR))
            await elapse(0.2)
        assert set(matters(reports)) == {ReportKind.ASKING}
        for _ in range(5):
            order(cluster, Command.REPLAN, reports[-1][1].number)
            await elapse(0.2)
        assert matters(reports)[:2] == [ReportKind.ASKING, ReportKind.GOING_ROUND]

    play(story, broad().changed(3, 5, tmp_path / "fleet.json"))


@pytest.mark.slow
def test_the_scenario_that_ships_is_finished_without_a_flaw() -> None:
    outcome = FieldRun(FieldSetup(load("bystander"))).run()
    assert outcome.success and outcome.frames["OperatorReport"] >= 10, outcome


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_boxes_that_come_and_go_are_never_touched(seed: int) -> None:
    async def story(cluster: Cluster, reports: Reports) -> None:
        boxes = random_temporary_obstacle_generator(
            seed,
            FieldSetup(cluster.scenario).field.polygon,
            mean_period_s=5.0,
            begin_at_s=10.0,
            end_at_s=200.0,
        )
        schedule(cluster.world, boxes)
        rng = Random(seed)
        loop = asyncio.get_running_loop()
        while loop.time() < LIMIT_S and not cluster.finished:
            await elapse(1.0)
            cluster.check()
            for robot in cluster.running:
                pause = robot.peer.named.obstacle.question
                if (
                    isinstance(pause, ObstacleStop)
                    and pause.machine.state is QuestionState.ASKING
                    and rng.random() < 0.3
                ):
                    what = rng.choice((Command.WAIT, Command.CONTINUE, Command.REPLAN))
                    cluster.order(OperatorCommand(what, robot.slot, OPERATOR, pause.number))
        assert cluster.finished, f"seed {seed}"
        assert any(r.matter is ReportKind.ASKING for _, r in reports)

    play(story, load("small").changed(3, seed))


@pytest.mark.slow
def test_a_tractor_asks_too_and_drives_home_on_its_turning_circle() -> None:
    async def story(cluster: Cluster, reports: Reports) -> None:
        home = cluster.world.body(ROBOT).position
        await until_at_work(cluster, ROBOT)
        assert not reports, "its own fleet and its own fences are nothing to ask about"
        box = put_box_before(cluster, ROBOT, 7.0)
        await asked(cluster, ROBOT)
        cluster.world.remove_box(box)
        await elapse(2.0)
        order(cluster, Command.GO_HOME)
        loop = asyncio.get_running_loop()
        while loop.time() < LIMIT_S and matters(reports)[-1:] != [ReportKind.ARRIVED]:
            await elapse(0.5)
        x_m, y_m = cluster.world.body(ROBOT).position
        assert hypot(x_m - home[0], y_m - home[1]) < 0.6
        order(cluster, Command.CONTINUE)
        await finished(cluster)

    play(story, broad().changed(2, 1, drive="ackermann"))
