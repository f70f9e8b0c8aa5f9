"""Frames of a delivery fleet: transport tasks, their planned carriers, bids, and joint plans."""

from struct import Struct
from typing import NamedTuple

ORDER = Struct("<HHHH")
BOOK = Struct("<BBIH")
BID = Struct("<HIBB")
ITINERARY = Struct("<BBBBHH")
OFFER = Struct("<BBIH")
ROW = Struct("<BBBBHH")
assert all(layout.size == 8 for layout in (ORDER, BOOK, BID, ITINERARY, OFFER, ROW))

BUCKET_TASKS = 48  # of a TASK_BOOK frame
HASTENS = 1  # of a PLAN_OFFER frame
NO_TASK = 0xFFFF  # fills an itinerary's last frame


class TaskOrder(NamedTuple):
    """Carry a parcel from one place to another: from an operator, or repeated by who knows. Priority 6.

    byte  field    type  meaning
    0..1  task     u16   its number, which is its section
    2..3  pickup   u16   cell of the floor, row by row from the south-west
    4..5  dropoff  u16   likewise
    6..7  check    u16   0; reserved for kinds of tasks
    """

    task: int
    pickup: int
    dropoff: int
    check: int = 0

    def pack(self) -> bytes:
        return ORDER.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "TaskOrder":
        return cls._make(ORDER.unpack(data))


class TaskBookDigest(NamedTuple):
    """Which of 48 tasks the sender knows; who knows another one repeats its order. Priority 7.

    byte  field   type  meaning
    0     bucket  u8    tasks 48*bucket .. 48*bucket+47
    1     check   u8    of what it knows of them
    2..7  bits    u48   bit i: task 48*bucket+i is known
    """

    bucket: int
    check: int
    bits: int

    def pack(self) -> bytes:
        return BOOK.pack(self.bucket, self.check, self.bits & 0xFFFFFFFF, self.bits >> 32)

    @classmethod
    def unpack(cls, data: bytes) -> "TaskBookDigest":
        bucket, check, low, high = BOOK.unpack(data)
        return cls(bucket, check, low | high << 32)


class TaskBid(NamedTuple):
    """What it would cost the sender to add a task to its itinerary; the least bid has it. Priority 5.

    byte  field  type  meaning
    0..1  task   u16
    2..5  cost   u32   how much longer its tasks wait in sum, ms
    6     place  u8    where in its itinerary it would come
    7     round  u8    counts the auctions of this task
    """

    task: int
    cost_ms: int
    place: int
    round: int

    def pack(self) -> bytes:
        return BID.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "TaskBid":
        return cls._make(BID.unpack(data))


class Itinerary(NamedTuple):
    """Two tasks of those that the sender means to begin, in its order. Priority 7.

    byte  field    type  meaning
    0     version  u8    counts the itineraries of this sender
    1     first    u8    position of the first of the two
    2     length   u8    of the whole
    3     battery  u8    what is left, of 255
    4..5  task     u16
    6..7  after    u16   0xffff where there is none
    """

    version: int
    first: int
    length: int
    battery: int
    task: int
    after: int

    def pack(self) -> bytes:
        return ITINERARY.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "Itinerary":
        return cls._make(ITINERARY.unpack(data))


class PlanOffer(NamedTuple):
    """A round of planning: its begin with how long it takes, then what each found. Priority 5.

    byte  field   type  meaning
    0     round   u8    counts the rounds of the fleet
    1     replan  u8    begin: how long the search takes, 0.25 s; 0: this is an offer
    2..5  cost    u32   last finish of the offered plan, ms; less is better. Where tasks are only to wait
                        less: their waiting in sum. Of a begin: 1 where that is what is wanted
    6..7  digest  u16   of the plan
    """

    round: int
    replan: int
    cost_ms: int
    digest: int

    @property
    def hastens(self) -> bool:
        """It calls a round in which planned tasks are to wait less."""
        return self.replan > 0 and self.cost_ms == HASTENS

    def pack(self) -> bytes:
        return OFFER.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "PlanOffer":
        return cls._make(OFFER.unpack(data))


class PlanRow(NamedTuple):
    """Two tasks of a robot's itinerary in the plan that the sender streams. Priority 6.

    byte  field   type  meaning
    0     round   u8    what is of an older round is not believed
    1     slot    u8    whose itinerary
    2     first   u8    position of the first of the two
    3     length  u8    of the whole itinerary
    4..5  task    u16
    6..7  after   u16   0xffff where there is none
    """

    round: int
    slot: int
    first: int
    length: int
    task: int
    after: int

    def pack(self) -> bytes:
        return ROW.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "PlanRow":
        return cls._make(ROW.unpack(data))
