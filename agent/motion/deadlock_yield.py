"""Deadlock resolution: which robot gives way when robots stand nose to nose, and where it goes.

ORCA keeps bodies apart; it does not decide which robot goes first. Two robots that want the same
spot stand still for ever. A robot is stalled if it wants to move, makes no progress, and has
another robot close by. Of two working robots the one with the higher slot gives way first. Both
know both slots, so they agree without a message. The yielding robot drives to a refuge near by. It
waits there until the other robot is gone or a timeout ends. If it cannot give way, because it
stands in a corner, the robot with the lower slot does so after a longer timeout. So at least one
side resolves a jam of two. A robot that does not want to move (idle, stopped, gone) is gone round:
the refuges are then a point beside it and one beyond it, because from a point before it the mission
leads back to where the robot was stalled.
"""

from math import ceil, cos, hypot, pi, sin
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.fence_distance import way_gap_m
from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.geometry import Point
from agent.interface.lifecycle import State

PERIOD_S: Final = CONTROL_PERIOD_US / S

# A stalled robot wants at least this speed, and has moved less than this distance.
WANTS_M_S: Final = 0.1
GOT_ON_M: Final = 0.4
# Nor is a robot stalled that covered this share of the requested distance, as when it creeps.
GETS_ON: Final = 0.4
PATIENCE_US: Final = 1_500 * MS  # stalled for this long, the robot that yields first gives way
LONG_PATIENCE_US: Final = 7 * S  # for the robot that gives way second
NEAR_M: Final = 1.2  # a gap wider than this stalls no robot
APART_M: Final = 5.0  # a robot leaves its refuge when the gap is this wide
REFUGE_US: Final = 10 * S  # a robot leaves its refuge after this time at the latest
ROUND_US: Final = 4 * S  # longest duration of one leg of a detour round a standing robot
PASS_M: Final = 0.45  # gap to a standing robot on a detour; avoidance needs 0.15 m of it
# Refuges are looked for in so many directions, at the distances `RADII_M`.
DIRECTIONS: Final = 16
STEP_M: Final = 0.5  # sampling step on the way to a refuge
RADII_M = (2.5, 4.5, 7.0)


class NearbyRobot(NamedTuple):
    """A neighbour close by: slot, offset from us in metres (x east, y north), state, and course
    as a unit vector; (0, 0) if it stands.
    """

    slot: int
    dx_m: float
    dy_m: float
    state: int
    ux: float = 0.0
    uy: float = 0.0
    at_work: bool = False  # its implement is down, or soon will be

    @property
    def distance_m(self) -> float:
        """From middle to middle."""
        return hypot(self.dx_m, self.dy_m)


