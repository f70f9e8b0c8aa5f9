"""A whole fleet in one process: N peers with a bus object each, the world, and the shared bus.

It uses the same runner as a robot, driven by a host: an asyncio loop in virtual or real time, or
our event loop. The same seed gives the same run on each host.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from random import Random

import can

from agent.interface.config import ADDRESS_FIRST, ADDRESS_LAST, STOP_SPACING_US
from agent.interface.effects import Effect
from agent.interface.identity import SilencePolicy
from agent.interface.lifecycle import State
from agent.interface.ports import Body, Journal
from agent.peer.inputs import Press
from agent.peer.peer import Peer
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from agent.runtime.peer_runner import PeerRunner
from agent.segments.segment_area import Area
from protocol.authentication import Keys, Signed
from protocol.frame_proofs import ToolProofs
from protocol.frames.codec import decode, decode_once, destination_of, encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.frames.safety_frames import (
    Challenge,
    Command,
    EmergencyReset,
    EmergencyStop,
    OperatorCommand,
    Reason,
)
from protocol.links.bus import CanBus
from protocol.name import tool_name
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.fleet.contact_history import ContactHistory
from sim.fleet.event_loop import EventLoop
from sim.fleet.scheduler import Handle, Host, LoopHost
from sim.fleet.sensor_faults import ReceivedBody, Receiver
from sim.fleet.simulated_disk import MemoryJournal
from sim.fleet.stop_monitor import StopMonitor, reached
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import Join, Scenario

OPERATOR = 200  # slot of the operator device that sends a scenario's resets
TOOL_ADDRESS = 249  # source address of scripted operator frames, unless another device takes it
TOOL_ADDRESSES = 16  # the last ones of robots, for tools whose address is taken
STOP_PGN = GROUP_OF[EmergencyStop].pgn
PGN_MASK = 0x3FFFF  # of an identifier without its source address
Record = Callable[[int, int, Effect], None]  # slot, time in microseconds, effect


def tool_claim(number: int, address: int) -> Frame:
    """The address claim of an operator's device. `number`: that of its NAME."""
    return encode(AddressClaimed(tool_name(number).pack()), address)


class Robot:
    """One peer with everything around it."""

    def __init__(self, slot: int, runner: PeerRunner, bus: FieldBus) -> None:
        self.slot, self.runner, self.bus = slot, runner, bus
        self.task: Handle | None = None

    @property
    def peer(self) -> Peer:
        """The core that its runner drives."""
        return self.runner.peer

    @property
    def running(self) -> bool:
        """Whether its power is on."""
        return self.task is not None and not self.task.done()


def peer_of(
    setting: FleetSetup,
    slot: int,
    now_us: int,
    recalled: Mapping[str, bytes],
    first_boot: bool,
    lot: str = "",
    segment: int = 0,
    parts: MissionParts | None = None,
) -> Peer:
    """The peer of one slot of a scenario, the same on a virtual clock and in a separate process.

    `segment`: for a fleet of several segments; 0 if there are no others. `lot`: any value that no
    two boots of this robot share; the first boot in a simulation needs none. `parts`: of the
    mission; None: those of the setup.
    """
    scenario = setting.scenario
    identity = identity_of(
        scenario.name, slot, scenario.fleet.robots, setting.config_hash, setting.silence,
        first_boot=first_boot,
    )  # fmt: skip
    # A robot that has lost its memory must not draw the same random numbers again.
    rng = Random(f"{scenario.run.seed}/peer/{slot}{lot}")
    keyring = setting.keyring(slot, lot)
    parts = parts or setting.parts(slot, now_us, recalled)
    area = Area(segment, setting.section_count) if segment else None
    return make_peer(identity, rng, now_us, recalled, parts, keyring=keyring, area=area)


