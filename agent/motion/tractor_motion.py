"""From a motion request to a drive for steered bodies: keep to the path, slow or stop for others.

A tractor cannot follow ORCA's velocities, so ORCA only limits the speed along its own course. Its
disc is larger by the tracking and steering error (the argument of NH-ORCA, Alonso-Mora et al.
2010). The path planner handles fences: a path never leaves free ground. A body that left its path
stops before a fence, and its mission plans another one from there. Of two tractors nose to
nose, the one with the higher slot backs away by one arc and waits. Its mission replans from there.
One that fences hold in front and behind, or a fence and another body, turns on the spot, if it can.
"""

from collections.abc import Mapping
from functools import partial
from math import atan2, ceil, copysign, cos, hypot, inf, sin

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.fence_distance import gap_m
from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.effects import Drive
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits as Body
from agent.interface.observation import Neighbour, Observation
from agent.motion.deadlock_yield import NearbyRobot
from agent.motion.holonomic_motion import MARGIN_M, HolonomicMotion
from agent.motion.in_place_rotation import AWAY_M, InPlaceRotation
from agent.motion.obstacle_detector import ObstacleDetector, stopping_m
from agent.motion.tractor_escape import EscapeManoeuvre
from agent.motion.tractor_tracker import HOLD_M_S, SteeredWheels, SteeringLimits
from agent.paths.dubins import step
from agent.paths.tractor_route import TurnRoute, VehiclePose

DISC_M = 0.2  # extra disc radius for the tracking error and the swing into an arc
SHARES = (1.0, 0.8, 0.6, 0.4, 0.25, 0.12)  # of the wanted speed, tried in this order
SAME_M_S = 0.03  # a velocity that ORCA changes by less is permitted
TOO_NEAR_M = 0.02  # so far outside the discs, only motion away from the other body is permitted
PATIENCE_US = 1_500 * MS  # after this time without progress the robot with the higher slot escapes
LONG_PATIENCE_US = 6 * S  # the same for the robot with the lower slot
WAIT_US = 8 * S  # maximum wait after backing away
APART_M = 5.0  # at this distance between bodies the way is free again
NEAR_M = 1.8  # a robot further away is not the reason why we stand
GOT_ON_M = 0.4  # a move of this length is progress
# From hull to fence, where the body stops. It may move by 2 cm while its wheels are turned.
FENCE_STOP_M, HOLD_STOP_M = 0.03, 0.01
FENCE_LOOK_M = 0.2  # between places of a way that is looked at for fences
HALF_PERIOD_S = CONTROL_PERIOD_US / S / 2  # the course is that of the middle of the control period