class DeadlockYield:
    """One robot's part in resolving a jam: notices that it is stalled, and drives to a refuge."""

    def __init__(
        self,
        slot: int,
        radius_m: float,
        speed_m_s: float,
        fences: NDArray[np.float64],
        scale: float = 1.0,
        near_m: float = NEAR_M,
    ) -> None:
        """`slot`: ours. `radius_m`: of every body. `speed_m_s`: the highest of ours. `fences`:
        segments (n, 4) of ax, ay, bx, by in metres. `scale`: factor for all distances, 1 for field
        machines and less for small robots indoors. `near_m`: a gap wider than this, before scaling,
        stalls no robot.
        """
        self.scale = scale
        self.slot, self.radius_m, self.speed_m_s, self.fences = slot, radius_m, speed_m_s, fences
        self.near_m = near_m * scale
        self.given = 0  # how often we gave way
        self._anchor: Point = (0.0, 0.0)
        self._anchor_at_us = 0
        self._wanted_m = 0.0  # distance requested since then
        self._wanted: Point = (0.0, 0.0)  # the same as a vector, metres
        self._yield_ends_at_us = 0
        self._for: int | None = None  # slot of the robot we give way to
        self._refuge: Point = (0.0, 0.0)
        self._beyond: Point | None = None  # the next place of a detour round a standing robot

    def wish(
        self, at: Point, wanted: Point, others: list[NearbyRobot], now_us: int
    ) -> Point | None:
        """The velocity to use instead of the mission's, (x, y) metres a second; None if no robot is
        in the way.

        Call it once each control period. `at`: our position, metres. `wanted`: the mission's
        velocity. `others`: the robots near by.
        """
        if now_us < self._yield_ends_at_us:
            return self._go(at, others, now_us)
        moved_m = hypot(at[0] - self._anchor[0], at[1] - self._anchor[1])
        wanted_m_s = hypot(*wanted)
        self._wanted_m += wanted_m_s * PERIOD_S
        wx_m, wy_m = self._wanted
        self._wanted = (wx_m + wanted[0] * PERIOD_S, wy_m + wanted[1] * PERIOD_S)
        if moved_m > GOT_ON_M * self.scale or wanted_m_s < WANTS_M_S:
            self._anchor, self._anchor_at_us = at, now_us
            self._wanted_m, self._wanted = 0.0, (0.0, 0.0)
            return None
        if now_us - self._anchor_at_us < PATIENCE_US or moved_m >= GETS_ON * self._wanted_m:
            return None
        close = [o for o in others if o.distance_m < 2 * self.radius_m + self.near_m]
        if not close:
            return None
        return self._decide(at, wanted, close, others, now_us)

    def _decide(
        self,
        at: Point,
        wanted: Point,
        close: list[NearbyRobot],
        others: list[NearbyRobot],
        now_us: int,
    ) -> Point | None:
        ahead = [o for o in close if o.dx_m * wanted[0] + o.dy_m * wanted[1] > 0] or close
        blocker = min(ahead, key=lambda o: (o.state != State.WORKING, o.slot))
        standing = blocker.state != State.WORKING
        first = standing or blocker.slot < self.slot
        if not first and now_us - self._anchor_at_us < LONG_PATIENCE_US:
            return None
        detour = self._round(at, blocker, others) if standing else None
        if detour is not None:
            refuge, self._beyond = detour
        else:
            found = self._find(at, wanted if standing else (0.0, 0.0), blocker, others)
            if found is None:
                return None
            refuge, self._beyond = found, None
        self.given += 1
        self._for, self._refuge = blocker.slot, refuge
        self._yield_ends_at_us = now_us + (ROUND_US if standing else REFUGE_US)
        self._anchor_at_us = self._yield_ends_at_us
        self._wanted_m, self._wanted = 0.0, (0.0, 0.0)
        return self._go(at, others, now_us)

    def _go(self, at: Point, others: list[NearbyRobot], now_us: int) -> Point:
        other = next((o for o in others if o.slot == self._for), None)
        if other is None or other.distance_m > 2 * self.radius_m + APART_M * self.scale:
            self._yield_ends_at_us = 0  # the way is free
        dx_m, dy_m = self._refuge[0] - at[0], self._refuge[1] - at[1]
        distance_m = hypot(dx_m, dy_m)
        if distance_m < 0.3 * self.scale:
            if self._beyond is None:
                return 0.0, 0.0
            self._refuge, self._beyond = self._beyond, None
            self._yield_ends_at_us = now_us + ROUND_US
            return self._go(at, others, now_us)
        speed_m_s = min(0.6 * self.speed_m_s, distance_m)
        return dx_m / distance_m * speed_m_s, dy_m / distance_m * speed_m_s

    def _round(
        self, at: Point, blocker: NearbyRobot, others: list[NearbyRobot]
    ) -> tuple[Point, Point] | None:
        """A place beside the line through a standing robot and one beyond it, on the side that is
        nearer; None if neither side is free.

        What was wanted in the whole time of the stall says where beyond is. A robot that was pushed
        off its line wants to go back to the line at one moment, and along it at another.
        """
        norm_m = hypot(*self._wanted)
        if norm_m < WANTS_M_S * PERIOD_S:
            return None
        ux, uy = self._wanted[0] / norm_m, self._wanted[1] / norm_m
        keep_m = 2 * self.radius_m + PASS_M * self.scale
        onward_m = blocker.dx_m * ux + blocker.dy_m * uy + keep_m
        across_m = blocker.dy_m * ux - blocker.dx_m * uy  # the blocker is this far to the left
        for side in (1.0, -1.0) if across_m < 0.0 else (-1.0, 1.0):
            aside_m = across_m + side * keep_m
            beside = (-aside_m * uy, aside_m * ux)
            beyond = (beside[0] + onward_m * ux, beside[1] + onward_m * uy)
            legs = ((0.0, 0.0), beside), (beside, beyond)
            if all(self._leg_clear(at, a, b, others) for a, b in legs):
                return (at[0] + beside[0], at[1] + beside[1]), (
                    at[0] + beyond[0],
                    at[1] + beyond[1],
                )
        return None

    def _leg_clear(self, at: Point, a: Point, b: Point, others: list[NearbyRobot]) -> bool:
        """Whether a straight leg between two offsets from `at` is free."""
        length_m = hypot(b[0] - a[0], b[1] - a[1])
        there = [o._replace(dx_m=o.dx_m - a[0], dy_m=o.dy_m - a[1]) for o in others]
        direction = ((b[0] - a[0]) / length_m, (b[1] - a[1]) / length_m)
        return self._clear((at[0] + a[0], at[1] + a[1]), direction, length_m, there)

    def _find(
        self, at: Point, wanted: Point, blocker: NearbyRobot, others: list[NearbyRobot]
    ) -> Point | None:
        """A place that can be reached straight, away from fences and from all robots; None if there
        is none.

        The distance to the robot we give way to counts most. For a detour round a standing robot,
        the place must lie towards our goal.
        """
        best: tuple[float, Point] | None = None
        norm = max(hypot(*wanted), 1e-9)
        for radius_m in (self.scale * radius_m for radius_m in RADII_M):
            for k in range(DIRECTIONS):
                ux, uy = cos(2 * pi * k / DIRECTIONS), sin(2 * pi * k / DIRECTIONS)
                if not self._clear(at, (ux, uy), radius_m, others):
                    continue
                spot = (at[0] + ux * radius_m, at[1] + uy * radius_m)
                away_m = hypot(ux * radius_m - blocker.dx_m, uy * radius_m - blocker.dy_m)
                onward_m = (ux * wanted[0] + uy * wanted[1]) / norm * radius_m
                score = min(away_m, APART_M * self.scale) + 0.5 * onward_m - 0.2 * radius_m
                if best is None or score > best[0] + 1e-9:
                    best = (score, spot)
        return None if best is None else best[1]

    def _clear(
        self, at: Point, direction: Point, length_m: float, others: list[NearbyRobot]
    ) -> bool:
        ux, uy = direction
        for other in others:
            along_m = min(max(other.dx_m * ux + other.dy_m * uy, 0.0), length_m)
            gap_m = hypot(other.dx_m - ux * along_m, other.dy_m - uy * along_m)
            if gap_m < min(2 * self.radius_m + 0.2 * self.scale, other.distance_m - 0.02):
                return False
        if self.fences.size == 0:
            return True
        step_m = STEP_M * self.scale
        count = ceil((length_m / self.scale + STEP_M / 2 - STEP_M) / STEP_M)
        near_m: float = way_gap_m(at[0], at[1], ux, uy, step_m, count, self.fences)
        return near_m > self.radius_m + 0.15 * self.scale
