"""New keys for a fleet at work: a new secret for each robot, sealed under that robot's own key.

All keys of a *generation* come from one secret of 16 bytes. The owner of the fleet draws it and sends
it to each robot but the revoked one, sealed with AES-SIV (RFC 5297) under a key that only this robot and
the owner hold. AES-SIV needs no nonce, so a repeated part reveals nothing. When the robots have it, the
owner says that they shall switch, with a tag under the new secret. So a thief of one robot's keys can
neither read the new keys, nor make others switch, nor sign after the switch.

A robot that was away keeps the old keys. It hears no proof of the others and stands until the owner
has given it the new ones.
"""

from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Final, NamedTuple

from protocol.authentication import KEY_SIZE, Keys
from protocol.ciphers import derived_key, mac_of, siv_opened, siv_sealed
from protocol.frames.key_frames import (
    GENERATION_BITS,
    GENERATION_SHORT_BITS,
    HELD_TAG_BITS,
    PART_BYTES,
    PARTS_BITS,
    SWITCH_TAG_BITS,
    KeyPart,
    KeysHeld,
    KeySwitch,
)

OWN_SIZE: Final = 32  # bytes of a robot's own key: AES-SIV takes two keys of 16
TAG_SIZE: Final = 16  # bytes that sealing adds
NOBODY: Final = 255  # slot: no member is revoked, the keys are only rotated
SLOTS: Final = 128  # numbers of robots
ALWAYS_S: Final = 0xFFFF_FFFF  # all that the revoked member ever said is void
GENERATION_MAX: Final = (1 << GENERATION_BITS) - 1
AHEAD_MAX: Final = (1 << GENERATION_SHORT_BITS) - 1  # generations that a robot may have missed
CONTENT = Struct(f"<{KEY_SIZE}sHBxI")  # secret, generation, revoked slot, seconds before the switch
PARTS: Final = -(-(CONTENT.size + TAG_SIZE) // PART_BYTES)
assert PARTS <= 1 << PARTS_BITS


class Rekeying(NamedTuple):
    """What the owner tells each robot."""

    generation: int
    secret: bytes
    revoked: int = NOBODY
    void_for_s: int = ALWAYS_S  # what it said up to this long before the switch is void

    @property
    def keys(self) -> Keys:
        """The fleet's keys of this generation, without a robot's own."""
        return Keys(
            derived_key(self.secret, b"headland master", KEY_SIZE),
            derived_key(self.secret, b"headland operators", KEY_SIZE),
            generation=self.generation,
        )  # fmt: skip

    @property
    def is_sayable(self) -> bool:
        """Whether its values fit into the frames, as those of a file may not."""
        return (
            len(self.secret) == KEY_SIZE
            and 0 < self.generation <= GENERATION_MAX
            and (0 <= self.revoked < SLOTS or self.revoked == NOBODY)
            and 0 <= self.void_for_s <= ALWAYS_S
        )

    def switch(self) -> KeySwitch:
        """What makes robots that hold the secret use it."""
        return KeySwitch(self.generation, self._tag(b"S", SWITCH_TAG_BITS))

    def held(self, slot: int, switched: bool) -> KeysHeld:
        """What robot `slot` confirms."""
        tag = self._tag(b"H" + bytes((slot, switched)), HELD_TAG_BITS)
        return KeysHeld(slot, self.generation, switched, tag)

    def _tag(self, content: bytes, bits: int) -> int:
        mac = mac_of(derived_key(self.secret, b"headland rekeying", KEY_SIZE))
        mac.update(content + self.generation.to_bytes(2, "little"))
        return int.from_bytes(mac.finalize()[: bits // 8], "little")


def own_key(root: bytes, slot: int) -> bytes:
    """The key that only robot `slot` and the owner of `root` hold."""
    return derived_key(root, b"headland robot" + bytes((slot,)), OWN_SIZE)


def seal(rekeying: Rekeying, own: bytes, slot: int) -> list[KeyPart]:
    """The frames of the new secret for one robot."""
    content = CONTENT.pack(
        rekeying.secret, rekeying.generation, rekeying.revoked, rekeying.void_for_s
    )
    sealed = siv_sealed(own, content, _about(slot))
    short = rekeying.generation & AHEAD_MAX
    return [
        KeyPart(slot, short, part, sealed[part * PART_BYTES : (part + 1) * PART_BYTES])
        for part in range(PARTS)
    ]


def opened(parts: Mapping[int, bytes], own: bytes, slot: int) -> Rekeying | None:
    """The new secret from all its parts; None if they are not those of the owner for this robot."""
    sealed = b"".join(parts[part] for part in range(PARTS))[: CONTENT.size + TAG_SIZE]
    content = siv_opened(own, sealed, _about(slot))
    if content is None:
        return None
    secret, generation, revoked, void_for_s = CONTENT.unpack(content)
    return Rekeying(generation, secret, revoked, void_for_s)


class PartsOf:
    """Collects the parts for one robot. Each source has its own set, so that nobody mixes in parts."""

    SOURCES_MAX: Final = 4  # a fleet has one owner; more addresses are forgers

    def __init__(self, slot: int, own: bytes) -> None:
        self.slot, self.own = slot, own
        self.bad = 0  # sets that could not be opened
        self._parts: dict[tuple[int, int], dict[int, bytes]] = {}

    def hear(self, source: int, m: KeyPart) -> Rekeying | None:
        """The new secret, when its last part has come."""
        if m.robot != self.slot or m.part >= PARTS:
            return None
        parts = self._parts.setdefault((source, m.generation), {})
        parts[m.part] = m.data
        if len(self._parts) > self.SOURCES_MAX:
            del self._parts[next(iter(self._parts))]
        if len(parts) < PARTS:
            return None
        self._parts.pop((source, m.generation), None)
        found = opened(parts, self.own, self.slot)
        self.bad += found is None
        return found


def confirmed(rekeying: Rekeying, heard: Sequence[KeysHeld], switched: bool) -> set[int]:
    """Slots of the robots that hold this secret, or use it, by their tags."""
    return {
        m.slot for m in heard
        if m == rekeying.held(m.slot, m.switched) and (m.switched or not switched)
    }  # fmt: skip


def _about(slot: int) -> bytes:
    return b"headland rekeying" + bytes((slot,))
