"""Who has confirmed a stop or a release, and who has not (item 10; findings T12 and T14)."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from agent.interface.lifecycle import State
from agent.runtime.files.key_file import OPERATOR, fresh, read, write
from protocol.authentication import Keyring, Keys
from protocol.frames.agreement_frames import SilentPosition
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.fleet_frames import Heartbeat, Member, StandsBy, Standstill
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import (
    Challenge,
    Command,
    EmergencyStop,
    Freshness,
    OperatorCommand,
    Reason,
)
from protocol.links.bus import CanBus
from protocol.name import fleet_name
from protocol.rekeying import NOBODY
from sim.can.simulated_bus import FieldBus
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.common import bus_address
from tools.common.bus_address import AttachError, robots_of_launch
from tools.livemap import command
from tools.livemap.stop_panel import Panel
from tools.operate import rekey
from tools.operate.estop import AGAIN, press, stop_status, tell
from tools.operate.operator_device import ECHOES_TRIED, KnownRobot, Operator
from tools.operate.order import convey
from tools.operate.reset import release, word

KEYS = Keys(b"m" * 16, b"o" * 16)
PANEL = 140


class Silent:
    def send(self, frame: Frame) -> bool:
        return True

    def subscribe(self, callback: object) -> None:
        """Nothing comes."""


def operator(keyring: Keyring | None = None) -> Operator:
    return Operator(Silent(), keyring)  # type: ignore[arg-type]


class Recorded(Silent):
    """A bus that keeps what one tool sends."""

    def __init__(self) -> None:
        self.sent: list[Message] = []

    def send(self, frame: Frame) -> bool:
        message = decode(frame)[1]
        assert not isinstance(message, Malformed)
        self.sent.append(message)
        return True


def test_an_open_tool_with_the_same_key_answers_no_question_about_the_counter_of_another(
    tmp_path: Path,
) -> None:
    """An open `headland say` told robots its own counter when they asked for that of a release. They
    believed the first answer, and then not the release."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    key = read(tmp_path / "operator.json", OPERATOR)
    robot = Keyring(read(tmp_path / "fleet.json").keys, 0, b"robot")
    buses = [Recorded(), Recorded()]

    async def story() -> None:
        tools = [Operator(bus, key.keyring()) for bus in buses]  # type: ignore[arg-type]
        for tool in tools:
            await tool.device.held()
        tools[1].command(Command.MANUAL_RESET, 0)
        question = robot.ask(249, 0)
        assert question is not None
        for tool, bus in zip(tools, buses, strict=True):  # the open one is the first to answer
            say(tool, 0.0, 0, question)
            for answer in bus.sent:
                if isinstance(answer, Freshness):
                    robot.prove(answer, 0)
        buses[1].sent.clear()
        tools[1].command(Command.MANUAL_RESET, 0)
        for order in buses[1].sent:
            assert isinstance(order, OperatorCommand) and robot.verify(order, 249, 0)

    run_virtual(story())
    assert robot.accepted == 2


def test_a_robot_that_has_signed_very_much_confirms_a_stop(tmp_path: Path) -> None:
    """A robot whose stop was pressed on a dead bus for an hour could confirm no stop until it was started
    again: 65,535 counters were tried."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    keys, bus = read(tmp_path / "fleet.json").keys, Recorded()
    robot = Keyring(keys, 0, b"robot", sent=70_000)

    async def story() -> None:
        tool = Operator(bus, Keyring(keys, PANEL, b"panel"))  # type: ignore[arg-type]
        await tool.device.held()
        say(tool, 1.0, 0, Member(0, 1, 7), beat())
        for at_s in (1.0, 1.5):
            stop = tool.new_stop(Reason.OPERATOR_INTERVENTION)
            tool.stop(stop)
            say(tool, at_s, 0, robot.sign(stop._replace(echo=True)))
            for question in [m for m in bus.sent if isinstance(m, Challenge)]:
                answer = robot.answer(question, round(at_s * 1e6))
                if answer is not None:
                    say(tool, at_s, 0, answer)
        assert tool.confirmed(tool.robots[0])

    run_virtual(story())


def test_a_press_answers_for_its_first_frame(tmp_path: Path) -> None:
    """Before it had heard a frame it did not know the time, and robots asked again 0.1 s later."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    bus = Recorded()

    async def story() -> None:
        await elapse(60.0)
        tool = Operator(bus, read(tmp_path / "operator.json").keyring())  # type: ignore[arg-type]
        await tool.device.held()
        pressing = asyncio.create_task(press(tool, Reason.OPERATOR_INTERVENTION, 1.0))
        await elapse(0.001)
        say(tool, asyncio.get_running_loop().time(), 0, Challenge(tool.slot, 0, 1))
        pressing.cancel()

    run_virtual(story())
    assert [kind for kind in map(type, bus.sent) if kind is Freshness] == [Freshness]


