"""Authenticates commands: MAC check, two-frame confirmation, freshness challenge.

A fleet without keys accepts every sender. With keys, a stop needs one valid tag, because it must
not wait. An operator's order needs two frames that agree. A tag that is valid by chance may stop a
fleet, but it must not release it. `protocol/authentication.py` says what a tag covers.
"""

from collections.abc import Sequence

from agent.interface.config import S
from agent.interface.effects import Effect, Send
from protocol.authentication import OPERATOR_FIRST, AnySigned, Keyring, Keys, Signed
from protocol.fleet_tags import HeldTags
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import (
    Challenge,
    Command,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    StopsHeld,
)  # fmt: skip
from protocol.frames.trust_frames import OperatorBadge
from protocol.operator_badges import Role

# Two equal frames, each with its own tag, must arrive within this: 48 bits to guess instead of 24.
AGREE_US = 2 * S
ORDERS_MAX = 64  # orders that wait for their second frame


# What each order needs: one of these roles. What makes a robot stand is for those who may stop or direct.
NEEDS: dict[int, Role] = {
    Command.MANUAL_RESET: Role.RELEASE,
    Command.START: Role.RELEASE | Role.DIRECT,
    Command.HOLD: Role.STOP | Role.DIRECT,
    Command.WAIVE: Role.RELEASE,
    Command.GO_HOME: Role.DIRECT,
    Command.CONTINUE: Role.DIRECT,
    Command.REPLAN: Role.DIRECT,
    Command.WAIT: Role.STOP | Role.DIRECT,
    Command.STOP: Role.STOP | Role.DIRECT,
    Command.SET_GOAL: Role.DIRECT,
}
assert NEEDS.keys() == set(Command)


def role_for(m: AnySigned) -> Role:
    """The roles of which an operator needs one to say this."""
    if isinstance(m, OperatorCommand):
        return NEEDS[m.command]
    if isinstance(m, OperatorGoal):
        return Role.DIRECT
    return Role.STOP if isinstance(m, EmergencyStop) else Role.RELEASE


class CommandAuthority:
    """Decides for one robot which stops and orders are genuine.

    A sender is the identifier under which a frame is signed: 0 to 127 robots, from 128 stop panels,
    from 192 operator devices (`protocol/authentication.py`). None stands for an address that no
    device has claimed.
    """

    def __init__(self, slot: int, keyring: Keyring | None) -> None:
        self.slot, self.keyring = slot, keyring
        self.refused = 0  # count of frames without authority
        self.forbidden = 0  # of them, those of a genuine operator whose key has another role
        self.operator: Keyring | None = None  # keys of the person giving orders at this machine now
        secret = None if keyring is None else keyring.keys.operator
        self._held = HeldTags(keyring.keys) if keyring is not None and secret else None
        self._orders: dict[tuple[object, ...], int] = {}  # order received once -> its time

    def rekey(self, keys: Keys) -> None:
        """The fleet has other keys from now on."""
        assert self.keyring is not None, "a fleet without keys is not given any while it works"
        self.keyring.rekey(keys)
        self._held = HeldTags(keys) if keys.operator else None
        self._orders.clear()

    def sign(self, message: Signed) -> Signed:
        """The message with our freshness counter and tag, or unchanged in a fleet without keys."""
        return message if self.keyring is None else self.keyring.sign(message)

    def vouch(self, held: StopsHeld, question: int) -> StopsHeld:
        """The report of our stops with a tag that only a robot of this fleet can make.

        `question`: the 48-bit nonce of the challenge that it answers. The report is unchanged if
        this robot does not hold the operators' secret.
        """
        return held if self._held is None else self._held.sign(held, question)

    def believes(self, m: AnySigned, sender: int | None, now_us: int) -> bool:
        """Whether the tag of a stop or an order is valid and its sender may send it.

        `sender`: under whose key the tag is checked; None is never believed. Any sender may stop;
        only operator devices may release or order. A frame that is not believed is counted in
        `refused`. Without keys every frame is believed.
        """
        if self.keyring is None:
            return True
        may = sender is not None and (isinstance(m, EmergencyStop) or sender >= OPERATOR_FIRST)
        if may and sender is not None and self.keyring.verify(m, sender, now_us):
            if sender < OPERATOR_FIRST or self.keyring.badges.allows(sender, role_for(m), now_us):
                return True
            self.forbidden += 1
        self.refused += 1
        return False

    def hear_badge(self, m: OperatorBadge, now_us: int) -> None:
        """What an operator's device says that its key allows; its tags prove it."""
        if self.keyring is not None:
            self.keyring.badges.hear(m, now_us)

    def agreed(
        self, m: EmergencyReset | HeldReset | OperatorCommand | OperatorGoal, now_us: int
    ) -> bool:
        """Whether an operator has now sent this order for the second time within `AGREE_US`.

        Call it only with an order that `believes` accepted. Two orders are the same if all fields
        agree but freshness and tag. Without keys the first frame is enough.
        """
        if self.keyring is None:
            return True
        order = (type(m), *m[:-2])  # without freshness and tag
        said_at_us = self._orders.pop(order, -AGREE_US - 1)
        self._orders[order] = now_us
        if len(self._orders) > ORDERS_MAX:
            del self._orders[next(iter(self._orders))]
        return now_us - said_at_us <= AGREE_US

    def ask(self, sender: int | None, now_us: int) -> Sequence[Effect]:
        """A challenge to the sender of a frame that was not believed, or no effect.

        The sender may be genuine while we have lost track of its counter. The keyring limits the
        rate of challenges.
        """
        question = None
        if self.keyring is not None and sender is not None and sender != self.slot:
            question = self.keyring.ask(sender, now_us)
        return () if question is None else [Send(question)]

    def answer(self, source: int, m: Challenge, now_us: int) -> Sequence[Effect]:
        """The proofs of our counters to a robot that has challenged us.

        There are up to two: for the keys of this robot, and for those of an operator at
        this machine. `source`: bus address of the asker, to which the proof is sent.
        """
        said: list[Effect] = []
        for ring in (self.keyring, self.operator):
            proof = None if ring is None else ring.answer(m, now_us)
            if ring is not None and proof is not None:
                said += [] if ring.badge is None else [Send(ring.badge.told())]
                said.append(Send(proof, source))
        return said

    def prove(self, m: Freshness, now_us: int) -> Sequence[Effect]:
        """Take in another sender's answer to our challenge. A wrong or late proof is counted in
        `refused`.
        """
        if self.keyring is not None and not self.keyring.prove(m, now_us):
            self.refused += 1
        return ()
