"""Task allocation among peers: announced itineraries, task auctions, and joint plans.

Each robot announces only its own itinerary: the tasks that it will begin, in order. A task in no
itinerary is open. Up to `t_max` open tasks are auctioned one after the other: each robot bids its
cost for the task, unless it has received a lower bid (scenario B). More open tasks are replanned by
all robots (scenarios A and C, `agent/delivery/plan_negotiation.py`). All of this is only a hint:
before a task is begun its register is claimed, so late, repeated or lost frames only cost some
duplicate work.

Tasks of a silent robot keep their owner for a lease. Then they are auctioned, the last of its order
first, and are placed behind the winner's own tasks, also in a network split.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import sqrt
from typing import NamedTuple

from agent.delivery.absent_owners import AbsentOwners
from agent.delivery.cost_matrix import FULL
from agent.delivery.itinerary_broadcast import STOPS_MAX, ItineraryBroadcast, RemoteItinerary
from agent.delivery.plan_negotiation import SLICE_US, PlanNegotiation, ProblemSnapshot
from agent.delivery.routing_problem import IMPOSSIBLE_MS
from agent.delivery.task_registry import TASKS_MAX, TaskRegistry, TransportTask
from agent.delivery.tour_auction import RoutingPlanner
from agent.delivery.waiting_policy import REPLAN_US as HASTE_US
from agent.delivery.waiting_policy import WaitingPolicy
from agent.delivery.warehouse import CarrierState, Warehouse
from agent.interface.config import MS, S
from agent.interface.lifecycle import ABLE
from agent.interface.mission import FleetView, Record
from crdt import Phase
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)

# Tasks and robots of one round. The time of the auction grows with the fourth power of the tasks and
# the square of the robots. These numbers, with batteries, take 25 ms on a small computer: half of a
# control period.
ROUND_TASKS, ROUND_ROBOTS = 72, 6
LOOK_US = 250 * MS  # period of the search for open tasks
BIDS_US = 300 * MS  # bids for a task are collected this long: six beats of a small fleet
AWARDED_US = 2 * S  # the winner has announced its itinerary by then
STABLE_US = 500 * MS  # more than t_max open tasks for this long start a round
STAGGER_US = 150 * MS  # the robot of each higher slot calls a round this much later
BOOT_US = 3 * S  # wait this long for the whole fleet before the first plan
# A robot that cannot work for longer gives up its tasks. Protective stops are shorter.
RESIGN_US = 2 * S
NOBODY_US = 5 * S  # a task without a bid is auctioned again after this
AGAIN_US = 5 * S  # between two rounds
MOVES_A_TASK = 2_000  # moves of the search for each task of a round
REPLAN_US = (2 * S, 10 * S)  # shortest and longest duration of the search
Dispatched = TaskOrder | TaskBookDigest | TaskBid | Itinerary | PlanOffer | PlanRow


class Auction(NamedTuple):
    """The auction of one task as we know it: when it closes, the best bid, and our own bid."""

    task: int
    closes_at_us: int
    best: tuple[int, int] | None  # cost, slot
    mine: TaskBid | None  # ours, until it is sent


class TaskAllocation:
    """One robot's part in distributing tasks: itinerary, bids, and joint plans."""

    def __init__(
        self,
        slot: int,
        house: Warehouse,
        now_us: int,
        seed: int,
        recalled: Mapping[int, TransportTask],
    ) -> None:
        """`seed`: of our own search for plans. `recalled`: tasks received before a restart, by
        number.
        """
        self.slot, self.house = slot, house
        self.book = TaskRegistry(slot, house.tasks, now_us, house.known, recalled)
        self.round = PlanNegotiation(slot, seed)
        self.itinerary: list[int] = []  # tasks that we intend to begin, not those begun
        self.telling = ItineraryBroadcast(now_us)
        self.absence = AbsentOwners(house.carrier.handle_ms * MS)
        self.haste = WaitingPolicy(now_us)
        self.left = FULL
        self._auction: Auction | None = None
        # The best bid (task, (cost, slot)) of another robot for a task that we do not auction yet.
        self._rival: tuple[int, tuple[int, int]] | None = None
        self._awarded: dict[int, int] = {}  # task: until when its winner is waited for
        self._born_at_us, self._look_at_us, self._many_at_us, self._round_at_us = (
            now_us,
            now_us,
            0,
            0,
        )
        self._done: set[int] = set()
        self.cut: frozenset[int] = frozenset()  # tasks that we cannot reach
        self._able_at_us = now_us  # when we last could work
        # For each task the slots that have begun it, as far as we know, oldest first.
        self.workers: dict[int, list[int]] = {}
        self._calls: list[PlanOffer] = []  # received calls, answered in the next control period

    @property
    def remote_itineraries(self) -> dict[int, RemoteItinerary]:
        """The itineraries of other robots, by slot."""
        return self.telling.told

    @property
    def deciding(self) -> int | None:
        """The task that is auctioned now, as far as we know; None if there is none."""
        return None if self._auction is None else self._auction.task

    # ---------------------------------------------------------------- what there is to do

    def on_tick(self, view: FleetView, able: bool) -> None:
        """Once each control period. `able`: this robot can work; after `RESIGN_US` without, its
        tasks are given up.
        """
        now_us = view.now_us
        if able:
            self._able_at_us = now_us
        elif self.itinerary and now_us - self._able_at_us > RESIGN_US:
            self.itinerary = []
            self.telling.changed(now_us)
        self.round.on_tick(now_us)
        for offer in self._calls:
            if self.round.wanted(offer):
                self._begin_round(view, able, offer)
        self._calls.clear()
        if self.round.adopted is not None:
            self._adopt(view)
        self._close(view, able)
        if now_us >= self._look_at_us:
            self._look_at_us = now_us + LOOK_US
            self._look(view, able)
        if self.telling.due(now_us):
            self._plan_stops(view)

    def _look(self, view: FleetView, able: bool) -> None:
        self.absence.observe(view)
        self._tidy(view)
        if not self.round.active:
            fresh, orphans = self.open(view)
            self._consider(fresh, orphans, view, able)
        self._rival = None

    def _consider(self, fresh: list[int], orphans: list[int], view: FleetView, able: bool) -> None:
        now_us = view.now_us
        if len(fresh) <= self.house.t_max:
            self._many_at_us = now_us
        whole = len(view.live) >= len(view.live | view.fell_silent_at_us.keys()) > 1
        if now_us - self._born_at_us < BOOT_US and not (whole and now_us - self._born_at_us > S):
            return  # not all robots are here yet
        due_at_us = max(self._many_at_us + STABLE_US, self._round_at_us) + STAGGER_US * self._order(
            view
        )
        planned = sum(len(self.means(slot)) for slot in view.live)
        room = round_tasks_max(len(view.live)) - planned
        if len(fresh) > self.house.t_max and room < min(len(fresh), planned):
            fresh = []  # a backlog: wait until planned tasks have begun
        if len(fresh) > self.house.t_max and now_us >= self._round_at_us:
            if now_us >= due_at_us:
                self._round_at_us = now_us + AGAIN_US
                tasks = min(len(fresh), room)
                search_for_us = min(
                    max(tasks * MOVES_A_TASK // 15_000 * SLICE_US, REPLAN_US[0]), REPLAN_US[1]
                )
                self._begin_round(view, able, search_for_us=search_for_us)
        elif self._auction is None and (fresh or orphans):
            self._open_auction([*fresh, *orphans], len(fresh), view, able)
        elif self._auction is None:
            means = {task for slot in view.live for task in self.means(slot)}
            waiting = sum(view.allocation.phase_of(task) is Phase.FREE for task in means)
            turn_for_us = STAGGER_US * self._order(view)
            if self.haste.due(now_us - turn_for_us, self.book.added, waiting, len(view.live)):
                self._begin_round(view, able, search_for_us=HASTE_US, haste=True)

    def _plan_stops(self, view: FleetView) -> None:
        """Our announced stops, including the bay that we are at or will have to visit."""
        held = view.allocation.assigned_sections(self.slot)
        at_bay = [
            TASKS_MAX + self.house.bay_of(s) for s in held if s >= TASKS_MAX and self.house.bays
        ]
        known = [t for t in self.itinerary if self.house.known(self.book.tasks[t])]
        ahead = self.house.charged_between(self.standing(view), known, self.book.tasks)
        self.telling.stops = (at_bay + ahead)[:STOPS_MAX]

    def _order(self, view: FleetView) -> int:
        return sum(slot < self.slot for slot in view.live)

    def open(self, view: FleetView) -> tuple[list[int], list[int]]:
        """Tasks in no itinerary, ascending, and tasks whose owners are gone, the last of an
        itinerary first.
        """
        allocation, now_us = view.allocation, view.now_us
        holder: dict[int, int] = {}
        for slot, told in self.remote_itineraries.items():
            for task in told.whole:
                holder.setdefault(task, slot)
        own = set(self.itinerary)
        fresh: list[int] = []
        orphans: list[tuple[int, int]] = []
        for task in self.book.tasks:
            if task in self._done or task in own or task in self.cut:
                continue
            if self._awarded.get(task, 0) > now_us:
                continue
            phase = allocation.phase_of(task)
            if phase is Phase.DONE:
                self._done.add(task)
                continue
            if self.taken_back(task, view):
                continue
            owner = self._holder(task, phase, holder, view)
            if owner == self.slot and phase is Phase.FREE:
                self.itinerary.insert(0, task)  # we had begun it: find out where its parcel is
            if owner is None:
                fresh.append(task)
            elif owner != self.slot and self._left_by(owner, task, phase, view):
                order = (
                    self.remote_itineraries[owner].whole if owner in self.remote_itineraries else ()
                )
                orphans.append((order.index(task) if task in order else -1, task))
        return sorted(fresh), [task for _, task in sorted(orphans, reverse=True)]

    def _left_by(self, owner: int, task: int, phase: Phase, view: FleetView) -> bool:
        """Whether others may take a task from a slot: it is gone, or has given the task back for good."""
        if self.absence.leaves(owner, task, view):
            return True
        given_back = phase is Phase.FREE and bool(view.progress.bits(task, 0))
        return given_back and self.absence.drops(owner, task, task in self.means(owner), view)

    def taken_back(self, task: int, view: FleetView) -> bool:
        """Whether a task was taken back before its parcel was picked up, as far as we know."""
        order = self.book.tasks.get(task)
        return order is not None and order.withdrawn and not view.progress.bits(task, 0) & 1

    def _holder(
        self, task: int, phase: Phase, holder: dict[int, int], view: FleetView
    ) -> int | None:
        """The slot that holds or plans a task: by its register, its last carrier, or an announced
        itinerary.
        """
        if phase is not Phase.FREE:
            owner = view.allocation.owner_of(task)
            if phase is Phase.STARTED and owner is not None:
                self._began(task, owner)
            return owner
        if view.progress.bits(task, 0):  # picked up, and given back: its carrier has it aboard
            return self.workers.get(task, [view.allocation.entry(task).owner])[-1]
        return holder.get(task)

    def _began(self, task: int, owner: int) -> None:
        self.absence.began(task)
        workers = self.workers.setdefault(task, [])
        if not workers or workers[-1] != owner:
            workers.append(owner)

    def _tidy(self, view: FleetView) -> None:
        """Remove from our itinerary tasks that are not free, or that a lower slot announced."""
        lower = {
            task
            for slot, told in self.remote_itineraries.items()
            if slot < self.slot and slot in view.live
            for task in told.whole
        }
        kept = []
        for task in self.itinerary:
            owner = view.allocation.owner_of(task)
            held = owner in view.live and not self.absence.leaves(owner, task, view)
            gone = owner is not None and (owner == self.slot or held)
            done = view.allocation.phase_of(task) is Phase.DONE or self.taken_back(task, view)
            if done or gone or task in lower or task in self.cut:
                continue
            kept.append(task)
        self.itinerary = kept
        known = view.live | view.fell_silent_at_us.keys()
        for slot in [s for s in self.remote_itineraries if s not in known]:
            del self.remote_itineraries[slot]  # it left with a farewell

    # ---------------------------------------------------------------- scenario B

    def _open_auction(self, tasks: list[int], fresh: int, view: FleetView, able: bool) -> None:
        """Auction the first task, or one that another robot has bid for.

        `fresh`: number of new tasks at the front of `tasks`; tasks of absent owners follow.
        """
        rival = self._rival
        if rival is not None and rival[0] not in tasks:
            rival = None
        task = tasks[0] if rival is None else rival[0]
        bid = self._bid(task, tasks.index(task) >= fresh, view) if able else None
        best = None if bid is None else (bid.cost_ms, self.slot)
        if rival is not None and (best is None or rival[1] < best):
            best, bid = rival[1], None
        self._auction = Auction(task, view.now_us + BIDS_US, best, bid)

    def standing(self, view: FleetView) -> CarrierState:
        """When, where and with what charge we are free for the next task."""
        here = CarrierState(self.slot, (view.here.x_m, view.here.y_m), 0, self.left)
        return self.through(here, view)

    def _bid(self, task: int, behind: bool, view: FleetView) -> TaskBid | None:
        """Our bid for a task; None if we cannot do it. `behind`: only as the last task."""
        if not self.house.known(self.book.tasks[task]) or task in self.cut:
            return None
        order = [*self.itinerary, task]
        trips = [self.house.trip(self.book.tasks[t]) for t in order]
        planner = RoutingPlanner(self.house.work(trips, [self.standing(view)]))
        last = len(order) - 1
        first = last if behind else self.haste.held(self.itinerary, view.now_us)
        place, cost_ms = planner.inserted(0, range(last), last, first)
        if cost_ms >= IMPOSSIBLE_MS:
            return None
        return TaskBid(task, min(cost_ms, 0xFFFFFFFF), min(place, 0xFF), int(behind))

    def _heard_bid(self, slot: int, bid: TaskBid, now_us: int) -> None:
        if bid.task not in self.book.tasks:
            return
        told = (bid.cost_ms, slot)
        auction = self._auction
        if auction is None or auction.task != bid.task:
            rival = (bid.task, told) if self._rival is None else self._rival
            if auction or rival[0] != bid.task or self._awarded.get(bid.task, 0) > now_us:
                self._awarded[bid.task] = now_us + BIDS_US + AWARDED_US  # others auction it already
            else:  # our control period comes later than theirs: bid now
                self._rival, self._look_at_us = min(rival, (bid.task, told)), now_us
            return
        if auction.best is None or told < auction.best:
            self._auction = auction._replace(best=told, mine=None)

    def _close(self, view: FleetView, able: bool) -> None:
        auction, now_us = self._auction, view.now_us
        if auction is None or now_us < auction.closes_at_us:
            return
        self._auction = None
        if auction.best is None:
            self._awarded[auction.task] = now_us + NOBODY_US
            return
        self._awarded[auction.task] = now_us + AWARDED_US
        if auction.best[1] == self.slot and auction.task not in self.itinerary:
            behind = auction.mine is not None and bool(auction.mine.round)
            bid = self._bid(auction.task, behind, view) if able else None
            place = len(self.itinerary) if bid is None else bid.place
            self.itinerary.insert(place, auction.task)
            self.telling.changed(now_us)

    # ---------------------------------------------------------------- scenarios A and C

    def _begin_round(
        self, view: FleetView, able: bool, offer: PlanOffer | None = None, search_for_us: int = 0,
        haste: bool = False,
    ) -> None:  # fmt: skip
        """Join the round that `offer` calls; None: call one.

        `search_for_us`: duration of the search. `haste`: the round only re-orders tasks to cut waiting
        time.
        """
        haste = haste or (offer is not None and offer.hastens)
        frozen = (hastened if haste else new_problem)(self, view, able)
        self.haste.planned(view.now_us, self.book.added)
        if offer is None:
            self.round.call(frozen, search_for_us, view.now_us)
        else:
            self.round.join(offer, frozen, view.now_us)
        if not self.itinerary and able:
            # After the boot the auction's plan, equal at all robots, holds until there is a better one.
            self.itinerary = list(self.round.first.get(self.slot, []))

    def means(self, slot: int) -> Sequence[int]:
        """The tasks that a robot intends to begin, in its order, as far as we know."""
        if slot == self.slot:
            return self.itinerary
        whole = self.remote_itineraries[slot].whole if slot in self.remote_itineraries else ()
        return [stop for stop in whole if stop in self.book]

    def through(self, standing: CarrierState, view: FleetView) -> CarrierState:
        """The state of a robot after what it has claimed or begun: tasks to their dropoff, charges
        to the full.
        """
        for section in view.allocation.assigned_sections(standing.slot):
            order = self.book.tasks.get(section)
            if order is not None and self.house.known(order):
                loaded = bool(view.progress.bits(section, 0))
                standing = self.house.after(standing, self.house.trip(order), loaded)
            elif order is None and self.house.bays:
                standing = self._charged(standing, section)
        return standing

    def after_all(self, standing: CarrierState, tasks: Sequence[int]) -> CarrierState:
        """The state of a robot after these tasks, with the charges that they need."""
        orders = self.book.tasks
        known = [task for task in tasks if self.house.known(orders[task])]
        for stop in self.house.charged_between(standing, known, orders):
            if stop >= TASKS_MAX:
                standing = self._charged(standing, stop)
            else:
                standing = self.house.after(standing, self.house.trip(orders[stop]), False)
        return standing

    def _charged(self, standing: CarrierState, section: int) -> CarrierState:
        carrier, bay = self.house.carrier, self.house.bays[self.house.bay_of(section)]
        charge_ms = round((carrier.dock_s + carrier.charge_s) * 1000)
        return CarrierState(standing.slot, bay, standing.ready_ms + charge_ms, FULL)

    def _adopt(self, view: FleetView) -> None:
        rows, self.round.adopted = self.round.adopted, None
        assert rows is not None
        # A row may name an order that we have not received, or that never was.
        rows = {slot: [t for t in row if t in self.book] for slot, row in rows.items()}
        planned = {task for row in rows.values() for task in row}
        for slot, row in rows.items():
            means = self.means(slot)
            held = self.haste.held(means, view.now_us)
            first = [task for task in means[:held] if task not in planned]
            if slot == self.slot:
                kept = [task for task in means[held:] if task not in planned]
                self.itinerary = [*first, *row, *kept]
            else:
                old = self.remote_itineraries.get(slot)
                left, version = (FULL, 0) if old is None else (old.left, old.version)
                self.remote_itineraries[slot] = RemoteItinerary(
                    version, {}, 0, left, (*first, *row)
                )
        self._tidy(view)
        self.telling.changed(view.now_us)

    # ---------------------------------------------------------------- frames

    def on_message(self, slot: int | None, message: Dispatched, now_us: int) -> Sequence[Record]:
        """Take in a frame. `slot`: of its sender; None for a device that is not a member.

        The returned records must be durable before the next frame is sent.
        """
        if isinstance(message, TaskOrder | TaskBookDigest):
            added = self.book.added
            records = self.book.on_message(message, now_us)
            if self.book.added > added and isinstance(message, TaskOrder):
                self.haste.known(message.task, now_us)
                # so that all robots that received it bid at the same time
                self._look_at_us = now_us
            return records
        if slot is not None:
            self._heard(slot, message, now_us)
        return ()

    def _heard(
        self, slot: int, message: TaskBid | Itinerary | PlanOffer | PlanRow, now_us: int
    ) -> None:
        if isinstance(message, TaskBid):
            self._heard_bid(slot, message, now_us)
        elif isinstance(message, Itinerary):
            self.telling.on_message(slot, message)
        elif isinstance(message, PlanOffer) and self.round.wanted(message):
            self._calls.append(message)
        else:
            self.round.on_message(slot, message, now_us)

    def outgoing(self, now_us: int) -> Iterator[Dispatched]:
        """The frames that are due with our beat: orders, plans, our bid, our itinerary."""
        yield from self.book.outgoing(now_us)
        yield from self.round.outgoing(now_us)
        auction = self._auction
        if auction is not None and auction.mine is not None:
            yield auction.mine
            self._auction = auction._replace(mine=None)
        yield from self.telling.outgoing(now_us, self.left)


# ---------------------------------------------------------------- the problem of a round


def standings(dispatch: TaskAllocation, view: FleetView, able: bool) -> list[CarrierState]:
    """When and where each live robot that can work will be free, by slots. `able`: we can work."""
    robots = [dispatch.standing(view)] if able else []
    for slot in sorted(view.live - {dispatch.slot}):
        neighbour = view.neighbours.get(slot)
        if neighbour is not None and neighbour.pose.state in ABLE:
            left = (
                dispatch.remote_itineraries[slot].left
                if slot in dispatch.remote_itineraries
                else FULL
            )
            at = neighbour.pose.x_m, neighbour.pose.y_m
            robots.append(dispatch.through(CarrierState(slot, at, 0, left), view))
    return sorted(robots)


def new_problem(dispatch: TaskAllocation, view: FleetView, able: bool) -> ProblemSnapshot:
    """The problem of a full round: every free task, including those in itineraries of any robot.

    It has at most `round_tasks_max` tasks, those with the lowest numbers, so that all robots choose
    alike.
    """
    robots = standings(dispatch, view, able)
    fresh, _ = dispatch.open(view)
    planned = {
        t for s, told in dispatch.remote_itineraries.items() if s in view.live for t in told.whole
    }
    wanted = sorted({*fresh, *dispatch.itinerary, *planned})
    tasks = [task for task in wanted if _plannable(dispatch, view, task)]
    del tasks[round_tasks_max(len(robots)) :]  # the others wait for a later round
    return _frozen(dispatch, robots, tasks)


def round_tasks_max(robots: int) -> int:
    """How many tasks one round plans for this many robots; further tasks wait for a later round.

    >>> round_tasks_max(1), round_tasks_max(6), round_tasks_max(60)
    (29, 72, 227)
    """
    return int(ROUND_TASKS * sqrt(robots / ROUND_ROBOTS))


def hastened(dispatch: TaskAllocation, view: FleetView, able: bool) -> ProblemSnapshot:
    """The problem of a round that only cuts waiting time, with the current plan to start from.

    It has all tasks in itineraries except those that are too old to be overtaken.
    """
    robots, rows = [], []
    met = set[int]()
    for robot in standings(dispatch, view, able):
        own = dispatch.means(robot.slot)
        held = dispatch.haste.held(own, view.now_us)
        robots.append(dispatch.after_all(robot, own[:held]))
        row = [t for t in own[held:] if t not in met and _plannable(dispatch, view, t)]
        met.update(own)
        rows.append(row)
    tasks = sorted(task for row in rows for task in row)
    index = {task: k for k, task in enumerate(tasks)}
    plan = [[index[task] for task in row] for row in rows]
    return _frozen(dispatch, robots, tasks)._replace(plan=plan)


def _plannable(dispatch: TaskAllocation, view: FleetView, task: int) -> bool:
    order = dispatch.book.tasks.get(task)
    return (
        order is not None
        and view.allocation.phase_of(task) is Phase.FREE
        and not view.progress.bits(task, 0)
        and dispatch.house.known(order)
        and not dispatch.taken_back(task, view)
        and task not in dispatch.cut
    )


def _frozen(
    dispatch: TaskAllocation, robots: list[CarrierState], tasks: list[int]
) -> ProblemSnapshot:
    trips = [dispatch.house.trip(dispatch.book.tasks[task]) for task in tasks]
    work = dispatch.house.work(trips, robots)
    return ProblemSnapshot(tuple(robot.slot for robot in robots), tuple(tasks), work)
