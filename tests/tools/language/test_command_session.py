"""Phrases to a fleet that works a field, in virtual time: what robots then do, and who answers."""

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from agent.interface.lifecycle import State
from agent.peer import fleet_summary as bulletin
from protocol.frames.operator_frames import OperatorGoal
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.language.authorize import AuthorizedOrder
from tools.language.command_session import CommandSession
from tools.language.fleet_state import FleetNow, RobotNow
from tools.language.goal_queue import GoalQueue
from tools.language.intent import AnyIntent, Goal
from tools.language.outcome import LATCHED, Outcome
from tools.language.parse import read
from tools.language.places import Places
from tools.language.question import Question
from tools.language.question import QuestionReason as Why

SETTING = FieldSetup(load("small"))
PLACES = Places({"gate": SETTING.field.gate, "shelf": (10.0, -5.0)})
Story = Callable[[Cluster, CommandSession], Awaitable[None]]
_numbers = itertools.count()


def play(story: Story, folder: Path, by: str | None = None, yes: bool = False) -> None:
    async def words(phrase: str) -> tuple[tuple[AnyIntent, ...] | Question, bool]:
        return read(phrase, PLACES), False

    async def answer(question: str) -> bool:
        return yes

    async def main() -> None:
        cluster = Cluster(SETTING, f"speaker {next(_numbers)}")
        cluster.boot_all()
        bus = CanBus(FieldBus(cluster.segment.channel))
        speaker = CommandSession(
            bus, None, PLACES, GoalQueue(folder / "queue.json"), words, answer, by=by
        )
        try:
            await elapse(15.0)
            await story(cluster, speaker)
        finally:
            bus.close()
            await cluster.close()
        assert cluster.world.contacts == []

    run_virtual(main())


def at_m(cluster: Cluster, slot: int, place: tuple[float, float]) -> float:
    x_m, y_m = cluster.world.body(slot).position
    return hypot(x_m - place[0], y_m - place[1])