class Cluster:
    """All robots of a setting on one simulated bus and in one world, with switches for power, cuts
    and faults."""

    def __init__(
        self,
        setting: FleetSetup,
        channel: str,
        record: Record | None = None,
        host: Host | None = None,
    ) -> None:
        """`host`: None for the running asyncio loop."""
        self.setting, self.channel, self.record = setting, channel, record
        self._loop_host = LoopHost()
        self.host: Host = self._loop_host if host is None else host
        self.scenario: Scenario = setting.scenario
        self.world = setting.world()
        self.stops = StopMonitor(
            self.world, self.scenario.fleet.robots, self._up, self._mute, self._hearers,
            self.host.now_us, self.setting.silence is SilencePolicy.STOP,
        )  # fmt: skip
        bus, seed = self.scenario.bus, self.scenario.run.seed
        clock = host if isinstance(host, EventLoop) else None
        self.segment = segment(channel, bitrate=bus.bitrate, seed=seed, clock=clock)
        faults = self.segment.wire.faults
        faults.loss, faults.error = bus.loss, bus.error_rate
        faults.omission, faults.duplicate = bus.omission, bus.duplicate
        self.acquaintance = ContactHistory(self.segment.wire)
        self.robots: dict[int, Robot] = {}
        self.journals: dict[int, Journal] = {}
        self.receivers: dict[int, Receiver] = {}
        self.boots: Counter[int] = Counter()
        # (robot, whether it is switched on); called before the change.
        self.on_power: Callable[[int, bool], None] | None = None
        # Called before any robot receives it.
        self.on_order: Callable[[Message], None] | None = None
        # Called before a thief says it with a member's keys.
        self.on_lie: Callable[[Message], None] | None = None
        self._tool: FieldBus | None = None
        # Our devices, by the addresses that they prefer, and those that they have claimed.
        self._tools: dict[int, int] = {}
        self._tools_displaced = 0  # how often another device has taken one of them
        self._keyring = setting.keyring(OPERATOR, "operator")
        self._proofs: ToolProofs | None = None
        if self._keyring is not None:
            self._proofs = ToolProofs(self._keyring.keys, OPERATOR, self._keyring.lot)

    def boot_all(self) -> None:
        """Boot all robots except those that join later."""
        late = {fault.robot for fault in self.scenario.fault if isinstance(fault, Join)}
        for slot in range(self.scenario.fleet.robots):
            if slot not in late:
                self.boot(slot)

    def has_room(self, slot: int) -> bool:
        """Whether there is room for a robot that is to be switched on for the first time."""
        return True

    def boot(self, slot: int) -> Robot:
        """Power a robot up with the contents of its journal."""
        self.look()
        self.acquaintance.boots(slot)
        self.stops.boots(slot)
        journal = self.journals.setdefault(slot, MemoryJournal())
        if self.on_power is not None:
            self.on_power(slot, True)
        boots = self.boots[slot]
        lot = f"/{boots}" if boots else ""
        now_us, recalled = self.host.now_us(), journal.load()
        parts = self.parts(slot, now_us, recalled)
        peer = peer_of(self.setting, slot, now_us, recalled, not boots, lot, parts=parts)
        self.boots[slot] += 1
        bus = can.Bus(interface="fieldbus", channel=self.channel)
        assert isinstance(bus, FieldBus)
        record = self.record

        def keep(now_us: int, effect: Effect) -> None:
            if record is not None:
                record(slot, now_us, effect)

        runner = self.host.make_runner(peer, CanBus(bus), self._received(slot), journal, keep)
        robot = Robot(slot, runner, bus)
        robot.task = self.host.start(runner)
        self.robots[slot] = robot
        return robot

    def _received(self, slot: int) -> Body:
        receiver = self.receivers.setdefault(slot, Receiver())
        return ReceivedBody(self.world.body(slot), self.host, receiver)

    def parts(self, slot: int, now_us: int, recalled: Mapping[str, bytes]) -> MissionParts:
        """What the mission brings to the peer of a robot that is switched on."""
        return self.setting.parts(slot, now_us, recalled)

    def kill(self, slot: int) -> None:
        """Power off without a message. The body stays where it is and its commands expire."""
        self.look()
        robot = self.robots[slot]
        hung_at_us = self.acquaintance.hang_began_at_us(slot, self.host.now_us())
        if robot.running and hung_at_us is not None:
            self.stops.dies_hung(slot, hung_at_us)
        if robot.running:
            self.stops.dies(slot)
        if self.on_power is not None and robot.running:
            self.on_power(slot, False)
        if robot.task is not None:
            robot.task.cancel()
        robot.runner.bus.close()

    def _up(self) -> set[int]:
        return {robot.slot for robot in self.running}

    def _mute(self) -> set[int]:
        return {robot.slot for robot in self.running if robot.peer.address is None}

    def _hearers(self) -> set[int]:
        """All robots that are switched on, if all of them receive a device that joins the bus; else
        none."""
        wire, nodes = self.segment.wire, [self.node_of(slot) for slot in self._up()]
        faults, here = wire.faults, [wire.nodes[node] for node in nodes]
        lossy = faults.loss or faults.omission or faults.error or faults.deaf
        cut = any(node.island != 0 or node.off_ends_at_us is not None for node in here)
        self.world.advance(self.host.now_us())
        return set() if lossy or cut else self._up()

    def freeze(self, slot: int, for_s: float) -> None:
        """The robot's process does nothing for this long."""
        self.look()
        self.robots[slot].runner.freeze(for_s)
        now_us = self.host.now_us()
        self.acquaintance.hangs(slot, now_us, now_us + round(for_s * 1e6))

    def is_up(self, slot: int) -> bool:
        """Whether the robot is switched on; the buttons of a dead machine do nothing."""
        return slot in self.robots and self.robots[slot].running

    def press(self, slot: int, reason: Reason = Reason.PERSON_IN_FIELD) -> None:
        """A person presses the stop of that robot; from now on the monitor checks which robots
        obey.

        Robots that can receive the stop must obey. If the policy stops on silence, robots that have
        met that robot must obey too. A robot that hangs sends nothing, or one frame.
        """
        if not self.is_up(slot):
            return
        self.look()
        members = [r for r in self.running if r.peer.state is not State.DISCONNECTED]
        nodes = {robot.bus.node for robot in members}
        hangs = self.acquaintance.is_hung(slot, self.host.now_us())
        hearers = set() if hangs else reached(self.segment.wire, self.node_of(slot), nodes)
        silence = self.setting.silence is SilencePolicy.STOP
        members = [
            robot for robot in members
            if robot.bus.node in hearers or (silence and self.acquaintance.met(robot.slot, slot))
        ]  # fmt: skip
        now_us = self.host.now_us()
        self.world.advance(now_us)
        unheard = {robot.slot for robot in members if robot.bus.node not in hearers} - {slot}
        self.stops.pressed(now_us, {slot, *(robot.slot for robot in members)}, unheard, by=slot)
        if self._stop_passes not in self.segment.taps:
            self.segment.taps.append(self._stop_passes)
        safety = self.robots[slot].peer.safety
        stops, stopped_at_us = safety.stops.active, safety.stopped_at_us
        self.robots[slot].runner.operate(Press(reason))
        # A robot that has just pressed a stop of its own, for one with a used name, sends no other.
        recent = 0 <= now_us - stopped_at_us < STOP_SPACING_US
        if recent and safety.stops.active == stops and any(dot.slot == slot for dot in stops):
            self.stops.repeats(slot)

    def _stop_passes(self, t_us: int, frame: Frame) -> None:
        """A tap on the bus, as long as a pressed robot waits for its stop frame to be sent."""
        if frame.identifier >> 8 & PGN_MASK == STOP_PGN and frame.data:
            self.stops.sent(frame.data[0], t_us)
            if not self.stops.waits:
                self.segment.taps = [tap for tap in self.segment.taps if tap != self._stop_passes]

    def look(self) -> None:
        """Update the contact history; call before links change or robots come and go."""
        there = self.segment.wire.nodes  # a cancelled asyncio task still runs for a moment
        nodes = {r.slot: r.bus.node for r in self.running if r.bus.node in there}
        self.acquaintance.look(self.host.now_us(), nodes)

    def node_of(self, slot: int) -> int:
        """Number of a robot's controller on the wire."""
        return self.robots[slot].bus.node

    def partition(self, islands: list[set[int]]) -> None:
        """Cut the bus into islands of robots. Slots that are not in the fleet are ignored."""
        nodes = [
            {self.node_of(slot) for slot in island if slot in self.robots} for island in islands
        ]
        self.segment.wire.partition(*nodes)

    def inject(self, message: Message, source: int = TOOL_ADDRESS) -> None:
        """Send a frame of a device that is not a robot, as an operator's tool would."""
        if self._tool is None:
            self._tool = FieldBus(self.channel)
            self._tool.subscribe(self._answer)
            self._tool.tell_sent(self._said)
        if source not in self._tools and not ADDRESS_FIRST <= source <= ADDRESS_LAST:
            # Claim only for a device of ours; a frame from a robot's address is forged.
            self._tools[source] = source
            self._tool.submit(tool_claim(source, source))
        self._tool.submit(encode(message, self._tools.get(source, source)))

    def waits(self, command: Command) -> bool:
        """Whether such an order of an operator has not been sent yet."""
        queue = [] if self._tool is None else self.segment.wire.nodes[self._tool.node].queue
        unsent = (decode(frame)[1] for _, _, frame in queue)
        return any(isinstance(m, OperatorCommand) and m.command == command for m in unsent)

    def propose(self, message: Message) -> None:
        """Send a frame of a device that is no robot, with its proof in a fleet with keys. The caller
        repeats it, because the device may not know the fleet's time yet."""
        self.inject(message)
        if self._proofs is not None:
            address = self._tools[TOOL_ADDRESS]
            for said in self._proofs.after(message, address, self.host.now_us()):
                self.inject(said)

    def order(self, message: Signed) -> None:
        """Send an order from the operator's device. In a fleet with keys: with a tag, and twice."""
        if self.on_order is not None:
            self.on_order(message)
        self.stops.ordered(message)
        if self._keyring is None:
            self.inject(message)
            return
        for _ in range(2):
            self.inject(self._keyring.sign(message))

    def rekeyed(self, keys: Keys) -> None:
        """The owner has given the fleet other keys: the operator's device has them, too."""
        if self._keyring is not None:
            self._keyring.rekey(keys)
        if self._proofs is not None:
            self._proofs.renew(keys, None)

    def _said(self, t_us: int, frame: Frame) -> None:
        """An order that had to wait for a full bus counts from the time it left."""
        message = decode_once(frame)[1]
        if self.on_order is not None and isinstance(message, EmergencyReset | OperatorCommand):
            self.on_order(message)

    def _answer(self, frame: Frame) -> None:
        """The operator's device answers requests for its address claim and challenges to its
        counter."""
        source, message = decode_once(frame)
        asked = isinstance(message, Request) and message.pgn == GROUP_OF[AddressClaimed].pgn
        if asked and self._tool is not None:
            for number, address in sorted(self._tools.items()):
                if destination_of(frame) in (GLOBAL_ADDRESS, address):
                    self._tool.submit(tool_claim(number, address))
        if isinstance(message, AddressClaimed):
            self._contend(source, message.name)
        if self._proofs is not None:
            self._proofs.hear(source, message, self.host.now_us())
        if isinstance(message, Challenge) and self._keyring is not None and self._tool is not None:
            proof = self._keyring.answer(message, self.host.now_us())
            if proof is not None:
                self._tool.submit(
                    encode(proof, self._tools.get(TOOL_ADDRESS, TOOL_ADDRESS), source)
                )

    def _contend(self, address: int, name: int) -> None:
        """Another device claims an address of ours: keep it if our NAME is smaller, else take a free one,
        as `tools/operate/tool_address.py` does."""
        for number in [n for n, own in self._tools.items() if own == address]:
            ours = tool_name(number).pack()
            if name == ours or self._tool is None:
                continue
            if name < ours:
                self._tools[number] = ADDRESS_LAST - self._tools_displaced % TOOL_ADDRESSES
                self._tools_displaced += 1
            self._tool.submit(tool_claim(number, self._tools[number]))

    def check(self) -> None:
        """Raise what a robot's task has raised: a failed assertion must not look like silence."""
        for robot in self.robots.values():
            if robot.task is not None:
                robot.task.check()

    @property
    def running(self) -> list[Robot]:
        """The robots whose power is on, in slot order."""
        return [robot for _, robot in sorted(self.robots.items()) if robot.running]

    @property
    def finished(self) -> bool:
        """Whether every running replica has every section done that robots can reach."""
        sections = self.setting.reachable_count
        return bool(self.running) and all(
            robot.peer.allocation.done_count() == sections for robot in self.running
        )

    @property
    def replicas_equal(self) -> bool:
        """Whether what robots share is equal byte for byte."""
        return len({self.replica_of(robot) for robot in self.running}) <= 1

    def replica_of(self, robot: Robot) -> tuple[bytes, ...]:
        """What a robot shares with the others, in bytes: registers and progress."""
        return robot.peer.allocation.serialize(), robot.peer.progress.serialize()

    async def close(self) -> None:
        """Close a fleet that runs on an asyncio loop."""
        await self._loop_host.close()
        self.end()

    def end(self) -> None:
        """Close all buses and forget the channel. The cluster cannot be used afterwards."""
        for robot in self.robots.values():
            robot.runner.bus.close()
        if self._tool is not None:
            self._tool.shutdown()
        forget(self.channel)
