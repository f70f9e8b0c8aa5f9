"""The exploration mission: robots build one shared map without a coordinator.

A frontier is a section of the allocation, claimed like a swath of a field. A claim of a frontier
ends in two ways. It is released if the frontier was seen on the way or a better one was found. It
is DONE if a robot has looked all round at its station, so that no robot returns for cells that
cannot be seen. The map is the progress. Exploration is over for a robot when it sees no frontier
that it could reach.
"""

from collections import Counter
from collections.abc import Sequence
from math import hypot

from agent.claims.standing_owners import STANDS, StandingOwners
from agent.exploration.exploration_task import (
    ORDERS_FIRST,
    ROBOTS_MAX,
    ExplorationOrder,
    FleetFullError,
    FleetTask,
    Status,
    TaskKind,
    view_cells,
)
from agent.exploration.frontier import (
    Frontier,
    FrontierChooser,
    OtherExplorer,
    Values,
    frontiers,
    wave_from,
)
from agent.exploration.frontier_path import STUCK_US, TURN_ROUND, FrontierPath
from agent.interface.config import LEASE_US, MS, S
from agent.interface.geometry import Cell, Point
from agent.interface.lifecycle import ABLE, State
from agent.interface.mission import ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.mapping.inflation import Grid
from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from crdt import Phase
from crdt.occupancy import SIDE, MergeResult, corner_of
from crdt.sighting import FREE, UNKNOWN

CHOOSE_US = 250 * MS  # a robot without a target searches for one this often
CHECK_US = 500 * MS  # how often a robot checks that its target is still a frontier
REASSIGN_US = 5 * S  # how often another target may be taken instead
LOOK_ROUND_US = 500 * MS  # at the station: at `TURN_RAD_S` every gap between 36 rays is swept twice
# An order that a nearer robot does not take for this long is ours: it may have tried in vain. A claim
# takes 0.25 s, and robots may have different views of the fleet for 2 s.
UNTAKEN_US = 5 * S
SHUNNED_US = 30 * S  # what we gave up is left to others for this long
# A frontier is left for twice as long after each that we gave up in a row. Many lie behind a gap that
# stops us, and we must not begin again before we have given up all of them.
SHUNNED_TIMES = 4  # doublings at most, to eight minutes: 60 frontiers of 8 s
STAYS_M = 1.0  # a robot that moves further than this does not stand