@pytest.mark.slow
def test_a_named_robot_goes_and_the_others_work_on(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        told = await speaker.say("send robot 1 to the shelf")
        assert told.code == 0 and told.orders[0][1] == "UNDER WAY", told
        busy = await speaker.say("what is robot 1 doing")
        assert "is sent to 10.0, -5.0" in busy.answers[0].text
        await elapse(60.0)
        assert at_m(cluster, 1, (10.0, -5.0)) < 1.0
        assert cluster.robots[0].peer.state is State.WORKING
        taken = await speaker.say("send robot 0 to the shelf")
        assert taken.question is not None and taken.question.reason is Why.UNSAFE
        back = await speaker.say("robot 1 continue")
        assert back.code == 0 and back.orders[0][1] == "WORKING", back

    play(story, tmp_path)


def test_a_stop_of_all_is_said_at_once_and_confirmed(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        told = await speaker.say("STOP!")
        assert told.stopped == [0, 1, 2] and told.not_stopped == [] and told.code == 0
        assert told.lines() == ["stopped: 0, 1, 2"] and not told.to_dict()["emergency_stop"]
        assert loop.time() - begun_s < 1.0
        await elapse(3.0)
        assert all(cluster.world.body(slot).speed_m_s == 0.0 for slot in range(3))
        assert all(cluster.robots[slot].peer.state is State.IDLE for slot in range(3)), "no latch"
        held = await speaker.say("start all")
        assert held.question is not None and held.question.reason is Why.UNSAFE
        one = await speaker.say("start robot 2")
        assert one.code == 0
        await elapse(5.0)
        assert cluster.robots[2].peer.state is State.WORKING
        assert cluster.robots[0].peer.state is State.IDLE

    play(story, tmp_path)


@pytest.mark.parametrize(
    "phrase", ["emergency stop and where is robot 9", "where is robot 9 and stop"]
)
def test_a_stop_with_a_question_beside_it_is_said_before_the_question_is_weighed(
    phrase: str, tmp_path: Path
) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        saying = asyncio.create_task(speaker.say(phrase))
        await elapse(0.4)  # a stop is sent every 50 ms, and no robot was heard before
        assert all(cluster.robots[slot].peer.state is not State.WORKING for slot in range(3))
        told = await saying
        assert told.stopped == [0, 1, 2] and loop.time() - begun_s < 6.0
        assert told.code == 3 and told.question is not None and "robot 9" in told.question.text
        assert told.lines()[0] == "stopped: 0, 1, 2", told.lines()

    play(story, tmp_path)


def test_what_needs_no_queue_is_done_beside_a_damaged_one(tmp_path: Path) -> None:
    """Each question and each order ended the command, and an order that was given was not told."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        (tmp_path / "queue.json").write_text("{")
        assert (await speaker.say("where is robot 1")).code == 0
        told = await speaker.say("stop robot 1 and send the nearest robot to the shelf")
        assert told.code == 3 and told.question is not None and not told.queued
        assert told.question.reason is Why.NOT_NOW and "delete it" in told.question.text
        assert told.lines()[0] == "robot 1: stop; it says: STOPPED"

    play(story, tmp_path)


ALARMS = (  # of M13: each was answered by a question while the fleet drove on
    "don't move", "nobody move", "please, for the love of god, stop", "sotp", "stp", "emergency",
    "cut the power", "shut down", "everything off", "stop the one at the gate", "stop robot 2 or 3",
    "whoa", "help", "there's a child in the field", "STOP ROBOT TWENTY ONE", "hold still",
    "stay where you are", "terminate", "stoop", "stop robot 2 then start it", "kill the engines",
    "robot two stop and go home", "stop robot 9",
)  # fmt: skip


@pytest.mark.slow
def test_m13_what_may_be_an_alarm_holds_everybody_and_asks_then(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        loop = asyncio.get_running_loop()
        for phrase in ALARMS:
            begun_s = loop.time()
            told = await speaker.say(phrase)
            assert told.question is not None, phrase
            assert told.held == [0, 1, 2] and told.not_stopped == [], (phrase, told)
            assert loop.time() - begun_s < 2.0 and told.code == 3, phrase
            await elapse(1.5)  # the way to a stand from the greatest speed
            bodies = [cluster.world.body(slot).speed_m_s for slot in range(3)]
            assert max(bodies) == 0.0, (phrase, bodies)
            assert all(r.peer.state is not State.EMERGENCY_STOP for r in cluster.robots.values())
            for slot in range(3):
                assert (await speaker.say(f"start robot {slot}")).code == 0
        await elapse(10.0)
        assert any(cluster.world.body(slot).speed_m_s > 0.0 for slot in range(3)), "work goes on"

    play(story, tmp_path)


def test_m13_a_hold_that_a_robot_does_not_confirm_is_told(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        await speaker.hear_fleet()
        cluster.partition([{0, 1}, {2}])
        told = await speaker.say("whoa")
        assert told.held == [0, 1] and told.not_stopped == [2]
        assert any(line.startswith("NOT STOPPED: 2") for line in told.lines())

    play(story, tmp_path)


def test_m14_questions_of_the_trial_are_answered(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        for phrase in (
            "what's the battery of robot 1", "how much is left to do", "which sections are done",
            "is robot 2 ok", "how far is robot 2 from the gate",
        ):  # fmt: skip
            told = await speaker.say(phrase)
            assert told.code == 0 and told.answers and told.held is None, (phrase, told)

    play(story, tmp_path)


def test_an_emergency_stop_latches_and_nothing_is_sent_then(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        told = await speaker.say("emergency stop")
        assert told.stopped == [0, 1, 2] and told.code == 0
        assert all(r.peer.state is State.EMERGENCY_STOP for r in cluster.robots.values())
        for phrase in ("send robot 1 to the shelf", "start robot 1", "robot 1 go home"):
            refused = await speaker.say(phrase)
            assert refused.question is not None and refused.question.reason is Why.NOT_NOW

    play(story, tmp_path)


def test_a_stop_that_is_not_heard_is_told(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        assert len((await speaker.hear_fleet()).live) == 3
        cluster.partition([{0, 1}, {2}])
        await elapse(3.0)
        told = await speaker.say("stop")
        assert told.stopped == [0, 1] and told.not_stopped == [2]
        assert told.code != 0

    play(story, tmp_path)


def test_an_ordinary_stop_waits_for_no_address_that_is_long_gone(tmp_path: Path) -> None:
    """In a conversation of hours it became an emergency stop, because of an address that had spoken once
    and had never said which robot it is."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        loop = asyncio.get_running_loop()
        await speaker.hear_fleet()
        speaker.operator.unknown[140] = loop.time() - 60.0
        told = await speaker.say("stop")
        assert told.stopped == [0, 1, 2] and told.code == 0 and not told.latched
        begun_s = loop.time()
        assert (await speaker.say("whoa")).held == [0, 1, 2]
        assert loop.time() - begun_s < 2.0

    play(story, tmp_path)


def test_a_robot_that_has_left_is_not_said_to_drive(tmp_path: Path) -> None:
    """Each later stop of the conversation said NOT STOPPED of it, and exit 1."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        await speaker.hear_fleet()
        await cluster.robots[2].runner.leave()
        await elapse(3.0)
        assert (await speaker.say("whoa")).not_stopped == []
        told = await speaker.say("stop")
        assert told.stopped == [0, 1] and told.not_stopped == [] and told.code == 0

    play(story, tmp_path)


def test_an_ordinary_stop_that_became_an_emergency_stop_says_so(tmp_path: Path) -> None:
    """Nothing told a person that `start all` would not end it."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        await speaker.hear_fleet()
        cluster.partition([{0, 1}, {2}])
        told = await speaker.say("stop")
        assert cluster.robots[0].peer.state is State.EMERGENCY_STOP
        assert told.lines()[:2] == ["stopped: 0, 1", LATCHED] and told.to_dict()["emergency_stop"]
        assert "headland release" in LATCHED

    play(story, tmp_path)


def test_a_place_of_which_a_frame_is_lost_is_said_again(tmp_path: Path) -> None:
    """The robot has half of the place and refuses. That counted as its answer to the whole of it."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        await speaker.hear_fleet()
        operator, lost = speaker.operator, list[object]()
        send = operator.send

        def losing(message: Any) -> bool:
            if isinstance(message, OperatorGoal) and not lost:
                lost.append(message)
                return True
            return send(message)

        operator.send = losing  # type: ignore[method-assign]
        told = await speaker.say("send robot 1 to the shelf")
        assert lost and told.code == 0 and told.orders[0][1] == "UNDER WAY", told

    play(story, tmp_path)


@pytest.mark.slow
def test_a_goal_waits_for_an_idle_robot(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        told = await speaker.say("send the nearest robot to the shelf")
        assert told.queued == ["shelf"] and told.orders == [] and told.code == 0
        again = await speaker.say("what is queued")
        assert again.answers[0].value == ["shelf"]
        given: list[Outcome] = []
        serving = asyncio.create_task(speaker.serve(given.append))
        await elapse(5.0)
        assert given == [] and len(speaker.queue) == 1
        await asyncio.wait_for(serving, 600.0)  # the field is done, robots are idle
        [outcome] = given
        [(order, word)] = outcome.orders
        assert word == "UNDER WAY" and len(speaker.queue) == 0
        await elapse(120.0)  # others stand on its way
        assert at_m(cluster, order.slot, (10.0, -5.0)) < 1.0

    play(story, tmp_path)


def idle(speaker: CommandSession, monkeypatch: pytest.MonkeyPatch) -> None:
    """Robots 1 and 2 stand without work; robot 0 was there."""
    robots = {slot: RobotNow(slot, "IDLE", 0.0, 0.0, silent=not slot) for slot in range(3)}

    async def hear_fleet() -> FleetNow:
        return FleetNow(robots, {})

    monkeypatch.setattr(speaker, "hear_fleet", hear_fleet)


def test_the_goal_of_a_dead_robot_holds_up_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command before had sent it and died, and its robot died, too: no later goal was given."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        idle(speaker, monkeypatch)
        asked: list[int] = []

        async def convey(order: AuthorizedOrder) -> str | None:
            asked.append(order.slot)
            return "UNDER WAY" if order.slot == 2 else None

        monkeypatch.setattr(speaker, "_convey", convey)
        given: list[Outcome] = []
        for place in ("of the dead", "of the deaf", "shelf"):
            speaker.queue.add(place, (10.0, -5.0))
        speaker.queue.give(1, 0)
        speaker.queue.give(2, 1)
        serving = asyncio.create_task(speaker.serve(given.append))
        await elapse(3.0)
        serving.cancel()
        assert [told.phrase for told in given] == ["queued: shelf"]
        assert speaker.queue.names == ["of the dead", "of the deaf"], (
            "no second robot is sent there"
        )
        assert set(asked) == {1, 2}

    play(story, tmp_path)


def test_a_goal_waits_on_when_the_address_of_its_robot_is_another_makers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The operator's device drops that robot, and a conversation ended with a traceback."""

    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        idle(speaker, monkeypatch)
        speaker.operator.robots.clear()
        speaker.queue.add("shelf", (10.0, -5.0))
        assert await speaker._deliver(speaker.queue.goals[0], frozenset()) is None
        assert speaker.queue.names == ["shelf"]

    play(story, tmp_path)


def test_any_peer_answers_and_all_say_the_same(tmp_path: Path) -> None:
    async def story(cluster: Cluster, speaker: CommandSession) -> None:
        positions = []
        for slot in range(3):
            speaker.by = str(slot)
            told = await speaker.say("where are the robots")
            assert told.told_by == f"robot {slot}"
            positions.append([(r["x_m"], r["y_m"]) for r in told.answers[0].value])
        for other in positions[1:]:
            for one, two in zip(positions[0], other, strict=True):
                assert hypot(one[0] - two[0], one[1] - two[1]) < 10.0, "they drove on between"
        cluster.kill(0)
        await elapse(3.0)
        speaker.by = "any"
        told = await speaker.say("status of robot 1")
        assert told.told_by == "robot 1" and told.code == 0
        speaker.by = "0"
        told = await speaker.say("where is robot 1")
        assert "did not answer" in told.told_by and told.code == 0

    play(story, tmp_path)


def test_what_a_model_read_is_obeyed_only_after_a_yes(tmp_path: Path) -> None:
    async def model(phrase: str) -> tuple[tuple[AnyIntent, ...] | Question, bool]:
        return (Goal(robot=1, place="shelf"),), True

    async def no(cluster: Cluster, speaker: CommandSession) -> None:
        speaker.read = model
        told = await speaker.say("the box is over there you know")
        assert told.question is not None and told.by_model and told.orders == []
        await elapse(1.0)
        assert cluster.robots[1].peer.state is State.WORKING

    async def yes(cluster: Cluster, speaker: CommandSession) -> None:
        speaker.read = model
        told = await speaker.say("the box is over there you know")
        assert told.orders[0][1] == "UNDER WAY"

    play(no, tmp_path)
    play(yes, tmp_path, yes=True)


def test_a_bulletin_is_read_as_it_was_written() -> None:
    lines = tuple(
        bulletin.MemberRow(slot, State.WORKING, "LIVE", -1234.5, 1000.0, 2.5, (slot, 60_000), 0.1)
        for slot in range(100)
    )
    whole = bulletin.FleetSummary(3, 14, 2, lines)
    told = bulletin.read(bulletin.write(whole))
    assert told is not None and told.more == 100 - len(told.lines)
    assert told.lines == lines[: len(told.lines)] and len(told.lines) >= 25
    for nonsense in ("", "by", "by x sections 1 done 2", "by 1 sections 2 done 3\n0 NAPPING"):
        assert bulletin.read(nonsense) is None


def test_a_queue_outlives_the_command_and_is_delivered_by_one(tmp_path: Path) -> None:
    first, second = (
        GoalQueue(tmp_path / "q" / "queue.json"),
        GoalQueue(tmp_path / "q" / "queue.json"),
    )
    assert [first.add("gate", (1.0, 2.0)), second.add("shelf", (3.0, 4.0))] == [1, 2]
    with first.delivering() as ours, second.delivering() as theirs:
        assert ours and not theirs
        first.give(1, 7)
    assert second.goals[0].given_to == 7
    second.done(1)
    assert first.names == ["shelf"] and first.clear() == 1 and not second
