"""Every bit of every frame as a named signal, for external tools that read a log.

Little-endian throughout: `start` is the lowest bit, counted from bit 0 of byte 0. A signal has the
name of the message's field, unless that is a keyword of C or C++, and gives its value as `raw *
scale + offset`. Reserved bits have separate signals with their fixed value, because encoders of
other makers would otherwise send 0 where J1939 requires 1.
"""

from contextlib import suppress
from math import pi
from random import Random
from typing import NamedTuple

from protocol.frames.accord_frames import Accord, AgreementKind, AgreementReply, Fallen
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)
from protocol.frames.fleet_frames import (
    COURSES,
    LENGTH_M,
    SPEED_M_S,
    Heartbeat,
    LeaderElectionVote,
    Member,
    Pose,
    StandsBy,
    Standstill,
    VectorSlice,
)
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.network_frames import (
    Acknowledgment,
    AddressClaimed,
    Control,
    RepetitionRateRequest,
    Request,
    TransportData,
    TransportManagement,
)
from protocol.frames.operator_frames import (
    LOWEST_M,
    PLACE_M,
    OperatorGoal,
    OperatorReport,
    ReportKind,
)
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Challenge,
    Command,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    Reason,
    StopsHeld,
    Switch,
)
from protocol.frames.segment_frames import FleetReset, FleetStop, GatewayBeat, SegmentSummary
from protocol.frames.work_frames import (
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)
from protocol.name import FIELDS


class Signal(NamedTuple):
    name: str
    start: int  # lowest bit
    length: int  # bits
    scale: float = 1
    offset: float = 0
    unit: str = ""
    choices: tuple[tuple[int, str], ...] = ()
    reserved: int | None = None  # always sent with this value, and never read


def _members(kind: type) -> tuple[tuple[int, str], ...]:
    return tuple((int(member), member.name) for member in kind)  # type: ignore[attr-defined]


STATE = (
    (0, "DISCONNECTED"),
    (1, "IDLE"),
    (2, "SYNCHRONIZING"),
    (3, "WORKING"),
    (4, "EMERGENCY_STOP"),
)
PHASE = ((0, "FREE"), (1, "CLAIMED"), (2, "STARTED"), (7, "DONE"))
_LOW = -(1 << 16) * LENGTH_M  # of POSE's coordinates

_DOT = (Signal("slot", 0, 8), Signal("incarnation", 8, 8), Signal("counter", 16, 8))
_PROOF = (Signal("freshness", 32, 8), Signal("tag", 40, 24))
_REGISTER = (
    Signal("section", 0, 16), Signal("epoch", 16, 8), Signal("phase", 24, 3, choices=PHASE),
    Signal("bid", 27, 5), Signal("lamport", 32, 24), Signal("owner", 56, 8),
)  # fmt: skip

