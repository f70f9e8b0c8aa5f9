"""From a motion request to a drive: neighbours, limits, and the velocity that avoids collisions.

The pipeline of one control period ends here, except for the safety gate, which comes after it. The
position of a neighbour is its last beat extrapolated by its age, with a margin for rounding. A
standing neighbour does not avoid us, so we do all of the avoidance. `agent/motion/stopping_zone.py`
says where a silent robot may have come to rest.
"""

from collections.abc import Mapping
from math import cos, hypot, sin
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.fence_braking import braking_first
from agent.avoidance.orca import OrcaSolver
from agent.interface.config import CONTROL_PERIOD_US, NEIGHBOURS_MAX, S
from agent.interface.effects import HALT, Drive
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits, MotionController
from agent.interface.observation import Neighbour, Observation
from agent.motion.deadlock_yield import DeadlockYield, NearbyRobot
from agent.motion.implement_clearance import Implement
from agent.motion.obstacle_detector import ObstacleDetector
from agent.motion.obstacle_stop import ObstacleStop
from agent.motion.pushed_ahead import PushedAhead
from agent.motion.right_of_way import RightOfWay
from agent.motion.sensed_walls import fences_of
from agent.motion.stopping_zone import StoppingZone
from agent.motion.unexplained_echoes import UnexplainedEchoes, thinned

# The margins grow with the accuracy of our own place: 19 of 20 places are within two deviations. Walls
# that the range sensors see are where they are seen, whatever the place is.
ACCURACIES: Final = 2.0
# A place that is worse, or whose accuracy is infinite or no number, has stopped the robot already
# (`POSITION_ACCURACY_M` of `agent/peer/sense_freshness.py`): here it counts as this.
INACCURATE_M: Final = 0.5
MARGIN_M: Final = 0.15  # POSE rounds to 0.05 m, a drive takes a period to act, wheels slip
HORIZON_S: Final = 4.0  # how far ahead two moving robots avoid a collision
STANDING_M_S: Final = 0.05  # slower than this a neighbour cannot be relied on to give way
AGE_MAX_US: Final = 1 * S  # an older pose is not extrapolated, because the robot may have stopped
UNHEARD_US: Final = 5 * S  # a neighbour not received for this long may be anywhere
# Nearest possible places of a silent member: 1.5 m of its way, which we can meet before stopping.
PLACES_MAX: Final = 4
FENCE_M: Final = 0.2  # distance kept from fences and holes
# So much further from fences, at most, with an inaccurate place: more would close ways that were planned
# (`CLEARANCE_M` of `agent/field/field_plan.py`). A field needs 0.075 m: twice this is within `FENCE_M`.
FENCE_SPARE_M: Final = 0.04
FIELD_RADIUS_M: Final = 0.8  # body radius for which the distances of deadlock yielding are set
_tuple = tuple.__new__  # faster than keyword arguments; one is made each period for each neighbour


def _square(row: tuple[float, ...]) -> float:
    return row[0] * row[0] + row[1] * row[1]


def _place_error_m(here: Observation) -> float:
    """How far from its true place the robot may sense itself."""
    return ACCURACIES * min(INACCURATE_M, here.position_accuracy_m)