def beat(stopped: bool = False, leaving: bool = False) -> Heartbeat:
    return Heartbeat(1, State.WORKING, stopped, False, True, leaving, 1.0, 0, 0)


def say(who: Operator, t_s: float, slot: int, *messages: Message) -> None:
    for message in messages:
        who.hear(t_s, encode(message, 128 + slot))


def test_t12_leaving_forged_50_times_a_second_takes_nobody_out_of_the_count() -> None:
    tool = operator()
    say(tool, 0.0, 1, Member(1, 1, 7))
    for tick in range(200):
        say(tool, tick * 0.02, 1, beat(leaving=True))
        say(tool, tick * 0.02, 1, beat(leaving=True), beat())
        assert [robot.slot for robot in tool.live] == [1]
    assert [robot.slot for robot in tool.members if not tool.confirmed(robot)] == [1]


def test_t12_a_frame_after_a_farewell_is_no_exception_and_silence_after_it_is_leaving() -> None:
    tool = operator()
    say(tool, 0.0, 1, Member(1, 1, 7), beat(), beat(leaving=True))
    say(tool, 0.1, 1, EmergencyStop(1, 1, 1, Reason.OPERATOR_INTERVENTION, echo=True))
    assert [robot.slot for robot in tool.live] == [1], "it may still beat"
    tool.now_s = 0.7
    assert not tool.members and not tool.silent
    say(tool, 0.8, 1, beat())
    assert [robot.slot for robot in tool.live] == [1], "it has not left"


def test_t14_who_fell_silent_or_was_only_told_of_counts_and_is_named() -> None:
    tool = operator()
    say(tool, 0.0, 0, Member(0, 1, 7), beat(stopped=True))
    say(tool, 0.0, 1, Member(1, 1, 7), beat())
    say(tool, 2.0, 0, beat(stopped=True), SilentPosition(0, 0, 2, 0))
    tool.expect([3])
    assert [robot.slot for robot in tool.silent] == [1, 2, 3]
    assert "NOT HEARD" in word(tool, tool.robots[3], False)