SIGNALS: dict[type[Message], tuple[Signal, ...]] = {
    EmergencyStop: (
        *_DOT, Signal("reason", 24, 4, choices=_members(Reason)), Signal("echo", 28, 1),
        Signal("spent", 29, 1), *_PROOF,
    ),
    EmergencyReset: (*_DOT, Signal("operator_id", 24, 8), *_PROOF),
    StopsHeld: (
        Signal("slot", 0, 8), Signal("stops", 8, 8), Signal("digest", 16, 24), Signal("tag", 40, 24),
    ),
    HeldReset: (Signal("digest", 0, 24), Signal("operator_id", 24, 8), *_PROOF),
    OperatorCommand: (
        Signal("command", 0, 8, choices=_members(Command)), Signal("target", 8, 8),
        Signal("operator_id", 16, 8), Signal("argument", 24, 8), *_PROOF,
    ),
    OperatorGoal: (
        Signal("target", 0, 8), Signal("operator_id", 8, 8), Signal("value", 16, 15),
        Signal("north", 31, 1), *_PROOF,
    ),
    OperatorReport: (
        Signal("slot", 0, 8), Signal("number", 8, 4),
        Signal("matter", 12, 4, choices=_members(ReportKind)),
        Signal("x_m", 16, 16, PLACE_M, LOWEST_M, "m"),
        Signal("y_m", 32, 16, PLACE_M, LOWEST_M, "m"),
        Signal("distance_m", 48, 8, PLACE_M, 0, "m"), Signal("radius_m", 56, 8, PLACE_M, 0, "m"),
    ),
    Challenge: (Signal("asked", 0, 8), Signal("asker", 8, 8), Signal("number", 16, 48)),
    Freshness: (Signal("sender", 0, 8), Signal("counter", 8, 32), Signal("tag", 40, 24)),
    AllImplementsStop: (
        Signal("transition", 48, 8), Signal("state", 56, 2, choices=_members(Switch)),
    ),
    LeaderElectionVote: (
        Signal("election", 0, 16), Signal("term", 16, 16), Signal("candidate", 32, 8),
        Signal("flags", 40, 8), Signal("name_hash", 48, 16),
    ),
    TaskClaim: _REGISTER,
    StateSyncResponse: _REGISTER,
    Pose: (
        Signal("x_m", 0, 17, LENGTH_M, _LOW, "m"), Signal("y_m", 17, 17, LENGTH_M, _LOW, "m"),
        Signal("course_rad", 34, 9, 2 * pi / COURSES, 0, "rad"),
        Signal("speed_m_s", 43, 8, SPEED_M_S, 0, "m/s"), Signal("state", 51, 3, choices=STATE),
        Signal("stopped", 54, 1), Signal("heard", 55, 8),
    ),
    Heartbeat: (
        Signal("counter", 0, 8), Signal("state", 8, 3, choices=STATE), Signal("stopped", 11, 1),
        Signal("held", 12, 1), Signal("started", 13, 1), Signal("leaving", 14, 1),
        Signal("health", 16, 8, 1 / 250), Signal("operations", 24, 16), Signal("digest", 40, 24),
    ),
    Member: (
        Signal("slot", 0, 8), Signal("incarnation", 8, 16), Signal("config_hash", 24, 24),
        Signal("flags", 48, 8),
    ),
    Standstill: (
        Signal("slot", 0, 8), Signal("cause", 8, 8, choices=_members(StandsBy)),
        Signal("place", 16, 4), Signal("causes", 20, 4), Signal("about", 24, 8),
        Signal("number", 32, 16),
    ),
    StateSyncRequest: (
        Signal("cut", 0, 24), Signal("digest", 24, 24), Signal("scope", 48, 8),
        Signal("round", 56, 8),
    ),
    Digests: (
        Signal("triple", 0, 8), Signal("salt", 8, 8), Signal("first", 16, 16),
        Signal("second", 32, 16), Signal("third", 48, 16),
    ),
    VectorSlice: (
        Signal("base", 0, 8), *(Signal(f"counts_{k}", 8 + 8 * k, 8) for k in range(7)),
    ),
    WorkProgress: (Signal("section", 0, 16), Signal("block", 16, 8), Signal("bits", 24, 40)),
    Accord: (
        Signal("round", 0, 16), Signal("say", 16, 4, choices=_members(AgreementKind)),
        Signal("answer", 20, 4, choices=_members(AgreementReply)), Signal("first", 24, 16),
        Signal("second", 40, 16), Signal("detail", 56, 8),
    ),
    Fallen: (
        Signal("x_m", 0, 17, LENGTH_M, _LOW, "m"), Signal("y_m", 17, 17, LENGTH_M, _LOW, "m"),
        Signal("slot", 34, 8), Signal("stamp", 42, 22),
    ),
    MapPatch: (
        Signal("patch", 0, 16), Signal("time", 16, 13, unit="s"), Signal("level", 29, 4),
        Signal("observer", 33, 5), Signal("cells", 38, 26),
    ),
    MapDigests: (
        Signal("node", 0, 13), Signal("salt", 13, 3),
        *(Signal(f"digests_{k}", 16 + 3 * k, 3) for k in range(16)),
    ),
    FleetStop: (
        Signal("segment", 0, 15), Signal("told", 15, 1), Signal("slot", 16, 8),
        Signal("incarnation", 24, 8), Signal("counter", 32, 8), Signal("tag", 40, 24),
    ),
    FleetReset: (
        Signal("segment", 0, 15), Signal("part", 15, 1), Signal("slot", 16, 8),
        Signal("incarnation", 24, 8), Signal("counter", 32, 8), Signal("half", 40, 24),
    ),
    GatewayBeat: (
        Signal("candidate", 0, 8), Signal("flags", 8, 8), Signal("term", 16, 16),
        Signal("reached", 32, 16), Signal("lot", 48, 16),
    ),
    SegmentSummary: (
        Signal("segment", 0, 16), Signal("live", 16, 8), Signal("silent", 24, 8),
        Signal("halted", 32, 8), Signal("done", 40, 8), Signal("digest", 48, 16),
    ),
    TaskOrder: (
        Signal("task", 0, 16), Signal("pickup", 16, 16), Signal("dropoff", 32, 16),
        Signal("check", 48, 16),
    ),
    TaskBookDigest: (Signal("bucket", 0, 8), Signal("check", 8, 8), Signal("bits", 16, 48)),
    TaskBid: (
        Signal("task", 0, 16), Signal("cost_ms", 16, 32, unit="ms"), Signal("place", 48, 8),
        Signal("round", 56, 8),
    ),
    Itinerary: (
        Signal("version", 0, 8), Signal("first", 8, 8), Signal("length", 16, 8),
        Signal("battery", 24, 8), Signal("task", 32, 16), Signal("after", 48, 16),
    ),
    PlanOffer: (
        Signal("round", 0, 8), Signal("replan", 8, 8), Signal("cost_ms", 16, 32, unit="ms"),
        Signal("digest", 48, 16),
    ),
    PlanRow: (
        Signal("round", 0, 8), Signal("slot", 8, 8), Signal("first", 16, 8),
        Signal("length", 24, 8), Signal("task", 32, 16), Signal("after", 48, 16),
    ),
    AddressClaimed: tuple(Signal(name, start, length) for name, start, length in FIELDS),
    Request: (Signal("pgn", 0, 24),),
    RepetitionRateRequest: (Signal("pgn", 0, 24), Signal("rate_ms", 24, 16)),
    Acknowledgment: (
        Signal("control", 0, 8, choices=_members(Control)), Signal("group_function", 8, 8),
        Signal("address", 32, 8), Signal("pgn", 40, 24),
    ),
    TransportManagement: (
        Signal("control", 0, 8), *(Signal(f"body_{k}", 8 + 8 * k, 8) for k in range(4)),
        Signal("pgn", 40, 24),
    ),
    TransportData: (
        Signal("sequence", 0, 8), *(Signal(f"body_{k}", 8 + 8 * k, 8) for k in range(7)),
    ),
}  # fmt: skip

