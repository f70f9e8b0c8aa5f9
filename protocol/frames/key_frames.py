"""Frames that give a fleet new keys while it works, and take a member's keys away.

`protocol/rekeying.py` says what is in the parts and what the tags cover.
"""

from typing import Final, NamedTuple

from protocol.frames.layout import ANY_DEVICE, ROBOT, FrameLayout, flag, integer, octets

PART_BYTES: Final = 6
PARTS_BITS: Final = 3
GENERATION_SHORT_BITS: Final = 5  # in KEY_PART: enough to tell the next few generations apart
GENERATION_BITS: Final = 15
SWITCH_TAG_BITS: Final = 48
HELD_TAG_BITS: Final = 40


class KeyPart(NamedTuple):
    """A part of the new secret for one robot, sealed under that robot's own key.

    The owner of a fleet sends seven of them to each robot, before KEY_SWITCH. No other robot can
    read them.
    """

    robot: int
    generation: int
    part: int
    data: bytes


KEY_PART = FrameLayout(
    KeyPart, "KEY_PART", pgn=0xFF34, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("robot", 8, "slot of the robot that can read it"),
        integer("generation", GENERATION_SHORT_BITS, "low bits of the number of the new keys"),
        integer("part", PARTS_BITS, "place among the parts, from 0"),
        octets("data", PART_BYTES, "of the sealed secret"),
    ),
)  # fmt: skip


class KeySwitch(NamedTuple):
    """From now on the keys of this generation are the fleet's.

    The owner sends it when the robots that are heard hold the new secret. A robot that does not hold
    it ignores this.
    """

    generation: int
    tag: int


KEY_SWITCH = FrameLayout(
    KeySwitch, "KEY_SWITCH", pgn=0xFF35, priority=2, sender=ANY_DEVICE,
    fields=(
        integer("generation", 16, "number of the keys"),
        integer("tag", SWITCH_TAG_BITS, "AES-CMAC under the new secret"),
    ),
)  # fmt: skip


class KeysHeld(NamedTuple):
    """A robot holds the new secret, or has switched to it.

    Robots send it when they have all parts, when they have switched, and again for each repeated
    part or switch, at most five times a second.
    """

    slot: int
    generation: int
    switched: bool
    tag: int


KEYS_HELD = FrameLayout(
    KeysHeld, "KEYS_HELD", pgn=0xFF36, priority=6, sender=ROBOT,
    fields=(
        integer("slot", 8, "of the robot"),
        integer("generation", GENERATION_BITS, "number of the keys"),
        flag("switched", "it uses them"),
        integer("tag", HELD_TAG_BITS, "AES-CMAC under the new secret"),
    ),
)  # fmt: skip
