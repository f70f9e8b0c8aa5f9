"""The delivery mission: one robot's part, from its itinerary to the parcel that it carries.

A task is a section with two units: picked up, delivered. A visit of a charger bay is a section as
well, and is claimed like one. Only a robot at the place of a parcel can pick it up, so the parcel
itself ensures that one robot carries it. Claims only avoid duplicate work. A parcel of a robot that
died is where that robot stands. The robot that takes the task over fetches it from there.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from math import dist, hypot, inf

from agent.delivery.charging import ChargerState, Charging
from agent.delivery.cost_matrix import FULL, Trip
from agent.delivery.parcel_search import ParcelSearch
from agent.delivery.reachability import Reachability
from agent.delivery.task_allocation import Dispatched, TaskAllocation
from agent.delivery.task_headway import TaskHeadway
from agent.delivery.task_registry import TASKS_MAX, recalled_orders, stop_names
from agent.delivery.warehouse import SECTIONS_END, CarrierState, Warehouse
from agent.interface.config import MS, S
from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from agent.interface.mission import ClaimRequest, FleetView, MotionRequest, Record
from agent.navigation.navigation_mission import NavigationMission
from agent.navigation.path_requests import AHEAD_S, PathRequests
from crdt import Phase
from protocol.frames.messages import Message
from protocol.sync.map_sync import MapSync

PICKED, DELIVERED = 0, 1  # units of a task
NOTHING_RECALLED: Mapping[str, bytes] = {}
UNDER_WAY = -1  # stands for the current goal where sections are checked
REACH_M = 1.2  # reach of the arm, from the robot's middle to the parcel's
BESIDE_M = 1.0  # this distance is near enough if another body is in the way
UNTOUCHED_M = 0.2  # a parcel this near to its pickup was not moved
IDLE_CHARGE = 0.5  # an idle robot charges below this
HOME_US = 5 * S  # a robot idle for this long makes room
# A robot within reach that gets no nearer by this much for this long handles the parcel from there.
STALLED_US, NEARER_M = 1 * S, 0.05
# A robot that a stop cause holds for longer takes no tasks. A person passes sooner.
HELD_US = 10 * S
MISSING_US = 3 * S  # after this time at a place without a parcel, the parcel counts as missing
SHUN_US = 30 * S  # how long a dead bay, or a task whose parcel is not found, is left alone


class DeliveryMission(NavigationMission):
    """One robot's part in carrying parcels. Places are (x, y) metres."""

    passes = False  # it has to stop there to handle a parcel

    def __init__(
        self, slot: int, house: Warehouse, home: Point, speed_m_s: float, deceleration_m_s2: float,
        now_us: int, seed: int, chart: MapSync | None = None,
        recalled: Mapping[str, bytes] = NOTHING_RECALLED, asks: bool = False,
    ) -> None:  # fmt: skip
        """`house`: the building and all that is planned with. `home`: where the robot was switched
        on. `seed`: of its own search for plans. `chart`: the fleet's map; None if it has none.
        `recalled`: durable memory as it was before the start. `asks`: as in `NavigationMission`.
        """
        super().__init__(
            slot, {}, house.floor, speed_m_s, deceleration_m_s2, chart=chart, now_us=now_us,
            asks=asks,
        )  # fmt: skip
        self.house, self.home = house, home
        self.dispatch = TaskAllocation(slot, house, now_us, seed, recalled_orders(recalled))
        self.paths = PathRequests(super()._way)
        self.replanning.path = partial(self.paths.urgent, self.hazards.path)
        self.hazards.reach_m = BESIDE_M
        self.cut_off = Reachability(self.hazards)
        self.charging = Charging(house)
        self.whereabouts = ParcelSearch(house, self.dispatch.book, self.hazards, self.bodies)
        self.section: int | None = None  # a task or a bay under way
        self.waited_for_us = 0  # total wait for new itineraries, by the rule of scenario C
        self._load = -1
        self._handling_at_us: int | None = None  # since when we stand where we handle or charge
        self._idle_at_us: int | None = None
        self._shun_ends_at_us: dict[int, int] = {}  # bays, and tasks, by section
        self._told_aboard = -1  # the parcel whose pickup we have announced
        # Least distance within reach of the goal, and when.
        self._nearest: tuple[float, int] = (0.0, 0)
        self.headway = TaskHeadway()
        self._may_at_us = now_us  # when no stop cause held us

    @property
    def section_units(self) -> Mapping[int, int]:
        return {}

    @property
    def sections(self) -> Collection[int]:
        return range(SECTIONS_END if self.house.bays else TASKS_MAX)

    # ---------------------------------------------------------------- frames

    def on_message(self, slot: int | None, message: Message, now_us: int) -> Sequence[Record]:
        if isinstance(message, Dispatched):
            return self.dispatch.on_message(slot, message, now_us)
        return super().on_message(slot, message, now_us)

    def outgoing(self, now_us: int) -> Iterable[Message]:
        return [*super().outgoing(now_us), *self.dispatch.outgoing(now_us)]

    # ---------------------------------------------------------------- each control period

    def on_control_period(self, view: FleetView, state: State) -> None:
        self._load = view.here.load
        if view.may_move:
            self.dispatch.absence.watch(view)
        self.dispatch.left = round(view.here.battery * FULL)
        if view.may_move:
            self._may_at_us = view.now_us
        held = view.now_us - self._may_at_us > HELD_US
        able = state in (State.IDLE, State.WORKING, State.SYNCHRONIZING) and not held
        able = able and not self._load_unknown and not self._stranded(view)
        self.dispatch.on_tick(view, able)
        self.paths.work()
        super().on_control_period(view, state)

    @property
    def _load_unknown(self) -> bool:
        """Whether a parcel is aboard whose order we do not know: our memory is lost, and no robot that
        knows the order has been received yet. There is no room for another one."""
        return 0 <= self._load < TASKS_MAX and self._load not in self.dispatch.book

    def _stranded(self, view: FleetView) -> bool:
        """Whether we cannot begin more tasks: updates unreachable tasks and checks our progress."""
        at, now_us = (view.here.x_m, view.here.y_m), view.now_us
        if self.cut_off.due(now_us, self.dispatch.book.added):
            self.cut_off.observe(at, self._goals(view), now_us)
            self.dispatch.cut = self.cut_off.sections
        charging = self.section is not None and self.section >= TASKS_MAX and self._handling_at_us
        busy = self.section is not None and not charging
        still = self.cut_off.stands_still(at, busy, now_us) or self.headway.holds_back(at, now_us)
        return still or self._load in self.cut_off.sections

    def _goals(self, view: FleetView) -> dict[int, list[Point]]:
        """For each task that is not done, where its parcel is and where it goes; and the place of
        each bay.
        """
        found = {TASKS_MAX + bay: [place] for bay, place in enumerate(self.house.bays)}
        if self.goal is not None:
            found[UNDER_WAY] = [self.goal]
        for task, order in self.dispatch.book.tasks.items():
            done = view.allocation.phase_of(task) is Phase.DONE or self.dispatch.taken_back(
                task, view
            )
            if done or not self.house.known(order):
                continue
            found[task] = [self.house.trip(order).dropoff]
            owner = view.allocation.owner_of(task)
            aboard = owner in view.live and view.progress.bits(task, 0) & 1
            if task != self._load and not aboard:
                workers = self.dispatch.workers.get(task, [])
                found[task].append(self.whereabouts.likeliest(task, workers, view))
        return found

    @property
    def stops(self) -> list[str]:
        """The itinerary as people read it: [P5, D5, C1]; see `stop_names`."""
        begun, itinerary = [], self.dispatch.itinerary
        if self.section is not None and self.section >= TASKS_MAX:
            begun.append(TASKS_MAX + self.house.bay_of(self.section))
        elif self.section is not None:
            begun.append(self.section)
        ahead = self.dispatch.telling.stops
        if [stop for stop in ahead if stop < TASKS_MAX and stop in itinerary] != itinerary:
            ahead = itinerary  # the itinerary has changed since
        left = [s for s in ahead if s not in begun and (s >= TASKS_MAX or s in itinerary)]
        return stop_names(begun, left, self._load)

    # ---------------------------------------------------------------- choosing

    def choose(self, view: FleetView) -> ClaimRequest | None:
        load = self._load  # aboard since before a restart, or after an operator's order
        if load in self.dispatch.book and view.allocation.phase_of(load) is not Phase.DONE:
            bay = self._charge(view, load) if self._falls_short(load, view) else None
            return bay or self._claim(load, view)
        task = None if self._load_unknown else self._next(view)
        if task is None:
            low = view.here.battery < IDLE_CHARGE and not self.dispatch.round.active
            return self._charge(view, None) if low else None
        if self._must_charge(task, view):
            return self._charge(view, task)
        if self._waits(task, view):
            self.waited_for_us += 50 * MS
            return None
        return self._claim(task, view)

    def _next(self, view: FleetView) -> int | None:
        """The first task of our itinerary that is available, and that a charge makes possible."""
        for task in self.dispatch.itinerary:
            if task == self.section or self._shun_ends_at_us.get(task, 0) > view.now_us:
                continue
            owner = view.allocation.owner_of(task)
            away = owner is not None and self.dispatch.absence.leaves(owner, task, view)
            free = owner is None or (owner != self.slot and away)
            if free and not self._beyond_battery(task, view):
                return task
        return None

    def _claim(self, task: int, view: FleetView) -> ClaimRequest | None:
        owner = view.allocation.owner_of(task)
        if owner is not None and owner != self.slot:
            if not self.dispatch.absence.leaves(owner, task, view) and self._load != task:
                return None
            return ClaimRequest(task, 0, True, self.dispatch.absence.why(owner))
        return ClaimRequest(task, 0)

    def _waits(self, task: int, view: FleetView) -> bool:
        """Whether to wait for the plan (scenario C): the task takes less time than the rest of the
        running round.
        """
        left_for_us = self.dispatch.round.left_for_us(view.now_us)
        if not left_for_us or self.dispatch.round.first.get(self.slot, [])[:1] == [task]:
            return False  # no round, or this is the first task of the auction's plan
        here = self.dispatch.standing(view)
        order = self.dispatch.book.tasks[task]
        through = self.house.after(here._replace(ready_ms=0), self.house.trip(order), False)
        return through.ready_ms * MS < left_for_us

    def _must_charge(self, task: int, view: FleetView) -> bool:
        return self.charging.before(self.dispatch.standing(view), self._trip(task, view))

    def _beyond_battery(self, task: int, view: FleetView) -> bool:
        """Whether no charge lasts for a task: one that waits for a charge would charge for ever."""
        return self.charging.beyond(self.dispatch.standing(view), self._trip(task, view))

    def _trip(self, task: int, view: FleetView) -> Trip:
        dropoff = self.house.trip(self.dispatch.book.tasks[task]).dropoff
        return Trip(self._pickup(task, view), dropoff)

    def _here(self, view: FleetView) -> CarrierState:
        return CarrierState(self.slot, (view.here.x_m, view.here.y_m), 0, self.dispatch.left)

    def _falls_short(self, task: int, view: FleetView) -> bool:
        loaded, dropoff = (
            task == self._load,
            self.house.trip(self.dispatch.book.tasks[task]).dropoff,
        )
        trip = Trip(dropoff if loaded else self._pickup(task, view), dropoff)
        return self.charging.falls_short(self._here(view), trip, loaded)

    def _short(self, section: int, view: FleetView) -> bool:
        """Once a second on the way: whether a delay has used so much charge that a bay
        comes first.
        """
        untold = self._load == section != self._told_aboard  # first announce that it is aboard
        if section >= TASKS_MAX or untold or not self.charging.due(view.now_us):
            return False
        return self._falls_short(section, view) and self._charge(view, section) is not None

    def _search_ends(self, section: int, view: FleetView) -> bool:
        """Whether to charge before the search for a parcel goes on; no plan knew how long the
        search takes.
        """
        if section == self._load or not self.whereabouts.searching(section):
            return False
        assert self.goal is not None
        dropoff = self.house.trip(self.dispatch.book.tasks[section]).dropoff
        return self.charging.before(self._here(view), Trip(self.goal, dropoff))

    def _charge(self, view: FleetView, task: int | None) -> ClaimRequest | None:
        """A claim of a bay on the way to what is next; None: all are taken."""
        onward = None
        if task is not None and task == self._load:
            onward = self.house.trip(self.dispatch.book.tasks[task]).dropoff
        elif task is not None:
            onward = self._pickup(task, view)
        shunned = {s for s, end_at_us in self._shun_ends_at_us.items() if end_at_us > view.now_us}
        shunned |= self.cut_off.sections | self._occupied(view)
        at, absence = (view.here.x_m, view.here.y_m), self.dispatch.absence
        return self.charging.visit(
            at, onward, view.allocation, shunned, lambda owner: absence.silent(owner, view)
        )

    def _occupied(self, view: FleetView) -> set[int]:
        """The bays in which a latched robot stands: it stays until a person comes."""
        width_m = 2 * self.floor.radius_m
        latched = [
            (n.pose.x_m, n.pose.y_m)
            for slot, n in view.neighbours.items()
            if slot in view.live and n.pose.state == State.EMERGENCY_STOP
        ]
        return {
            TASKS_MAX + bay
            for bay, place in enumerate(self.house.bays)
            if any(dist(place, at) < width_m for at in latched)
        }

    # ---------------------------------------------------------------- the section under way

    def _pickup(self, task: int, view: FleetView) -> Point:
        return self.whereabouts.next(task, self.dispatch.workers.get(task, []), view)

    def begin(self, section: int, view: FleetView) -> None:
        self.section, self._handling_at_us = section, None

    def _taken_back(self, section: int, view: FleetView) -> bool:
        """Whether its order was taken back before any robot has picked the parcel up."""
        return self._load != section and self.dispatch.taken_back(section, view)

    def _unknown(self, section: int) -> bool:
        """Whether there is nothing to drive to: no order with this number, or no bay.

        Our durable claim may outlive the order, which is refused if its cells are no places.
        """
        return not self.house.bays if section >= TASKS_MAX else section not in self.dispatch.book

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        if self._taken_back(section, view) or self._unknown(section):
            return MotionRequest(0.0, 0.0)
        self._go(self._goal(section, view))
        return self._drive(view)[0]

    def _goal(self, section: int, view: FleetView) -> Point:
        if section >= TASKS_MAX:
            return self.house.bays[self.house.bay_of(section)]
        if self._load == section:
            return self.house.trip(self.dispatch.book.tasks[section]).dropoff
        return self._pickup(section, view)

    def _go(self, goal: Point) -> None:
        if goal != self.goal:
            self.goal, self._tracker, self._handling_at_us = goal, None, None
            self.cut_off.forget(UNDER_WAY)

    def work(self, view: FleetView) -> MotionRequest:
        self._idle_at_us = None
        if self.section is None:  # the section was kept over a stop
            held = view.allocation.assigned_sections(view.slot)
            self.begin(held[0], view)
        section = self.section
        assert section is not None
        if self._unknown(section):
            return self._given_up(section, view, "no such task or bay")
        if section < TASKS_MAX and self._delivered(section, view):
            self._through()
            return MotionRequest(0.0, 0.0, covered=(PICKED, DELIVERED), finished=True)
        if self._hopeless(section) or self._taken_back(section, view):
            return self._given_up(section, view)
        if self._way_is_cut(section, view):
            return self._missing(section, view)
        self._go(self._goal(section, view))
        if self._search_ends(section, view):
            return self._given_up(section, view)
        if self._short(section, view):
            self._through()
            self.given_up_why = "charges first"
            return MotionRequest(0.0, 0.0, given_up=True)  # a parcel aboard stays aboard
        wish, arrived = self._drive(view)
        self._plan_ahead(section, view)
        if self._load == section and self._told_aboard != section:
            self._told_aboard = section
            self._nearest = (inf, 0)  # the way to the dropoff begins, which may be within reach
            wish = wish._replace(covered=(PICKED,))
        # Within reach it handles the parcel in a round as well, because the round ends some time.
        if not (arrived or self._beside(view)):
            self._handling_at_us = None
            lost = self._without_headway(section, view)
            if lost:
                return self._given_up(section, view, lost)
            return wish._replace(near_end=self._near_end(section, view))
        self.headway.handles()
        if self._handling_at_us is None:
            self._handling_at_us = view.now_us
            self.charging.begin(view.here.battery)
        if section >= TASKS_MAX:
            return self._at_bay(section, view)
        return self._handling(section, view)._replace(covered=wish.covered)

    def _without_headway(self, section: int, view: FleetView) -> str:
        """Why a section under way, whose parcel is not aboard, has to be given back; else empty."""
        assert self.goal is not None
        at, tracker = (view.here.x_m, view.here.y_m), self._tracker
        bound = self.agreement.bound or tracker is None
        left_m = inf if bound or tracker is None else tracker.total_m - tracker.along_m
        self.headway.observe(at, self.goal, left_m, view.now_us)
        if self._load == section or not self.headway.lost:
            return ""
        why = self.headway.lost
        self.headway.gave_back(at, view.now_us)
        return why

    def _hopeless(self, section: int) -> bool:
        """Whether a section cannot be reached, and its parcel is not aboard."""
        if section >= TASKS_MAX:
            section = TASKS_MAX + self.house.bay_of(section)
        return section in self.cut_off.sections and section != self._load

    def _way_is_cut(self, section: int, view: FleetView) -> bool:
        """Whether the place where we look for a parcel is out of reach, and the arm does not see the
        parcel from here.
        """
        fetching = self._load != section < TASKS_MAX and section not in view.here.parcels
        return fetching and self.goal is not None and UNDER_WAY in self.cut_off.sections

    def _beside(self, view: FleetView) -> bool:
        """Whether a body, perhaps an unknown one, blocks our place, but the arm reaches over it."""
        section = self.section
        if section is None or section >= TASKS_MAX or self.goal is None:
            return False
        x_m, y_m = self.goal
        away_m = hypot(x_m - view.here.x_m, y_m - view.here.y_m)
        reached = away_m < BESIDE_M or (self._load != section and section in view.here.parcels)
        nearer = away_m < self._nearest[0] - NEARER_M
        if not reached or nearer:
            self._nearest = (away_m, view.now_us)
            return False
        width_m = 2 * self.floor.radius_m
        others = [(n.pose.x_m, n.pose.y_m) for n in view.neighbours.values()]
        others += self.bodies.dead.values()
        taken = any(hypot(x_m - p[0], y_m - p[1]) < width_m for p in others)
        return taken or view.now_us - self._nearest[1] > STALLED_US

    def _near_end(self, section: int, view: FleetView) -> bool:
        """Whether to claim the next section: on the last leg and not before, because it may be
        re-planned.
        """
        if section >= TASKS_MAX or self._load != section or self.goal is None:
            return False
        left_m = hypot(self.goal[0] - view.here.x_m, self.goal[1] - view.here.y_m)
        return left_m < self.speed_m_s

    def _plan_ahead(self, section: int, view: FleetView) -> None:
        """Request the path after the current one when that one is nearly driven."""
        tracker = self._tracker
        if tracker is None or self.goal is None:
            return
        if tracker.total_m - tracker.along_m > AHEAD_S * self.speed_m_s:
            return
        if section < TASKS_MAX and self._load != section:
            onward: Point | None = self.house.trip(self.dispatch.book.tasks[section]).dropoff
        else:
            task = self._next(view)
            onward = None if task is None else self._pickup(task, view)
        if onward is not None and onward != self.goal:
            self.paths.ask(self.goal, onward)

    def _way(self, at: Point, goal: Point) -> tuple[Point, ...]:
        return self.paths.take(at, goal)

    def _delivered(self, task: int, view: FleetView) -> bool:
        """Whether the parcel was carried and we see it within reach of its dropoff."""
        seen = view.here.parcels.get(task)
        if seen is None or seen.on_robot:
            return False
        order = self.dispatch.book.tasks[task]
        pickup, dropoff = self.house.trip(order)
        carried = self._told_aboard == task or view.progress.bits(task, 0) & 1
        untouched = hypot(pickup[0] - seen.x_m, pickup[1] - seen.y_m) < UNTOUCHED_M
        if not carried and (untouched or order.withdrawn):  # then nobody knows where the pickup was
            return False
        return hypot(dropoff[0] - seen.x_m, dropoff[1] - seen.y_m) < REACH_M

    def _handling(self, task: int, view: FleetView) -> MotionRequest:
        """Load or unload. The result is sensed: the parcel aboard, and the visible parcels."""
        assert self._handling_at_us is not None
        if self._load != task and task not in view.here.parcels:
            if view.now_us - self._handling_at_us > MISSING_US:
                return self._missing(task, view)
            return MotionRequest(0.0, 0.0)
        return MotionRequest(0.0, 0.0, parcel_action=task)

    def _missing(self, task: int, view: FleetView) -> MotionRequest:
        """The parcel is not here: try the next place; after the last one release the task for a
        while.
        """
        assert self.goal is not None
        self._handling_at_us = None
        if self.whereabouts.looked(task, self.goal):
            self._go(self._pickup(task, view))
            return MotionRequest(0.0, 0.0)
        return self._given_up(task, view)

    def _given_up(
        self, section: int, view: FleetView, why: str = "out of reach or missing"
    ) -> MotionRequest:
        self.given_up_why = why
        if section >= TASKS_MAX and self.house.bays:
            section = TASKS_MAX + self.house.bay_of(section)  # the bay, not this visit
        self._shun_ends_at_us[section] = view.now_us + SHUN_US
        self._through()
        return MotionRequest(0.0, 0.0, given_up=True)

    def _at_bay(self, section: int, view: FleetView) -> MotionRequest:
        state = self.charging.observe(view.here.battery, view.now_us)
        if state is ChargerState.CHARGES:
            return MotionRequest(0.0, 0.0)
        if state is ChargerState.DEAD:  # leave the bay, it needs a repair
            bay = self.house.bay_of(section)
            self._shun_ends_at_us[TASKS_MAX + bay] = view.now_us + 20 * SHUN_US
            self.given_up_why = "the bay does not charge"
        self._through()
        if state is ChargerState.FULL and self.house.used_again(section, view.allocation):
            self.given_up_why = "charged"
            return MotionRequest(0.0, 0.0, given_up=True)
        return MotionRequest(
            0.0, 0.0, finished=state is ChargerState.FULL, given_up=state is ChargerState.DEAD
        )

    def _through(self) -> None:
        if self.section in self.dispatch.itinerary:
            self.dispatch.itinerary.remove(self.section)
        self.section, self.goal, self._tracker, self._handling_at_us = None, None, None, None
        self._calls = (0, 0)

    def abandon(self) -> None:
        self._through()

    def idle(self, view: FleetView) -> MotionRequest:
        """Nothing to do: go to where we were switched on, out of the way of other robots."""
        self.section = None
        if self._idle_at_us is None:
            self._idle_at_us = view.now_us
        away_m = hypot(self.home[0] - view.here.x_m, self.home[1] - view.here.y_m)
        if view.now_us - self._idle_at_us < HOME_US or away_m < 1.0:
            return super().idle(view)
        if self.house.carrier.runs_dry and self.dispatch.left < self.house.home(self.home):
            return super().idle(view)
        self._go(self.home)
        return self._drive(view)[0]