SAMPLES = 32  # a bit that is not constant is 1 in all of them with odds of 2^-32
NAME_OF_FIELD = {"operator": "operator_id", "switch": "state"}  # of signals, where they differ


def _ones(kind: type[Message], length: int) -> int:
    """Bits that are 1 in every frame of this kind, judged from a few samples."""
    rng, ones, left = Random(0), (1 << 8 * length) - 1, SAMPLES
    while left:
        with suppress(ValueError):
            ones &= int.from_bytes(kind.unpack(rng.randbytes(length)).pack(), "little")
            left -= 1
    return ones


def reserved_of(kind: type[Message]) -> tuple[Signal, ...]:
    """The unused bits of a frame, run by run, each with the value that we send."""
    length = GROUP_OF[kind].length
    used = {bit for s in SIGNALS[kind] for bit in range(s.start, s.start + s.length)}
    sent = _ones(kind, length)
    runs: list[list[int]] = []
    for bit in range(8 * length):
        if bit in used:
            continue
        if runs and runs[-1][-1] == bit - 1:
            runs[-1].append(bit)
        else:
            runs.append([bit])
    return tuple(
        Signal(
            f"reserved_{run[0]}", run[0], len(run), reserved=sent >> run[0] & (1 << len(run)) - 1
        )
        for run in runs
    )


assert SIGNALS.keys() == GROUP_OF.keys(), "every frame kind has its signals"
for _kind, _signals in SIGNALS.items():
    _used = [bit for s in _signals for bit in range(s.start, s.start + s.length)]
    assert len(_used) == len(set(_used)) and max(_used) < 8 * GROUP_OF[_kind].length
