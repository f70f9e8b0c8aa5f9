"""Tags on the frames that stop and release a fleet: AES-CMAC, 24 bits, 8 bits of freshness.

After AUTOSAR SecOC profile 1. Each sender has its own key, derived by HKDF. Robots and stop panels
derive it from the fleet's master secret, operator devices from a separate secret, so a panel can
release no robot.
The tag covers the parameter group, the sender, the full 64-bit counter and the payload; 8 bits of
the counter travel. A receiver accepts a counter 1 to 127 ahead of the last it accepted: no replay.

A receiver that cannot follow a sender's counter (after a restart or a long cut) sends it a nonce,
and the sender proves its current counter with it. Operators must do so before any order is
accepted, and again after `SESSION_US` without a frame, so a delayed frame cannot be replayed later.
An operator's counter never goes back, not even over restarts. A robot's counter may, because only
stops can be replayed.

Guessing a tag succeeds with odds of 2^-24 a try. After `BAD_MAX` bad tags in `BAD_WINDOW_US` the
sender is ignored for the same time. Limits: every holder of a secret can sign for every sender
under it, and a robot must hold both secrets to verify. The tags defend against devices that hold
none.
"""

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from protocol.ciphers import derived_key, load, mac_of
from protocol.frames.layout import FrameLayout
from protocol.frames.operator_frames import OPERATOR_GOAL, OperatorGoal
from protocol.frames.safety_frames import (
    EMERGENCY_RESET,
    EMERGENCY_STOP,
    FRESHNESS,
    HELD_RESET,
    OPERATOR_COMMAND,
    Challenge,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
)  # fmt: skip
from protocol.operator_badges import Badge, BadgeBook

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.cmac import CMAC

Signed = TypeVar("Signed", EmergencyStop, EmergencyReset, HeldReset, OperatorCommand, OperatorGoal)
AnySigned = EmergencyStop | EmergencyReset | HeldReset | OperatorCommand | OperatorGoal

OPERATOR_FIRST = 192  # and from here operator devices, which may release
KEY_SIZE = 16  # bytes
WINDOW = 127  # a counter this far ahead is fresh; more frames than that are never lost in a row
# The largest counter in Freshness: 248 days of repeating a stop without pause.
COUNTER_MAX = 0xFFFF_FFFF
SESSION_US = 10_000_000  # an operator that sent nothing for this long must prove its counter again
BAD_MAX = 8
BAD_WINDOW_US = 10_000_000
# Between challenges to any senders, so that forged frames cannot cause a flood of them.
ASK_SPACING_US = 100_000
NUMBER_LIFE_US = 1_000_000  # of a nonce: a proof that arrives later than this is void
ANSWER_SPACING_US = 10_000  # minimum time between answers to one asker
COUNTERS_TRIED = 256  # high bytes of a robot's counter that `wrote` tries: 65,536 signed frames
MACS_MAX = 512
_SIGNED: dict[type, FrameLayout[Any]] = {
    layout.kind: layout
    for layout in (EMERGENCY_STOP, EMERGENCY_RESET, HELD_RESET, OPERATOR_COMMAND, OPERATOR_GOAL)
}


class Keys(NamedTuple):
    """The secrets of a fleet, 16 bytes each. A device holds only those that it needs.

    `own`: the key of one robot, 32 bytes, which no other robot holds. `generation`: the number of the
    first two, which are replaced while the fleet works (`protocol/rekeying.py`). In a restricted key file
    of an operator's device, `operator` is the secret of its badge (`protocol/operator_badges.py`), and
    `held` the key by which it checks what robots say of their stops.
    """

    master: bytes | None
    operator: bytes | None
    own: bytes | None = None
    generation: int = 0
    held: bytes | None = None