def test_on_a_bus_that_is_seconds_behind_a_press_draws_few_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Twenty robots on an overloaded machine: a press drew ten names before the first echo came. Each
    robot repeats each of them, which made the bus later still, and all have to be cleared."""
    tool = operator()
    say(tool, 0.0, 0, Member(0, 1, 7), beat())
    names = set()
    monkeypatch.setattr(tool, "stop", lambda message: names.add(message[:3]))

    async def story() -> None:
        pressing = asyncio.create_task(press(tool, Reason.OPERATOR_INTERVENTION, 3.0))
        while not pressing.done():
            say(tool, asyncio.get_running_loop().time(), 0, beat())
            await elapse(0.05)
        assert await pressing == [tool.robots[0]]

    run_virtual(story())
    assert 4 <= len(names) <= 6, "a name may be a cleared one, so another is tried"


def test_no_start_is_given_while_no_robot_is_heard() -> None:
    """Found by `headland chaos`, profile flood 104000086, of its simulated operator: a start that waited
    in the device during a flood arrived at its end, after a stop that was pressed later."""

    class Waiting(Silent):
        def __init__(self) -> None:
            self.frames: list[Frame] = []

        def send(self, frame: Frame) -> bool:
            self.frames.append(frame)
            return True

    async def released(heard: bool) -> list[Command]:
        adapter = Waiting()
        tool = Operator(adapter, None)  # type: ignore[arg-type]
        if heard:
            tool.now_s = asyncio.get_running_loop().time()
            say(tool, tool.now_s, 1, Member(1, 1, 7), beat())
        await release(tool, True, 0.3)
        said = [decode(frame)[1] for frame in adapter.frames]
        return [Command(each.command) for each in said if isinstance(each, OperatorCommand)]

    assert run_virtual(released(heard=False)) == []
    assert Command.START in run_virtual(released(heard=True))


def test_t14_another_device_at_an_address_is_not_the_robot_that_was_there() -> None:
    tool = operator()
    say(tool, 0.0, 1, AddressClaimed(fleet_name("f", 1).pack()), Member(1, 1, 7), beat())
    say(tool, 0.1, 1, AddressClaimed(0))
    for tick in range(40):
        say(tool, 0.1 + tick * 0.05, 1, beat(stopped=True))
    assert [robot.slot for robot in tool.silent] == [1] and not tool.unknown
    assert not tool.confirmed(tool.robots[1])


def test_t14_in_a_fleet_with_keys_only_a_signed_echo_confirms() -> None:
    tool = operator(Keyring(KEYS, PANEL, b"1"))
    robot = Keyring(KEYS, 1, b"2", sent=31_000)  # whatever its counter is
    say(tool, 0.0, 1, Member(1, 1, 7))
    tool.begin_press()
    stop = tool.new_stop(Reason.OPERATOR_INTERVENTION)
    tool.stop(stop)
    echo = stop._replace(echo=True)
    say(tool, 0.1, 1, beat(stopped=True), echo._replace(freshness=3, tag=0x123456))
    assert tool.robots[1].stopped and not tool.confirmed(tool.robots[1]), "anybody can say that"
    say(tool, 0.2, 1, robot.sign(echo))
    assert tool.confirmed(tool.robots[1])
    tool.begin_press()
    assert not tool.confirmed(tool.robots[1]), "of an earlier press"
    for guess in range(ECHOES_TRIED):
        tool.stop(stop)
        say(tool, 0.3, 1, echo._replace(tag=guess + 1))
    say(tool, 0.4, 1, robot.sign(echo))
    assert not tool.confirmed(tool.robots[1]), "after so many guesses none is believed"


def test_t14_the_robots_of_a_launch_are_known_from_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_address, "LAUNCH", tmp_path / "bus.json")
    assert robots_of_launch("socketcand", "127.0.0.1", 0) == []
    where = {"host": "127.0.0.1", "port": 5, "channel": "can0", "robots": [0, 1, 2]}
    (tmp_path / "bus.json").write_text(json.dumps(where))
    assert robots_of_launch("socketcand", "127.0.0.1", 0) == [0, 1, 2]
    assert robots_of_launch("socketcand", "127.0.0.1", 5) == [0, 1, 2]
    assert robots_of_launch("socketcand", "127.0.0.1", 6) == [], "another bus"
    assert robots_of_launch("socketcan", "127.0.0.1", 0) == []


def test_a_press_in_another_folder_knows_the_robots_of_the_launch_whose_keys_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It said that all had stopped, of a launch with a dead robot, where it was called elsewhere."""
    monkeypatch.chdir(tmp_path)
    keys = tmp_path / "L" / "keys"
    keys.mkdir(parents=True)
    (keys / "operator.key").write_text("")
    where = {"host": "127.0.0.1", "port": 5, "robots": [0, 1, 2]}
    (tmp_path / "L" / "bus.json").write_text(json.dumps(where))
    for given in (keys, keys / "operator.key", Path("L/keys")):
        assert robots_of_launch("socketcand", "127.0.0.1", 5, given) == [0, 1, 2]
        assert robots_of_launch("socketcand", "127.0.0.1", 6, given) == [], "another bus"
    assert robots_of_launch("socketcand", "127.0.0.1", 5, None) == []


