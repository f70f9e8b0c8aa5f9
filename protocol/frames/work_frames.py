"""Frames about work: claims, progress, and the anti-entropy that repairs lost frames."""

from typing import NamedTuple

from protocol.frames.layout import ANY_DEVICE, ROBOT, FrameLayout, choice, integer

# scopes of STATE_SYNC_REQUEST
REGISTERS, BLOCKS, STOPS, BUCKETS_SINCE, ALL_BUCKETS = range(5)
PHASES = ((0, "FREE"), (1, "CLAIMED"), (2, "STARTED"), (7, "DONE"))  # of crdt.claim_register.Phase

REGISTER_FIELDS = (
    integer("section", 16, "its number"),
    integer("epoch", 8, "fencing token: release and takeover raise it"),
    choice("phase", 3, PHASES, "how far the section is"),
    integer("bid", 5, "cost of the section for the owner; the lowest bid wins"),
    integer("lamport", 24, "Lamport time of the operation that wrote the register"),
    integer("owner", 8, "slot"),
)


class TaskClaim(NamedTuple):
    """The register of one section as its owner wrote it.

    A robot sends it when it claims, starts, releases or finishes a section. Receivers join it to
    their own register; a claim is contested for 250 ms before work starts.
    """

    section: int
    epoch: int
    phase: int
    bid: int
    lamport: int
    owner: int


TASK_CLAIM = FrameLayout(
    TaskClaim, "TASK_CLAIM", pgn=0xFF08, priority=4, sender=ROBOT, fields=REGISTER_FIELDS
)


class StateSyncResponse(NamedTuple):
    """The register of one section, relayed to a robot that missed it.

    A robot sends it in answer to STATE_SYNC_REQUEST, or to correct an outdated claim. Receivers join
    it to their own register.
    """

    section: int
    epoch: int
    phase: int
    bid: int
    lamport: int
    owner: int


STATE_SYNC_RESPONSE = FrameLayout(
    StateSyncResponse, "STATE_SYNC_RESPONSE", pgn=0xFF0D, priority=7, sender=ROBOT,
    fields=REGISTER_FIELDS,
)  # fmt: skip


class StateSyncRequest(NamedTuple):
    """Asks for everything that is newer than the sender's replica.

    A robot sends it when another robot's digest differs from its own; a tool sends it with scope 2
    to ask for stops. Up to three robots that have what is missing answer, one after the other.
    """

    cut: int
    digest: int
    scope: int
    round: int


STATE_SYNC_REQUEST = FrameLayout(
    StateSyncRequest, "STATE_SYNC_REQUEST", pgn=0xFF0C, priority=6, sender=ANY_DEVICE,
    fields=(
        integer("cut", 24, "Lamport time of the stable cut; 0 for a fresh join"),
        integer("digest", 24, "of the sender's replica"),
        integer("scope", 8, "0: registers and progress after the cut; 2: stops; 3: what is in buckets "
                "that differ from the sender's DIGESTS, which follow, after the cut; 4: all of these; "
                "1: reserved"),
        integer("round", 8, "counts the sender's requests"),
    ),
)  # fmt: skip


class Digests(NamedTuple):
    """Digests of three buckets of the sender's replica.

    A robot sends all its buckets after a request that taught it nothing. Receivers answer only with
    what is in buckets that differ.
    """

    triple: int
    salt: int
    first: int
    second: int
    third: int


DIGESTS = FrameLayout(
    Digests, "DIGESTS", pgn=0xFF0E, priority=7, sender=ROBOT,
    fields=(
        integer("triple", 8, "number of the first bucket / 3"),
        integer("salt", 8, "mixed into the digests, so that one collision does not repeat"),
        integer("first", 16, "digest of bucket 3 * triple"),
        integer("second", 16, "digest of bucket 3 * triple + 1"),
        integer("third", 16, "digest of bucket 3 * triple + 2"),
    ),
)  # fmt: skip


class WorkProgress(NamedTuple):
    """Covered units of a section: a set that only grows.

    A robot that works sends it every 2 s, and in answer to STATE_SYNC_REQUEST. Receivers join it to
    their own progress by OR.
    """

    section: int
    block: int
    bits: int


WORK_PROGRESS = FrameLayout(
    WorkProgress, "WORK_PROGRESS", pgn=0xFF13, priority=6, sender=ROBOT,
    fields=(
        integer("section", 16, "its number"),
        integer("block", 8, "units 40 * block to 40 * block + 39"),
        integer("bits", 40, "bit i: unit 40 * block + i is covered"),
    ),
)  # fmt: skip
