"""Applies a scenario's faults to a simulated fleet at their times."""

from collections.abc import Callable
from math import ceil, hypot
from random import Random

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.vehicle import DriveTrain
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.operator_frames import goal_check, goal_frames
from protocol.frames.safety_frames import Command, EmergencyReset, OperatorCommand, Reason
from sim.can.simulated_bus import FieldBus
from sim.fleet.dropped_box import drop
from sim.fleet.event_loop import SimulatedRunner
from sim.fleet.foreign_devices import buttons, used_stop
from sim.fleet.forgers import forger
from sim.fleet.moving_obstacles import Shape, walk
from sim.fleet.scheduler import Script, follow
from sim.fleet.simulated_disk import Disk, LogJournal
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.fleet.strangers import foreign, nonsense, twin
from sim.scenarios import scenario as kinds

UNKNOWN_GROUP = 0x1FF0700  # its priority is drawn; even at 0 a stop has the lower identifier
BABBLER, BABBLE_FRAMES, BABBLE_US = 240, 2, 1_000  # more than the bus can carry
# Attempts: robots ask an operator that has been silent for a while to prove its counter, one after
# another.
TRIES = 5
ASK_S = 0.1  # between two attempts
ORDER_S = 0.15  # between two repeats of an order: a robot is asked, answers, and asks in turn
# Limit for a robot to start work; interval of checks.
WAIT_US, LOOK_US = 10 * S, S // 100
PUSHED_M_S = 1.0  # walking speed of people that push a machine
PUSHED_APART_M = 0.3  # gap left between two machines when one is pushed
# Room left to fences for a machine that steers like a tractor. One that is pushed aslant into a corner
# can drive neither ahead nor back.
STEERED_ROOM_M = 0.6
SETTLED_S = 3.0  # this long after trouble of links or members, all members receive each other again
HEARD_ALL_THE_SAME = (kinds.Buttons, kinds.UsedStop, kinds.Estop, kinds.Reset, kinds.Order,
                      kinds.Box, kinds.Person, kinds.PassingVehicle, kinds.Pushed)  # fmt: skip
PERSON = Shape(0.5)  # across the shoulders, with the arms
SETTLE_S = 1.0  # between a reset and the start that follows it: rejoin and sync


