"""A whole fleet in one event loop: N peers with a bus object each, the world, and the bus between.

The same shell as on a robot. Under `run_virtual` an hour passes in seconds and the same seed gives
the same run; under a real loop it is a demonstration.
"""

import asyncio
from collections.abc import Callable
from random import Random

import can

from agent.core import Identity, Peer
from agent.effects import Effect
from agent.field_work import FieldWork
from agent.motion import Limits, Motion
from agent.ports import Journal
from agent.route import Route
from agent.shell import Shell
from protocol.bus import CanBus
from protocol.name import fleet_name
from sim.fieldbus import segment
from sim.scenario import Scenario
from sim.setting import Setting

Recorder = Callable[[int, int, Effect], None]  # slot, time in microseconds, effect


class Robot:
    """One peer with everything around it."""

    def __init__(self, slot: int, shell: Shell, bus: can.BusABC) -> None:
        self.slot, self.shell, self.bus = slot, shell, bus
        self.task: asyncio.Task[None] | None = None

    @property
    def peer(self) -> Peer:
        return self.shell.peer

    @property
    def running(self) -> bool:
        return self.task is not None and not self.task.done()


def make_peer(setting: Setting, slot: int, now_us: int, recalled: dict[str, bytes]) -> Peer:
    """The peer of one slot for a scenario; the same on a virtual clock and in a process of its own."""
    fleet = setting.scenario.fleet
    work = FieldWork(setting.field, setting.route, fleet.speed_m_s, 0.7 * fleet.acceleration_m_s2)
    motion = Motion(slot, Limits(fleet.radius_m, fleet.speed_m_s, fleet.acceleration_m_s2), setting.fences)
    identity = Identity(
        slot=slot,
        members=frozenset(range(fleet.robots)),
        name=fleet_name(setting.scenario.name, slot),
        field_hash=setting.field.config_hash,
        silence=setting.silence,
        started=True,
    )
    rng = Random(f"{setting.scenario.run.seed}/peer/{slot}")
    return Peer(identity, rng, now_us, recalled, work, motion, setting.keyring(slot))


class Cluster:
    def __init__(self, setting: Setting, channel: str, recorder: Recorder | None = None) -> None:
        self.setting, self.channel, self.recorder = setting, channel, recorder
        self.scenario: Scenario = setting.scenario
        self.world = setting.world()
        self.segment = segment(channel, bitrate=self.scenario.bus.bitrate, seed=self.scenario.run.seed)
        self.robots: dict[int, Robot] = {}
        self.journals: dict[int, Journal] = {}

    def boot(self, slot: int) -> Robot:
        """Power a robot up with what its journal remembers."""
        journal = self.journals.get(slot)
        recalled = dict(journal.load()) if journal is not None else {}
        peer = make_peer(self.setting, slot, Shell.now_us(), recalled)
        bus = can.Bus(interface="fieldbus", channel=self.channel)
        recorder = self.recorder

        def record(now_us: int, effect: Effect) -> None:
            if recorder is not None:
                recorder(slot, now_us, effect)

        shell = Shell(peer, CanBus(bus), self.world.body(slot), journal, record)
        robot = Robot(slot, shell, bus)
        robot.task = asyncio.create_task(shell.run(), name=f"robot {slot}")
        self.robots[slot] = robot
        return robot

    def kill(self, slot: int) -> None:
        """Power off, without a word. The body stays where it is and its commands expire."""
        robot = self.robots[slot]
        if robot.task is not None:
            robot.task.cancel()
        robot.shell.bus.close()

    @property
    def running(self) -> list[Robot]:
        return [robot for _, robot in sorted(self.robots.items()) if robot.running]

    @property
    def finished(self) -> bool:
        """Every running replica knows every section done."""
        return bool(self.running) and all(
            robot.peer.allocation.done_count() == len(self.setting.field.sections)
            for robot in self.running
        )

    @property
    def replicas_equal(self) -> bool:
        states = {
            (robot.peer.allocation.serialize(), robot.peer.progress.serialize())
            for robot in self.running
        }
        return len(states) <= 1

    async def close(self) -> None:
        tasks = [robot.task for robot in self.robots.values() if robot.task is not None]
        for task in tasks:
            task.cancel()
        results = await asyncio.gather(*tasks, return_exceptions=True)
        for robot in self.robots.values():
            robot.shell.bus.close()
        for result in results:
            if isinstance(result, Exception):
                raise result
