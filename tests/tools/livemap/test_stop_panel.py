"""The operator device of a map: when a press is one of its own."""

import asyncio
from collections.abc import Callable
from random import Random
from typing import Any

import pytest

from agent.interface.lifecycle import State
from protocol.frames.codec import decode, encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyStop, Reason
from protocol.frames.work_frames import StateSyncRequest
from protocol.links.socketcand_link import SocketcandLink
from sim.fleet.virtual_clock import elapse, run_virtual
from tools.livemap.stop_panel import ASK_S, CONFIRM_S, Panel, PanelError, not_confirmed, told_result

PERIOD_S = 0.05


class Robots:
    """A bus with two: robot 0 obeys and robot 1 never confirms."""

    def __init__(self) -> None:
        self.stops: list[tuple[int, int, int]] = []  # names of stops that were pressed, in order
        self.latched, self.started = False, True
        self._spent: set[tuple[int, int, int]] = set()
        self.panel = Panel(self, None)  # type: ignore[arg-type]

    def send(self, frame: Frame) -> bool:
        _, message = decode(frame)
        if isinstance(message, EmergencyStop):
            name = message[:3]
            if name not in self.stops:
                self.stops.append(name)
            if name not in self._spent and not self.latched:
                self.latched = True
                echo = encode(message._replace(echo=True), 128)
                asyncio.get_running_loop().call_soon(self.panel.hear, self._now_s, echo)
        return True

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """The panel is told by `beat`."""

    @property
    def _now_s(self) -> float:
        return asyncio.get_running_loop().time()

    def beat(self) -> None:
        for slot in (0, 1):
            beat = Heartbeat(
                1, State.WORKING, self.latched and slot == 0, False, self.started, False, 1.0, 0, 0
            )
            for message in (Member(slot, 1, 7), beat):
                self.panel.hear(self._now_s, encode(message, 128 + slot))

    def release(self) -> None:
        """The stop is cleared, and its name is known."""
        self._spent, self.latched = set(self.stops), False

    async def run(self, for_s: float) -> None:
        ends_at_s = self._now_s + for_s
        while self._now_s < ends_at_s:
            self.beat()
            await elapse(PERIOD_S)


def test_a_press_after_a_release_is_a_new_stop_although_the_last_one_is_not_confirmed_yet() -> None:
    """It joined the press before it, which repeated a stop that was cleared, and robot 0 counted as
    stopped by its echo of that. Robots answer that such a stop is spent, and then another one is pressed;
    without that answer nobody stood when the ten seconds of the first press were over."""

    async def story() -> None:
        robots = Robots()
        await robots.run(1.0)
        first = asyncio.create_task(robots.panel.stop())
        await robots.run(CONFIRM_S - 1.0)
        assert robots.latched and not first.done() and len(robots.stops) == 1
        robots.release()
        await robots.run(0.5)
        second = asyncio.create_task(robots.panel.stop())
        await robots.run(0.2)
        assert len(robots.stops) == 2 and robots.latched
        third = asyncio.create_task(robots.panel.stop())
        await robots.run(CONFIRM_S)
        assert len(robots.stops) == 2, "of one press"
        for answer in (await first, await second, await third):
            assert answer["stopped"] == [0] and answer["late"] == [1]

    run_virtual(story())


def test_a_press_ends_a_release_that_is_under_way() -> None:
    """A release that had started the fleet went on, and the one after the press was refused."""

    async def story() -> None:
        robots = Robots()
        await robots.run(1.0)
        first = asyncio.create_task(robots.panel.release(keyless=True, reset=True, start=True))
        await robots.run(0.3)
        with pytest.raises(PanelError, match="under way"):
            await robots.panel.release(keyless=True, reset=True, start=True)
        pressed = asyncio.create_task(robots.panel.stop())
        await robots.run(0.1)
        with pytest.raises(PanelError, match="STOP was pressed"):
            await first
        second = asyncio.create_task(robots.panel.release(keyless=True, reset=True, start=False))
        await robots.run(CONFIRM_S)
        assert (await second)["late"] == [0] and (await pressed)["stopped"] == [0]

    run_virtual(story())


class KeyedRobots(Robots):
    """Robots that tell the stop that holds them, and obey no release without a tag."""

    HELD = EmergencyStop(1, 7, 9, Reason.OPERATOR_INTERVENTION, echo=True)

    def send(self, frame: Frame) -> bool:
        _, message = decode(frame)
        if isinstance(message, StateSyncRequest) and self.latched:
            told = encode(self.HELD, 128)
            asyncio.get_running_loop().call_soon(self.panel.hear, self._now_s, told)
        return True


def test_a_stop_that_robots_hold_after_a_release_was_not_cleared() -> None:
    """The page named every stop that was shown as cleared, also where no robot was released."""

    async def story() -> None:
        robots = KeyedRobots()
        robots.latched = True
        await robots.run(1.0)
        done = asyncio.create_task(robots.panel.release(keyless=True, reset=True, start=False))
        await robots.run(CONFIRM_S)
        answer = await done
        assert answer["late"] == [0] and answer["cleared"] == []

    run_virtual(story())


