"""One trial of a working fleet on a bus that a device floods, with presses meanwhile.

A flooder sends one frame without pause, or with short pauses. From a time limit after a press, no
robot may be commanded to move and no robot may move, judged by the true commands and positions of
the bodies. After the flood the wire carries frames again, and the fleet works again: by itself, or,
if a stop was pressed, after a reset and a start.
"""

from math import inf
from random import Random
from typing import NamedTuple

from agent.interface.config import MS, S, beat_of
from agent.interface.identity import SilencePolicy
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import Command, EmergencyReset, OperatorCommand
from sim.can.simulated_bus import FieldBus
from sim.fleet.event_loop import EventLoop
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import OPERATOR, Cluster
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

FLEETS = {3: "small", 6: "small", 20: "oxted"}  # robots and where they work
DRAWN = (3,) * 9 + (6,) * 9 + (20,) * 2  # twenty robots take ten times as long
ADDRESS = 0x4D  # of the flooder
LOWEST = (0, ADDRESS, 0x0000FFFE)  # identifiers that outrank any frame that a robot can send
UNKNOWN = 0x1FF0700 | ADDRESS  # a group that no robot reads
REACTION_US = 120 * MS  # from a press to the last command, in addition to the silence limit
# A robot must have moved for this long before the flood; upper limit for that wait.
WORK_S, WORK_MAX_S = (2.0, 20.0)
SHARES = (1.0, 1.0, 1.0, 0.999, 0.99, 0.9)  # share of the time in which the flooder sends
PIECE_US = 100 * MS  # period in which sending and pausing alternate
RECOVER_US = 5 * S  # limit for the wire and the fleet to work again
AFTER_US = 3 * S  # how long robots stand after a flood with a press, before the reset
LOOK_US = 20 * MS
RESET_US = 500 * MS  # between two attempts of an operator


class Flood(NamedTuple):
    """The events of a trial."""

    seed: int
    robots: int
    policy: str
    identifier: int
    length: int  # data bytes
    for_s: float
    share: float  # share of the time
    presses: tuple[tuple[float, int], ...]  # seconds after its beginning, robot
    longest_for_s: float = 0.0  # the upper limit with which it was drawn


class FloodResult(NamedTuple):
    """What one flood did to a fleet."""

    flood: Flood
    late: int  # robots that were commanded to move, or moved, after the bound of a press
    wire_for_s: float  # from the end of the flood until every robot's frame has left; inf: never
    # From its end, or from the reset and start, until a robot moves and all members are received.
    fleet_for_s: float
    moved_m: float  # the longest distance of a robot during the flood

    @property
    def broken(self) -> bool:
        """Whether a robot moved after the bound of a press, or the wire or the fleet took too long
        to recover."""
        slow = max(self.wire_for_s, self.fleet_for_s) > RECOVER_US / S
        return bool(self.late) or slow


def draw(
    seed: int, robots: int | None = None, policy: str | None = None, longest_for_s: float = 120.0
) -> Flood:
    """The trial of a seed. Arguments that are given are not drawn."""
    rng = Random(f"{seed}/flood")
    count, ending = rng.choice(DRAWN), rng.choice([p.name.lower() for p in SilencePolicy])
    low, priority = rng.choice(LOWEST), rng.randrange(8)
    identifier = low if rng.random() < 0.4 else priority << 26 | rng.choice((ADDRESS, UNKNOWN))
    # Half of the draws are between 1 and 11 s, half between 11 and 120 s.
    for_s = round(longest_for_s ** rng.random(), 3)
    share, length = rng.choice(SHARES), rng.choice((0, 8, 8, 8))
    presses = rng.choice((0, 1, 1, 1, 3))
    count, ending = robots or count, policy or ending
    times = sorted(round(rng.uniform(0.0, for_s), 3) for _ in range(presses))
    return Flood(
        seed, count, ending, identifier, length, for_s, share,
        tuple((at_s, rng.randrange(count)) for at_s in times), longest_for_s,
    )  # fmt: skip