def test_t12_the_lamp_is_not_green_for_robots_that_are_not_heard() -> None:
    """It said ALL STOPPED of a launch with a dead robot, or one that had not said which it is."""
    tool = operator()
    tool.expect((1, 2))
    assert stop_status(tool).told(False).startswith("NOBODY ")
    say(tool, 0.0, 1, Member(1, 1, 7), beat(stopped=True))
    assert stop_status(tool).told(False) == "NOT ALL HEARD  live [1]  stopped [1]  not heard [2]"
    say(tool, 0.1, 2, beat(stopped=False))
    say(tool, 0.2, 2, Member(2, 1, 7))
    assert stop_status(tool).told(False) == "MOVING  live [1, 2]  stopped [1]"
    assert json.loads(stop_status(tool).told(True)) == {
        "says": "MOVING", "live": [1, 2], "stopped": [1], "not_heard": [],
    }  # fmt: skip
    say(tool, 0.3, 2, beat(stopped=True))
    assert stop_status(tool).told(False) == "ALL STOPPED  live [1, 2]  stopped [1, 2]"
    say(tool, 0.4, 3, beat(stopped=True))
    assert stop_status(tool).told(False).startswith("NOT ALL HEARD "), (
        "a robot that has not said which it is"
    )
    say(tool, 2.0, 1, beat(stopped=True))
    say(tool, 2.0, 2, beat(stopped=True))
    assert stop_status(tool).told(False).startswith("ALL STOPPED "), "nobody speaks there any more"
    say(tool, 9.0, 1, beat(stopped=True))
    assert stop_status(tool).told(False) == "NOT ALL HEARD  live [1]  stopped [1]  not heard [2]"


@pytest.fixture
def launched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The keys of a launch that was started in another folder; each tool gets a mute bus."""
    monkeypatch.chdir(tmp_path)
    keys = tmp_path / "L" / "keys"
    keys.mkdir(parents=True)
    where = {"host": "127.0.0.1", "port": 5, "robots": [0, 1, 2]}
    (tmp_path / "L" / "bus.json").write_text(json.dumps(where))
    write(keys / "fleet.json", keys / "operator.json", fresh(), 249, range(3))
    return keys


def test_new_keys_in_another_folder_know_the_robots_of_the_launch_whose_keys_they_are(
    launched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a dead robot it said that all used the new keys, and ended with exit code 0."""
    expected: list[int] = []

    def expect(tool: Operator, slots: Iterable[int]) -> None:
        expected.extend(slots)

    monkeypatch.setattr(Operator, "expect", expect)
    monkeypatch.setattr(rekey, "attach", lambda *words: CanBus(FieldBus("new keys elsewhere")))
    bus = ("socketcand", "can0", 250_000, "127.0.0.1", 5)
    assert rekey.rekey(NOBODY, 0, launched, bus, 0.1, True) == 1, "no robot is heard"
    assert expected == [0, 1, 2]


