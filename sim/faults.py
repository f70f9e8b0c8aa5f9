"""A scenario's faults, carried out on a cluster at their times."""

from random import Random

from agent.config import S
from protocol.frame import Frame
from protocol.network_frames import AddressClaimed
from protocol.operator_frames import goal_check, goal_frames
from protocol.safety_frames import Command, EmergencyReset, OperatorCommand, Reason
from sim import scenario as kinds
from sim.cluster import OPERATOR, Cluster
from sim.disk import Disk, LogJournal
from sim.fieldbus import FieldBus
from sim.host import Script, follow
from sim.swarm import SwarmShell

BABBLER, BABBLE_FRAMES, BABBLE_US = 240, 2, 1_000  # more than the bus can carry
TRIES = (
    5  # robots ask an operator they have not heard for a while to prove itself, one after another
)
ASK_S = 0.1  # between two tries
ORDER_S = 0.15  # between two of an order: a robot is asked, answers, and asks in turn
SETTLE_S = 1.0  # between a reset and the start that follows it: rejoin and sync


class FaultPlan:
    """Runs beside the robots, and waits for each fault's time on the host's clock."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster = cluster
        self.done: list[tuple[float, str]] = []
        self._rng = Random(f"{cluster.scenario.run.seed}/faults")

    async def run(self) -> None:
        """On the running asyncio loop."""
        await follow(self.script())

    def script(self) -> Script[None]:
        for fault in sorted(self.cluster.scenario.fault, key=lambda f: f.at_s):
            yield round(fault.at_s * S)
            self.done.append((self.cluster.host.now_us() / S, fault.kind))
            after = self._carry_out(fault)
            if after is not None:
                self.cluster.host.spawn(after)

    def _now_us(self) -> int:
        """The world is brought to this instant before anything is done to it."""
        now_us = self.cluster.host.now_us()
        self.cluster.world.advance(now_us)
        return now_us

    def _carry_out(self, fault: kinds.Fault) -> Script[None] | None:
        now_us = self._now_us()
        cluster, wire = self.cluster, self.cluster.segment.wire
        match fault:
            case kinds.Partition(islands=islands):
                cluster.partition([set(island) for island in islands])
            case kinds.Heal():
                wire.heal()
            case kinds.OneWay(sender=sender, receiver=receiver):
                wire.faults.deaf.add((cluster.node_of(sender), cluster.node_of(receiver)))
            case kinds.Crash(robot=robot):
                cluster.kill(robot)
            case kinds.Restart(robot=robot, disk=disk):
                cluster.kill(robot)
                if disk == "lost":
                    cluster.journals[robot] = LogJournal(Disk())
                journal = cluster.journals[robot]
                if disk == "torn" and isinstance(journal, LogJournal):
                    cluster.journals[robot] = LogJournal(journal.disk.after_cut(self._rng))
                cluster.boot(robot)
            case kinds.Join(robot=robot):
                cluster.boot(robot)
            case kinds.Freeze(robot=robot, for_s=for_s):
                cluster.robots[robot].shell.freeze(for_s)
            case kinds.Loss(rate=rate):
                wire.faults.loss = rate
            case kinds.Omission(rate=rate):
                wire.faults.omission = rate
            case kinds.Duplicate(rate=rate):
                wire.faults.duplicate = rate
            case kinds.Errors(rate=rate):
                wire.faults.error = rate
            case kinds.BusOff(robot=robot, for_s=for_s):
                wire.bus_off(cluster.node_of(robot), now_us + round(for_s * S))
            case kinds.Estop(robot=robot, reason=reason):
                cluster.press(robot, Reason[reason])
            case kinds.Reset():
                return self._reset()
            case kinds.Order(robot=robot, order=order, x_m=x_m, y_m=y_m):
                return self._order(robot, Command[order.upper()], (x_m, y_m))
            case kinds.Box(x_m=x_m, y_m=y_m, size_m=size_m, for_s=for_s):
                return self._box(x_m, y_m, size_m, for_s)
            case kinds.Pushed(robot=robot, dx_m=dx_m, dy_m=dy_m):
                cluster.stops.carried(robot)
                cluster.world.body(robot).push(dx_m, dy_m)
            case kinds.Babble(priority=priority, for_s=for_s):
                return self._babble(priority, for_s)
            case kinds.Clone(robot=robot, wins=wins):
                self._clone(robot, wins)
            case kinds.Drift(robot=robot, ppm=ppm):
                shell = cluster.robots[robot].shell
                if isinstance(shell, SwarmShell):  # asyncio has one clock for all
                    shell.drift(ppm)
        return None

    def _box(self, x_m: float, y_m: float, size_m: float, for_s: float) -> Script[None]:
        until_us = self._now_us() + round(for_s * S)
        box = self.cluster.world.add_box(x_m, y_m, size_m)
        yield until_us
        self._now_us()
        self.cluster.world.remove_box(box)

    def _babble(self, priority: int, for_s: float) -> Script[None]:
        bus = FieldBus(self.cluster.channel)
        bus.subscribe(lambda frame: None)
        until_us = self._now_us() + round(for_s * S)
        while self._now_us() < until_us:
            # of a group that nobody knows, below and above ours in urgency
            frame = Frame(priority << 26 | 0x1FF0700 | BABBLER, self._rng.randbytes(8))
            for _ in range(BABBLE_FRAMES):
                bus.submit(frame)
            yield self._now_us() + BABBLE_US
        bus.shutdown()

    def _clone(self, robot: int, wins: bool) -> None:
        peer = self.cluster.robots[robot].peer
        if peer.address is not None:
            number = peer.identity.name.pack()
            name = number - 1 if wins else number + 1
            self.cluster.inject(AddressClaimed(name), peer.address)

    def _order(self, robot: int, command: Command, goal: tuple[float, float]) -> Script[None]:
        """Said until a robot that has not heard this operator for a while can have asked and
        believed."""
        cluster, argument = self.cluster, 0
        for _ in range(1 if cluster.setting.keyring(OPERATOR, "operator") is None else TRIES):
            if command is Command.SET_GOAL:
                frames = goal_frames(robot, OPERATOR, *goal)
                argument = goal_check(frames[0].value, frames[1].value)
                for frame in frames:
                    cluster.order(frame)
            cluster.order(OperatorCommand(command, robot, OPERATOR, argument))
            yield self._now_us() + round(ORDER_S * S)

    def _reset(self) -> Script[None]:
        """An operator clears what is shown, goes from machine to machine, and then gives the start."""
        cluster = self.cluster
        dots = {dot for robot in cluster.running for dot in robot.peer.safety.stops.active}
        for _ in range(1 if cluster.setting.keyring(OPERATOR, "operator") is None else TRIES):
            for dot in sorted(dots):
                cluster.order(EmergencyReset(*dot, OPERATOR))
            yield self._now_us() + round(ASK_S * S)
        cluster.order(OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR))
        yield self._now_us() + round(SETTLE_S * S)
        cluster.order(OperatorCommand(Command.START, 255, OPERATOR))
