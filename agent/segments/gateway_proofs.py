"""What a gateway believes, and proves, in a fleet with keys.

A gateway with the fleet's master secret passes work and maps on only if it can vouch for them. Frames of
its own bus are *held* until their sender has proven them, as in a robot (`agent/peer/proven_frames.py`).
What it says on its bus is covered by proofs under a key of its own, because the robots there hold its
frames, too. Messages of the backbone end with a tag of 64 bits. So trust goes from hop to hop. A
gateway without keys in a fleet with keys carries stops and resets, which have their own tags. Its work
is held by every robot, and dropped.

Beats and votes of the candidates of one segment are not held here: a forged one can make gateways
lose their lead, which robots notice as the loss of other segments. Robots believe proven beats only.
"""

from collections.abc import Sequence
from typing import Any, Final

from agent.interface.config import MS, S
from agent.interface.effects import Send
from agent.peer.proven_frames import GATEWAY_KINDS, PROVEN_KINDS, SOON_US
from protocol.authentication import Keys
from protocol.backbone_messages import BackboneKind
from protocol.frame_proofs import (
    FleetTime,
    ProofBatch,
    ProofChecker,
    ProofKeys,
    Proven,
    TimeAnswers,
)
from protocol.frames.fleet_frames import LeaderElectionVote, Member
from protocol.frames.segment_frames import GatewayBeat, gateway_slot
from protocol.frames.trust_frames import WORD_BITS, FleetTimeTold, Proof, TimeQuestion
from protocol.frames.work_frames import STOPS, StateSyncRequest

ASK_US: Final = 500 * MS  # between questions for the fleet's time, while it is unknown
DOUBT_US: Final = 5 * S  # and after a proof of a known robot could not be verified
# Of the backbone, what changes work, maps, or what robots are told of other segments.
TAGGED: Final = frozenset((BackboneKind.SUMMARY, BackboneKind.WORK, BackboneKind.MAP))
HELD_KINDS: Final = (PROVEN_KINDS | GATEWAY_KINDS) - {GatewayBeat, LeaderElectionVote}


