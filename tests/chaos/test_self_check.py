"""A robot that nobody hears, whose controller is sick, or that was frozen stands still by itself."""

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial

import can
import pytest

from agent.interface.config import ACTUATOR_TTL_US, S
from agent.peer.self_check import LATE_HOLD_US, PASSIVE_US
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus, open_bus
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.virtual_clock import elapse, run_virtual
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

Story = Callable[[Cluster], Awaitable[None]]


def play(story: Story, robots: int = 3, scenario: str = "small") -> None:
    async def main() -> None:
        cluster = Cluster(FieldSetup(load(scenario).changed(robots, 7)), f"self check {id(story)}")
        cluster.boot_all()
        try:
            await elapse(10.0)
            assert not any(causes(cluster, slot) for slot in range(robots)), "no false alarm"
            await story(cluster)
            cluster.check()
        finally:
            await cluster.close()
        assert cluster.world.contacts == []

    run_virtual(main())


def causes(cluster: Cluster, slot: int) -> set[StopCause]:
    return {cause for cause, _ in cluster.robots[slot].peer.safety.causes}


def stands(cluster: Cluster, slot: int) -> bool:
    return cluster.world.body(slot).speed_m_s == 0.0


def deafen(cluster: Cluster, speaker: int, hearers: list[int]) -> None:
    links = {(cluster.node_of(speaker), cluster.node_of(slot)) for slot in hearers}
    cluster.segment.wire.faults.deaf |= links


def test_who_is_heard_by_nobody_stands_and_goes_on_when_it_is_heard_again() -> None:
    async def story(cluster: Cluster) -> None:
        deafen(cluster, 1, [0, 2])
        await elapse(0.3 + 0.3 + 2 * 0.05 + 0.1)  # theirs, ours, a round, two periods
        assert StopCause.UNHEARD in causes(cluster, 1)
        assert cluster.robots[1].peer.membership.live == {0, 1, 2}, "it hears them well"
        await elapse(3.0)
        assert stands(cluster, 1) and not stands(cluster, 0), "they go on, by their policy"
        cluster.segment.wire.heal()
        await elapse(3.0)
        assert not causes(cluster, 1) and not stands(cluster, 1)

    play(story)


def test_who_is_heard_by_one_goes_on() -> None:
    async def story(cluster: Cluster) -> None:
        deafen(cluster, 1, [0])
        await elapse(5.0)
        assert StopCause.UNHEARD not in causes(cluster, 1)

    play(story)


@pytest.mark.slow
@pytest.mark.parametrize("robots", [1, 2, 12])
def test_nobody_is_alarmed_in_a_sound_fleet(robots: int) -> None:
    async def story(cluster: Cluster) -> None:
        for _ in range(40):
            await elapse(0.5)
            found = {cause for slot in range(robots) for cause in causes(cluster, slot)}
            assert not found & {StopCause.UNHEARD, StopCause.ERROR_PASSIVE, StopCause.LATE_TICK}

    play(story, robots, "small" if robots < 12 else "oxted")


def test_a_bus_that_takes_nothing_is_noticed() -> None:
    async def story(cluster: Cluster) -> None:
        robot = cluster.robots[2]
        submit = robot.bus.submit
        robot.runner.bus._submit = lambda frame: False  # type: ignore[attr-defined]
        await elapse(0.5)
        assert StopCause.UNHEARD in causes(cluster, 2)
        await elapse(1.5)
        assert stands(cluster, 2)
        robot.runner.bus._submit = submit  # type: ignore[attr-defined]
        await elapse(3.0)
        assert not causes(cluster, 2)

    play(story)


def test_error_passive_is_borne_for_a_second() -> None:
    async def story(cluster: Cluster) -> None:
        node = cluster.segment.wire.nodes[cluster.node_of(1)]

        async def sick(seconds: float) -> None:
            for _ in range(round(seconds / 0.01)):
                node.tec = 200  # what is sent well takes one off each
                await elapse(0.01)

        await sick(PASSIVE_US / S * 0.8)
        assert not causes(cluster, 1)
        node.tec = 0
        await elapse(0.2)
        await sick(PASSIVE_US / S + 0.2)
        assert causes(cluster, 1) == {StopCause.ERROR_PASSIVE}
        await sick(1.5)
        assert stands(cluster, 1)
        node.tec = 0
        await elapse(1.0)
        assert not causes(cluster, 1) and not stands(cluster, 1)

    play(story)