class HolonomicMotion(MotionController):
    """The motion controller of a body that can drive in any direction at any heading."""

    steers = False  # its course turns as the body does

    def __init__(
        self,
        slot: int,
        limits: BodyLimits,
        fences: NDArray[np.float64] | None,
        *,
        fence_m: float = FENCE_M,
        horizon_s: float = HORIZON_S,
        gives_way: bool = True,
        keep_right_rad: float = 0.0,
        looks: bool = False,
        stops: bool = False,
        asks: bool = False,
        half_bar_m: float = 0.0,
        overlap_m: float = 0.0,
    ) -> None:
        """`slot`: ours. `limits`: our body; all bodies are taken to be alike. `fences`: impassable
        segments (n, 4) of ax, ay, bx, by in metres. None: use the walls that the range sensors see,
        for a robot among unknown walls.

        `fence_m`: distance kept from fences. `horizon_s`: how far ahead collisions are avoided.
        `gives_way`: False if the mission itself decides which robot goes first. `keep_right_rad`:
        see `OrcaSolver`. `looks`: go round everything that the range sensors see and that neither a
        fence nor a robot explains; the fences must be complete. `stops`: keep enough distance to
        stop behind a robot ahead that halts. `asks`: stop before an unannounced obstacle and ask an
        operator, even if `looks` would go round it; not without known fences. `half_bar_m`: see
        `Implement`. `overlap_m`: so much longer is the bar at each end.
        """
        self.slot, self.limits = slot, limits
        self.sensing = fences is None
        fences = np.empty((0, 4)) if fences is None else fences
        self.fences = np.asarray(fences, dtype=np.float64).reshape(-1, 4)
        # A larger change of velocity takes the body more than two control periods.
        self.sudden_m_s = 2 * limits.acceleration_m_s2 * CONTROL_PERIOD_US / S
        self.spare_m = min(fence_m, FENCE_SPARE_M)
        self.avoidance = OrcaSolver(
            limits.radius_m + fence_m, limits.speed_m_s, 0.5 * limits.acceleration_m_s2,
            horizon_s, CONTROL_PERIOD_US / S, fences, keep_right_rad=keep_right_rad,
            stopping_m_s2=limits.acceleration_m_s2 if stops else 0.0,
        )  # fmt: skip
        # No robot further away can be met within the horizon, both at full speed.
        self.reach_m = 2 * limits.speed_m_s * horizon_s + 2 * limits.radius_m
        self.sensed = UnexplainedEchoes(fences, limits.radius_m) if looks else None
        self.right = RightOfWay()
        self.implement = Implement(half_bar_m, limits.radius_m)
        self.whole_half_bar_m = half_bar_m + overlap_m  # to its very end
        self.change_m_s = limits.acceleration_m_s2 * CONTROL_PERIOD_US / S  # in one period
        self.told_m_s = 0.0, 0.0  # of wheels without slip by the commands so far: x, y
        self.pushed: PushedAhead | None = None
        if self.implement.has:
            self.pushed = PushedAhead(
                limits.radius_m, limits.speed_m_s, self.implement.aside_m, fences
            )
        self.coasting = StoppingZone(limits.radius_m, limits.acceleration_m_s2)
        self.state = State.IDLE  # ours, as the beat says
        self.strange: list[tuple[float, float]] = []  # seen at the last control period
        self.others: list[NearbyRobot] = []  # within reach at the last control period
        # A robot that stops and asks must know every wall beforehand.
        self.lookout: ObstacleDetector | None = None
        assert not (asks and self.sensing)
        if asks or not (looks or self.sensing):
            self.lookout = ObstacleDetector(
                limits.radius_m, limits.acceleration_m_s2, fences, self.coasting
            )
        self.giving_way: DeadlockYield | None = None
        if gives_way:
            scale = limits.radius_m / FIELD_RADIUS_M if self.sensing else 1.0
            self.giving_way = DeadlockYield(
                slot, limits.radius_m, limits.speed_m_s, fences, scale, self.implement.near_m
            )

    @property
    def body_limits(self) -> BodyLimits:
        """Size and dynamic limits of the body."""
        return self.limits

    def set_state(self, state: State) -> None:
        """Our own lifecycle state, as our beats report it."""
        self.state = state

    def obstacle_question(self) -> ObstacleStop | None:
        """A new obstacle stop; None for a robot that does not know every wall: it cannot tell a
        person from one.
        """
        if self.lookout is None:
            return None
        return ObstacleStop(
            self.slot, self.limits, self.lookout, self.whole_half_bar_m, self.steers
        )

    def drive(
        self,
        here: Observation,
        wish: MotionRequest,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Drive:
        """The drive nearest to the mission's request that collides with nothing known.

        Called once each control period. A request to hold gives a halt. The implement is up while
        the robot gives way, and where a lowered one would hit a body.
        """
        if wish.hold:  # others go round a standing robot, so standing still is safe
            self._tell(0.0, 0.0)
            return HALT._replace(parcel_action=wish.parcel_action)
        rows, others = self._rows(here, neighbours, now_us, not wish.tool_on)
        if self.sensed is not None:
            rows = self._look(here, rows)
        if self.sensing:
            bodies = [(here.x_m + o.dx_m, here.y_m + o.dy_m, self.limits.radius_m) for o in others]
            self.fences = seen = fences_of(here, bodies)
            self.avoidance.fence(seen)
            if self.giving_way is not None:
                self.giving_way.fences = seen
        wanted, tool_on = self._limited(wish), wish.tool_on
        other = None
        if self.giving_way is not None:
            other = self.giving_way.wish((here.x_m, here.y_m), wanted, others, now_us)
        aside = None
        if self.pushed is not None and not tool_on:
            aside = self.pushed.wish((here.x_m, here.y_m), others, now_us)
            other = other if aside is None else aside
        if other is not None:
            wanted, tool_on = other, False
        if tool_on and self.implement.must_be_up(here, wanted, others, self.slot):
            tool_on = False
        more_m = 0.0 if self.sensing else min(self.spare_m, _place_error_m(here))
        self.avoidance.keep_more_from_fences(more_m)
        vx_m_s, vy_m_s = self.avoidance.velocity(
            (here.x_m, here.y_m), (here.vx_m_s, here.vy_m_s), wanted, rows
        )
        if self.pushed is not None and aside is None:
            self.pushed.observe(wanted, (vx_m_s, vy_m_s), now_us)
        if hypot(vx_m_s - here.vx_m_s, vy_m_s - here.vy_m_s) > self.sudden_m_s:
            vx_m_s, vy_m_s = braking_first(
                here.x_m, here.y_m, here.vx_m_s, here.vy_m_s, vx_m_s, vy_m_s, *self.told_m_s,
                self.fences, self.limits.radius_m + FENCE_M / 2 + more_m, self.limits.acceleration_m_s2,
            )  # fmt: skip
        self._tell(vx_m_s, vy_m_s)
        return _tuple(Drive, (vx_m_s, vy_m_s, wish.turn_rad_s, tool_on, wish.parcel_action))

    def _tell(self, vx_m_s: float, vy_m_s: float) -> None:
        """The wheels are told this velocity, and follow as fast as they can."""
        told_x_m_s, told_y_m_s = self.told_m_s
        dx_m_s, dy_m_s = vx_m_s - told_x_m_s, vy_m_s - told_y_m_s
        share = min(1.0, self.change_m_s / max(hypot(dx_m_s, dy_m_s), self.change_m_s))
        self.told_m_s = told_x_m_s + share * dx_m_s, told_y_m_s + share * dy_m_s

    def _rows(
        self, here: Observation, neighbours: Mapping[int, Neighbour], now_us: int,
        keeps_off: bool = False,
    ) -> tuple[list[tuple[float, ...]], list[NearbyRobot]]:  # fmt: skip
        """Neighbours within reach, as rows for ORCA (nearest first, at most `NEIGHBOURS_MAX`) and
        as robots.

        A row: dx, dy, vx, vy in metres and metres a second, the distance to keep from middle to
        middle, our share of the avoidance, and the seconds by which the pose was extrapolated.
        `keeps_off`: keep the distance that a lowered implement needs.
        """
        near: list[tuple[float, ...]] = []
        others: list[NearbyRobot] = []
        bodies_m = 2 * self.limits.radius_m + MARGIN_M + _place_error_m(here)
        keeps_off = keeps_off and self.implement.has
        self.coasting.observe(neighbours, here, now_us)
        own_x_m, own_y_m, reach_m = here.x_m, here.y_m, self.reach_m
        for slot, (pose, heard_at_us) in neighbours.items():
            pose_x_m, pose_y_m, course_rad, speed_m_s, state, stopped, _, at_work = pose
            dx_m, dy_m = pose_x_m - own_x_m, pose_y_m - own_y_m
            if abs(dx_m) > reach_m or abs(dy_m) > reach_m:
                continue
            share, vx_m_s, vy_m_s, moved_on_for_s = 1.0, 0.0, 0.0, 0.0
            age_us = now_us - heard_at_us
            if self.sensed is not None and age_us > UNHEARD_US and len(here.ranges_m):
                continue  # it may be anywhere by now, but the range sensors see it
            places = self.coasting.places(slot)
            if places is not None:
                offsets = [(x_m - own_x_m, y_m - own_y_m) for x_m, y_m in places]
                offsets.sort(key=lambda d: d[0] * d[0] + d[1] * d[1])
                others += [NearbyRobot(slot, *offset, state) for offset in offsets[:1]]
                near += [(*d, 0.0, 0.0, bodies_m, 1.0, 0.0) for d in offsets[:PLACES_MAX]]
                continue
            if speed_m_s > STANDING_M_S and age_us < AGE_MAX_US and not stopped:
                vx_m_s, vy_m_s = speed_m_s * cos(course_rad), speed_m_s * sin(course_rad)
                moved_on_for_s = age_us / S
                dx_m, dy_m = dx_m + vx_m_s * moved_on_for_s, dy_m + vy_m_s * moved_on_for_s
                share = self.right.share(slot, self.state, state, age_us, now_us)
            combined_m = bodies_m
            if keeps_off and at_work:
                combined_m = self.implement.combined_m(hypot(dx_m, dy_m), bodies_m)
            ux, uy = (0.0, 0.0)
            if speed_m_s > STANDING_M_S:
                ux, uy = cos(course_rad), sin(course_rad)
            others.append(_tuple(NearbyRobot, (slot, dx_m, dy_m, state, ux, uy, at_work)))
            near.append((dx_m, dy_m, vx_m_s, vy_m_s, combined_m, share, moved_on_for_s))
        self.others = others
        if len(near) > 1:
            near.sort(key=_square)
        return near[:NEIGHBOURS_MAX], others

    def _look(self, here: Observation, rows: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        """The rows with unexplained echoes added. These count as standing, so we do all of the
        avoidance.
        """
        assert self.sensed is not None
        bodies = [(here.x_m + row[0], here.y_m + row[1]) for row in rows]
        self.strange = self.sensed.strange(here, self.reach_m / 2, bodies)
        if not self.strange:
            return rows
        combined_m = self.limits.radius_m + MARGIN_M + _place_error_m(here)
        free = max(NEIGHBOURS_MAX - len(rows), NEIGHBOURS_MAX // 2)
        seen: list[tuple[float, ...]] = [
            (x - here.x_m, y - here.y_m, 0.0, 0.0, combined_m, 1.0)
            for x, y in thinned(self.strange, free)
        ]
        both = sorted(rows + seen, key=lambda row: hypot(row[0], row[1]) - row[4])
        return both[:NEIGHBOURS_MAX]

    def _limited(self, wish: MotionRequest) -> tuple[float, float]:
        speed_m_s = hypot(wish.vx_m_s, wish.vy_m_s)
        if speed_m_s <= self.limits.speed_m_s:
            return wish.vx_m_s, wish.vy_m_s
        scale = self.limits.speed_m_s / speed_m_s
        return wish.vx_m_s * scale, wish.vy_m_s * scale