class TractorMotion(HolonomicMotion):
    """The motion controller of a body that steers (bicycle model)."""

    steers = True

    def __init__(
        self, slot: int, limits: Body, turns: TurnRoute, steering: SteeringLimits,
        fences: NDArray[np.float64], half_bar_m: float = 0.0, wheels: SteeredWheels | None = None,
        turns_on_the_spot: bool = False, overlap_m: float = 0.0,
    ) -> None:  # fmt: skip
        """`slot`: ours. `limits`: our body; all bodies are taken to be alike. `turns`: knows which
        arcs stay on free ground. `steering`: our chassis. `fences`: known segments (n, 4) of ax,
        ay, bx, by in metres. `half_bar_m`, `overlap_m`: see `HolonomicMotion`. `wheels`: of our
        chassis; they are told here what is commanded. `turns_on_the_spot`: it can.
        """
        # A body that cannot swerve stops behind another one that halts in its way.
        super().__init__(
            slot, limits, np.empty((0, 4)), stops=True, half_bar_m=half_bar_m, overlap_m=overlap_m
        )
        self.lookout = ObstacleDetector(
            limits.radius_m, limits.acceleration_m_s2, fences, self.coasting
        )
        self._braking_m_s2 = steering.deceleration_m_s2
        self.known_fences = fences
        self.wheels = wheels or SteeredWheels(steering.steer_1_m_s)
        self.escape = EscapeManoeuvre(turns, limits.radius_m, steering, self.wheels)
        self.rotation = InPlaceRotation() if turns_on_the_spot else None
        self.given = 0
        self._anchor, self._anchor_at_us = (0.0, 0.0), 0
        self._wait_ends_at_us = 0
        self._for = -1
        self._is_cornered = False  # another body blocks it, and no piece leads away from that body

    def drive(
        self,
        here: Observation,
        wish: MotionRequest,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Drive:
        """The share of the mission's request that is safe now, or an escape from a robot that we
        block.

        Called once each control period. The curvature of the request is kept at any share.
        """
        rows, others = self._rows(here, neighbours, now_us)
        pose = VehiclePose(here.x_m, here.y_m, here.heading_rad)
        places = {o.slot: (here.x_m + o.dx_m, here.y_m + o.dy_m) for o in others}
        self._is_cornered = False
        if now_us < self._wait_ends_at_us:
            wish = self._out_of_the_way(pose, places)
        elif self._stalled(pose, wish, now_us):
            close = [o for o in others if o.distance_m < 2 * self.limits.radius_m + NEAR_M]
            wish = self._decide(pose, wish, close, places, now_us)
        ahead = wish.vx_m_s * cos(here.heading_rad) + wish.vy_m_s * sin(here.heading_rad)
        permitted = self._permitted(here, wish, rows)
        share = self._before_fences(here, wish, permitted)
        if self.rotation is not None:
            is_held = share == 0.0 and (permitted > 0.0 or self._is_cornered)
            away_m = partial(self._away_m, here, rows)
            turn_rad_s = self.rotation.turn_rad_s(
                pose, copysign(1.0, ahead), is_held, away_m, now_us
            )
            if turn_rad_s is not None:
                return Drive(0.0, 0.0, turn_rad_s, False)
        # Down while it waits, too: the ground under it is then not worked twice.
        tool_on = wish.tool_on and not self.implement.must_be_up(
            here, (wish.vx_m_s, wish.vy_m_s), others, self.slot
        )
        speed_m_s = copysign(hypot(wish.vx_m_s, wish.vy_m_s), ahead)
        self.wheels.command(speed_m_s * share, wish.turn_rad_s * share)
        return Drive(wish.vx_m_s * share, wish.vy_m_s * share, wish.turn_rad_s * share, tool_on)

    def _before_fences(self, here: Observation, wish: MotionRequest, share: float) -> float:
        """As much of this share as lets the body come to rest before a fence, or drive away from it.

        Paths keep `FENCE_M` from fences. A body that left its path may be nearer.
        """
        asked_m_s = hypot(wish.vx_m_s, wish.vy_m_s)
        now_m = gap_m(here.x_m, here.y_m, self.known_fences)
        keep_m = self.limits.radius_m + FENCE_STOP_M
        way_m = stopping_m(asked_m_s * share, self._braking_m_s2)
        if not asked_m_s or now_m > keep_m + way_m:
            return share
        if asked_m_s <= HOLD_M_S:
            keep_m = self.limits.radius_m + HOLD_STOP_M
        course_rad = atan2(wish.vy_m_s, wish.vx_m_s)
        backward = cos(course_rad - here.heading_rad) < 0.0
        # The wheels are still on their way to the curvature of the request.
        wheels_1_m = -self.wheels.curvature_1_m if backward else self.wheels.curvature_1_m
        bend_1_m = (wheels_1_m + wish.turn_rad_s / asked_m_s) / 2
        for part in SHARES:
            way_m = stopping_m(asked_m_s * share * part, self._braking_m_s2)
            if self._gap_on_way_m(here, course_rad, bend_1_m, way_m) >= min(keep_m, now_m):
                return share * part
        return 0.0

    def _away_m(self, here: Observation, rows: list[tuple[float, ...]], course_rad: float) -> float:
        """By how much a body that drives straight on gets away from fences, metres; negative: it would
        get too near to one, or avoidance would not let it begin."""
        if _closes(rows, cos(course_rad), sin(course_rad)):
            return -1.0
        now_m = gap_m(here.x_m, here.y_m, self.known_fences)
        least_m = self._gap_on_way_m(here, course_rad, 0.0, AWAY_M)
        if least_m < min(self.limits.radius_m + FENCE_STOP_M, now_m):
            return -1.0
        x_m, y_m, _ = step(here.x_m, here.y_m, course_rad, 0.0, AWAY_M)
        return gap_m(x_m, y_m, self.known_fences) - now_m

    def _gap_on_way_m(
        self, here: Observation, course_rad: float, bend_1_m: float, way_m: float
    ) -> float:
        """The least distance of the middle of the body to a fence on an arc from here."""
        steps = ceil(way_m / FENCE_LOOK_M)
        gaps_m = []
        for k in range(1, steps + 1):
            x_m, y_m, _ = step(here.x_m, here.y_m, course_rad, bend_1_m, way_m * k / steps)
            gaps_m.append(gap_m(x_m, y_m, self.known_fences))
        return min(gaps_m, default=inf)

    def _permitted(
        self, here: Observation, wish: MotionRequest, rows: list[tuple[float, ...]]
    ) -> float:
        """The share of the wanted velocity that collides with no robot."""
        if wish.vx_m_s == 0.0 and wish.vy_m_s == 0.0:
            return 0.0
        if _closes(rows, wish.vx_m_s, wish.vy_m_s):
            return 0.0
        facing: list[tuple[float, ...]] = [
            (dx_m, dy_m, vx_m_s, vy_m_s, combined_m + DISC_M, 1.0)
            for dx_m, dy_m, vx_m_s, vy_m_s, combined_m, *_ in rows
            if not _is_too_near(dx_m, dy_m, combined_m)
        ]
        at, moving = (here.x_m, here.y_m), (here.vx_m_s, here.vy_m_s)
        for share in SHARES:
            wanted = wish.vx_m_s * share, wish.vy_m_s * share
            got = self.avoidance.velocity(at, moving, wanted, facing)
            if hypot(got[0] - wanted[0], got[1] - wanted[1]) < SAME_M_S:
                return share
        return 0.0

    def _stalled(self, pose: VehiclePose, wish: MotionRequest, now_us: int) -> bool:
        # A body that waits until its wheels are turned is not held up by another one.
        wants = hypot(wish.vx_m_s, wish.vy_m_s) > HOLD_M_S
        moved_m = hypot(pose.x_m - self._anchor[0], pose.y_m - self._anchor[1])
        if moved_m > GOT_ON_M or not wants:
            self._anchor, self._anchor_at_us = pose[:2], now_us
        return now_us - self._anchor_at_us >= PATIENCE_US

    def _decide(
        self, pose: VehiclePose, wish: MotionRequest, close: list[NearbyRobot],
        places: Mapping[int, tuple[float, float]],
        now_us: int,
    ) -> MotionRequest:  # fmt: skip
        ahead = [o for o in close if o.dx_m * wish.vx_m_s + o.dy_m * wish.vy_m_s > 0.0]
        if not ahead:
            return wish
        blocker = min(ahead, key=lambda o: (o.distance_m, o.slot))
        first = blocker.slot < self.slot
        if not first and now_us - self._anchor_at_us < LONG_PATIENCE_US:
            return wish
        self.escape.follow = None
        self._for = blocker.slot
        if self.escape.find(pose, [places[blocker.slot]], list(places.values())) is None:
            self._is_cornered = True
            return wish
        self.given += 1
        self._wait_ends_at_us = now_us + WAIT_US
        self._anchor_at_us = self._wait_ends_at_us
        return self._out_of_the_way(pose, places)

    def _out_of_the_way(
        self, pose: VehiclePose, places: Mapping[int, tuple[float, float]]
    ) -> MotionRequest:
        other = places.get(self._for)
        if other is None or (
            hypot(other[0] - pose.x_m, other[1] - pose.y_m)
            > 2 * self.limits.radius_m + MARGIN_M + APART_M
        ):
            self._wait_ends_at_us = 0
            self.escape.follow = None
            return MotionRequest(0.0, 0.0)
        gap_m = hypot(other[0] - pose.x_m, other[1] - pose.y_m)
        near = [other] if gap_m < 2 * self.limits.radius_m + NEAR_M + 1.0 else []
        command = self.escape.go(pose, near, list(places.values()))
        if command is None:
            return MotionRequest(0.0, 0.0)
        speed_m_s, turn_rad_s = command
        course = pose.heading_rad + turn_rad_s * HALF_PERIOD_S
        return MotionRequest(speed_m_s * cos(course), speed_m_s * sin(course), turn_rad_s)


def _is_too_near(dx_m: float, dy_m: float, combined_m: float) -> bool:
    return hypot(dx_m, dy_m) < combined_m + DISC_M + TOO_NEAR_M


def _closes(rows: list[tuple[float, ...]], east: float, north: float) -> bool:
    """Whether a motion in this direction goes towards a body that is too near already."""
    return any(
        dx_m * east + dy_m * north > 0.0 and _is_too_near(dx_m, dy_m, combined_m)
        for dx_m, dy_m, _, _, combined_m, *_ in rows
    )
