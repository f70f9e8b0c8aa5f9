"""A person releases the fleet's stops from the computer of one machine.

The authority is the same as everywhere: in a fleet with keys the operator's keyring, which the machine
does not hold, signs every order, and each robot may challenge its counter. Orders name the stops that
this machine held when the release began, so a stop that is pressed meanwhile stays. Robots are asked
which stops they still hold: `outstanding` lists the robots that hold one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from agent.interface.effects import Effect, Send
from crdt.stops import StopDot
from protocol.authentication import Keyring
from protocol.frames.safety_frames import Challenge, EmergencyReset, HeldReset, StopsHeld
from protocol.frames.work_frames import STOPS, StateSyncRequest

if TYPE_CHECKING:
    from agent.peer.peer import Peer

KEYLESS_OPERATOR: Final = 249  # operator number in orders of a fleet without keys
NAMED_MAX: Final = 64  # resets by dot; further stops are cleared by the digest
SAID_WITH_TAGS: Final = 2  # robots act on two frames that agree


class Release:
    def __init__(self, peer: "Peer", operator: Keyring | None, question: int) -> None:
        """`operator`: keyring of the person; None without keys. `question`: 48 bits, used once."""
        self.peer, self.operator, self._question = peer, operator, question
        held = peer.safety.held_stops
        self.digest = held.digest if held.stops else None
        self.dots: tuple[StopDot, ...] = tuple(sorted(peer.safety.stops.active))[:NAMED_MAX]
        self._told: dict[int, StopsHeld] = {}  # slot -> its answer since we asked

    def hear(self, slot: int, m: StopsHeld) -> None:
        """Another robot's answer about the stops that it holds."""
        authority = self.peer.safety.authority
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
        peer, found = self.peer, list[int]()
        if peer.safety.stops.latched or peer.safety.far.latched:
            found.append(peer.slot)
        for slot in peer.membership.live - {peer.slot}:
            seen, told = peer.membership.neighbours.get(slot), self._told.get(slot)
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
        safety = self.peer.safety
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
