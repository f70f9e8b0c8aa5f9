"""Scenarios A and C: all robots search in parallel, each with its own seed; the cheapest plan wins.

A round has four phases (`NEGOTIATION_TABLE`). One robot calls it and announces its duration. All
robots freeze the problem and start from the same auction, or from the current plan if only waiting
time is to be reduced. When the time is up, each robot offers the cost of its plan, unless it has
received a better offer. The cheapest is elected, lower slots first among equals. The term of that
election is the number of the round, so frames of an older round are ignored. The elected robot
streams its plan row by row. If it falls silent, the others elect the second best. A plan is adopted
if its digest matches the offer.

Robots' snapshots may differ slightly; the adopted plan defines the problem.
"""

from collections.abc import Iterator, Mapping
from enum import Enum
from math import ceil
from typing import NamedTuple
from zlib import crc32

from agent.delivery.routing_problem import Itineraries, Workload
from agent.delivery.tour_auction import RoutingPlanner
from agent.interface.config import MS
from protocol.frames.delivery_frames import HASTENS, NO_TASK, PlanOffer, PlanRow
from protocol.state_machine import StateMachine, matrix

SLICE_US = 50 * MS  # a control period
# Moves of the search in each slice: 10 ms of a small computer's 50. With charging bays fewer moves take
# the same time. Their number is for routes of `ROUTE_TASKS` tasks and falls with longer routes.
SLICE_MOVES = 15_000
SLICE_MOVES_CHARGING = 3_000
ROUTE_TASKS = 5
SLICE_MOVES_HASTE = 2_000  # for less waiting; more moves found no better plans
WORTH = 0.99  # a plan with less than this share of the waiting before is worth its frames
REPLAN_UNIT_US = 250 * MS
OFFERS_US = 500 * MS  # offers are collected this long; the bus needs a tenth of it for all of them
HUSH_US = 700 * MS  # without a row of the stream for this long, the next best robot takes over
ROWS_A_BEAT = 6  # rows of a plan sent with one beat
PASSES = 2  # number of times a plan is streamed
CALLS = 3  # number of times a call is sent
HOT, COLD = 0.02, 0.0002  # first and last temperature of the whole search, over all slices

Rows = dict[int, list[int]]  # slot -> its tasks, by number


class ProblemSnapshot(NamedTuple):
    """What one robot froze when a round began: robots and tasks, by slot and number, with their
    costs.
    """

    slots: tuple[int, ...]
    tasks: tuple[int, ...]
    work: Workload
    plan: Itineraries | None = None  # to improve for less waiting; None: start from the auction


class NegotiationPhase(Enum):
    """The phases of a round; docs/how/states.md shows them."""

    REST = "no round"
    SEARCH = "every robot searches for a plan, from the auction on"
    OFFER = "robots offer the costs of their plans"
    STREAM = "the robot with the cheapest plan streams it"


class NegotiationEvent(Enum):
    """What moves a round from one phase to another."""

    BEGUN = "a round with a later number was called, by us or by another robot"
    SEARCHED = "the time for the search is up"
    ELECTED = "the time for offers is up, so the cheapest is elected"
    SILENT = "no row of the elected robot was received for a while, so its offer is dropped"
    NO_OFFER = "no robot has a plan to offer"
    ADOPTED = "a whole plan with the offered digest was received, or our own was streamed"


REST, SEARCH, OFFER, STREAM = NegotiationPhase
stay = None

# fmt: off
NEGOTIATION_TABLE = matrix(
    NegotiationEvent,
    # phase   BEGUN   SEARCHED  ELECTED  SILENT  NO_OFFER  ADOPTED
    (REST,    SEARCH, stay,     stay,    stay,   stay,     stay),
    (SEARCH,  stay,   OFFER,    stay,    stay,   stay,     REST),  # if others were called earlier
    (OFFER,   SEARCH, stay,     STREAM,  stay,   stay,     REST),
    (STREAM,  SEARCH, stay,     stay,    OFFER,  REST,     REST),
)
# fmt: on