def test_a_map_that_is_started_later_knows_the_robots_of_the_launch(
    launched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its page said that all had confirmed a stop, of a launch with a dead robot."""
    known: list[int] = []

    class EnoughError(AttachError):
        pass

    class Listed(Panel):
        def __init__(self, *words: Any) -> None:
            super().__init__(*words)
            known.extend(robot.slot for robot in self.stopper.members)
            raise EnoughError

    async def mute(*words: object) -> CanBus:
        return CanBus(FieldBus("map elsewhere"))

    monkeypatch.setattr(command, "stay_attached", mute)
    monkeypatch.setattr(command, "Panel", Listed)
    show_map = command.show_map
    code = show_map(None, "socketcand", "can0", 250_000, "127.0.0.1", 5, launched, None, 0, True)
    assert code == 2 and known == [0, 1, 2]


@asynccontextmanager
async def fleet_and_tool(name: str) -> AsyncIterator[tuple[Cluster, CanBus, Operator]]:
    """Three robots after 11 s, and a tool on its bus that knows them."""
    cluster = Cluster(FieldSetup(load("small")), name)
    cluster.boot_all()
    bus = CanBus(FieldBus(cluster.segment.channel))
    tool, loop = Operator(bus, None), asyncio.get_running_loop()
    bus.subscribe(lambda frame: tool.hear(loop.time(), frame))
    try:
        await elapse(10.0)
        tool.ask_who()
        await elapse(1.0)
        yield cluster, bus, tool
    finally:
        await cluster.close()


def test_t14_a_press_names_the_robot_that_is_dead() -> None:
    async def main() -> tuple[list[int], list[int]]:
        async with fleet_and_tool("confirmations") as (cluster, bus, tool):
            cluster.kill(2)
            late = await press(tool, Reason.OPERATOR_INTERVENTION, 2.0)
            bus.close()
            return [robot.slot for robot in late], [r.slot for r in tool.members if r not in late]

    assert run_virtual(main()) == ([2], [0, 1])


def test_only_people_whom_a_live_robot_does_not_obey_are_told_to_press_again(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tool = operator()
    say(tool, 0.0, 1, Member(1, 1, 7), beat())
    say(tool, 5.0, 2, Member(2, 1, 7), beat())
    late = list(tool.members)
    assert tell(tool, late, as_json=False, signed=True) == 1
    assert AGAIN in capsys.readouterr().err
    assert tell(tool, late, as_json=True, signed=True) == 1
    told = capsys.readouterr()
    assert not json.loads(told.out)["all_stopped"] and not told.err, "a program joins both streams"
    silent = [robot for robot in late if robot not in tool.live]
    assert silent and tell(tool, silent, as_json=False, signed=True) == 1
    assert AGAIN not in capsys.readouterr().err, "no press reaches a robot that is silent"


FLOOD_S, LEAST_S = 6.0, 4.0


def test_a_press_that_is_held_goes_on_through_a_flood_until_all_have_confirmed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without it the press ended in the flood, nobody had latched, and the fleet drove on after it."""

    async def main(hold: bool) -> tuple[list[KnownRobot], float, list[bool]]:
        async with fleet_and_tool(f"held press {hold}") as (cluster, bus, tool):
            flood, loop = CanBus(FieldBus(cluster.segment.channel)), asyncio.get_running_loop()
            begun_s = loop.time()
            flooding = asyncio.create_task(_flood(flood, begun_s + FLOOD_S))
            late = await press(tool, Reason.OPERATOR_INTERVENTION, 2.0, hold)
            ended_s = loop.time() - begun_s
            bus.close()  # as the command does; what it has not sent is gone
            await flooding
            flood.close()
            await elapse(5.0)
            return late, ended_s, [r.peer.safety.latched for r in cluster.running]

    late, ended_s, latched = run_virtual(main(False))
    assert len(late) == 3 and ended_s < FLOOD_S and not any(latched), "the flood lets nothing pass"
    assert "pressing on" not in capsys.readouterr().err
    late, ended_s, latched = run_virtual(main(True))
    assert not late and ended_s > LEAST_S and all(latched)
    assert "not confirmed by robot 0, robot 1, robot 2; pressing on" in capsys.readouterr().err


async def _flood(bus: CanBus, until_s: float) -> None:
    """Frames that outrank a stop, more than the wire carries."""
    while asyncio.get_running_loop().time() < until_s:
        for _ in range(4):
            bus.send(Frame(0, bytes(8)))
        await elapse(0.001)


@pytest.mark.parametrize(
    "why", ["latched", "its place is lost", "held by another cause", "asks first"]
)
def test_a_start_of_one_robot_is_taken_only_when_what_a_start_ends_is_over(why: str) -> None:
    """`headland order 2 start` said `obeys start` of each robot that had its start before: of a latched
    one, which refuses it, of one with PLACE_LOST, and of one that asks for a proof first and so has
    refused what came before."""

    async def story(keyring: Keyring | None) -> bool:
        tool, loop = operator(keyring), asyncio.get_running_loop()
        asks_until_s = loop.time() + 0.5
        beats = beat(stopped=why == "latched")._replace(held=why != "asks first")
        causes = {
            "its place is lost": StandsBy.PLACE_LOST,
            "held by another cause": StandsBy.WORK_OFF,
        }
        say(tool, loop.time(), 2, Member(2, 1, 7), beats)
        giving = asyncio.create_task(convey(tool, tool.robots[2], "start", None, 2.0))
        while not giving.done():
            await elapse(0.05)
            say(tool, loop.time(), 2, beats)
            if why in causes:
                say(tool, loop.time(), 2, Standstill(2, causes[why], 0, 1, 0xFF, 0))
            if why == "asks first" and loop.time() < asks_until_s:
                say(tool, loop.time(), 2, Challenge(tool.slot, 2, 1))
        assert why != "asks first" or loop.time() > asks_until_s, "said again after the proof"
        return giving.result()

    keyring = Keyring(KEYS, 200, b"1") if why == "asks first" else None
    assert run_virtual(story(keyring)) is (why in ("held by another cause", "asks first"))
