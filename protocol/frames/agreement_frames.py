"""Frames by which robots agree on which robot goes where. One use is robots in each other's way
(`agent/mapf/joint_plan_agreement.py`), the other a grid that robots cover together
(`agent/coverage/plan_agreement.py`). A fleet has one of the two uses."""

from enum import IntEnum
from typing import NamedTuple

from protocol.frames.fleet_frames import COORDINATE_BITS, LENGTH_M, NOWHERE_M
from protocol.frames.layout import ROBOT, FrameLayout, choice, integer, scaled


class AgreementKind(IntEnum):
    """What an ACCORD frame says; a robot says each at most one way in one round."""

    PLACE = 0  # I stand at node `first` and want to node `second`; `detail`: where in the node
    PLAN = 1  # the digest of the plan that I computed: `first` low, `second` high half
    AT = 2  # I have reached the `first`-th node of my route, counted from 1; 0: not yet on it
    BODY = 3  # on a grid: something is in cell `first`; `second`: its slot, 0xFFFF: not a robot;
    # `detail`: 1 where it is taken to stay. Else: something that I see stands on node `first`
    # On a grid PLACE has a cell as `first` and a digest of what is covered as `second` and `detail`;
    # `first` is 0xFFFF where the robot is STOPPED and in no cell.
    # AT has a step of the plan as `first` and the low half of the plan's digest as `second`.


class AgreementReply(IntEnum):
    """With PLACE: whether this robot clears the way when it is asked to."""

    GRANT = 0
    STOPPED = 1  # refused: an emergency stop, a hold, a fault: it does not move
    BUSY = 2  # refused: it is in the middle of something that must not move, a drop or a charge;
    # on a grid: it stands between two cells, and goes back when the robot behind it has gone
    # refused: it does not receive a member that others receive, so it cannot agree with all.
    DEAF = 3


class AgreementMessage(NamedTuple):
    """One statement of a robot in a round of agreement on a joint plan.

    A robot sends it when it calls a round or receives one, and repeats it until the others have
    answered. Receivers stop, collect the places of all, compute the same plan, and drive when all
    digests are equal.
    """

    round: int
    say: int
    answer: int
    first: int
    second: int
    detail: int


ACCORD = FrameLayout(
    AgreementMessage, "ACCORD", pgn=0xFF15, priority=6, sender=ROBOT,
    fields=(
        integer("round", 16, "a later round (modulo 2^16) makes earlier ones void"),
        choice("say", 4, AgreementKind, "what the frame tells"),
        choice("answer", 4, AgreementReply, "with PLACE: whether the robot clears the way"),
        integer("first", 16, "PLACE: node where it stands, on a grid 0xFFFF: in no cell; "
                "PLAN: low half of the digest; AT: node of its route; BODY: node"),
        integer("second", 16, "PLACE: node where it wants to be; PLAN: high half of the digest; BODY: "
                "slot, 0xFFFF: no robot"),
        integer("detail", 8, "PLACE: sixteenths of the pitch east (bits 0-3) and north (4-7) of the "
                "node, offset 8"),
    ),
)  # fmt: skip

STAMP_BITS = 22
STAMP_MAX = (1 << STAMP_BITS) - 1


class SilentPosition(NamedTuple):
    """Where a silent member stands, according to the last frame that was received from it.

    One robot repeats the position of each silent member every 5 s, and faster while a round of
    agreement waits for it. Receivers keep the position with the latest stamp as an obstacle. The
    lowest coordinates say that the member has left its position.
    """

    x_m: float
    y_m: float
    slot: int
    stamp: int


FALLEN = FrameLayout(
    SilentPosition, "FALLEN", pgn=0xFF18, priority=6, sender=ROBOT,
    fields=(
        scaled("x_m", COORDINATE_BITS, LENGTH_M, "m", "as in POSE", NOWHERE_M),
        scaled("y_m", COORDINATE_BITS, LENGTH_M, "m", "as in POSE", NOWHERE_M),
        integer("slot", 8, "of the silent member"),
        integer("stamp", STAMP_BITS, "quarters of a second of the fleet's common clock: when its last "
                "frame was received"),
    ),
)  # fmt: skip
