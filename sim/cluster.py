"""A whole fleet in one event loop: N peers with a bus object each, the world, and the bus between.

The same shell as on a robot. Under `run_virtual` an hour passes in seconds and the same seed gives
the same run; under a real loop it is a demonstration.
"""

import asyncio
from collections.abc import Callable, Mapping
from random import Random

import can

from agent.core import Identity, Peer
from agent.effects import Effect
from agent.shell import Shell
from protocol.bus import CanBus
from protocol.codec import encode
from protocol.messages import Message
from protocol.name import fleet_name
from sim.disk import MemoryJournal
from sim.errand_setting import ErrandSetting
from sim.fieldbus import FieldBus, forget, segment
from sim.scenario import Join, Scenario
from sim.setting import Setting

TOOL_ADDRESS = 249  # where scripted operator frames come from
AnySetting = Setting | ErrandSetting
Record = Callable[[int, int, Effect], None]  # slot, time in microseconds, effect


class Robot:
    """One peer with everything around it."""

    def __init__(self, slot: int, shell: Shell, bus: FieldBus) -> None:
        self.slot, self.shell, self.bus = slot, shell, bus
        self.task: asyncio.Task[None] | None = None

    @property
    def peer(self) -> Peer:
        return self.shell.peer

    @property
    def running(self) -> bool:
        return self.task is not None and not self.task.done()


def make_peer(setting: AnySetting, slot: int, now_us: int, recalled: Mapping[str, bytes]) -> Peer:
    """The peer of one slot of a scenario; the same on a virtual clock and in a process of its own."""
    identity = Identity(
        slot=slot,
        members=frozenset(range(setting.scenario.fleet.robots)),
        name=fleet_name(setting.scenario.name, slot),
        field_hash=setting.config_hash,
        silence=setting.silence,
        started=True,
    )
    rng = Random(f"{setting.scenario.run.seed}/peer/{slot}")
    mission, motion = setting.mission(slot), setting.motion(slot)
    return Peer(identity, rng, now_us, recalled, mission, motion, setting.keyring(slot))


class Cluster:
    def __init__(self, setting: AnySetting, channel: str, record: Record | None = None) -> None:
        self.setting, self.channel, self.record = setting, channel, record
        self.scenario: Scenario = setting.scenario
        self.world = setting.world()
        bus, seed = self.scenario.bus, self.scenario.run.seed
        self.segment = segment(channel, bitrate=bus.bitrate, seed=seed)
        faults = self.segment.wire.faults
        faults.loss, faults.error = bus.loss, bus.error_rate
        faults.omission, faults.duplicate = bus.omission, bus.duplicate
        self.robots: dict[int, Robot] = {}
        self.journals: dict[int, MemoryJournal] = {}
        self.tasks: set[asyncio.Task[None]] = set()
        self._tool: FieldBus | None = None

    def boot_all(self) -> None:
        """Everybody but those that join later."""
        late = {fault.robot for fault in self.scenario.fault if isinstance(fault, Join)}
        for slot in range(self.scenario.fleet.robots):
            if slot not in late:
                self.boot(slot)

    def boot(self, slot: int) -> Robot:
        """Power a robot up with what its journal remembers."""
        journal = self.journals.setdefault(slot, MemoryJournal())
        peer = make_peer(self.setting, slot, Shell.now_us(), journal.load())
        bus = can.Bus(interface="fieldbus", channel=self.channel)
        assert isinstance(bus, FieldBus)
        record = self.record

        def keep(now_us: int, effect: Effect) -> None:
            if record is not None:
                record(slot, now_us, effect)

        shell = Shell(peer, CanBus(bus), self.world.body(slot), journal, keep)
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

    def node_of(self, slot: int) -> int:
        return self.robots[slot].bus.node

    def partition(self, islands: list[set[int]]) -> None:
        nodes = [
            {self.node_of(slot) for slot in island if slot in self.robots} for island in islands
        ]
        self.segment.wire.partition(*nodes)

    def inject(self, message: Message, source: int = TOOL_ADDRESS) -> None:
        """A frame of a device that is not a robot, as an operator's tool would send it."""
        if self._tool is None:
            self._tool = FieldBus(self.channel)
        self._tool.submit(encode(message, source))

    def check(self) -> None:
        """Raise what a robot's task has raised: a broken assertion must not pass for silence."""
        for robot in self.robots.values():
            if robot.task is not None and robot.task.done() and not robot.task.cancelled():
                robot.task.result()

    @property
    def running(self) -> list[Robot]:
        return [robot for _, robot in sorted(self.robots.items()) if robot.running]

    @property
    def finished(self) -> bool:
        """Every running replica knows every section done."""
        sections = self.setting.section_count
        return bool(self.running) and all(
            robot.peer.allocation.done_count() == sections for robot in self.running
        )

    @property
    def replicas_equal(self) -> bool:
        """Registers and progress, byte for byte."""
        states = {
            (robot.peer.allocation.serialize(), robot.peer.progress.serialize())
            for robot in self.running
        }
        return len(states) <= 1

    async def close(self) -> None:
        tasks = [robot.task for robot in self.robots.values() if robot.task is not None]
        tasks += list(self.tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for robot in self.robots.values():
            robot.shell.bus.close()
        if self._tool is not None:
            self._tool.shutdown()
        forget(self.channel)