class GatewayProofs:
    """Holds what robots say until it is proven, and proves what the gateway says."""

    def __init__(self, keys: Keys, boot: int, now_us: int) -> None:
        """`keys`: of the file of panels, which has the master secret. `boot`: different at each start."""
        self.keys = ProofKeys(keys)
        self.checker = ProofChecker(self.keys, FleetTime(0, now_us))
        self.refused = 0  # messages of the backbone without a valid tag
        self._boot = boot.to_bytes(4, "little")
        self._answers = TimeAnswers(self.keys)
        self._batch: ProofBatch | None = None
        self._address: int | None = None
        self._question: TimeQuestion | None = None
        self._asked, self._asked_at_us = 0, now_us - 2 * S
        self._ask_at_us = now_us

    def rekey(self, keys: Keys, now_us: int) -> None:
        """The fleet has other keys from now on; what waits was said under the old ones. We ask for the
        time that began with them."""
        self.checker.rekey(keys)
        self.checker.time.known, self._ask_at_us = False, now_us
        if self._batch is not None:
            self._batch.rekey()

    # ---------------------------------------------------------------- from our bus

    def hear(
        self, source: int, slot: int | None, message: Any, now_us: int
    ) -> Sequence[tuple[int, Any]] | None:
        """What is believed now: senders and messages. None: the message needs no proof.

        `slot`: of the robot that has proven this address, or the number of a gateway."""
        kind = type(message)
        if kind is Proof:
            return self._verified(source, slot, message, now_us)
        if kind is FleetTimeTold:
            ticks = self._answers.hear(source, message, self._question)
            if ticks is not None:
                fresh = now_us - self._asked_at_us <= S
                if fresh and self.checker.time.begins_again(ticks, now_us):
                    self.checker.rekey(self.keys.keys)
                    if self._batch is not None:
                        self._batch.rekey()
                self.checker.time.learn(ticks, now_us)
            return ()
        if kind not in HELD_KINDS or (kind is StateSyncRequest and message.scope == STOPS):
            return None
        found = self.checker.hold(source, message, now_us)
        return [each for proven in found for each in self._believed(source, slot, proven)]

    def _verified(
        self, source: int, slot: int | None, proof: Proof, now_us: int
    ) -> Sequence[tuple[int, Any]]:
        number = gateway_slot(source)
        if proof.sender != (slot if number is None else number) and not any(
            type(message) is Member and message.slot == proof.sender
            for message in self.checker.held(source)
        ):
            self.checker.bad += 1
            return ()
        proven = self.checker.verify(source, proof, now_us)
        if proven is not None:
            return self._believed(source, slot, proven)
        if self.checker.time.known and len(self.checker.held(source)) >= proof.covered:
            self._ask_at_us = min(self._ask_at_us, now_us + DOUBT_US)
        return ()

    @staticmethod
    def _believed(source: int, slot: int | None, proven: Proven) -> list[tuple[int, Any]]:
        """The MEMBER frame first, which binds the address for the others."""
        number, sender = gateway_slot(source), proven.sender
        if number is not None:
            slot = number
        binds = [m for m in proven.messages if type(m) is Member and m.slot == sender]
        if sender != slot and (number is not None or not binds):
            return []
        rest = [m for m in proven.messages if type(m) is not Member]
        return [(sender, message) for message in (*binds, *rest)]

    # ---------------------------------------------------------------- to our bus

    @property
    def due_at_us(self) -> int:
        """When `cover` has a proof or a question to send; only while there is an address."""
        batch = self._batch
        proof_at_us = None if batch is None else batch.due_at_us
        return self._ask_at_us if proof_at_us is None else min(self._ask_at_us, proof_at_us)

    def cover(self, effects: Sequence[Any], number: int, address: int, now_us: int) -> list[Any]:
        """What the gateway does, with the proofs of its frames that are due, and its question."""
        batch = self._batch
        if batch is None or batch.sender != number:
            batch = self._batch = ProofBatch(number, self.keys, self.checker.time)
        covered: list[Any] = []
        for effect in effects:
            covered.append(effect)
            if type(effect) is Send and type(effect.message) in GATEWAY_KINDS:
                now = type(effect.message) is GatewayBeat
                batch.add(effect.message, now_us if now else now_us + SOON_US)
                if batch.full:
                    covered += self._sealed(batch, address, now_us)
        if batch.due_at_us is not None and batch.due_at_us <= now_us:
            covered += self._sealed(batch, address, now_us)
        if now_us >= self._ask_at_us:
            self._asked_at_us = now_us
            covered.append(Send(self._ask(number), source=address))
            known = self.checker.time.known
            self._ask_at_us = now_us + (1 << 40 if known else ASK_US)
        return covered

    @staticmethod
    def _sealed(batch: ProofBatch, address: int, now_us: int) -> list[Any]:
        proof = batch.seal(address, now_us)
        return [] if proof is None else [Send(proof, source=address)]

    def _ask(self, number: int) -> TimeQuestion:
        self._asked += 1
        lot = self._boot + self._asked.to_bytes(8, "little")
        self._question = TimeQuestion(number, self.keys.number(b"nonce", lot, WORD_BITS))
        return self._question

    # ---------------------------------------------------------------- the backbone

    def sealed(self, message: bytes) -> bytes:
        """A message for the backbone with its tag."""
        return message + self.keys.backbone_tag(message)

    def opened(self, message: bytes) -> tuple[bytes, bool]:
        """A message of the backbone without its tag, and whether the tag was right. A message without
        one is left as it is, because stops are carried with and without."""
        told, tag = message[: -self.keys.BACKBONE_TAG], message[-self.keys.BACKBONE_TAG :]
        return (told, True) if self.keys.backbone_tag(told) == tag else (message, False)