class PlanNegotiation:
    """One robot's part in rounds: it searches, offers its plan, and adopts the cheapest."""

    def __init__(self, slot: int, seed: int) -> None:
        """`slot`: ours. `seed`: of our own search, another one for each robot."""
        self.slot, self.seed = slot, seed
        self.number = 0
        # No round since our boot: where on the circle of numbers the fleet is, is not known yet.
        self._fresh = True
        self.machine = StateMachine("plan negotiation", NEGOTIATION_TABLE, REST)
        self.ends_at_us = 0  # of the phase
        self.adopted: Rows | None = None  # the adopted plan, until the caller takes it
        self.first: Rows = {}  # the auction's plan, the same for all
        self.streamed = 0  # number of rounds in which we streamed the plan
        self._frozen: ProblemSnapshot | None = None
        self._planner: RoutingPlanner | None = None
        self._plan: Itineraries = []
        self._hastens = False
        self._slices = self._done = self._calls = 0
        self._offers: dict[int, tuple[int, int]] = {}  # slot -> cost, digest
        self._told: dict[int, dict[int, dict[int, int]]] = {}  # source -> slot -> index -> task
        self._lengths: dict[int, dict[int, int]] = {}  # source -> slot -> number of tasks
        self._heard_at_us = 0  # when the last row was received
        self._queue: list[PlanRow] = []
        self._mine: Rows = {}
        self._mute: set[int] = set()  # elected robots that were not received

    @property
    def phase(self) -> NegotiationPhase:
        """The phase of the current round."""
        return self.machine.state

    @property
    def active(self) -> bool:
        """Whether a round is running."""
        return self.phase is not REST

    def left_for_us(self, now_us: int) -> int:
        """How long it takes until new itineraries can be expected; 0 without a full round."""
        if self.phase is REST or self._hastens:
            return 0
        return max(self.ends_at_us - now_us, 0) + (OFFERS_US if self.phase is SEARCH else 0)

    # ---------------------------------------------------------------- the steps

    def call(self, frozen: ProblemSnapshot, search_for_us: int, now_us: int) -> None:
        """Begin the next round: `frozen` is its problem, and the search takes `search_for_us`."""
        units = min(ceil(search_for_us / REPLAN_UNIT_US), 255)
        self._calls = CALLS
        self._begin((self.number + 1) & 0xFF, max(units, 1), frozen, now_us)

    def wanted(self, offer: PlanOffer) -> bool:
        """Whether this is the call of a later round, which we have to join."""
        return offer.replan > 0 and (self._fresh or _newer(offer.round, self.number))

    def join(self, offer: PlanOffer, frozen: ProblemSnapshot, now_us: int) -> None:
        """Join the round that `offer` calls, with our own snapshot of the problem."""
        self._calls = 1 if self.slot % 4 == 0 else 0  # an echo for robots that missed the call
        self._begin(offer.round, offer.replan, frozen, now_us)

    def _begin(self, number: int, units: int, frozen: ProblemSnapshot, now_us: int) -> None:
        self.number, self._fresh = number, False
        self.machine.fire(NegotiationEvent.BEGUN)
        self.ends_at_us = now_us + units * REPLAN_UNIT_US
        self._frozen, self._planner = frozen, RoutingPlanner(frozen.work)
        self._hastens = frozen.plan is not None
        self._plan = self._planner.auctioned() if frozen.plan is None else frozen.plan
        self.first = self._rows()
        self._slices, self._done = units * REPLAN_UNIT_US // SLICE_US, 0
        self._offers, self._told, self._lengths = {}, {}, {}
        self._queue, self._mine, self._mute = [], {}, set()

    def _rows(self) -> Rows:
        assert self._frozen is not None
        tasks = self._frozen.tasks
        return {
            slot: [tasks[t] for t in row]
            for slot, row in zip(self._frozen.slots, self._plan, strict=True)
        }

    def on_tick(self, now_us: int) -> None:
        """Each control period: search, elect, or stream, as the phase says."""
        if self.phase is SEARCH:
            self._search(now_us)
        elif self.phase is OFFER and now_us >= self.ends_at_us:
            self.machine.fire(NegotiationEvent.ELECTED)
            self._heard_at_us = now_us
            self._pass()
        elif self.phase is STREAM:
            self._stream(now_us)

    def _search(self, now_us: int) -> None:
        assert self._planner is not None
        if now_us < self.ends_at_us:
            if self._done < self._slices:
                self._plan = self._slice(self._planner)
                self._done += 1
            return
        self.machine.fire(NegotiationEvent.SEARCHED)
        self.ends_at_us = now_us + OFFERS_US
        self._mine = self._rows()
        cost_ms = self._cost_ms(self._planner)
        if cost_ms is not None:
            self._offers[self.slot] = (min(cost_ms, 0xFFFFFFFF), digest_of(self._mine))

    def _slice(self, planner: RoutingPlanner) -> Itineraries:
        seed = self.seed + self._done
        if self._hastens:
            return planner.hastened(self._plan, seed, SLICE_MOVES_HASTE)
        hot = HOT * (COLD / HOT) ** (self._done / self._slices)
        cold = HOT * (COLD / HOT) ** ((self._done + 1) / self._slices)
        moves = SLICE_MOVES
        if planner.work.power is not None:
            routes = max(planner.work.robots, 1) * ROUTE_TASKS
            moves = SLICE_MOVES_CHARGING * routes // max(planner.work.tasks, routes)
        return planner.improved(self._plan, seed, moves, (hot, cold))

    def _cost_ms(self, planner: RoutingPlanner) -> int | None:
        """The cost of our plan; None if it is not feasible or not worth its frames."""
        if self._hastens:
            assert self._frozen is not None and self._frozen.plan is not None
            before_ms = planner.waiting_ms(self._frozen.plan)
            cost_ms = planner.waiting_ms(self._plan)
            return cost_ms if worth_streaming(before_ms, cost_ms) else None
        worth = planner.worth(self._plan)
        return worth.makespan_ms if worth.feasible else None

    def _rank(self) -> list[int]:
        return sorted(self._offers, key=lambda slot: (self._offers[slot], slot))

    def _pass(self) -> None:
        """If we are elected, begin to stream; otherwise wait for the elected robot."""
        rank = self._rank()
        if rank and rank[0] == self.slot and not self._queue:
            self._queue = list(_said(self.number, self._mine)) * PASSES

    def _stream(self, now_us: int) -> None:
        rank = self._rank()
        if not rank:
            self.machine.fire(NegotiationEvent.NO_OFFER)
        elif self._queue:
            self._heard_at_us = now_us
        elif rank[0] == self.slot:  # all rows were sent
            self._adopt(self._mine)
            self.streamed += 1
        elif now_us - self._heard_at_us > HUSH_US:
            self._mute.add(rank[0])  # it is dead or not received, so the next best is elected
            del self._offers[rank[0]]
            self.machine.fire(NegotiationEvent.SILENT)
            self.ends_at_us = now_us + OFFERS_US

    def _adopt(self, rows: Rows) -> None:
        self.machine.fire(NegotiationEvent.ADOPTED)
        self.adopted = rows
        self._queue = []

    # ---------------------------------------------------------------- frames

    def on_message(self, slot: int, message: PlanOffer | PlanRow, now_us: int) -> None:
        """Take in an offer or a row of a plan from member `slot`."""
        if message.round != self.number or self.phase is REST:
            return
        if isinstance(message, PlanOffer):
            if not message.replan and slot not in self._mute:
                self._offers[slot] = (message.cost_ms, message.digest)
            return
        self._heard_at_us = now_us
        rows = self._told.setdefault(slot, {}).setdefault(message.slot, {})
        self._lengths.setdefault(slot, {})[message.slot] = message.length
        rows[message.first] = message.task
        if message.after != NO_TASK:
            rows[message.first + 1] = message.after
        if slot in self._offers:
            self._complete(slot)

    def _complete(self, source: int) -> None:
        """Adopt what a source has streamed if it is complete and matches its offer."""
        plan: Rows = {}
        for slot, length in self._lengths[source].items():
            row = self._told[source][slot]
            if any(k not in row for k in range(length)):
                return
            plan[slot] = [row[k] for k in range(length)]
        if digest_of(plan) == self._offers[source][1]:
            self._adopt(plan)

    def outgoing(self, now_us: int) -> Iterator[PlanOffer | PlanRow]:
        """The frames that are due with our beat: calls, our offer, or rows of our plan."""
        if self.phase is SEARCH and self._calls:
            self._calls -= 1
            left_for_us = max(self.ends_at_us - now_us, 1)
            yield PlanOffer(
                self.number, ceil(left_for_us / REPLAN_UNIT_US), HASTENS if self._hastens else 0, 0
            )
        elif self.phase is OFFER and self._rank()[:1] == [self.slot]:
            yield PlanOffer(self.number, 0, *self._offers[self.slot])
        elif self.phase is STREAM:
            yield from self._queue[:ROWS_A_BEAT]
            del self._queue[:ROWS_A_BEAT]


def worth_streaming(before_ms: int, after_ms: int) -> bool:
    """Whether a plan lets tasks wait so much less in sum that it is worth its frames."""
    return after_ms < before_ms * WORTH


def _newer(a: int, b: int) -> bool:
    """Whether `a` is later than `b`; numbers of rounds count modulo 256."""
    return 0 < (a - b & 0xFF) < 128


def _said(number: int, rows: Rows) -> Iterator[PlanRow]:
    for slot, row in sorted(rows.items()):
        padded = [*row, NO_TASK, NO_TASK]
        for first in range(0, max(len(row), 1), 2):
            yield PlanRow(number, slot, first, len(row), padded[first], padded[first + 1])


def digest_of(rows: Mapping[int, list[int]]) -> int:
    """A 16-bit digest of a plan."""
    return crc32(repr(sorted(rows.items())).encode()) & 0xFFFF
