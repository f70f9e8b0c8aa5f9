"""The navigation mission: each robot drives to its own goals through a building.

Normally a robot follows its any-angle path, and ORCA keeps it away from the others. It calls a
round of agreement (`agent/mapf/joint_plan_agreement.py`) if it makes no progress, or if it would
enter a narrow passage against a robot that comes out. Then it drives the route of the joint plan
until it is through.

A goal is a section of the shared state with one unit, so that what was reached stays reached.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import cos, hypot, sin
from typing import NamedTuple

from agent.interface.config import GONE_QUIET_US, MS, S
from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from agent.interface.mission import (
    STILL,
    ClaimRequest,
    FleetView,
    Mission,
    MotionRequest,
    Record,
)
from agent.interface.observation import Neighbour, Observation
from agent.mapf.agreement_phase import AgreementPhase
from agent.mapf.joint_plan_agreement import JointPlanAgreement
from agent.mapping.building import Floor
from agent.mapping.dynamic_obstacles import RANGE_M, DynamicObstacles
from agent.motion.path_tracker import PathTracker
from agent.navigation.path_lookahead import PathLookahead
from agent.navigation.replan_policy import Replanning
from agent.navigation.silent_robots import DEAD_US, SilentRobots
from crdt import Phase
from protocol.frames.agreement_frames import AgreementMessage, AgreementReply, SilentPosition
from protocol.frames.messages import Message
from protocol.sync.map_sync import MapSync

GOALS_MAX = 512  # goals of a robot: a section is the slot times this plus the goal's number
WANTS_M_S = 0.1  # a robot that wants less than this is not stalled
GOT_ON_M = 0.3  # a robot that drives less along its path within `STALL_US` is stalled
STALL_US = 2 * S
CALLS_US = (2 * S, 4 * S, 8 * S, 16 * S)  # between our calls while they bring no progress
LOOK_M = 2.5  # passages are checked this far ahead
BESIDE_PATH_M = 0.5  # a robot nearer to the path than this is on it
SETTLED_M = 0.1  # this near to a node of the route, it is reached
ACQUAINTED_US = 1 * S  # after joining, until all robots near by have been received, by many beats
VOUCHED_US = 3 * S  # in a fleet of ten, other members name each member ten times within this
AGE_MAX_US = 500 * MS  # a pose is extrapolated this long: 10 beats, 30 % of them lost
CLAIM_S = 0.5  # twice the time of a contest, so the next goal is ours when we are at this one
CLOSE_M = RANGE_M + 2.0  # our rays can hit a robot whose last beat was this near
# A robot without another robot near that stands for this long and wants to move is stalled. The time
# is longer than a stop for a robot that passes.
STALLED_ALONE_US = 5 * S
AHEAD_M = 0.3  # an obstacle that cannot be passed is assumed this far beyond the hull
FOLLOWED_MAX = 512  # lines remembered, at most 2 MB: each goal takes a few of them
LOST_M = 0.8  # this far off the path, another is planned


class FollowedPath(NamedTuple):
    """A polyline (x, y) metres that a robot was to follow from a time on, and why."""

    t_us: int
    points: tuple[Point, ...]
    why: str  # goal, lost, blocked, stalled, restored, plan (a joint one), after plan


class NavigationMission(Mission):
    """One robot's part in driving through a building. Places are (x, y) metres."""

    replans = True
    passes = True  # passing a goal counts as reaching it; missions that must stop there set False

    def __init__(
        self,
        slot: int,
        goals: Mapping[int, Sequence[Point]],
        floor: Floor,
        speed_m_s: float,
        deceleration_m_s2: float,
        agrees: bool = True,
        chart: MapSync | None = None,
        now_us: int = 0,
        asks: bool = False,
    ) -> None:
        """`goals`: of every robot by slot, in their order. `floor`: the building. `speed_m_s`,
        `deceleration_m_s2`: of our body. `agrees`: False for ORCA without agreements. `chart`: the
        fleet's map; None if it has none. `asks`: an obstacle is driven round only by an operator's
        order (`agent/motion/obstacle_stop.py`).
        """
        assert all(len(own) <= GOALS_MAX for own in goals.values())
        self.slot, self.goals, self.floor, self.agrees = slot, goals, floor, agrees
        self.speed_m_s, self.deceleration_m_s2 = speed_m_s, deceleration_m_s2
        self.asks = asks
        self._keeps_on = asks  # stay on the plan's path: no operator has ordered a detour
        self.agreement = JointPlanAgreement(slot, floor.lattice, floor.radius_m)
        self.goal: Point | None = None
        self.answer = AgreementReply.GRANT
        self.hazards = DynamicObstacles(floor, chart)
        self.bodies = SilentRobots(slot, now_us, self.hazards.on_map)
        self.replanning = Replanning(self.hazards, speed_m_s, deceleration_m_s2)
        self.next_way = PathLookahead(self.hazards)
        self._near_m = speed_m_s**2 / (2 * deceleration_m_s2) + CLAIM_S * speed_m_s
        self.followed: deque[FollowedPath] = deque(maxlen=FOLLOWED_MAX)  # newest last
        self._tracker: PathTracker | None = None  # on the path to the goal
        self._lane: PathTracker | None = None  # on the route of a joint plan
        self._lane_of = (-1, -1, -1)  # round, first and last node of the lane
        self._gone_on: tuple[float, int] = (0.0, 0)  # arc length of the path, and since when
        # Where and since when the robot makes no progress without another robot near.
        self._alone_since: tuple[Point, int] | None = None
        self._stalls = 0  # number of stalls in a row on the way to this goal
        self._planned = False  # a joint plan was driven since the last path
        # The extrapolated positions of robots last received within `CLOSE_M`, by slot.
        self._around: dict[int, Point] = {}
        self._known_at: Point | None = None  # where we last knew that we are
        self._alone_at_us = 0  # when we last were not a member of the fleet
        # Slot -> when another robot last reported to receive it.
        self._vouched_at_us: dict[int, int] = {}
        # Number of calls since we last arrived, and the earliest time of the next call.
        self._calls: tuple[int, int] = (0, 0)

    @property
    def section_units(self) -> Mapping[int, int]:
        return {
            slot * GOALS_MAX + k: 1 for slot, own in self.goals.items() for k in range(len(own))
        }

    @property
    def remaining_path(self) -> list[Point]:
        """What is left of the path, or of the lane of a joint plan."""
        tracker = self._lane if self.agreement.bound else self._tracker
        return [] if tracker is None else tracker.remaining_path

    # ---------------------------------------------------------------- what a mission is asked

    def choose(self, view: FleetView) -> ClaimRequest | None:
        first = self.slot * GOALS_MAX
        for section in range(first, first + len(self.goals.get(self.slot, ()))):
            if view.allocation.phase_of(section) is Phase.FREE:
                return ClaimRequest(section, 0)
        return None

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        self._go_for(section)
        return self._drive(view)[0]

    def begin(self, section: int, view: FleetView) -> None:
        self._go_for(section)

    def work(self, view: FleetView) -> MotionRequest:
        (section,) = view.allocation.assigned_sections(view.slot)[:1]
        self._go_for(section)
        wish, arrived = self._drive(view)
        if not arrived:
            return wish._replace(near_end=self._look_ahead(section))
        self.goal, self._tracker = None, None
        self._calls = (0, 0)
        return wish._replace(covered=(0,), finished=True, near_end=True)

    def _look_ahead(self, section: int) -> bool:
        """Whether the goal is near. Then the path from it to the next goal is planned as well."""
        tracker, own = self._tracker, self.goals[self.slot]
        if tracker is None or tracker.total_m - tracker.along_m > self._near_m:
            return False
        following = section - self.slot * GOALS_MAX + 1
        if following < len(own):
            self.next_way.prepare(own[following - 1], own[following])
        return True

    def accepts_goal(self, goal: Point) -> bool:
        return self.floor.route.admits(goal)

    def travel(self, goal: Point, view: FleetView) -> MotionRequest:
        if goal != self.goal:
            self.goal, self._tracker = goal, None
        return self._drive(view)[0]

    def idle(self, view: FleetView) -> MotionRequest:
        self.goal, self._tracker = None, None
        return self._drive(view)[0]

    def abandon(self) -> None:
        self.goal, self._tracker = None, None

    def on_stalled(self, view: FleetView) -> None:
        """Plan again from here. A robot without others near does so by its own rule
        (`_stalled_alone`), and in a round the joint plan is the path.
        """
        if not self.agreement.bound and self._near(view):
            self._tracker = None

    def on_control_period(self, view: FleetView, state: State) -> None:
        """Each control period, in every state: our part in a round."""
        here = view.here
        self.bodies.observe(view)
        dead, silent = self.bodies.dead, view.fell_silent_at_us
        gone = {s for s, start_at_us in silent.items() if view.now_us - start_at_us > DEAD_US}
        self._around = {
            s: _now_at(n, view.now_us)
            for s, n in view.neighbours.items()
            if s not in gone and _within(n, here, CLOSE_M)
        }
        around = list(self._around.values())
        reach_m = self.replanning.horizon_m + self.floor.radius_m
        if state is State.DISCONNECTED:
            # Without a fleet, the echo of a robot would count as an obstacle.
            self._alone_at_us = view.now_us
        if view.now_us - self._alone_at_us > ACQUAINTED_US:
            # Rays from a place that is not believed would put obstacles where there are none.
            seen = here if view.placed else here._replace(ranges_m=())
            self.hazards.observe(seen, reach_m, around, view.now_us, dead)
        if view.placed:
            self._known_at = (here.x_m, here.y_m)
        if self._known_at is None:
            return  # a robot that never knew where it is cannot take part
        placeless = self._placeless(view)
        lost = [(p.x_m, p.y_m) for s, (p, _) in view.neighbours.items() if s in placeless]
        # A robot that does not know its place any more brakes, whatever speed its old senses say.
        speed_m_s = hypot(here.vx_m_s, here.vy_m_s) if view.placed else 0.0
        # A robot that may not drive makes no way for others: they plan round it.
        stopped = state is State.EMERGENCY_STOP or not (view.may_move and view.placed)
        answer = AgreementReply.DEAF if self._deaf(gone, view) else self.answer
        self.agreement.on_tick(
            self._known_at, speed_m_s, self.goal, AgreementReply.STOPPED if stopped else answer,
            (view.live | silent.keys()) - gone, dead, [*self.hazards.hits, *lost], view.now_us,
            placeless,
        )  # fmt: skip

    def _placeless(self, view: FleetView) -> set[int]:
        """Live members that do not know where they are: their newest place is not a new one."""
        return {
            s for s in view.live - {self.slot}
            if s not in view.neighbours
            or view.now_us - view.neighbours[s].heard_at_us >= GONE_QUIET_US
        }  # fmt: skip

    def _deaf(self, gone: set[int], view: FleetView) -> bool:
        """Whether others receive a member that we do not. A round needs reception between all its
        members.
        """
        if not gone:
            return False
        for pose, heard_at_us in view.neighbours.values():
            self._vouched_at_us[pose.heard] = max(
                self._vouched_at_us.get(pose.heard, 0), heard_at_us
            )
        return any(
            self._vouched_at_us.get(s, 0) > view.fell_silent_at_us[s] + DEAD_US
            and view.now_us - self._vouched_at_us[s] < VOUCHED_US
            for s in gone
        )

    # ---------------------------------------------------------------- frames

    def on_message(self, slot: int | None, message: Message, now_us: int) -> Sequence[Record]:
        if isinstance(message, AgreementMessage):
            if slot is not None:
                self.agreement.on_message(slot, message, now_us)
        elif isinstance(message, SilentPosition):
            self.bodies.on_message(message, now_us)
        return ()

    def outgoing(self, now_us: int) -> Iterable[Message]:
        return [
            *self.agreement.outgoing(now_us),
            *self.bodies.outgoing(self.agreement.waiting, now_us),
        ]

    # ---------------------------------------------------------------- driving

    def _go_for(self, section: int) -> None:
        goal = self.goals[self.slot][section - self.slot * GOALS_MAX]
        if goal != self.goal:
            self.goal, self._tracker = goal, None

    def _drive(self, view: FleetView) -> tuple[MotionRequest, bool]:
        """The motion that is wanted now, and whether the goal has been reached."""
        if self.agreement.bound:
            self._tracker, self._planned = None, True  # afterwards we begin from somewhere else
            wish = self._along_plan(view) if self.agreement.phase is AgreementPhase.GO else HOLD
            return wish, self._at_goal((view.here.x_m, view.here.y_m))
        if self.goal is None:
            return HOLD, False
        here = view.here
        tracker = self._path(self.goal, view)
        tracker.locate(here.x_m, here.y_m)
        if tracker.arrived:
            return HOLD, True
        vx_m_s, vy_m_s = tracker.velocity(here.x_m, here.y_m)
        if self.agrees and self._stuck(tracker, hypot(vx_m_s, vy_m_s), view):
            self._call(view.now_us)
        return MotionRequest(vx_m_s, vy_m_s), False

    def _path(self, goal: Point, view: FleetView) -> PathTracker:
        """The path that we follow to the goal: the one we have, if it still serves."""
        here, now_us = view.here, view.now_us
        at, tracker = (here.x_m, here.y_m), self._tracker
        self._keeps_on = self.asks and not view.things
        if tracker is None or abs(tracker.off_m) > LOST_M:
            self.replanning.forget()
            why = "lost" if tracker is not None else "after plan" if self._planned else "goal"
            return self._set_out(self._way(at, goal), why, now_us)
        self.replanning.observe(here, tracker)
        old = self.replanning.restored(here, now_us)
        if old is not None:
            self._tracker = old
            self.followed.append(FollowedPath(now_us, tuple(old.points), "restored"))
            return old
        if self._keeps_on:
            return tracker
        if self._stalled_alone(view, tracker):
            return self._round_what_stalls(goal, view, tracker)
        if self.replanning.due(now_us):
            detour = self.replanning.detour(at, goal, tracker, now_us)
            if detour is not None:
                return self._set_out(detour, "blocked", now_us)
        return tracker

    def _stalled_alone(self, view: FleetView, tracker: PathTracker) -> bool:
        """Whether we want to move and may, and have not moved for `STALLED_ALONE_US` without a
        robot or an obstacle near that explains it.
        """
        at = (view.here.x_m, view.here.y_m)
        wanted_m_s = hypot(*tracker.velocity(*at))
        known = self.replanning.blocked or self._near(view) or not view.may_move
        since = self._alone_since
        moved = since is not None and hypot(at[0] - since[0][0], at[1] - since[0][1]) > GOT_ON_M
        if since is None or moved or known or wanted_m_s < WANTS_M_S:
            self._stalls = 0 if moved else self._stalls
            self._alone_since = (at, view.now_us)
            return False
        return view.now_us - since[1] > STALLED_ALONE_US

    def _round_what_stalls(self, goal: Point, view: FleetView, tracker: PathTracker) -> PathTracker:
        """Another path from here; from the second time on, one that avoids a place right ahead."""
        at, now_us = (view.here.x_m, view.here.y_m), view.now_us
        self._alone_since, self._stalls = (at, now_us), self._stalls + 1
        if self._stalls > 1:
            vx_m_s, vy_m_s = tracker.velocity(*at)
            ahead = (self.floor.radius_m + AHEAD_M) / hypot(vx_m_s, vy_m_s)
            self.hazards.avoid((at[0] + ahead * vx_m_s, at[1] + ahead * vy_m_s), now_us)
        self.replanning.forget()
        return self._set_out(self._way(at, goal), "stalled", now_us)

    def _way(self, at: Point, goal: Point) -> tuple[Point, ...]:
        if self._keeps_on:
            return self.floor.route.path(at, goal)
        prepared = self.next_way.take(at, goal)
        return prepared or self.hazards.path(at, goal) or self.floor.route.path(at, goal)

    def _set_out(self, path: tuple[Point, ...], why: str, now_us: int) -> PathTracker:
        self.followed.append(FollowedPath(now_us, path, why))
        self._tracker = PathTracker(list(path), self.speed_m_s, self.deceleration_m_s2)
        self._gone_on = (0.0, now_us)
        self._planned = False
        return self._tracker

    def _along_plan(self, view: FleetView) -> MotionRequest:
        """The motion along our route of the joint plan, as far as the robots before us have moved
        on.
        """
        agreement, here = self.agreement, view.here
        first, last = max(agreement.index, 0), agreement.permitted
        route = agreement.route
        for index in range(
            agreement.index + 1, last
        ):  # it brakes for its goal, even if the route goes on
            if self._at_goal(self.floor.lattice.point(route[index])):
                last = index
                break
        if self._lane is None or self._lane_of != (agreement.round, first, last):
            points = [self.floor.lattice.point(node) for node in route[first : last + 1]]
            self._lane = PathTracker(points, self.speed_m_s, self.deceleration_m_s2)
            if self._lane_of[0] != agreement.round:
                nodes = (self.floor.lattice.point(node) for node in route)
                way = ((here.x_m, here.y_m), *nodes)
                self.followed.append(FollowedPath(view.now_us, way, "plan"))
            self._lane_of = (agreement.round, first, last)
        lane = self._lane
        lane.locate(here.x_m, here.y_m)
        for index in range(last, agreement.index, -1):
            x_m, y_m = self.floor.lattice.point(route[index])
            along_m = lane.starts_m[index - first] - SETTLED_M
            passed = index > first and lane.along_m >= along_m and abs(lane.off_m) < SETTLED_M
            if passed or hypot(x_m - here.x_m, y_m - here.y_m) < SETTLED_M:
                agreement.reach(index, view.now_us)
                break
        x_m, y_m = self.floor.lattice.point(route[last])
        if hypot(x_m - here.x_m, y_m - here.y_m) < SETTLED_M / 2:
            return HOLD
        return MotionRequest(*lane.velocity(here.x_m, here.y_m))

    def _at_goal(self, at: Point) -> bool:
        """Whether a place is the goal. A goal once reached stays reached, even if the plan leads
        away from it.
        """
        goal = self.goal if self.passes else None
        return goal is not None and hypot(goal[0] - at[0], goal[1] - at[1]) < SETTLED_M

    # ---------------------------------------------------------------- when to call a round

    def _call(self, now_us: int) -> None:
        count, allowed_at_us = self._calls
        if now_us < allowed_at_us:
            return
        self._calls = (count + 1, now_us + CALLS_US[min(count, len(CALLS_US) - 1)])
        self.agreement.call(now_us)

    def _stuck(self, tracker: PathTracker, wanted_m_s: float, view: FleetView) -> bool:
        """Whether to call a round: we make no progress and a robot is near, or a passage ahead is
        taken.
        """
        along_m, start_at_us = self._gone_on
        if tracker.along_m > along_m + GOT_ON_M or wanted_m_s < WANTS_M_S:
            self._gone_on = (tracker.along_m, view.now_us)
        elif view.now_us - start_at_us > STALL_US and self._near(view):
            return True
        return self._head_on(tracker, view)

    def _near(self, view: FleetView) -> bool:
        reach_m = 2 * self.floor.lattice.pitch_m + 2 * self.floor.radius_m
        here = view.here
        near = [*self._around.values(), *self.bodies.dead.values()]
        return any(hypot(x_m - here.x_m, y_m - here.y_m) < reach_m for x_m, y_m in near)

    def _head_on(self, tracker: PathTracker, view: FleetView) -> bool:
        """Whether a robot stands in, or comes out of, a passage that we are about to enter."""
        here, lattice = view.here, self.floor.lattice
        around = [
            n.pose
            for s, n in view.neighbours.items()
            if s in self._around
            and hypot(n.pose.x_m - here.x_m, n.pose.y_m - here.y_m) < 2 * LOOK_M
        ]
        if not around:
            return False
        for x_m, y_m, ux, uy in tracker.ahead(LOOK_M):
            node = lattice.nearest((x_m, y_m))
            if not lattice.narrow[node]:
                continue
            for pose in around:
                if hypot(pose.x_m - x_m, pose.y_m - y_m) > BESIDE_PATH_M:
                    continue
                onward = _onward(pose.course_rad, pose.speed_m_s, ux, uy)
                if onward < WANTS_M_S:
                    return True
        return False


HOLD = STILL._replace(hold=True)


def _now_at(neighbour: Neighbour, now_us: int) -> Point:
    """The position of a robot extrapolated from its last beat."""
    pose, heard_at_us = neighbour
    way_m = pose.speed_m_s * min(now_us - heard_at_us, AGE_MAX_US) / S
    return pose.x_m + way_m * cos(pose.course_rad), pose.y_m + way_m * sin(pose.course_rad)


def _within(neighbour: Neighbour, here: Observation, reach_m: float) -> bool:
    pose = neighbour.pose
    return abs(pose.x_m - here.x_m) < reach_m and abs(pose.y_m - here.y_m) < reach_m


def _onward(course_rad: float, speed_m_s: float, ux: float, uy: float) -> float:
    """Speed of a robot along the direction (ux, uy), metres a second."""
    return speed_m_s * (cos(course_rad) * ux + sin(course_rad) * uy)
