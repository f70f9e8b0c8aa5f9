"""A scenario's faults, carried out on a cluster at their times."""

import asyncio
from collections.abc import Callable, Coroutine

from agent.config import S
from protocol.operator_frames import goal_check, goal_frames
from protocol.safety_frames import Command, EmergencyReset, OperatorCommand, Reason
from sim import scenario as kinds
from sim.cluster import OPERATOR, Cluster

TRIES = (
    5  # robots ask an operator they have not heard for a while to prove itself, one after another
)
SETTLE_S = 1.0  # between a reset and the start that follows it: rejoin and sync


class FaultPlan:
    """Runs beside the robots; sleeps to each fault's time on the loop's clock, virtual or not."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster = cluster
        self.done: list[tuple[float, str]] = []

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        for fault in sorted(self.cluster.scenario.fault, key=lambda f: f.at_s):
            await asyncio.sleep(max(0.0, fault.at_s - loop.time()))
            self.done.append((loop.time(), fault.kind))
            after = self._carry_out(fault)
            if after is not None:
                task = asyncio.create_task(after())
                self.cluster.tasks.add(task)
                task.add_done_callback(self.cluster.tasks.discard)

    def _now_us(self) -> int:
        """The world is brought to this instant before anything is done to it."""
        now_us = round(asyncio.get_running_loop().time() * S)
        self.cluster.world.advance(now_us)
        return now_us

    def _carry_out(self, fault: kinds.Fault) -> Callable[[], Coroutine[None, None, None]] | None:
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
                if disk == "lost":
                    cluster.journals.pop(robot, None)
                cluster.kill(robot)
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
                return self._reset
            case kinds.Order(robot=robot, order=order, x_m=x_m, y_m=y_m):
                return lambda: self._order(robot, Command[order.upper()], (x_m, y_m))
            case kinds.Box(x_m=x_m, y_m=y_m, size_m=size_m, for_s=for_s):
                return lambda: self._box(x_m, y_m, size_m, for_s)
            case kinds.Pushed(robot=robot, dx_m=dx_m, dy_m=dy_m):
                cluster.stops.carried(robot)
                cluster.world.body(robot).push(dx_m, dy_m)
        return None

    async def _box(self, x_m: float, y_m: float, size_m: float, for_s: float) -> None:
        box = self.cluster.world.add_box(x_m, y_m, size_m)
        await asyncio.sleep(for_s)
        self._now_us()
        self.cluster.world.remove_box(box)

    async def _order(self, robot: int, command: Command, goal: tuple[float, float]) -> None:
        """Said until a robot that has not heard this operator for a while can have asked and believed."""
        cluster, argument = self.cluster, 0
        for _ in range(1 if cluster.setting.keys is None else TRIES):
            if command is Command.SET_GOAL:
                frames = goal_frames(robot, OPERATOR, *goal)
                argument = goal_check(frames[0].value, frames[1].value)
                for frame in frames:
                    cluster.order(frame)
            cluster.order(OperatorCommand(command, robot, OPERATOR, argument))
            await asyncio.sleep(0.15)

    async def _reset(self) -> None:
        """An operator clears what is shown, goes from machine to machine, and then gives the start."""
        cluster = self.cluster
        dots = {dot for robot in cluster.running for dot in robot.peer.safety.stops.active}
        for _ in range(1 if cluster.setting.keys is None else TRIES):
            for dot in sorted(dots):
                cluster.order(EmergencyReset(*dot, OPERATOR))
            await asyncio.sleep(0.1)
        cluster.order(OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR))
        await asyncio.sleep(SETTLE_S)
        cluster.order(OperatorCommand(Command.START, 255, OPERATOR))