class Keyring:
    """Signs for one sender and verifies frames of all senders.

    `lot` is any value that no two starts of this sender share; nonces are derived from it. `badge`: of an
    operator's device. `badges`: those that a robot hears.
    """

    def __init__(
        self,
        keys: Keys,
        sender: int,
        lot: bytes,
        sent: int = 0,
        badge: Badge | None = None,
        badges: BadgeBook | None = None,
    ) -> None:
        self.sender, self.sent, self.badge = sender, sent, badge
        self.badges = BadgeBook() if badges is None else badges
        self.heard: dict[int, int] = {}
        self.accepted = self.bad = self.stale = self.ignored = self.unproven = self.expired = 0
        self._keys, self._lot = keys, lot
        load()
        self._macs: dict[tuple[int, Badge | None], CMAC] = {}
        self._bad_at_us: dict[int, deque[int]] = {}
        self._asked: dict[int, bytes] = {}  # sender -> the nonce that its proof must cover
        self._asked_at_us = -ASK_SPACING_US
        self._drawn_at_us: dict[int, int] = {}  # when that nonce was drawn
        self._proven_at_us: dict[int, int] = {}  # operator -> when it was last believed
        self._answered_at_us: dict[int, int] = {}
        self._stops_heard: dict[int, int] = {}  # counters of operators that are locked out
        self._questions = 0

    @property
    def keys(self) -> Keys:
        """The secrets, for other kinds of tags: `protocol/fleet_tags.py`."""
        return self._keys

    @property
    def lot(self) -> bytes:
        """A value that no two starts of this sender share."""
        return self._lot

    def rekey(self, keys: Keys) -> None:
        """Use other secrets from now on. Counters of robots go on."""
        self._keys = keys
        self._macs.clear()
        self._bad_at_us.clear()
        self._stops_heard.clear()
        self.badges.forget()
        for operator in [sender for sender in self.heard if sender >= OPERATOR_FIRST]:
            del self.heard[operator]  # a new key counts from 0
            self._proven_at_us.pop(operator, None)

    # ---------------------------------------------------------------- frames

    def sign(self, message: Signed) -> Signed:
        """Return the message with the next freshness and its tag."""
        self.sent += 1
        assert self.sent <= COUNTER_MAX
        fresh = message._replace(freshness=self.sent & 0xFF, tag=0)
        return fresh._replace(tag=self._tag(self.sender, self.sent, fresh))

    def verify(self, message: AnySigned, sender: int, now_us: int) -> bool:
        """Whether `sender` signed this and it was not accepted before."""
        if self._locked_out(sender, now_us):
            return self._stops_still(message, sender, now_us)
        if sender >= OPERATOR_FIRST and not self._proven(sender, now_us):
            self.unproven += 1
            return False
        if self._expired(sender, now_us):
            return False
        last = self.heard.get(sender, 0)
        ahead = (message.freshness - last) & 0xFF
        if not 1 <= ahead <= WINDOW:
            self.stale += 1
            return False
        counter = last + ahead
        if not self._holds(sender) or self._tag(sender, counter, message) != message.tag:
            self._count_bad(sender, now_us)
            return False
        self.heard[sender] = counter
        self.accepted += 1
        if sender >= OPERATOR_FIRST:
            self._proven_at_us[sender] = now_us
            self.badges.prove(sender, now_us)
        return True

    def wrote(self, message: EmergencyStop, sender: int) -> bool:
        """Whether `sender` signed this at any time, whatever its counter was: 0 to 65,535 of them
        are tried, and those near the one that it has proven last.

        Only for a frame whose content could not be known earlier, such as an echo of a dot that was
        drawn just now. A guessed tag passes with odds of 2^-16.
        """
        if not self._holds(sender):
            return False
        proven = self.heard.get(sender, 0) >> 8
        return any(
            self._tag(sender, high << 8 | message.freshness, message) == message.tag
            for high in (*range(COUNTERS_TRIED), proven, proven + 1)
        )

    # ---------------------------------------------------------------- proofs of where a counter is

    def ask(self, sender: int, now_us: int) -> Challenge | None:
        """The challenge to a sender whose frame could not be verified; None if one was just
        sent."""
        if now_us - self._asked_at_us < ASK_SPACING_US:
            return None
        self._asked_at_us = now_us
        if now_us - self._drawn_at_us.get(sender, -NUMBER_LIFE_US) >= NUMBER_LIFE_US:
            self._asked.pop(sender, None)
        if sender not in self._asked:
            self._questions += 1
            mac = self._mac(self.sender).copy()
            mac.update(b"number used once" + self._questions.to_bytes(8, "little") + self._lot)
            self._asked[sender], self._drawn_at_us[sender] = mac.finalize()[:6], now_us
        return Challenge(sender, self.sender, int.from_bytes(self._asked[sender], "little"))

    def answer(self, question: Challenge, now_us: int) -> Freshness | None:
        """The proof of our counter for a device that asked for it; None for another's question or
        too soon."""
        answered_at_us = self._answered_at_us.get(question.asker, -ANSWER_SPACING_US)
        if question.asked != self.sender or now_us - answered_at_us < ANSWER_SPACING_US:
            return None
        self._answered_at_us[question.asker] = now_us
        number = question.number.to_bytes(6, "little")
        tag = self._proof(self.sender, question.asker, number, self.sent)
        return Freshness(self.sender, self.sent, tag)

    def prove(self, answer: Freshness, now_us: int) -> bool:
        """Adopt the sender's counter if its proof is valid and answers a recent challenge."""
        sender = answer.sender
        number = self._asked.get(sender)
        late = now_us - self._drawn_at_us.get(sender, now_us) >= NUMBER_LIFE_US
        if number is None or late or not self._holds(sender):
            self.stale += 1
            return False
        operator = sender >= OPERATOR_FIRST
        locked = operator and self._locked_out(sender, now_us)
        badges: Sequence[Badge | None] = self.badges.candidates(sender) if operator else (None,)
        for badge in badges:
            if self._proof(sender, self.sender, number, answer.counter, badge) == answer.tag:
                break
        else:
            if not locked:
                self._count_bad(sender, now_us)
            return False
        if badge is not None and not badge.valid(self.badges.day(now_us)):
            self.expired += 1
            return False
        if locked:
            del self._asked[sender]
            self._stops_heard[sender] = answer.counter
            self.badges.prove(sender, now_us, badge)
            return False  # its orders are not believed yet
        if operator and answer.counter < self.heard.get(sender, 0):
            self.stale += 1
            return False
        del self._asked[sender]
        self.heard[sender] = answer.counter
        if operator:
            self._proven_at_us[sender] = now_us
            self.badges.prove(sender, now_us, badge)
        else:
            # Forged frames in its name must not keep its stops from being accepted.
            self._bad_at_us.pop(sender, None)
        return True

    # ---------------------------------------------------------------- inside

    def _stops_still(self, message: AnySigned, sender: int, now_us: int) -> bool:
        """Whether this is a stop of an operator in whose name somebody sends bad tags.

        Only a release is worth guessing tags for, so a lock-out does not hold back stops. Their counter
        was proven during the lock-out, and serves nothing else.
        """
        last = self._stops_heard.get(sender)
        if type(message) is not EmergencyStop or last is None or self._expired(sender, now_us):
            return False
        counter = last + ((message.freshness - last) & 0xFF)
        if (
            not last < counter <= last + WINDOW
            or self._tag(sender, counter, message) != message.tag
        ):
            return False
        self._stops_heard[sender] = counter
        self.badges.prove(sender, now_us)
        self.accepted += 1
        return True

    def _proven(self, operator: int, now_us: int) -> bool:
        proven_at_us = self._proven_at_us.get(operator)
        return proven_at_us is not None and now_us - proven_at_us <= SESSION_US

    def _locked_out(self, sender: int, now_us: int) -> bool:
        bad = self._bad_at_us.get(sender)
        if bad is None or len(bad) < BAD_MAX or now_us - bad[0] >= BAD_WINDOW_US:
            return False
        self.ignored += 1
        return True

    def _count_bad(self, sender: int, now_us: int) -> None:
        self.bad += 1
        self._bad_at_us.setdefault(sender, deque(maxlen=BAD_MAX)).append(now_us)

    def _expired(self, sender: int, now_us: int) -> bool:
        badges = self.badges
        if sender < OPERATOR_FIRST or badges.of(sender).valid(badges.day(now_us)):
            return False
        self.expired += 1
        return True

    def _secret(self, sender: int, badge: Badge | None) -> bytes | None:
        if badge is None:
            return self._keys.master
        operators = self._keys.operator
        if operators is None or sender == self.sender:
            return operators
        return badge.secret(operators)

    def _holds(self, sender: int) -> bool:
        keys = self._keys
        return (keys.master if sender < OPERATOR_FIRST else keys.operator) is not None

    def _tag(self, sender: int, counter: int, message: AnySigned) -> int:
        mac = self._mac(sender).copy()
        layout = _SIGNED[type(message)]
        head = layout.pgn.to_bytes(3, "little") + bytes((sender,))
        mac.update(head + counter.to_bytes(8, "little") + layout.pack(message)[:-3])
        return int.from_bytes(mac.finalize()[:3], "little")

    def _proof(
        self, sender: int, asker: int, number: bytes, counter: int, badge: Badge | None = None
    ) -> int:
        mac = self._mac(sender, badge).copy()
        head = FRESHNESS.pgn.to_bytes(3, "little") + bytes((sender, asker))
        mac.update(head + number + counter.to_bytes(8, "little"))
        return int.from_bytes(mac.finalize()[:3], "little")

    def _mac(self, sender: int, badge: Badge | None = None) -> "CMAC":
        """`badge`: of an operator; None: the one that it told last."""
        if sender >= OPERATOR_FIRST and badge is None:
            badge = self.badges.of(sender)
        mac = self._macs.get((sender, badge))
        if mac is None:
            if len(self._macs) >= MACS_MAX:  # somebody tells many badges
                self._macs.clear()
            secret = self._secret(sender, badge)
            assert secret is not None, "a sender whose secret is not held is not verified"
            info = b"headland sender" + bytes((sender,))
            mac = self._macs[sender, badge] = mac_of(derived_key(secret, info, KEY_SIZE))
        return mac
