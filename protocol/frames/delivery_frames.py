"""Frames of a delivery fleet: transport tasks, their planned carriers, bids, and joint plans."""

from typing import NamedTuple

from protocol.frames.layout import ROBOT, TOOL, FrameLayout, integer

BUCKET_BITS = 8
CHECK_BITS = 5
ORDER_SALTS = 8  # of a TASK_BOOK frame, used in turn
BUCKET_TASKS = 48  # of a TASK_BOOK frame
TASK_NUMBERS = BUCKET_TASKS << BUCKET_BITS  # a task from here on has no bucket
HASTENS = 1  # of a PLAN_OFFER frame
NO_TASK = 0xFFFF  # fills an itinerary's last frame


class TaskOrder(NamedTuple):
    """Orders the transport of a parcel from one place to another.

    An operator tool sends it once for each task. Robots store it, and repeat it when a TASK_BOOK
    shows that another robot does not know it.
    """

    task: int
    pickup: int
    dropoff: int
    check: int = 0


TASK_ORDER = FrameLayout(
    TaskOrder, "TASK_ORDER", pgn=0xFF20, priority=6, sender=TOOL,
    fields=(
        integer("task", 16, "its number, which is its section"),
        integer("pickup", 16, "cell of the floor, row by row from the south-west"),
        integer("dropoff", 16, "cell of the floor"),
        integer("check", 16, "0; reserved for kinds of tasks"),
    ),
)  # fmt: skip


class TaskBookDigest(NamedTuple):
    """Which of 48 tasks the sender knows.

    Every robot of a delivery fleet sends one bucket a second. A receiver that knows a task more
    repeats its order. A tool that lists tasks sends it to be told their orders.
    """

    bucket: int
    salt: int
    check: int
    bits: int


TASK_BOOK = FrameLayout(
    TaskBookDigest, "TASK_BOOK", pgn=0xFF21, priority=7, sender=ROBOT,
    fields=(
        integer("bucket", BUCKET_BITS, "tasks 48 * bucket to 48 * bucket + 47"),
        integer("salt", 3, "mixed into the check: orders that collide with one salt differ with another"),
        integer("check", CHECK_BITS, "digest of the orders that it knows of them"),
        integer("bits", BUCKET_TASKS, "bit i: task 48 * bucket + i is known"),
    ),
)  # fmt: skip


class TaskBid(NamedTuple):
    """What it would cost the sender to add a task to its itinerary.

    A robot sends it for an open task, unless it has received a lower bid. The lowest bid of 0.3 s
    wins the task.
    """

    task: int
    cost_ms: int
    place: int
    round: int


TASK_BID = FrameLayout(
    TaskBid, "TASK_BID", pgn=0xFF22, priority=5, sender=ROBOT,
    fields=(
        integer("task", 16, "its number"),
        integer("cost_ms", 32, "how much longer its tasks wait in sum", unit="ms"),
        integer("place", 8, "position that the task would have in its itinerary"),
        integer("round", 8, "counts the auctions of this task"),
    ),
)  # fmt: skip


class Itinerary(NamedTuple):
    """Two tasks of those that the sender will begin, in its order.

    A robot sends its whole itinerary when it changes, and again every 5 s. A task in no itinerary is
    open.
    """

    version: int
    first: int
    length: int
    battery: int
    task: int
    after: int


ITINERARY = FrameLayout(
    Itinerary, "ITINERARY", pgn=0xFF23, priority=7, sender=ROBOT,
    fields=(
        integer("version", 8, "counts the itineraries of this sender"),
        integer("first", 8, "position of the first of the two"),
        integer("length", 8, "of the whole itinerary"),
        integer("battery", 8, "remaining charge, of 255"),
        integer("task", 16, "its number"),
        integer("after", 16, "the next task; 0xFFFF: none", special=((0xFFFF, "NONE"),)),
    ),
)  # fmt: skip


class PlanOffer(NamedTuple):
    """Calls a round of planning, or offers the plan that the sender found in it.

    The robot that calls says how long the search takes. When that time is over, robots that found a
    plan cheaper than those offered so far send its cost.
    """

    round: int
    replan: int
    cost_ms: int
    digest: int

    @property
    def hastens(self) -> bool:
        """Whether it calls a round in which planned tasks are to wait less."""
        return self.replan > 0 and self.cost_ms == HASTENS


PLAN_OFFER = FrameLayout(
    PlanOffer, "PLAN_OFFER", pgn=0xFF24, priority=5, sender=ROBOT,
    fields=(
        integer("round", 8, "counts the rounds of the fleet"),
        integer("replan", 8, "of a call: duration of the search in 0.25 s; 0: this is an offer"),
        integer("cost_ms", 32, "last finish of the offered plan, or, if tasks are to wait less, their "
                "waiting times in sum; of a call: 1 if tasks are to wait less, else 0", unit="ms"),
        integer("digest", 16, "of the plan"),
    ),
)  # fmt: skip


class PlanRow(NamedTuple):
    """Two tasks of one robot's itinerary in the plan of the round.

    The robot with the cheapest offer streams its plan twice. Receivers adopt it if its digest is
    that of the offer.
    """

    round: int
    slot: int
    first: int
    length: int
    task: int
    after: int


PLAN_ROW = FrameLayout(
    PlanRow, "PLAN_ROW", pgn=0xFF25, priority=6, sender=ROBOT,
    fields=(
        integer("round", 8, "rows of an older round are ignored"),
        integer("slot", 8, "whose itinerary"),
        integer("first", 8, "position of the first of the two"),
        integer("length", 8, "of the whole itinerary"),
        integer("task", 16, "its number"),
        integer("after", 16, "the next task; 0xFFFF: none", special=((0xFFFF, "NONE"),)),
    ),
)  # fmt: skip
