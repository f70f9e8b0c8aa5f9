"""Frames that authenticate other frames in a fleet with keys: proofs, and the time they are from.

A frame has 8 bytes and no room for a tag. So a second frame, PROOF, covers a few frames that the
same device has just sent. `protocol/frame_proofs.py` says what its tag covers.
"""

from typing import Final, NamedTuple

from protocol.frames.layout import ANY_DEVICE, FrameLayout, integer, reserved

MOMENT_BITS: Final = 12
COUNT_BITS: Final = 4
PROOF_TAG_BITS: Final = 40
WORD_BITS: Final = 56  # of a fleet time, of a nonce, and of a tag of a fleet time
ROLES_BITS: Final = 4
TICKS, TAG = 0, 1  # values of `part` in FLEET_TIME


class Proof(NamedTuple):
    """Authenticates the frames that the same device has sent since its last proof.

    A robot of a fleet with keys sends it with every heartbeat, and within 20 ms after other frames.
    Receivers hold frames until their proof arrives. It is also the robot's authenticated sign of
    life. A fleet without keys does not send it.
    """

    sender: int
    covered: int
    moment: int
    tag: int


PROOF = FrameLayout(
    Proof, "PROOF", pgn=0xFF3E, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("sender", 8, "under whose key the tag is: robots 0 to 127, operator devices from 192"),
        integer("covered", COUNT_BITS, "different frames that it covers"),
        integer("moment", MOMENT_BITS, "low bits of the fleet's time, in ticks of 8 ms; never twice"),
        integer("tag", PROOF_TAG_BITS, "AES-CMAC over sender, address, time, and the frames in order "
                "of group and data"),
    ),
)  # fmt: skip


class OperatorBadge(NamedTuple):
    """What the key of an operator's device allows, and until when.

    An operator's device with a restricted key sends it before each FRESHNESS and PROOF. The tags of
    what follows are right only if it is true. A fleet without keys does not send it.
    """

    device: int
    roles: int
    expires_day: int


OPERATOR_BADGE = FrameLayout(
    OperatorBadge, "OPERATOR_BADGE", pgn=0xFF3B, priority=2, sender=ANY_DEVICE,
    fields=(
        integer("device", 8, "number of the operator's device, 192 to 254", accepted=range(192, 255)),
        integer("roles", ROLES_BITS, "1: stop, 2: release, 4: direct, 8: task; a sum of them"),
        reserved(4),
        integer("expires_day", 16, "first day on which it is void, from 1970-01-01; 0: never"),
        reserved(32),
    ),
)  # fmt: skip


class TimeQuestion(NamedTuple):
    """Asks for the fleet's time, which proofs are checked against.

    A device of a fleet with keys sends it when it has joined, and when it cannot verify the proofs of
    a robot. One robot that knows the time answers with FLEET_TIME.
    """

    asker: int
    nonce: int


TIME_QUESTION = FrameLayout(
    TimeQuestion, "TIME_QUESTION", pgn=0xFF3C, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("asker", 8, "slot of the robot, or the operator device"),
        integer("nonce", WORD_BITS, "used once"),
    ),
)  # fmt: skip


class FleetTimeTold(NamedTuple):
    """One half of the fleet's time: its ticks, then the tag that proves it to one asker.

    The tag covers the nonce of a TIME_QUESTION, so an answer that was recorded proves nothing later.
    """

    part: int
    value: int


FLEET_TIME = FrameLayout(
    FleetTimeTold, "FLEET_TIME", pgn=0xFF3D, priority=7, sender=ANY_DEVICE,
    fields=(
        integer("part", 8, "0: ticks of 8 ms; 1: tag", accepted=range(2)),
        integer("value", WORD_BITS, "the ticks, or an AES-CMAC over asker, nonce and ticks"),
    ),
)  # fmt: skip
