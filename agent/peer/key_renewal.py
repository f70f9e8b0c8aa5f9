"""New keys while the fleet works: takes the sealed secret for this robot, and switches when it is told.

The owner's tool gives every robot but a revoked one the new secret, and then tells all to switch in one
frame that all hear. From then on nothing that is signed with the old keys is believed. What is durable
comes first: a robot that restarts has the newest keys that it had.
"""

from collections.abc import Mapping
from struct import Struct
from typing import Any, Final

from agent.interface.config import S
from agent.interface.effects import Persist, Send, Trace
from agent.peer import inputs, notices
from agent.peer.part import NOTHING, DirectListener, Handler, Header, Outputs, Part, StepContext
from agent.safety.command_authentication import CommandAuthority
from protocol.authentication import KEY_SIZE, Keys
from protocol.ciphers import derived_key
from protocol.frames.key_frames import KeyPart, KeysHeld, KeySwitch
from protocol.rekeying import ALWAYS_S, NOBODY, PartsOf, Rekeying

FLEET_KEYS = "keys"  # the record in durable memory
# Generation, secret, one bit for each revoked slot, and which own key the secret was sealed for. Robots
# before did not write the last one.
RECORD_BEFORE = Struct(f"<H{KEY_SIZE}s16s")
RECORD = Struct(f"{RECORD_BEFORE.format}8s")
RECORD_SIZES: Final = RECORD_BEFORE.size, RECORD.size
ANSWER_SPACING_US: Final = S // 5


class KeptKeys:
    """What durable memory holds of keys that were given to the fleet after its key files were made."""

    def __init__(self, recalled: Mapping[str, bytes], given: Keys | None) -> None:
        """`given`: of the key file. What was given with other own keys is void: the owner has made new
        ones, because the old ones are in wrong hands, it may be."""
        raw = recalled.get(FLEET_KEYS, b"")
        own = None if given is None else given.own
        if len(raw) == RECORD.size and raw[-8:] != own_name(own):
            raw = b""
        generation, secret, bits = 0, b"", b""
        if len(raw) in RECORD_SIZES:
            generation, secret, bits = RECORD_BEFORE.unpack(raw[: RECORD_BEFORE.size])
        self.rekeying = Rekeying(generation, secret) if generation else None
        number = int.from_bytes(bits, "little")
        self.revoked = frozenset(slot for slot in range(128) if number >> slot & 1)

    def newest(self, given: Keys) -> Keys:
        """The keys of a key file, or those that the fleet was given later."""
        kept = self.rekeying
        if kept is None or kept.generation <= given.generation:
            return given
        return kept.keys._replace(own=given.own)


def record(rekeying: Rekeying, revoked: frozenset[int], own: bytes | None) -> Persist:
    """What makes the keys of a fleet durable. `own`: the robot's own key."""
    bits = sum(1 << slot for slot in revoked).to_bytes(16, "little")
    value = RECORD.pack(rekeying.generation, rekeying.secret, bits, own_name(own))
    return Persist(FLEET_KEYS, value)


def own_name(own: bytes | None) -> bytes:
    """Eight bytes that tell which own key this is, and nothing else about it."""
    return bytes(8) if own is None else derived_key(own, b"headland kept keys", 8)


class KeyRenewal(Part):
    """The part that takes new keys. Without keys of its own a robot takes none."""

    def __init__(self, slot: int, authority: CommandAuthority, kept: KeptKeys) -> None:
        """`kept`: what durable memory holds."""
        self.slot, self.authority = slot, authority
        self.revoked = kept.revoked
        ring = authority.keyring
        own = None if ring is None else ring.keys.own
        self._parts = None if own is None else PartsOf(slot, own)
        self._next: Rekeying | None = None  # held, not used yet
        self._now: Rekeying | None = kept.rekeying  # used
        self._answered_at_us = -ANSWER_SPACING_US

    @property
    def generation(self) -> int:
        """The number of the keys that are in use; 0: those of the key files, or none."""
        ring = self.authority.keyring
        return 0 if ring is None else ring.keys.generation

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            KeyPart: self._hear_part,
            KeySwitch: self._hear_switch,
            KeysHeld: lambda ctx, header, m: NOTHING,  # the owner's tool reads it
        }

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {inputs.DateTold: self._date}

    def _date(self, fact: inputs.DateTold, now_us: int) -> Outputs:
        ring = self.authority.keyring
        if ring is not None:
            ring.badges.correct(fact.clock_zero_at_s)
        return NOTHING

    def _hear_part(self, ctx: StepContext, header: Header, m: KeyPart) -> Outputs:
        found = None if self._parts is None else self._parts.hear(header.source, m)
        if found is None:
            return NOTHING
        # Recorded parts of an older generation replace no newer ones. An owner that begins again uses a
        # number twice.
        held_already = 0 if self._next is None else self._next.generation
        if found.generation > self.generation and found.generation >= held_already:
            self._next = found
        # After a restart a robot does not know which robot its keys revoked.
        held = next((r for r in (self._now, self._next) if r and r[:2] == found[:2]), None)
        return NOTHING if held is None else self._confirm(held, ctx.now_us)

    def _hear_switch(self, ctx: StepContext, header: Header, m: KeySwitch) -> Outputs:
        new, now = self._next, self._now
        if now is not None and m == now.switch():
            return self._confirm(now, ctx.now_us)
        if new is None or m != new.switch():
            return NOTHING
        return self._switch(new, ctx.now_us)

    def _switch(self, new: Rekeying, now_us: int) -> Outputs:
        ring = self.authority.keyring
        assert ring is not None, "only a robot with its own key opens a secret"
        keys = new.keys._replace(own=ring.keys.own)
        self.authority.rekey(keys)
        self._now, self._next = new, None
        outputs: list[Any] = []
        compromised_at_us = None if new.void_for_s == ALWAYS_S else now_us - new.void_for_s * S
        if new.revoked != NOBODY:
            self.revoked |= {new.revoked}
        outputs.append(record(new, self.revoked, keys.own))
        outputs.append(notices.KeysChanged(keys, new.revoked, compromised_at_us))
        said = f"revoked robot {new.revoked}" if new.revoked != NOBODY else "rotated"
        outputs.append(Trace("keys", "", "SWITCHED", str(new.generation), said))
        self._answered_at_us = -ANSWER_SPACING_US
        return [*outputs, *self._confirm(new, now_us)]

    def _confirm(self, held: Rekeying, now_us: int) -> Outputs:
        if now_us - self._answered_at_us < ANSWER_SPACING_US:
            return NOTHING
        self._answered_at_us = now_us
        return [Send(held.held(self.slot, held is self._now))]
