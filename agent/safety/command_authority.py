"""Authenticates commands: MAC check, two-frame confirmation, freshness challenge.

A fleet without keys accepts every sender. With keys, a stop needs one valid tag, because it must
not wait. An operator's order needs two frames that agree, because a tag that is valid by chance may
stop a fleet but must not release it. `protocol/authentication.py` says what a tag covers.
"""

from collections.abc import Sequence

from agent.interface.config import S
from agent.interface.effects import Effect, Send
from protocol.authentication import OPERATOR_FIRST, AnySigned, Keyring, Signed
from protocol.fleet_tags import HeldTags
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import (
    Challenge,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    StopsHeld,
)  # fmt: skip

# Two equal frames, each with its own tag, must arrive within this: 48 bits to guess instead of 24.
AGREE_US = 2 * S
ORDERS_MAX = 64  # orders that wait for their second frame


class CommandAuthority:
    def __init__(self, slot: int, keyring: Keyring | None) -> None:
        self.slot, self.keyring = slot, keyring
        self.refused = 0  # count of frames without authority
        self.operator: Keyring | None = None  # keys of the person giving orders at this machine now
        secret = None if keyring is None else keyring.keys.operator
        self._held = HeldTags(keyring.keys) if keyring is not None and secret else None
        self._orders: dict[tuple[object, ...], int] = {}  # order received once -> its time

    def sign(self, message: Signed) -> Signed:
        return message if self.keyring is None else self.keyring.sign(message)

    def vouch(self, held: StopsHeld, question: int) -> StopsHeld:
        return held if self._held is None else self._held.sign(held, question)

    def believes(self, m: AnySigned, sender: int | None, now_us: int) -> bool:
        if self.keyring is None:
            return True
        may = sender is not None and (isinstance(m, EmergencyStop) or sender >= OPERATOR_FIRST)
        if may and sender is not None and self.keyring.verify(m, sender, now_us):
            return True
        self.refused += 1
        return False

    def agreed(
        self, m: EmergencyReset | HeldReset | OperatorCommand | OperatorGoal, now_us: int
    ) -> bool:
        """Whether an authenticated operator has sent this order twice within AGREE_US."""
        if self.keyring is None:
            return True
        order = (type(m), *m[:-2])  # without freshness and tag
        said_us = self._orders.pop(order, -AGREE_US - 1)
        self._orders[order] = now_us
        if len(self._orders) > ORDERS_MAX:
            del self._orders[next(iter(self._orders))]
        return now_us - said_us <= AGREE_US

    def ask(self, sender: int | None, now_us: int) -> Sequence[Effect]:
        """Challenge the sender: it may be genuine while we have lost track of its counter."""
        question = None
        if self.keyring is not None and sender is not None and sender != self.slot:
            question = self.keyring.ask(sender, now_us)
        return () if question is None else [Send(question)]

    def answer(self, source: int, m: Challenge, now_us: int) -> Sequence[Effect]:
        proofs = [
            ring.answer(m, now_us) for ring in (self.keyring, self.operator) if ring is not None
        ]
        return [Send(proof, source) for proof in proofs if proof is not None]

    def prove(self, m: Freshness, now_us: int) -> Sequence[Effect]:
        if self.keyring is not None and not self.keyring.prove(m, now_us):
            self.refused += 1
        return ()