class Trial:
    """A fleet at work, a device that floods its bus, and people that press meanwhile."""

    def __init__(self, flood: Flood) -> None:
        self.flood, self.event_loop = flood, EventLoop()
        scenario = load(FLEETS[flood.robots]).changed(flood.robots, flood.seed, faults=())
        fleet = scenario.fleet.model_copy(update={"silence": flood.policy})
        scenario = scenario.with_engine("contact_free")
        setting = FieldSetup(scenario.model_copy(update={"fleet": fleet}))
        self.cluster = Cluster(setting, f"flood {id(self)}", host=self.event_loop)
        self.cluster.stops.bound_for_us = beat_of(flood.robots).silence_for_us + REACTION_US

    def run(self) -> FloodResult:
        """Play the trial to its end."""
        self.cluster.boot_all()
        try:
            return self.event_loop.run(self._story())
        finally:
            self.cluster.end()

    def _story(self) -> Script[FloodResult]:
        flood, world = self.flood, self.cluster.world
        yield from self._until(self._at_work, round(WORK_MAX_S * S))
        yield self.event_loop.now_us() + round(WORK_S * S)
        at_us = self._now_us()
        before = {slot: body.position for slot, body in world.robots.items()}
        bus = FieldBus(self.cluster.channel)
        bus.subscribe(lambda frame: None)
        press = self.event_loop.spawn(self._press(at_us))
        yield from self._send(bus, at_us + round(flood.for_s * S))
        end_at_us = self._now_us()
        moved_m = max(
            abs(complex(*body.position) - complex(*before[slot]))
            for slot, body in world.robots.items()
        )
        sent = self._sent()
        bus.shutdown()
        wire_for_us = yield from self._until(
            lambda: all(now > then for now, then in zip(self._sent(), sent, strict=True)),
            RECOVER_US,
        )
        assert press.done()
        begin_at_us = end_at_us
        if flood.presses:
            yield self._now_us() + AFTER_US
            begin_at_us = self._now_us()
        reset = self.event_loop.spawn(self._reset()) if flood.presses else None
        limit_for_us = max(1, begin_at_us + 2 * RECOVER_US - self._now_us())
        fleet_for_us = yield from self._until(self._works, limit_for_us)
        if reset is not None:
            reset.cancel()
        late = {slot for violation in self.cluster.stops.violations for slot in violation.slots}
        found_for_us = inf if fleet_for_us == inf else self._now_us() - begin_at_us
        return FloodResult(flood, len(late), wire_for_us / S, found_for_us / S, moved_m)

    def _send(self, bus: FieldBus, end_at_us: int) -> Script[None]:
        """Send without pause, or for its share of each period."""
        flood, wire = self.flood, self.cluster.segment.wire
        frame = Frame(flood.identifier, bytes(flood.length))
        while (now_us := self._now_us()) < end_at_us:
            wire.flood(bus.node, frame, now_us)
            self.cluster.segment.arm()
            if flood.share == 1.0:
                yield end_at_us
                return
            yield min(end_at_us, now_us + round(flood.share * PIECE_US))
            wire.flood(bus.node, None, self._now_us())
            self.cluster.segment.arm()
            yield min(end_at_us, now_us + PIECE_US)

    def _press(self, at_us: int) -> Script[None]:
        for at_s, slot in self.flood.presses:
            yield at_us + round(at_s * S)
            self._now_us()
            self.cluster.press(slot)

    def _reset(self) -> Script[None]:
        """An operator clears the known stops, resets and starts, until the fleet works."""
        cluster = self.cluster
        while True:
            for dot in sorted({d for r in cluster.running for d in r.peer.safety.stops.active}):
                cluster.order(EmergencyReset(*dot, OPERATOR))
            yield self._now_us() + RESET_US
            cluster.order(OperatorCommand(Command.MANUAL_RESET, 255, OPERATOR))
            yield self._now_us() + RESET_US
            cluster.order(OperatorCommand(Command.START, 255, OPERATOR))
            yield self._now_us() + 4 * RESET_US

    def _until(self, holds, limit_for_us: int) -> Script[float]:  # type: ignore[no-untyped-def]
        """Microseconds until the condition holds; inf if not within the limit."""
        begun_at_us = self._now_us()
        while not holds():
            if self._now_us() - begun_at_us >= limit_for_us:
                return inf
            yield self._now_us() + LOOK_US
        return float(self._now_us() - begun_at_us)

    def _now_us(self) -> int:
        now_us = self.event_loop.now_us()
        self.cluster.world.advance(now_us)
        return now_us

    def _at_work(self) -> bool:
        return any(body.speed_m_s > 0.1 for body in self.cluster.world.robots.values())

    def _works(self) -> bool:
        """Whether all robots receive each other and at least one drives, or the field is worked."""
        all_slots = frozenset(range(self.flood.robots))
        heard = all(robot.peer.membership.live == all_slots for robot in self.cluster.running)
        return heard and (self._at_work() or self._is_over())

    def _is_over(self) -> bool:
        """Whether all is worked, as all robots say: six of them finish in less than the longest flood."""
        wanted = self.cluster.setting.reachable_count
        return all(robot.peer.allocation.done_count() >= wanted for robot in self.cluster.running)

    def _sent(self) -> list[int]:
        return [robot.bus.sent for robot in self.cluster.running]
