"""A person releases the fleet's stops from the computer of one machine.

The authority is the same as everywhere: in a fleet with keys the operator's keyring, which the machine
does not hold, signs every order, and each robot may challenge its counter. Orders name the stops that
this machine held when the release began, so a stop that is pressed meanwhile stays. Robots are asked
which stops they still hold: `outstanding` lists the robots that hold one.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from agent.interface.effects import Effect, Send
from agent.peer import inputs
from agent.peer.membership import Membership
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from agent.safety.stop_controller import StopController
from crdt.stops import StopDot
from protocol.authentication import Keyring
from protocol.frames.safety_frames import Challenge, EmergencyReset, HeldReset, StopsHeld
from protocol.frames.work_frames import STOPS, StateSyncRequest

KEYLESS_OPERATOR: Final = 249  # operator number in orders of a fleet without keys
NAMED_MAX: Final = 64  # resets by dot; further stops are cleared by the digest
SAID_WITH_TAGS: Final = 2  # robots act on two frames that agree


class StopRelease(Part):
    """The release in progress, if there is one."""

    def __init__(self, safety: StopController, membership: Membership) -> None:
        self.safety, self.membership = safety, membership
        self.current: Release | None = None

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {StopsHeld: self._held}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {inputs.ReleaseStops: self._release, inputs.EndRelease: self._end}

    def _held(self, ctx: StepContext, header: Header, m: StopsHeld) -> Outputs:
        if self.current is not None and header.slot is not None:
            self.current.hear(header.slot, m)
        return NOTHING

    def _release(self, ctx: StepContext, call: inputs.ReleaseStops) -> Outputs:
        """Begin a release, or repeat its orders if it is in progress."""
        if self.current is None:
            self.current = Release(self.safety, self.membership, call.operator, call.question)
            self.safety.authority.operator = call.operator
            if call.operator is not None and call.operator.badge is not None:
                self.safety.authority.hear_badge(call.operator.badge.told(), ctx.now_us)
        return self.current.say(ctx.now_us)

    def _end(self, ctx: StepContext, call: inputs.EndRelease) -> Outputs:
        self.current = self.safety.authority.operator = None
        return NOTHING


class Release:
    """One release of stops by a person: the orders, and the answers of the other robots."""

    def __init__(
        self,
        safety: StopController,
        membership: Membership,
        operator: Keyring | None,
        question: int,
    ) -> None:
        """`operator`: keyring of the person; None without keys. `question`: 48 bits, used once."""
        self.safety, self.membership = safety, membership
        self.operator, self._question = operator, question
        held = safety.held_stops
        self.digest = held.digest if held.stops else None
        self.dots: tuple[StopDot, ...] = tuple(sorted(safety.stops.active))[:NAMED_MAX]
        self._told: dict[int, StopsHeld] = {}  # slot -> its answer since we asked

    def hear(self, slot: int, m: StopsHeld) -> None:
        """Another robot's answer about the stops that it holds."""
        authority = self.safety.authority
        if m.slot == slot and authority.vouch(m._replace(tag=0), self._question) == m:
            self._told[slot] = m

    def say(self, now_us: int) -> list[Effect]:
        """All orders and the question, sent to the others and applied to this machine."""
        number = KEYLESS_OPERATOR if self.operator is None else self.operator.sender
        orders: list[HeldReset | EmergencyReset] = []
        if self.digest is not None:
            orders.append(HeldReset(self.digest, number))
        orders += [EmergencyReset(*dot, number) for dot in self.dots]
        effects: list[Effect] = []
        for order in orders:
            for _ in range(1 if self.operator is None else SAID_WITH_TAGS):
                said = self._signed(order)
                effects += [*self._obey(said, now_us), Send(said)]
        question = StateSyncRequest(self._question & 0xFFFFFF, self._question >> 24, STOPS, 0)
        return [*effects, Send(question)]

    @property
    def outstanding(self) -> list[int]:
        """Members that hold a stop, or are stopped and have not answered that they hold none."""
        safety, membership, found = self.safety, self.membership, list[int]()
        if safety.stops.latched or safety.far.latched:
            found.append(safety.slot)
        for slot in membership.live - {safety.slot}:
            seen, told = membership.neighbours.get(slot), self._told.get(slot)
            stopped = seen is None or seen.pose.stopped
            if stopped and (told is None or told.stops):
                found.append(slot)
        return sorted(found)

    def _signed(self, order: HeldReset | EmergencyReset) -> HeldReset | EmergencyReset:
        if self.operator is None:
            return order
        if isinstance(order, HeldReset):
            return self.operator.sign(order)
        return self.operator.sign(order)

    def _obey(self, order: HeldReset | EmergencyReset, now_us: int) -> Sequence[Effect]:
        """Apply the order like one from the bus. A challenge to the operator is answered here."""
        safety = self.safety
        if isinstance(order, HeldReset):
            effects = safety.receive_held_reset(order, now_us)
        else:
            effects = safety.receive_reset(order, now_us)
        kept: list[Effect] = []
        for effect in effects:
            if isinstance(effect, Send) and isinstance(effect.message, Challenge):
                proof = None
                if self.operator is not None:
                    proof = self.operator.answer(effect.message, now_us)
                if proof is not None:
                    safety.authority.prove(proof, now_us)
            else:
                kept.append(effect)
        return kept