def test_robots_that_do_not_start_after_a_release_are_not_said_to_be_started() -> None:
    """The panel said "released and started" as soon as it had sent three starts."""

    async def story() -> None:
        robots = Robots()
        for starts in (False, True):
            robots.started = False
            await robots.run(1.0)
            done = asyncio.create_task(robots.panel.release(keyless=True, reset=True, start=True))
            await robots.run(2.0)
            robots.started = starts
            await robots.run(CONFIRM_S)
            answer = await done
            assert answer["started"] == starts and answer["late"] == ([] if starts else [0, 1])
            assert answer["released"]

    run_virtual(story())


def test_a_robot_that_is_not_heard_at_a_release_is_named() -> None:
    """The page said "released", while a robot that had been there stood behind a broken cable with its
    stop."""

    async def story() -> None:
        robots = Robots()
        robots.panel.stopper.expect([3])
        await robots.run(1.0)
        done = asyncio.create_task(robots.panel.release(keyless=True, reset=True, start=True))
        await robots.run(CONFIRM_S)
        answer = await done
        assert answer["released"] and answer["started"] and answer["silent"] == [3]
        assert not_confirmed(answer) == "robot 3 (not heard)"

    run_virtual(story())


@pytest.mark.parametrize("ago_s", [0.5, 60.0])
def test_a_press_does_not_wait_for_an_address_that_is_long_gone(ago_s: float) -> None:
    """A robot that fell silent before it had said who it is made every later press of that map last ten
    seconds and 2,000 frames. A release in that time was answered by a new stop."""

    async def story() -> None:
        robots, loop = Robots(), asyncio.get_running_loop()
        nameless = Heartbeat(1, State.WORKING, False, False, True, False, 1.0, 0, 0)
        robots.panel.hear(loop.time(), encode(nameless, 140))
        await elapse(ago_s)

        async def beats() -> None:
            while True:
                for message in (
                    Member(0, 1, 7), nameless._replace(stopped=robots.latched),
                ):  # fmt: skip
                    robots.panel.hear(loop.time(), encode(message, 128))
                await elapse(PERIOD_S)

        beating, begun_s = asyncio.create_task(beats()), loop.time()
        told = await robots.panel.stop()
        beating.cancel()
        assert told["stopped"] == [0] and told["late"] == []
        assert not told["unnamed"] and not not_confirmed(told)
        assert (loop.time() - begun_s < 1.0) is (ago_s > 1.0), "one that has just spoken may move"

    run_virtual(story())


def test_an_address_that_has_not_said_which_robot_it_is_has_not_confirmed() -> None:
    """The map said that all had confirmed, beside a robot whose name nobody had heard yet."""

    async def story() -> None:
        robots, loop = Robots(), asyncio.get_running_loop()
        nameless = Heartbeat(1, State.WORKING, False, False, True, False, 1.0, 0, 0)

        async def speaks() -> None:
            while True:
                robots.panel.hear(loop.time(), encode(nameless, 140))
                await elapse(PERIOD_S)

        speaking = asyncio.create_task(speaks())
        await robots.run(1.0)
        pressed = asyncio.create_task(robots.panel.stop())
        await robots.run(CONFIRM_S + 0.5)
        told = await pressed
        speaking.cancel()
        assert told["unnamed"] == [140] and "address 140" in not_confirmed(told)

    run_virtual(story())


def test_a_map_asks_again_what_was_said_while_its_bus_was_away() -> None:
    """Sections that were done meanwhile stayed as they were before, on the map and in the metrics."""

    async def story() -> None:
        robots = Robots()
        link, asked = SocketcandLink("127.0.0.1", 1, "can0", Random(1)), list[int]()
        robots.panel.bus = link
        robots.panel.stopper.ask_work = lambda: asked.append(link.connections)  # type: ignore[method-assign]
        asking = asyncio.create_task(robots.panel.keep_asking())
        for made in (1, 1, 2):
            link.connections = made
            await elapse(ASK_S + 1.0)
        asking.cancel()
        assert asked == [1, 2]

    run_virtual(story())


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ({"stopped": [0, 1]}, (True, "stopped: [0, 1]")),
        ({"stopped": [0], "late": [1]}, (False, "not confirmed: robot 1")),
        ({"stopped": [], "heard": False}, (False, "no robot is heard")),
        ({"released": True}, (True, "released")),
        ({"released": True, "late": [1]}, (False, "not started: robot 1")),
        ({"released": False, "late": [1]}, (False, "not released: robot 1")),
        ({"released": True, "heard": False}, (False, "no robot is heard")),
    ],
)
def test_viewers_and_ros_2_are_told_what_came_of_it(
    answer: dict[str, Any], told: tuple[bool, str]
) -> None:
    """Foxglove said "not confirmed" of robots that were released and did not start."""
    assert told_result({"late": [], "heard": True, **answer}) == told
