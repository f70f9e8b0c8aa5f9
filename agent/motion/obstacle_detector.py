"""Detects unannounced obstacles in the way: neither a known fence nor a known robot, so perhaps a
person.

An echo is explained if it lies at a known fence or hole, or where a known robot may be. A robot may
be between its last pose and its extrapolation, or where it may have come to rest
(`agent/motion/stopping_zone.py`). An unexplained echo within stopping distance along the motion is
an obstacle. From then on all unexplained echoes near by are kept as points, until the two rays on
either side of a point both pass it. So a standing body wider than the gap between two rays is not
lost. Bodies narrower than that gap at stopping distance can be missed.

Under a policy that goes on without silent members, two parts of a fleet that is cut drive in one
field and know nothing of each other. So while a member is silent, the nearest unexplained echo is
also compared with itself a quarter of a second ago. One that comes nearer by itself stops the robot
in time for both to brake, in whatever direction it is.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from math import atan2, ceil, cos, dist, floor, hypot, inf, pi, sin
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.fence_distance import gap_m, way_gap_m
from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, S
from agent.interface.geometry import Point
from agent.interface.observation import Neighbour, Observation
from agent.motion.stopping_zone import StoppingZone
from agent.motion.swept_ground import SweptGround
from protocol.frames.fleet_frames import Pose

GroundCell = tuple[int, int]  # a square of the ground: one point is remembered in each

REACTION_S: Final = (ACTUATOR_TTL_US + CONTROL_PERIOD_US) / S  # until a halt is in force
MARGIN_M: Final = 0.6  # distance left between the hull and the obstacle
BESIDE_M: Final = 0.15  # margin kept on either side; ORCA's margin
# What is left of it beside a confirmed obstacle, which a robot passes slowly.
PASSING_M: Final = 0.1
# An echo this near to a fence is the fence: maps and poses are not perfect.
FENCE_TOLERANCE_M: Final = 0.25
ROBOT_TOLERANCE_M: Final = 0.35  # round a known robot: POSE rounds, courses bend between two beats
# Round the places where a silent robot may stand, or one that does not know its place. ORCA keeps
# `BESIDE_M` from them, so a hull that is further out would be touched.
SILENT_TOLERANCE_M: Final = 0.1
assert SILENT_TOLERANCE_M < BESIDE_M, "avoidance keeps clear of what silent robots explain"
WATCH_M: Final = 8.0  # points are kept up to this distance
CHAIN_M: Final = 1.5  # echoes this close together are one thing
GRAIN_M: Final = 0.25  # side of a ground cell
BEYOND_M: Final = 0.4  # a ray that reaches this much further than a point has passed it
# A ray that ends this near to a fence shows that nothing else is on its way, and that a point behind the
# fence was noise. No ray reaches `BEYOND_M` further than a point in the strip before a fence.
AT_FENCE_M: Final = 0.2
# Such a ray ends at least this much before the point or behind it, or it ends where it meets the fence.
# One that ends at a known robot ends behind the point.
NEARER_M: Final = 0.1
LOOK_M: Final = 0.1  # between places of a way that is looked at for fences
FINE_LOOK_M: Final = 0.02  # the same round the end of a ray
assert AT_FENCE_M < FENCE_TOLERANCE_M, "what such a ray has passed is not the fence"
# What comes nearer by itself, while members are silent, is looked for up to `WATCH_M`.
APPROACH_OVER: Final = 5  # control periods over which it is measured
APPROACH_US: Final = (APPROACH_OVER - 1) * CONTROL_PERIOD_US  # at least; and twice that at most
APPROACHES_M_S: Final = 0.1  # by itself, so that it is no standing thing
# Two robots that cross brake with less than the sum of what each of them can.
CROSSING_SHARE: Final = 0.7
SAME_M: Final = (
    0.3  # an unexplained echo this much further than the nearest one is of the same hull
)
FORGET_US: Final = 300 * S  # a point that was not observed again for this long is dropped


class Detection(NamedTuple):
    """An obstacle in the way: its nearest point (x, y), and the free distance before the hull."""

    x_m: float  # the nearest point of it
    y_m: float
    free_m: float  # from the hull along the motion


class NearestEcho(NamedTuple):
    """Of what is neither a fence nor a robot that is heard, and where our body was."""

    at_us: int
    range_m: float  # from our middle
    x_m: float
    y_m: float


def stopping_m(speed_m_s: float, deceleration_m_s2: float) -> float:
    """Way to a standstill: reaction and braking, metres."""
    return speed_m_s * REACTION_S + speed_m_s * speed_m_s / (2 * deceleration_m_s2)


class ObstacleDetector:
    """The unexplained echoes that one robot remembers, and the nearest of them in its way."""

    def __init__(
        self, radius_m: float, deceleration_m_s2: float, fences: NDArray[np.float64],
        coasting: StoppingZone,
    ) -> None:  # fmt: skip
        """`radius_m`, `deceleration_m_s2`: of our body. `fences`: known segments (n, 4) of ax, ay,
        bx, by in metres. `coasting`: where silent robots may stand; our motion controller updates
        it.
        """
        self.radius_m, self.deceleration_m_s2 = radius_m, deceleration_m_s2
        self.fences, self.coasting = fences, coasting
        # The newest point in each ground cell, and when it was seen.
        self.points: dict[GroundCell, tuple[Point, int]] = {}
        self._nearest: deque[NearestEcho] = deque(maxlen=APPROACH_OVER + 1)

    def stopping_m(self, speed_m_s: float) -> float:
        """Way to a standstill from this speed: reaction and braking, metres."""
        return stopping_m(speed_m_s, self.deceleration_m_s2)

    def observe(
        self,
        here: Observation,
        motions: Sequence[Point],
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Detection | None:
        """Once each control period: the nearest obstacle in the way of the motions; None if there
        is none.

        `here`: our observation with its rays. `motions`: velocities that the body has or may have
        next, (x, y) metres a second. `neighbours`: newest poses by slot.
        """
        if not here.ranges_m:
            return None
        if self.points:
            self._forget(here, neighbours, now_us)
            self._explain(here, neighbours, now_us)
        if not self.points and not self._is_strange(here, motions, neighbours, now_us):
            return None
        everything = self._echoes(here, WATCH_M, None)
        self._remember(self._strange(everything, here, neighbours, now_us), now_us)
        seen = [self.ahead(here, motion, self.reach_m(hypot(*motion))) for motion in motions]
        return min((s for s in seen if s is not None), key=lambda s: s.free_m, default=None)

    def is_approached(
        self, here: Observation, neighbours: Mapping[int, Neighbour], now_us: int
    ) -> bool:
        """Whether something unexplained comes nearer by itself, while members are silent, and is so near
        that we and it have to brake. Called once each control period.

        `here`: our observation with its rays. `neighbours`: newest poses by slot.
        """
        if not here.ranges_m or not self.coasting.is_any:
            self._nearest.clear()
            return False
        echoes = self._echoes(here, WATCH_M, None)
        unheard = self._off_fences(self._off_heard(echoes, here, neighbours, now_us))
        if not unheard:
            self._nearest.clear()
            return False
        at = here.x_m, here.y_m
        x_m, y_m = min(unheard, key=lambda echo: dist(echo, at))
        range_m, then = dist((x_m, y_m), at), self._nearest[0] if self._nearest else None
        self._nearest.append(NearestEcho(now_us, range_m, here.x_m, here.y_m))
        passed_for_us = 0 if then is None else now_us - then.at_us
        if then is None or not APPROACH_US <= passed_for_us <= 2 * APPROACH_US:
            return False
        passed_for_s = passed_for_us / S
        closing_m_s = (then.range_m - range_m) / passed_for_s
        gap_to_it_m = range_m - self.radius_m - PASSING_M
        braking_m = closing_m_s**2 / (2 * CROSSING_SHARE * self.deceleration_m_s2)
        if closing_m_s <= 0.0 or gap_to_it_m > closing_m_s * REACTION_S + braking_m:
            return False
        # If it stands, no point of it was further than where the nearest one is now, but for what a round
        # hull has between two rays.
        itself_m = then.range_m - dist((x_m, y_m), (then.x_m, then.y_m))
        between_m = then.range_m * 2 * pi / len(here.ranges_m)
        if itself_m < APPROACHES_M_S * passed_for_s + between_m**2 / (8 * self.radius_m):
            return False
        near = [echo for echo in unheard if dist(echo, at) <= range_m + SAME_M]
        return bool(self._off_silent(near, here, neighbours))

    def _is_strange(
        self,
        here: Observation,
        motions: Sequence[Point],
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> bool:
        """Whether anything unexplained is in the way of one of the motions."""
        fastest_m_s = 0.0
        for vx_m_s, vy_m_s in motions:
            fastest_m_s = max(fastest_m_s, hypot(vx_m_s, vy_m_s))
        reach_m = self.reach_m(fastest_m_s)
        if not motions or min(here.ranges_m) > reach_m:
            return False
        for motion in motions:
            echoes = self._echoes(here, reach_m, motion)
            if echoes and self._strange(echoes, here, neighbours, now_us):
                return True
        return False

    def reach_m(self, speed_m_s: float) -> float:
        """Distance from our middle beyond which obstacles do not matter yet."""
        return self.radius_m + MARGIN_M + self.stopping_m(speed_m_s)

    def ahead(
        self, here: Observation, velocity: Point, reach_m: float, beside_to_m: float = 0.0
    ) -> Detection | None:
        """The nearest remembered point in the strip that the hull will pass; None for a velocity of
        zero.

        `velocity`: direction of the strip. `reach_m`: its length from our middle. `beside_to_m`: up
        to this far from our middle along the strip, points that the hull passes at `PASSING_M` or
        more are left out.
        """
        speed_m_s = hypot(*velocity)
        if speed_m_s == 0.0:
            return None
        ux, uy = velocity[0] / speed_m_s, velocity[1] / speed_m_s
        best: Detection | None = None
        for (x_m, y_m), _ in self.points.values():
            dx_m, dy_m = x_m - here.x_m, y_m - here.y_m
            along_m, across_m = dx_m * ux + dy_m * uy, abs(dy_m * ux - dx_m * uy)
            if not 0.0 < along_m <= reach_m or across_m > self.radius_m + BESIDE_M:
                continue
            if along_m <= beside_to_m and across_m >= self.radius_m + PASSING_M:
                continue
            free_m = max(0.0, along_m - self.radius_m)
            if best is None or free_m < best.free_m:
                best = Detection(x_m, y_m, free_m)
        return best

    def under_bar(
        self,
        here: Observation,
        ground: SweptGround,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> list[GroundCell]:
        """The remembered points that the lowered bar would sweep; call it after `observe`.

        What explains an echo is the same as for the body.
        """
        if not here.ranges_m:
            return []
        if not self.points:
            if min(here.ranges_m) > ground.reach_m:
                return []
            echoes = [
                (x_m, y_m)
                for x_m, y_m in self._echoes(here, ground.reach_m, None)
                if ground.has(x_m - here.x_m, y_m - here.y_m)
            ]
            if not echoes or not self._strange(echoes, here, neighbours, now_us):
                return []
            everything = self._echoes(here, WATCH_M, None)
            self._remember(self._strange(everything, here, neighbours, now_us), now_us)
        return [
            cell
            for cell, ((x_m, y_m), _) in self.points.items()
            if ground.has(x_m - here.x_m, y_m - here.y_m)
        ]

    # ---------------------------------------------------------------- echoes

    def _echoes(self, here: Observation, reach_m: float, velocity: Point | None) -> list[Point]:
        """Echoes within reach; with a velocity, those in the strip along it."""
        x_m, y_m, heading_rad, ranges_m = here.x_m, here.y_m, here.heading_rad, here.ranges_m
        step_rad, has_velocity = 2 * pi / len(ranges_m), velocity is not None
        vx_m_s, vy_m_s = (0.0, 0.0) if velocity is None else velocity
        half_m = (self.radius_m + BESIDE_M) * hypot(vx_m_s, vy_m_s)
        echoes: list[Point] = []
        for k, range_m in enumerate(ranges_m):
            if range_m > reach_m:
                continue
            angle_rad = heading_rad + k * step_rad
            dx_m, dy_m = range_m * cos(angle_rad), range_m * sin(angle_rad)
            if has_velocity:
                along = dx_m * vx_m_s + dy_m * vy_m_s
                if along <= 0.0 or abs(dy_m * vx_m_s - dx_m * vy_m_s) > half_m:
                    continue
            echoes.append((x_m + dx_m, y_m + dy_m))
        return echoes

    def _strange(
        self,
        echoes: Sequence[Point],
        here: Observation,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> list[Point]:
        """The echoes that neither a robot nor a fence explains."""
        return self._off_fences(self._off_robots(echoes, here, neighbours, now_us))

    def _off_fences(self, echoes: list[Point]) -> list[Point]:
        if not echoes or self.fences.size == 0:
            return echoes
        return [e for e in echoes if gap_m(e[0], e[1], self.fences) > FENCE_TOLERANCE_M]

    def _off_robots(
        self,
        echoes: Sequence[Point],
        here: Observation,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> list[Point]:
        """The echoes that no robot explains."""
        left = self._off_heard(echoes, here, neighbours, now_us)
        return self._off_silent(left, here, neighbours)

    def _off_silent(
        self, echoes: Sequence[Point], here: Observation, neighbours: Mapping[int, Neighbour]
    ) -> list[Point]:
        """The echoes that no robot explains that is silent."""
        left, silent_m = list(echoes), self.radius_m + SILENT_TOLERANCE_M
        for slot, (pose, _) in neighbours.items():
            places = self.coasting.places(slot)
            if places is None or _is_far(pose, here):
                continue
            left = [e for e in left if all(dist(e, place) > silent_m for place in places)]
        return left

    def _off_heard(
        self,
        echoes: Sequence[Point],
        here: Observation,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> list[Point]:
        """The echoes that no robot explains that is heard."""
        left, near_m = list(echoes), self.radius_m + ROBOT_TOLERANCE_M
        for slot, (pose, heard_at_us) in neighbours.items():
            if not left:
                return []
            if self.coasting.places(slot) is not None or _is_far(pose, here):
                continue
            age_s = (now_us - heard_at_us) / S
            way_m = pose.speed_m_s * age_s
            course = cos(pose.course_rad), sin(pose.course_rad)
            left = [e for e in left if _gap_m(e, (pose.x_m, pose.y_m), course, way_m) > near_m]
        return left

    # ---------------------------------------------------------------- memory

    def _remember(self, strange: list[Point], now_us: int) -> None:
        for x_m, y_m in strange:
            self.points[floor(x_m / GRAIN_M), floor(y_m / GRAIN_M)] = ((x_m, y_m), now_us)

    def _forget(self, here: Observation, neighbours: Mapping[int, Neighbour], now_us: int) -> None:
        """Drop points that both rays beside them have passed, and points that are too old."""
        count = len(here.ranges_m)
        step_rad = 2 * pi / count
        for grain, ((x_m, y_m), seen_at_us) in list(self.points.items()):
            dx_m, dy_m = x_m - here.x_m, y_m - here.y_m
            distance_m = hypot(dx_m, dy_m)
            turn = (atan2(dy_m, dx_m) - here.heading_rad) / step_rad
            beside = floor(turn) % count, ceil(turn) % count
            passed = distance_m < WATCH_M and (
                all(
                    self._passes(here, k, distance_m)
                    or self._passes_to_robot(here, k, distance_m, neighbours, now_us)
                    for k in beside
                )
                or (
                    all(self._ends_at_fence(here, k) for k in beside)
                    and self._is_behind(here, dx_m, dy_m)
                )
            )
            if passed or now_us - seen_at_us > FORGET_US:
                del self.points[grain]

    def _passes(self, here: Observation, ray: int, distance_m: float) -> bool:
        """Whether a ray shows that nothing is at this distance in its direction."""
        range_m = here.ranges_m[ray]
        if range_m > distance_m + BEYOND_M:
            return True
        if not self._ends_at_fence(here, ray):
            return False
        return abs(range_m - distance_m) > NEARER_M or self._meets_fence(here, ray)

    def _passes_to_robot(
        self,
        here: Observation,
        ray: int,
        distance_m: float,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> bool:
        """Whether a ray shows that nothing is at this distance before the robot at which it ends."""
        range_m = here.ranges_m[ray]
        if range_m == inf or range_m <= distance_m + NEARER_M:
            return False
        ux, uy = _direction(here, ray)
        end = here.x_m + range_m * ux, here.y_m + range_m * uy
        return not self._off_robots([end], here, neighbours, now_us)

    def _ends_at_fence(self, here: Observation, ray: int) -> bool:
        range_m = here.ranges_m[ray]
        if range_m == inf or self.fences.size == 0:
            return False
        ux, uy = _direction(here, ray)
        x_m, y_m = here.x_m + range_m * ux, here.y_m + range_m * uy
        return gap_m(x_m, y_m, self.fences) <= AT_FENCE_M

    def _meets_fence(self, here: Observation, ray: int) -> bool:
        """Whether the ray would end here without anything before the fence. A body beside a fence stops a
        slanting ray long before the fence does, although the ray then ends near the fence."""
        ux, uy = _direction(here, ray)
        begin_m = here.ranges_m[ray] - NEARER_M
        x_m, y_m = here.x_m + begin_m * ux, here.y_m + begin_m * uy
        count = ceil(2 * NEARER_M / FINE_LOOK_M)
        return way_gap_m(x_m, y_m, ux, uy, FINE_LOOK_M, count, self.fences) <= FINE_LOOK_M / 2

    def _is_behind(self, here: Observation, dx_m: float, dy_m: float) -> bool:
        """Whether a fence lies between us and a point: what is there is not in our way. Rays that end at
        a slanting fence may end as far away as such a point."""
        distance_m = max(hypot(dx_m, dy_m), LOOK_M)
        gap = way_gap_m(
            here.x_m, here.y_m, dx_m / distance_m, dy_m / distance_m, LOOK_M,
            ceil(distance_m / LOOK_M), self.fences,
        )  # fmt: skip
        return gap <= LOOK_M / 2

    def _explain(self, here: Observation, neighbours: Mapping[int, Neighbour], now_us: int) -> None:
        """Drop points that belong to a robot which has joined since they were seen."""
        strange = self._strange([p for p, _ in self.points.values()], here, neighbours, now_us)
        if len(strange) < len(self.points):
            left = set(strange)
            self.points = {cell: seen for cell, seen in self.points.items() if seen[0] in left}


def _is_far(pose: Pose, here: Observation) -> bool:
    return max(abs(pose.x_m - here.x_m), abs(pose.y_m - here.y_m)) > 2 * WATCH_M


def _direction(here: Observation, ray: int) -> Point:
    """Of a ray in the field, a unit vector."""
    angle_rad = here.heading_rad + ray * 2 * pi / len(here.ranges_m)
    return cos(angle_rad), sin(angle_rad)


def middle(grain: GroundCell) -> Point:
    """The middle of a ground cell, (x, y) metres."""
    return (grain[0] + 0.5) * GRAIN_M, (grain[1] + 0.5) * GRAIN_M


def _gap_m(echo: Point, at: Point, course: Point, way_m: float) -> float:
    """From an echo to the piece of the course that a robot may have driven."""
    dx_m, dy_m = echo[0] - at[0], echo[1] - at[1]
    along_m = min(max(dx_m * course[0] + dy_m * course[1], 0.0), way_m)
    return hypot(dx_m - course[0] * along_m, dy_m - course[1] * along_m)
