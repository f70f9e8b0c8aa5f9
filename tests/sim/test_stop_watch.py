"""The watch over stops sees who moves after one, and knows when a person has let it go."""

import asyncio
from collections.abc import Awaitable, Callable

from agent.effects import Drive
from protocol.safety_frames import Command, EmergencyReset, OperatorCommand
from sim.clock import run_virtual
from sim.cluster import OPERATOR, Cluster
from sim.scenario import load
from sim.setting import Setting

Story = Callable[[Cluster], Awaitable[None]]


def play(story: Story) -> Cluster:
    async def main() -> Cluster:
        cluster = Cluster(Setting(load("small").changed(3, 1)), f"watch {id(story)}")
        cluster.boot_all()
        try:
            await asyncio.sleep(10.0)
            await story(cluster)
            cluster.world.advance(cluster.robots[0].shell.now_us())
            return cluster
        finally:
            await cluster.close()

    return run_virtual(main())


def order(cluster: Cluster, command: Command) -> None:
    cluster.order(OperatorCommand(command, 255, OPERATOR))


async def release(cluster: Cluster) -> None:
    for dot in sorted(cluster.robots[0].peer.safety.stops.active):
        cluster.order(EmergencyReset(*dot, OPERATOR))
    await asyncio.sleep(0.2)
    order(cluster, Command.MANUAL_RESET)
    await asyncio.sleep(1.0)


def test_a_fleet_that_obeys_is_without_blame_and_free_after_the_start() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await asyncio.sleep(3.0)
        await release(cluster)
        order(cluster, Command.START)
        await asyncio.sleep(3.0)
        assert any(cluster.world.body(slot).speed_m_s > 0.5 for slot in range(3))

    assert play(story).stops.violations == []


def test_a_robot_that_drives_on_is_seen() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await asyncio.sleep(1.0)
        now_us = cluster.robots[2].shell.now_us()
        cluster.world.body(2).drive(Drive(1.0, 0.0), now_us)
        await asyncio.sleep(0.2)

    found = play(story).stops.violations
    assert found and {violation.slots for violation in found} == {(2,)}


def test_a_start_before_the_reset_frees_nobody() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await asyncio.sleep(1.0)
        order(cluster, Command.START)
        order(cluster, Command.MANUAL_RESET)
        order(cluster, Command.START)
        await asyncio.sleep(1.0)
        await release(cluster)
        cluster.world.body(0).drive(Drive(1.0, 0.0), cluster.robots[0].shell.now_us())
        await asyncio.sleep(0.2)

    assert {v.slots for v in play(story).stops.violations} == {(0,)}, "reset is not start"


def test_who_cannot_hear_is_not_expected_to_obey_where_silence_stops_nobody_for_long() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.partition([{0, 1}, {2}])
        await asyncio.sleep(5.0)
        cluster.press(1)
        await asyncio.sleep(3.0)
        assert cluster.world.body(2).speed_m_s > 0.5

    assert play(story).stops.violations == []


def test_a_robot_that_is_pushed_by_hand_is_excused() -> None:
    async def story(cluster: Cluster) -> None:
        cluster.press(1)
        await asyncio.sleep(2.0)
        cluster.stops.carried(2)
        cluster.world.body(2).push(0.3, 0.0)
        await asyncio.sleep(1.0)

    assert play(story).stops.violations == []