def test_bus_off_is_noticed_by_itself() -> None:
    async def story(cluster: Cluster) -> None:
        now_us = cluster.robots[1].runner.now_us()
        cluster.segment.wire.bus_off(cluster.node_of(1), now_us + 2 * S)
        await elapse(0.1)
        assert causes(cluster, 1) >= {StopCause.BUS_OFF}
        await elapse(1.5)
        assert stands(cluster, 1)
        await elapse(4.0)
        assert not causes(cluster, 1), "it came back, joined again, and goes on"

    play(story)


def test_a_late_control_period_is_looked_round_after() -> None:
    async def story(cluster: Cluster) -> None:
        runner = cluster.robots[0].runner
        runner.freeze(ACTUATOR_TTL_US / S - 0.02)
        await elapse(0.2)
        assert StopCause.LATE_TICK not in causes(cluster, 0), "the actuator has not missed it"
        runner.freeze(ACTUATOR_TTL_US / S + 0.1)
        await elapse(0.25)
        assert causes(cluster, 0) == {StopCause.LATE_TICK}
        await elapse(LATE_HOLD_US / S - 0.1)
        assert StopCause.LATE_TICK in causes(cluster, 0) and stands(cluster, 0)
        await elapse(0.5)
        assert not causes(cluster, 0)

    play(story)


def test_error_frames_of_a_driver_are_read() -> None:
    """As Linux gives them; python-can's virtual bus carries them."""

    async def main() -> None:
        driver = can.Bus(interface="virtual", channel="errors")
        bus = CanBus(can.Bus(interface="virtual", channel="errors"))
        heard = asyncio.Event()
        bus.subscribe(lambda frame: heard.set())
        for error_class, detail, health in (
            (0x004, 0x08, Health.WARNING),
            (0x004, 0x20, Health.PASSIVE),
            (0x080, 0x00, Health.PASSIVE),  # a bus error says nothing about it
            (0x040, 0x00, Health.OFF),
            (0x100, 0x00, Health.ACTIVE),  # restarted
            (0x004, 0x10, Health.PASSIVE),
            (0x004, 0x40, Health.ACTIVE),
        ):
            data = bytes((0, detail, 0, 0, 0, 0, 0, 0))
            driver.send(can.Message(arbitration_id=error_class, is_error_frame=True, data=data))
            driver.send(can.Message(arbitration_id=0x18FF0001, is_extended_id=True))
            async with asyncio.timeout(10.0):
                await heard.wait()  # another thread delivers, in order
            heard.clear()
            assert bus.health is health
        bus.close()
        driver.shutdown()

    asyncio.run(main())


@pytest.mark.slow
def test_item_2_an_interface_that_confirms_tells_what_has_left() -> None:
    """SocketCAN hands own frames back as python-can's virtual bus does: marked, and not heard."""

    async def main() -> None:
        confirming = open_bus("virtual", "confirmed")
        plain = CanBus(can.Bus(interface="virtual", channel="confirmed"))
        heard, own, told = list[Frame](), list[Frame](), asyncio.Queue[None]()

        def hear(into: list[Frame], frame: Frame) -> None:
            into.append(frame)
            told.put_nowait(None)

        confirming.subscribe(partial(hear, own))
        plain.subscribe(partial(hear, heard))
        frames = [Frame(0x18FF1080, bytes([count])) for count in range(3)]
        for frame in frames:
            assert confirming.send(frame)
        async with asyncio.timeout(10.0):
            for _ in frames:
                await told.get()  # another thread delivers, in order
            plain.send(frames[0])
            await told.get()
        assert confirming.sent == 3
        assert heard == frames and own == frames[:1], "what another device sends is heard"
        assert plain.sent is None
        confirming.close()
        plain.close()

    asyncio.run(main())


@pytest.mark.parametrize("policy", ["slow", "continue"])
def test_item_2_a_robot_that_hears_nobody_goes_on_only_where_its_frames_are_confirmed(
    policy: str,
) -> None:
    async def main(confirms: bool) -> bool:
        scenario = load("small").changed(2, 7)
        fleet = scenario.fleet.model_copy(update={"silence": policy})
        cluster = Cluster(
            FieldSetup(scenario.model_copy(update={"fleet": fleet})), f"alone {policy} {confirms}"
        )
        cluster.boot_all()
        if not confirms:
            for robot in cluster.running:
                robot.runner._confirming = None
        try:
            await elapse(8.0)
            assert not any(causes(cluster, slot) for slot in range(2)), "they hear each other"
            cluster.kill(1)
            await elapse(0.4)
            assert StopCause.MEMBER_SILENT in causes(cluster, 0)
            await elapse(3.0)
            assert (StopCause.UNHEARD in causes(cluster, 0)) is not confirms
            return stands(cluster, 0)
        finally:
            await cluster.close()

    assert not run_virtual(main(True)) and run_virtual(main(False))
