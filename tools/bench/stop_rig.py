"""N stop controllers on the real wire model, without the other parts of a peer: how long a stop
takes.

The bus is saturated: poses at the fleet's beats, and a device that always has a frame of the lowest
priority ready. Each press has a new fleet, so presses are independent.
"""

from heapq import heappop, heappush
from random import Random
from typing import NamedTuple

from agent.interface.config import STOP_REPEAT_US, beat_of
from agent.interface.effects import Drive, Effect, Send
from agent.interface.identity import SilencePolicy
from agent.safety.stop_controller import StopController
from protocol.frames.codec import decode_once, encode
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyStop, Reason
from protocol.frames.work_frames import StateSyncResponse
from sim.can.can_wire import ERROR_US, Delivery, Wire
from sim.can.frame_timing import BIT_US, worst_bits

ADDRESS = 128
FRAME_US = worst_bits(8) * BIT_US
BROKEN_US = FRAME_US + ERROR_US  # a frame that is destroyed at its end, and the error frame
LIMIT_US = 3_000_000


class PressResult(NamedTuple):
    """One press: when the last robot was commanded to stand, and what the bus did meanwhile."""

    last_for_us: int  # from the press; LIMIT_US if some robot never received it
    errors: int  # frames destroyed on the wire
    missed: int  # copies that the worst receiver missed
    dry: int  # times that every copy was lost and only the source's next repeat helped

    @property
    def bound_for_us(self) -> int:
        """Upper limit of the time of the last robot, given what the bus did.

        It is the sum of the frame on the wire; the stop itself; if copies were missed, the frame
        that enters before the first echo; errors; copies; and dry rounds, each with a period of
        repetition, a frame on the wire and one more copy.
        """
        first = FRAME_US + FRAME_US + BIT_US
        echo = FRAME_US if self.missed else 0
        rounds = self.dry * (STOP_REPEAT_US + 2 * FRAME_US)
        return first + echo + self.errors * BROKEN_US + self.missed * FRAME_US + rounds


class StopFrame(NamedTuple):
    """A stop frame, from any sender."""

    end_at_us: int
    receivers: frozenset[int]
    errors: int  # on the wire until then


class StopFleet:
    """Controllers of stops on one wire, with a device that fills it, and the instants at which each
    one braked."""

    def __init__(self, robots: int, omission: float, error: float, seed: int | str) -> None:
        self.rng = Random(f"{seed}/stop fleet")
        self.wire = Wire(seed)
        self.wire.faults.omission, self.wire.faults.error = omission, error
        self.nodes = [self.wire.attach() for _ in range(robots)]
        self.filler = self.wire.attach()
        self.safeties = []
        everybody = frozenset(range(robots))
        for slot in range(robots):
            safety = StopController(slot, 1, SilencePolicy.STOP, None, {}, 0)
            safety.start(0)
            safety.members(everybody, frozenset(), 0)
            self.safeties.append(safety)
        self.stood_at_us: dict[int, int] = {}
        self._copies: list[StopFrame] = []
        self._poses: list[tuple[int, int]] = []
        self._pose_period_us = beat_of(robots).pose_period_us
        for slot in range(robots):
            heappush(self._poses, (self.rng.randrange(self._pose_period_us), slot))
        self.now_us = 0

    def press(self) -> PressResult:
        """One press by any robot, at a random moment of the bus."""
        at_us = 2_000 + self.rng.randrange(self._pose_period_us)
        self._run(at_us)
        errors = self.wire.errors
        presser = self.rng.randrange(len(self.safeties))
        free = frozenset(range(len(self.safeties))) - {presser}
        self._effects(presser, self.safeties[presser].press(Reason.PERSON_IN_FIELD, at_us, free))
        end_at_us = at_us + LIMIT_US
        while len(self.stood_at_us) < len(self.safeties) and self.now_us < end_at_us:
            self._step(end_at_us)
        last_for_us = max(self.stood_at_us.values()) - at_us
        if len(self.stood_at_us) < len(self.safeties):
            last_for_us = LIMIT_US
        worst = max(self.stood_at_us, key=lambda slot: self.stood_at_us[slot])
        return PressResult(last_for_us, self.wire.errors - errors, *self._misses(worst))

    def _misses(self, slot: int) -> tuple[int, int]:
        """(copies missed, dry rounds) until this robot received one. Ready copies follow each other
        immediately, except for destroyed frames and for the frame before the first echo."""
        missed = dry = 0
        before: StopFrame | None = None
        for copy in self._copies:
            if before is not None:
                ready_for_us = FRAME_US + (copy.errors - before.errors) * BROKEN_US
                ready_for_us += FRAME_US if missed == 1 else 0
                dry += copy.end_at_us - before.end_at_us > ready_for_us
            before = copy
            if self.nodes[slot] in copy.receivers:
                break
            missed += 1
        return missed, dry

    def _run(self, end_at_us: int) -> None:
        while self.now_us < end_at_us:
            self._step(end_at_us)

    def _step(self, end_at_us: int) -> None:
        wire = self.wire
        if not wire.nodes[self.filler].queue:
            low = encode(StateSyncResponse(1, 1, 1, 1, 1, 1), 250)
            wire.submit(self.filler, Frame(low.identifier, self.rng.randbytes(8)), self.now_us)
        times = [end_at_us, self._poses[0][0]]
        if wire.next_at_us is not None:
            times.append(wire.next_at_us)
        times += [safety.due_at_us for safety in self.safeties]
        self.now_us = max(self.now_us, min(times))
        for delivery in wire.advance(self.now_us):
            self._deliver(delivery)
        while self._poses[0][0] <= self.now_us:
            due_at_us, slot = heappop(self._poses)
            heappush(self._poses, (due_at_us + self._pose_period_us, slot))
            stopped = self.safeties[slot].latched
            pose = Pose(
                self.rng.uniform(-50, 50), slot, 1.0, 2.0, 3, stopped, due_at_us // 50_000 & 255
            )
            wire.submit(self.nodes[slot], encode(pose, ADDRESS + slot), self.now_us)
        for slot, safety in enumerate(self.safeties):
            if safety.due_at_us <= self.now_us:
                self._effects(slot, safety.on_tick(self.now_us))

    def _deliver(self, delivery: Delivery) -> None:
        source, message = decode_once(delivery.frame)
        if not isinstance(message, EmergencyStop):
            return
        copy = StopFrame(delivery.t_us, frozenset(delivery.receivers), self.wire.errors)
        self._copies.append(copy)
        for node in delivery.receivers:
            if node < len(self.safeties):
                safety = self.safeties[node]
                self._effects(node, safety.receive_stop(message, source - ADDRESS, delivery.t_us))

    def _effects(self, slot: int, effects: object) -> None:
        assert isinstance(effects, list | tuple)
        effect: Effect
        for effect in effects:
            if isinstance(effect, Drive):
                self.stood_at_us.setdefault(slot, self.now_us)
            elif isinstance(effect, Send):
                frame = encode(effect.message, ADDRESS + slot, effect.destination)
                self.wire.submit(self.nodes[slot], frame, self.now_us)