class FaultPlan:
    """Runs beside the robots, and applies each fault when the host's clock reaches its time."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster = cluster
        # Those that found what they are about, and when, seconds.
        self.done: list[tuple[float, kinds.Fault]] = []
        self._begun = 0  # faults whose time has come
        self._slips: dict[int, int] = {}  # how many faults of slip a robot has had
        self._jam_ends_at_us: dict[int, int] = {}
        self._rng = Random(f"{cluster.scenario.run.seed}/faults")

    async def run(self) -> None:
        """Run on the present asyncio loop."""
        await follow(self.script())

    def script(self) -> Script[None]:
        """Wait for the time of each fault, the earliest first, and apply it. What a fault does
        later is a script of its own."""
        for fault in sorted(self.cluster.scenario.fault, key=lambda f: f.at_s):
            yield round(fault.at_s * S)
            self._begun += 1
            if not self._is_void(fault):
                self.done.append((self.cluster.host.now_us() / S, fault))
            self._trouble(fault)
            after = self._carry_out(fault)
            if after is not None:
                self.cluster.host.spawn(after)

    def _trouble(self, fault: kinds.Fault) -> None:
        """From now on and for a while, foreign devices are not expected to be received by all
        robots."""
        if not isinstance(fault, HEARD_ALL_THE_SAME):
            for_s = getattr(fault, "for_s", 0.0) + SETTLED_S
            self.cluster.stops.disturbed(self.cluster.host.now_us() + round(for_s * S))

    def _now_us(self) -> int:
        """The present time; the world is advanced to it before anything is changed in it."""
        now_us = self.cluster.host.now_us()
        self.cluster.world.advance(now_us)
        return now_us

    def _carry_out(self, fault: kinds.Fault) -> Script[None] | None:
        now_us = self._now_us()
        cluster, wire = self.cluster, self.cluster.segment.wire
        cluster.look()
        if not isinstance(fault, kinds.Join) and self._absent(fault):
            return None  # a robot that does not exist yet cannot break
        match fault:
            case kinds.Partition(islands=islands):
                cluster.partition([set(island) for island in islands])
            case kinds.Heal():
                wire.heal()
            case kinds.OneWay(sender=sender, receiver=receiver):
                wire.faults.deaf.add((cluster.node_of(sender), cluster.node_of(receiver)))
            case kinds.Crash(robot=robot):
                cluster.kill(robot)
            case kinds.CrashWorking(robot=robot, for_s=for_s, disk=disk):
                return self._crash_working(robot, for_s, disk)
            case kinds.Restart(robot=robot, disk=disk):
                self._restart(robot, disk)
            case kinds.Join(robot=robot) if not cluster.is_up(robot):
                if not cluster.has_room(robot):
                    return self._join_with_room(robot)
                cluster.boot(robot)
            case kinds.Freeze(robot=robot, for_s=for_s):
                cluster.freeze(robot, for_s)
            case kinds.Loss(rate=rate):
                wire.faults.loss = rate
            case kinds.Omission(rate=rate):
                wire.faults.omission = rate
            case kinds.Duplicate(rate=rate):
                wire.faults.duplicate = rate
            case kinds.Errors(rate=rate):
                wire.faults.error = rate
            case kinds.BusOff(robot=robot, for_s=for_s):
                if cluster.is_up(robot):  # the controller of a dead robot is off already
                    wire.bus_off(cluster.node_of(robot), now_us + round(for_s * S))
                    cluster.segment.arm()  # no other robot may send until it is back
            case kinds.Estop(robot=robot, reason=reason):
                cluster.press(robot, Reason[reason])
            case kinds.Reset():
                return self._reset()
            case kinds.Order(robot=robot, order=order, x_m=x_m, y_m=y_m):
                return self._order(robot, Command[order.upper()], (x_m, y_m))
            case kinds.Box(x_m=x_m, y_m=y_m, size_m=size_m, for_s=for_s):
                return drop(cluster.world, self._now_us, (x_m, y_m), size_m, for_s)
            case kinds.Person(route=route, speed_m_s=speed_m_s, yields=yields):
                return walk(cluster.world, self._now_us, PERSON, route, speed_m_s, yields)
            case kinds.PassingVehicle(route=route, speed_m_s=speed_m_s, yields=yields):
                shape = Shape(fault.length_m, fault.width_m)
                return walk(cluster.world, self._now_us, shape, route, speed_m_s, yields)
            case kinds.Pushed(robot=robot, dx_m=dx_m, dy_m=dy_m):
                return self._push(robot, dx_m, dy_m)
            case kinds.Babble(priority=priority, identifier=identifier, for_s=for_s):
                if identifier is None:
                    identifier = priority << 26 | UNKNOWN_GROUP | BABBLER
                return self._babble(identifier, for_s)
            case kinds.Buttons():
                return buttons(cluster, fault, self._rng, self._begun)
            case kinds.UsedStop():
                return used_stop(cluster, fault, self._rng)
            case kinds.Foreign():
                return foreign(cluster, fault, self._rng)
            case kinds.Twin():
                return twin(cluster, fault, self._rng)
            case kinds.Nonsense():
                return nonsense(cluster, fault, self._rng)
            case kinds.Forger(robot=robot, position=position, for_s=for_s):
                named = (robot,) if position == "outside" else range(cluster.scenario.fleet.robots)
                cluster.stops.imitated(named, now_us + round((for_s + SETTLED_S) * S))
                return forger(cluster, fault, self._rng)
            case kinds.Clone(robot=robot, wins=wins):
                self._clone(robot, wins)
            case kinds.Blind(robot=robot, for_s=for_s):
                cluster.receivers[robot].blind(now_us + round(for_s * S))
            case kinds.Frozen(robot=robot, for_s=for_s):
                cluster.receivers[robot].frozen(now_us, now_us + round(for_s * S))
            case kinds.HungFixes(robot=robot, every_s=every_s, share=share, for_s=for_s):
                end_at_us = now_us + round(for_s * S)
                cluster.receivers[robot].hung_fixes(end_at_us, round(every_s * S), share)
            case kinds.Jumped(robot=robot, dx_m=dx_m, dy_m=dy_m, turn_rad=turn_rad, for_s=for_s):
                end_at_us = now_us + round(for_s * S)
                cluster.receivers[robot].jumped(end_at_us, (dx_m, dy_m, turn_rad))
            case kinds.Drifting(robot=robot, vx_m_s=vx_m_s, vy_m_s=vy_m_s, for_s=for_s):
                end_at_us = now_us + round(for_s * S)
                cluster.receivers[robot].drifting(now_us, end_at_us, (vx_m_s, vy_m_s))
            case kinds.DeafWheels(robot=robot, for_s=for_s):
                cluster.receivers[robot].deaf_wheels(now_us + round(for_s * S))
            case kinds.Slipping(robot=robot, slip=slip, for_s=for_s):
                return self._slip(robot, slip, for_s)
            case kinds.StuckImplement(robot=robot, for_s=for_s):
                return self._jam(robot, for_s)
            case kinds.Late(robot=robot, by_s=by_s, for_s=for_s):
                cluster.receivers[robot].late(now_us + round(for_s * S), round(by_s * S))
            case kinds.NoRays(robot=robot, for_s=for_s):
                cluster.receivers[robot].scanner.dead(now_us + round(for_s * S))
            case kinds.StuckRays(robot=robot, for_s=for_s):
                cluster.receivers[robot].scanner.stuck(now_us + round(for_s * S))
            case kinds.NoisyRays(robot=robot, spread_m=spread_m, missing=missing, for_s=for_s):
                noise = Random(f"{self.cluster.host.now_us()} rays of {robot}")
                end_at_us = now_us + round(for_s * S)
                cluster.receivers[robot].scanner.noisy(end_at_us, noise, spread_m, missing)
            case kinds.DiskFull(robot=robot, for_s=for_s):
                return self._disk_full(robot, for_s)
            case kinds.Drift(robot=robot, ppm=ppm):
                runner = cluster.robots[robot].runner
                if isinstance(runner, SimulatedRunner):  # asyncio has one clock for all
                    runner.drift(ppm)
            case kinds.ClockJump(robot=robot, by_s=by_s):
                runner = cluster.robots[robot].runner
                if isinstance(runner, SimulatedRunner):
                    runner.jump(by_s)
        return None

    def _slip(self, robot: int, slip: float, for_s: float) -> Script[None]:
        """The wheels slip for a while. Of two such faults the later one holds, and ends with it."""
        body = self.cluster.world.robots[robot]
        body.slip(slip)
        self._slips[robot] = self._slips.get(robot, 0) + 1
        turn = self._slips[robot]
        yield self.cluster.host.now_us() + round(for_s * S)
        if self._slips[robot] == turn:
            self._now_us()
            body.slip(None)

    def _jam(self, robot: int, for_s: float) -> Script[None]:
        """The implement does not rise for a while. Of two such faults the later end holds."""
        body, end_at_us = self.cluster.world.robots[robot], self._now_us() + round(for_s * S)
        body.jam(True)
        self._jam_ends_at_us[robot] = max(self._jam_ends_at_us.get(robot, 0), end_at_us)
        yield end_at_us
        if self._now_us() >= self._jam_ends_at_us[robot]:
            body.jam(False)

    def _is_void(self, fault: kinds.Fault) -> bool:
        """Whether the fault finds nothing to change: a robot that does not exist yet, one that is off
        already, or on."""
        match fault:
            case kinds.Join(robot=robot):
                return self.cluster.is_up(robot)
            case kinds.Crash(robot=robot) | kinds.BusOff(robot=robot) | kinds.Estop(robot=robot):
                return not self.cluster.is_up(robot)
        return self._absent(fault)

    def _absent(self, fault: kinds.Fault) -> bool:
        """Whether the fault names a robot that has not been switched on yet."""
        named = [getattr(fault, key, None) for key in ("robot", "sender", "receiver")]
        return any(slot is not None and slot not in self.cluster.robots for slot in named)

    def _restart(self, robot: int, disk: str) -> None:
        cluster = self.cluster
        cluster.kill(robot)
        journal = cluster.journals[robot]
        # A robot with a full disk has latched; a person gives it a new disk with the restart.
        if disk == "lost" or (isinstance(journal, LogJournal) and journal.disk.full):
            journal = cluster.journals[robot] = LogJournal(Disk())
        if disk == "torn" and isinstance(journal, LogJournal):
            cluster.journals[robot] = journal.after_cut(self._rng)
        if disk == "rolled_back" and isinstance(journal, LogJournal):
            cluster.journals[robot] = journal.earlier(self._rng.random())
        cluster.boot(robot)

    def _join_with_room(self, robot: int) -> Script[None]:
        """Switch a robot on when the others have made room for it."""
        while not self.cluster.has_room(robot):
            yield self._now_us() + LOOK_US
        if not self.cluster.is_up(robot):
            self._now_us()
            self.cluster.boot(robot)

    def _disk_full(self, robot: int, for_s: float) -> Script[None]:
        """Only a simulated disk can be filled up."""
        journal = self.cluster.journals[robot]
        if isinstance(journal, LogJournal):
            journal.disk.fill()
            yield self._now_us() + round(for_s * S)
            if self.cluster.journals[robot] is journal:  # else another fault replaced it first
                self._restart(robot, "lost")

    def _crash_working(self, robot: int, for_s: float, disk: str) -> Script[None]:
        end_at_us = self._now_us() + WAIT_US
        while not (self.cluster.is_up(robot) and self.cluster.world.body(robot).tool_on):
            if self._now_us() >= end_at_us:
                return
            yield self._now_us() + LOOK_US
        self.cluster.kill(robot)
        yield self._now_us() + round(for_s * S)
        if not self.cluster.is_up(robot):  # another fault stopped it first
            self._restart(robot, disk)

    def _push(self, robot: int, dx_m: float, dy_m: float) -> Script[None]:
        """Push at walking speed as far as there is room: people do not push machines through fences
        or into each other."""
        body = self.cluster.world.body(robot)
        steps = ceil(hypot(dx_m, dy_m) * S / (PUSHED_M_S * CONTROL_PERIOD_US))
        for _ in range(steps):
            self._now_us()
            if not self._is_free(robot, dx_m / steps, dy_m / steps):
                return
            body.push(dx_m / steps, dy_m / steps)
            yield self._now_us() + CONTROL_PERIOD_US

    def _is_free(self, robot: int, dx_m: float, dy_m: float) -> bool:
        """Whether there is room for a robot beside where it stands."""
        body, bodies = self.cluster.world.body(robot), self.cluster.world.robots.values()
        is_tractor = body.chassis.kind is DriveTrain.ACKERMANN
        holds = self._space(body.radius_m + (STEERED_ROOM_M if is_tractor else 0.0))
        if holds is None:
            return True
        x_m, y_m = body.position[0] + dx_m, body.position[1] + dy_m
        apart_m = 2 * body.radius_m + PUSHED_APART_M
        others = (other.position for other in bodies if other is not body)
        return holds(x_m, y_m) and all(hypot(x_m - x, y_m - y) > apart_m for x, y in others)

    def _space(self, radius_m: float) -> Callable[[float, float], bool] | None:
        """Whether a body's centre can be at a point; None if there is no world."""
        return self.cluster.setting.free_space(radius_m)

    def _babble(self, identifier: int, for_s: float) -> Script[None]:
        bus = FieldBus(self.cluster.channel)
        bus.subscribe(lambda frame: None)
        end_at_us = self._now_us() + round(for_s * S)
        while self._now_us() < end_at_us:
            frame = Frame(identifier, self._rng.randbytes(8))
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
        """Send the order repeatedly, so that a robot that has not received this operator for a
        while has time to challenge it and accept the proof."""
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
        """An operator clears all known stops, resets every machine, and then gives the start.

        An operator cannot know of a stop that was not on the wire yet. One who sees that the reset is not
        sent gives no start: it would wait in the device, and arrive after a stop that is pressed later.
        """
        cluster = self.cluster
        known = {dot for robot in cluster.running for dot in robot.peer.safety.stops.active}
        dots = {dot for dot in known if dot.slot not in cluster.stops.unsent}
        for _ in range(1 if cluster.setting.keyring(OPERATOR, "operator") is None else TRIES):
            for dot in sorted(dots):
                cluster.order(EmergencyReset(*dot, OPERATOR))
            yield self._now_us() + round(ASK_S * S)
        keyed = cluster.setting.keyring(OPERATOR, "operator") is not None
        reset = OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR)
        cluster.order(reset)
        if keyed:  # a robot that has started meanwhile has asked for proof, and dropped the order
            yield self._now_us() + round(ASK_S * S)
            cluster.order(reset)
        yield self._now_us() + round(SETTLE_S * S)
        if cluster.waits(Command.MANUAL_RESET):
            return
        cluster.order(OperatorCommand(Command.START, 255, OPERATOR))