class ExplorationMission(Mission):
    """One robot's part in exploring: it maps, chooses frontiers, and carries out operators'
    orders.
    """

    replans = True

    def __init__(
        self,
        chart: LocalAndFleetMap,
        limits: BodyLimits,
        robots: int,
        robots_max: int = ROBOTS_MAX,
        orders: Sequence[ExplorationOrder] = (),
    ) -> None:
        """`chart`: our map and the fleet's. `limits`: of our body. `robots`: size of the fleet.
        `orders`: tasks of operators that all robots know. Raises FleetFullError if there are more
        than `robots_max` robots.
        """
        if robots > robots_max:
            raise FleetFullError(robots_max)
        self.chart, self.limits = chart, limits
        self.orders = {ORDERS_FIRST + k: order for k, order in enumerate(orders)}
        geometry = chart.geometry
        self.view_cells = view_cells(chart.range_m, geometry.cell_m)
        self.task: FleetTask | None = None
        self.ended: Counter[Status] = Counter()  # how many of our own tasks ended with each status
        self.last_merge = MergeResult(0, 0, 0)
        self.over = False  # at the last search there was no frontier that we could reach
        self.switched = 0  # number of targets left for better ones
        self._way = FrontierPath(chart, limits)
        self._legs: list[Point] = []  # places of an order still to visit
        self._shun_ends_at_us: dict[int, int] = {}
        self._in_vain = 0  # number of frontiers given up since we have reached a station
        self._untaken_at_us: dict[int, int] = {}  # orders: since when no robot has them
        self._choose_at_us = self._check_at_us = self._reassign_at_us = 0
        self._merged_at_us = 0
        self.standing = StandingOwners(STAYS_M)

    @property
    def progress_percent(self) -> float:
        """Percentage of the map's cells that any robot has seen."""
        return 100.0 * self.chart.fleet.progress

    @property
    def remaining_path(self) -> Sequence[Point]:
        return self._way.rest

    def on_control_period(self, view: FleetView, state: State) -> None:
        """Each control period, in every state: which owners of frontiers stand, and what we see while
        we may not drive.
        """
        if view.may_move:
            self.standing.observe(view, lambda sections: 0)  # a frontier has no units
        elif state in ABLE:
            self._see(view)  # others choose their first frontiers by it

    def on_stalled(self, view: FleetView) -> None:
        """Plan again from here, to the same station."""
        if self._way.station is not None:
            self._way.plan(view.here)

    # ---------------------------------------------------------------- seeing

    def _see(self, view: FleetView) -> None:
        """Each control period: add a scan, and exchange news with the fleet."""
        here, now_us = view.here, view.now_us
        radius_m = self.limits.radius_m + 0.1  # poses are rounded and a beat old
        others = [
            (n.pose.x_m, n.pose.y_m, radius_m) for s, n in view.neighbours.items() if s in view.live
        ]
        if view.placed:  # else the rays begin at another place than `here`
            self.chart.observe(here, others)
        self.chart.share_news(here, now_us)
        if self.chart.sync is not None and now_us >= self._merged_at_us + REASSIGN_US:
            self._merged_at_us = now_us
            self.last_merge = self.chart.sync.merged(now_us)

    def _passable(self, values: Values, here: Cell) -> Grid:
        """Cells known to be free with room for the body, (rows, columns); always the cells round
        ourselves.
        """
        self.chart.take_fleet_walls()
        passable: Grid = (values == FREE) & ~self.chart.grid.tight.blocked
        if not passable[here]:
            grid = self.chart.grid
            for r, c in grid.tight.carve(here, grid.solid, self.limits.radius_m / grid.cell_m):
                passable[r, c] = values[r, c] == FREE
            passable[here] = True
        return passable

    # ---------------------------------------------------------------- choosing

    def choose(self, view: FleetView) -> ClaimRequest | None:
        if view.now_us < self._choose_at_us:
            return None
        self._choose_at_us = view.now_us + CHOOSE_US
        order = self._order(view)
        if order is not None:
            return order
        best = self._best(view, None)
        if best is None:
            return None
        self._aim(best, view)
        return self._request(best.patch, view)

    def _order(self, view: FleetView) -> ClaimRequest | None:
        """A claim of an order that no robot works, if we are the nearest free robot."""
        for section, order in self.orders.items():
            if not self._open(section, view) or view.allocation.owner_of(section) == view.slot:
                self._untaken_at_us.pop(section, None)
                continue
            untaken_at_us = self._untaken_at_us.setdefault(section, view.now_us)
            x, y = order.points[0]
            mine_m = hypot(x - view.here.x_m, y - view.here.y_m)
            nearer = any(
                (hypot(x - n.pose.x_m, y - n.pose.y_m), slot) < (mine_m, view.slot)
                for slot, n in view.neighbours.items()
                if slot in view.live and n.pose.state == State.IDLE
            )
            if not nearer or view.now_us - untaken_at_us >= UNTAKEN_US:
                self._pursue(section, order, view)
                return self._request(section, view)
        return None

    def _request(self, section: int, view: FleetView) -> ClaimRequest:
        """A claim of what we have set out for; a takeover if another robot has it."""
        owner = view.allocation.owner_of(section)
        if owner is None or owner == view.slot:  # ours: after too many hand-overs to give it back
            return ClaimRequest(section, self._bid(view))
        stands = self.standing.stands(owner)
        self.standing.forget(owner)
        why = f"robot {owner} {STANDS}" if stands else ""
        return ClaimRequest(section, self._bid(view), takeover=True, why=why)

    def _left(self, section: int, view: FleetView) -> bool:
        """Whether the owner of a section is gone: silent for longer than the lease, or it stands."""
        owner = view.allocation.owner_of(section)
        if owner is None or owner == view.slot:
            return owner is not None
        if view.allocation.stays(section):
            return False
        silent_at_us = view.fell_silent_at_us.get(owner)
        if silent_at_us is not None:
            return view.now_us - silent_at_us >= LEASE_US
        return self.standing.stands(owner)

    def _best(self, view: FleetView, current: int | None) -> Frontier | None:
        """The best frontier for us; None if there is none. `current`: the patch that we are on the
        way to.
        """
        here = self._way.cell((view.here.x_m, view.here.y_m))
        values = self.chart.values()
        passable = self._passable(values, here)
        seen_by = self.chart.seen_by()
        theirs = (seen_by >= 0) & (seen_by != view.slot) & (self.chart.own() == UNKNOWN)
        wave = wave_from(passable, here, dear=theirs)
        found = [f for f in frontiers(values, wave, self.view_cells) if self._open(f.patch, view)]
        self.over = not found
        rivals = self._rivals(view, passable, seen_by)
        choosing = FrontierChooser(view.slot, self.chart.geometry.cell_m, self.view_cells)
        return choosing.best(found, wave, rivals, current)

    def _open(self, patch: int, view: FleetView) -> bool:
        """Whether a frontier is available: free, ours, or of a robot that is gone or stands."""
        if view.now_us < self._shun_ends_at_us.get(patch, 0):
            return False
        phase = view.allocation.phase_of(patch)
        return phase is Phase.FREE or (phase is not Phase.DONE and self._left(patch, view))

    def _rivals(self, view: FleetView, passable: Grid, seen_by: Values) -> list[OtherExplorer]:
        """Live robots that get on, each with its ways and the cell that it has claimed."""
        rivals = []
        for slot in sorted(view.live - {view.slot}):
            neighbour = view.neighbours.get(slot)
            if neighbour is None or neighbour.pose.stopped or self.standing.stands(slot):
                continue
            at = self._way.cell((neighbour.pose.x_m, neighbour.pose.y_m))
            claimed = [s for s in view.allocation.assigned_sections(slot) if s < ORDERS_FIRST]
            target = self._middle(claimed[-1]) if claimed else None
            was, passable[at] = bool(passable[at]), True
            theirs = (seen_by >= 0) & (seen_by != slot)
            rivals.append(
                OtherExplorer(slot, wave_from(passable, target or at, dear=theirs), target)
            )
            passable[at] = was
        return rivals

    def _middle(self, patch: int) -> Cell:
        return self._way.cell(self.place_of(patch))

    def place_of(self, section: int) -> Point:
        """The place of a section, (x, y) metres; the same for all peers."""
        if section in self.orders:
            return self.orders[section].points[0]
        row, column = corner_of(self.patch_of(section))
        geometry = self.chart.geometry
        half_m = SIDE / 2 * geometry.cell_m
        return (
            geometry.origin_m[0] + column * geometry.cell_m + half_m,
            geometry.origin_m[1] + row * geometry.cell_m + half_m,
        )

    def patch_of(self, section: int) -> int:
        """The number of the patch of the map that a section stands for."""
        return section

    def kind_of(self, section: int) -> TaskKind:
        """What a section asks a robot to do."""
        order = self.orders.get(section)
        return TaskKind.EXPLORE_FRONTIER if order is None else order.kind

    def _bid(self, view: FleetView) -> int:
        """Our bid: metres to the station, in 31 steps of a geometric scale."""
        assert self._way.station is not None
        x, y = self._way.station
        way_m = hypot(x - view.here.x_m, y - view.here.y_m)
        bid = 0
        while bid < 31 and way_m > 0.1 * 1.25**bid:
            bid += 1
        return bid

    # ---------------------------------------------------------------- tasks

    def _aim(self, frontier: Frontier, view: FleetView) -> None:
        self._legs = []
        self._way.head_for(self.chart.geometry.centre(*frontier.station), view)
        self._begin_task(frontier.patch, view)

    def _pursue(self, section: int, order: ExplorationOrder, view: FleetView) -> None:
        self._legs = list(order.points[1:])
        self._way.head_for(order.points[0], view)
        self._begin_task(section, view)

    def _begin_task(self, section: int, view: FleetView) -> None:
        self.task = FleetTask(
            section, self.kind_of(section), self.place_of(section), view.slot, Status.PENDING,
            view.now_us,
        )  # fmt: skip

    def _end_task(self, status: Status) -> None:
        if self.task is not None:
            self.ended[status] += 1
        self.task = None
        self._way.end()
        self._choose_at_us = 0

    def begin(self, section: int, view: FleetView) -> None:
        if self.task is None or self.task.section != section:
            # The section was kept over a restart or a stop.
            self._resume(section, view)
        assert self.task is not None
        self.task = self.task._replace(status=Status.ACTIVE)
        self._check_at_us = view.now_us + CHECK_US
        self._reassign_at_us = view.now_us + REASSIGN_US
        self._way.has_time(view.now_us)

    def _resume(self, section: int, view: FleetView) -> None:
        if section in self.orders:
            self._pursue(section, self.orders[section], view)
        else:
            self._way.head_for(self.place_of(section), view)
            self._begin_task(section, view)

    def abandon(self) -> None:
        self._end_task(Status.FAILED)

    # ---------------------------------------------------------------- moving

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        self._see(view)
        return self._way.drive(view)

    def accepts_goal(self, goal: Point) -> bool:
        return self.chart.admits(goal)

    def travel(self, goal: Point, view: FleetView) -> MotionRequest:
        self._see(view)
        if goal != self._way.station:
            self._way.head_for(goal, view)
        elif self._way.blocked:
            self._way.plan(view.here)
        return self._way.drive(view)

    def idle(self, view: FleetView) -> MotionRequest:
        self._see(view)
        if self.task is not None:
            self._end_task(Status.FAILED)  # its claim was lost before it began
        return TURN_ROUND

    def work(self, view: FleetView) -> MotionRequest:
        self._see(view)
        now_us = view.now_us
        if self.task is None:
            (section,) = view.allocation.assigned_sections(view.slot)[:1]
            self.begin(section, view)
        if now_us >= self._check_at_us:
            self._check_at_us = now_us + CHECK_US
            gone = self._check(view)
            if gone is not None:
                self._end_task(gone)
                return TURN_ROUND._replace(given_up=True)
        wish = self._way.drive(view)
        if not self._way.arrived_at_us or now_us < self._way.arrived_at_us + self._look_for_us:
            return wish
        if self._legs:
            self._way.head_for(self._legs.pop(0), view)
            return wish
        self._in_vain = 0
        self._end_task(Status.COMPLETED)
        return wish._replace(finished=True)

    @property
    def _look_for_us(self) -> int:
        return 0 if self._legs else LOOK_ROUND_US

    def _check(self, view: FleetView) -> Status | None:
        """The status with which the current task must be released; None: keep it."""
        assert self.task is not None
        self.given_up_why = "seen, or a better one found"
        if self._way.stuck(view.now_us):
            self.given_up_why = f"no headway for {STUCK_US // S} s"
            self._shun(self.task, view.now_us)
            return Status.FAILED
        if (not self._way.rest and not self._way.arrived_at_us) or self._way.blocked:
            self._way.plan(view.here)
        if self.task.kind is not TaskKind.EXPLORE_FRONTIER:
            return None
        due = view.now_us >= self._reassign_at_us
        values = self.chart.values()
        row, column = corner_of(self.patch_of(self.task.section))
        area = values[max(row - 1, 0) : row + SIDE + 1, max(column - 1, 0) : column + SIDE + 1]
        if not (area == 0).any():
            return Status.COMPLETED  # any robot has seen it on the way
        if self._contested(view):
            return Status.FAILED
        if not due:
            return None
        self._reassign_at_us = view.now_us + REASSIGN_US
        best = self._best(view, self.task.section)
        if best is None or best.patch == self.task.section:
            return None if best is not None else Status.COMPLETED
        self.switched += 1
        return Status.FAILED

    def _shun(self, task: FleetTask, now_us: int) -> None:
        """Leave what we got no nearer to to others."""
        times = 0
        if task.kind is TaskKind.EXPLORE_FRONTIER:
            times = min(self._in_vain, SHUNNED_TIMES)
            self._in_vain += 1
        self._shun_ends_at_us[task.section] = now_us + (SHUNNED_US << times)

    def _contested(self, view: FleetView) -> bool:
        """Whether a robot with a lower slot has claimed a frontier beside ours: then we give ours
        back.
        """
        assert self.task is not None
        x, y = self.task.target
        for slot in view.live:
            if slot < view.slot:
                for section in view.allocation.assigned_sections(slot):
                    a, b = self.place_of(section)
                    if section < ORDERS_FIRST and hypot(a - x, b - y) < 0.5:
                        return True
        return False
