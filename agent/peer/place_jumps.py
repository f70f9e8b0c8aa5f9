"""Whether a body can be where it senses that it is: what its wheels can do, and what nobody saw.

Between two places in time the wheels drive a known way at most. After a gap without a place, or while the
place stood still, a body has driven on and braked: it may be anywhere within its reach. A change that
neither explains is a jump. The sum of all changes since the last trusted place tells when the place is
back: where the body can have come by itself. What it drove in a gap in which the place jumped is such a
way, and no part of the jump. If it counted as one, the true place would be wrong for ever.

A place is trusted when the robot drives by it, or when nothing was wrong with it for `TRUSTED_US`.
"""

from math import degrees, hypot, inf, pi, radians, remainder
from typing import Final, NamedTuple

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, SPEED_MAX_M_S, S
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation

# Two missed control periods, the lifetime of a drive command. It is detected at most one period later,
# so the robot drives 0.15 s: 0.38 m at 2.5 m/s. It plans to brake with 0.7 of its deceleration
# (`BRAKING_SHARE`), which leaves 0.89 m of reserve before a fence at that speed. Below 1 m/s
# `MARGIN_M`, 0.15 m, is enough.
AGE_MAX_US: Final = 2 * CONTROL_PERIOD_US
# As a standard deviation. Twice this is within the reserve before a fence at full speed (above), and
# within the clearance of two robots, which plan with a margin of 0.15 m each.
POSITION_ACCURACY_M: Final = 0.15
HEADING_ACCURACY_RAD: Final = radians(10.0)  # 0.17 m to the side on a metre: the same error
# What the place may change beyond what the wheels drive: twice the accuracy.
JUMP_M: Final = 2 * POSITION_ACCURACY_M
JUMP_RAD: Final = 2 * HEADING_ACCURACY_RAD
# Wheels can do half as much again as the speed limit: a mecanum robot on its diagonal needs 1.41.
FASTER: Final = 1.5
STARTS_M_S: Final = 0.3  # below, the direction in which it drives is not known
# Sensed by a body that stands; receivers are no more exact. One that pivots has no speed, and turns on
# for half a second while it brakes.
STANDS_M_S: Final = 0.05
STANDS_RAD_S: Final = 0.1
# Share of its way by which a body may leave its course while it brakes; also radians.
ASIDE: Final = 0.25
TURN_RAD_S: Final = 8.0  # no body turns faster: 2.5 m/s with the wheels 0.31 m from its middle
# A receiver that jumped in a gap and is right again within this time is believed again. Later, its
# return is a jump: a robot that holds for an hour must not take one for the end of a gap.
TRUSTED_US: Final = 5 * S
ACCELERATION_M_S2: Final = 0.5  # used if the acceleration of the body is not known
FASTEST: Final = BodyLimits(0.0, SPEED_MAX_M_S, ACCELERATION_M_S2)
assert AGE_MAX_US <= ACTUATOR_TTL_US


class Unseen(NamedTuple):
    """How a body may have moved at most while its place did not change."""

    way_m: float = 0.0
    speed_m_s: float = 0.0
    turned_rad: float = 0.0

    def then(self, later: "Unseen") -> "Unseen":
        """Both, one after the other."""
        return Unseen(
            self.way_m + later.way_m,
            max(self.speed_m_s, later.speed_m_s),
            self.turned_rad + later.turned_rad,
        )

    def without(self, way_m: float) -> "Unseen":
        """The same with so much less way."""
        return self._replace(way_m=max(self.way_m - way_m, 0.0))


NOTHING_UNSEEN: Final = Unseen()


class Offset(NamedTuple):
    """From the last trusted place to the sensed one, without what wheels have driven in time."""

    east_m: float = 0.0
    north_m: float = 0.0
    turned_rad: float = 0.0

    def moved(self, east_m: float, north_m: float, turned_rad: float) -> "Offset":
        """The offset after a further change."""
        return Offset(
            self.east_m + east_m,
            self.north_m + north_m,
            remainder(self.turned_rad + turned_rad, 2 * pi),
        )


class Reach(NamedTuple):
    """Where a body can be that drove on without a place: along its course, and a little aside."""

    east: float = 0.0  # the course, a unit vector; (0, 0): not known
    north: float = 0.0
    way_m: float = 0.0
    turned_rad: float = 0.0

    def holds(self, off: Offset) -> bool:
        """Whether a body can have come there, but for the accuracy of its place."""
        along_m, across_m = hypot(off.east_m, off.north_m), 0.0
        if self.east or self.north:
            along_m = off.east_m * self.east + off.north_m * self.north
            across_m = abs(off.north_m * self.east - off.east_m * self.north)
        return (
            -JUMP_M <= along_m <= JUMP_M + self.way_m
            and across_m <= JUMP_M + ASIDE * self.way_m
            and abs(off.turned_rad) <= JUMP_RAD + self.turned_rad
        )

    def wider(self, other: "Reach") -> "Reach":
        """That of a body that drove on twice."""
        course = self if self.way_m >= other.way_m else other
        return Reach(
            course.east,
            course.north,
            self.way_m + other.way_m,
            self.turned_rad + other.turned_rad,
        )


NO_OFFSET: Final = Offset()
NO_REACH: Final = Reach()


class PlaceJumps:
    """Compares each accurate place of one robot with the ones before, and with its commands."""

    def __init__(self, doubted: bool = False) -> None:
        """`doubted`: the place was wrong before the restart, and nobody knows since by how much."""
        self._doubted = doubted
        self._before: Observation | None = None  # the last accurate place
        self._followed: Observation | None = None  # the newest place, while it leads nowhere
        self._gap = False  # how long ago that was is not known
        self._turn_rad_s = 0.0  # between the last two places in time
        self._offset, self._reach = NO_OFFSET, NO_REACH
        self._wrong_at_us = 0  # when there was last a gap or a jump
        self._told = self._told_before = False  # to move, since the last place and before it

    def forget(self) -> None:
        """An operator says that the next place is right."""
        self._before, self._followed, self._doubted = None, None, False
        self._offset, self._reach = NO_OFFSET, NO_REACH

    def gap(self) -> None:
        """The robot did nothing for a time that its clock does not tell."""
        self._gap = True

    def drove(self) -> None:
        """The wheels were told to move."""
        self._told = True

    def stays(self, here: Observation) -> None:
        """The place stands still, and is known to be frozen."""
        before = self._before
        if before is not None:
            self._before = before._replace(sensed_at_us=here.sensed_at_us)

    def follows(self, here: Observation, limits: BodyLimits) -> None:
        """The place is known to lead nowhere, and the robot stands.

        What moves it in time is no jump when it is believed again: people may push the body.
        """
        before, last = self._before, self._followed or self._before
        self._followed = here
        if before is None or last is None:
            return
        passed_for_us = here.sensed_at_us - last.sensed_at_us
        dx_m, dy_m = here.x_m - last.x_m, here.y_m - last.y_m
        turned_rad = remainder(here.heading_rad - last.heading_rad, 2 * pi)
        followed = 0 <= passed_for_us <= AGE_MAX_US and _in_time(
            limits, dx_m, dy_m, turned_rad, passed_for_us / S
        )
        if followed:
            x_m, y_m = before.x_m + dx_m, before.y_m + dy_m
            heading_rad = before.heading_rad + turned_rad
            before = before._replace(x_m=x_m, y_m=y_m, heading_rad=heading_rad)
        self._before = before._replace(sensed_at_us=here.sensed_at_us)

    def trust(self) -> None:
        """The robot drives by the newest place."""
        self._offset, self._reach = NO_OFFSET, NO_REACH

    def look(self, here: Observation, limits: BodyLimits, unseen: Unseen, now_us: int) -> str:
        """Why the body cannot have driven to this accurate place; empty if it can.

        `unseen`: how it may have moved at most while its place stood still, until now.
        """
        before, self._before, self._followed = self._before, here, None
        gap, self._gap = self._gap, False
        told = self._told or self._told_before
        self._told, self._told_before = False, self._told
        if before is None:
            return self._lost
        if self._lost:
            self._wrong_at_us = now_us
        elif now_us - self._wrong_at_us >= TRUSTED_US:
            self.trust()
        passed_for_us = max(here.sensed_at_us - before.sensed_at_us, 0)
        passed_for_s = passed_for_us / S
        dx_m, dy_m = here.x_m - before.x_m, here.y_m - before.y_m
        turned_rad = remainder(here.heading_rad - before.heading_rad, 2 * pi)
        in_time = passed_for_us <= AGE_MAX_US and not gap
        if in_time and _in_time(limits, dx_m, dy_m, turned_rad, passed_for_s):
            if passed_for_us:
                self._turn_rad_s = turned_rad / passed_for_s
            return self._lost
        self._wrong_at_us = now_us
        if in_time and unseen is NOTHING_UNSEEN:
            way_x_m, way_y_m = before.vx_m_s * passed_for_s, before.vy_m_s * passed_for_s
            self._offset = self._offset.moved(dx_m - way_x_m, dy_m - way_y_m, turned_rad)
            return self._lost or "jumped back"
        if in_time:
            reach = _reach_unseen(before, limits, unseen, passed_for_s)
        else:
            reach = self._reach_from(before, limits, unseen, told, inf if gap else passed_for_s)
        back = self._offset.moved(dx_m, dy_m, turned_rad)
        # It may have returned or driven on. One that drove on is not where it was before the jump.
        slow = unseen is not NOTHING_UNSEEN or hypot(before.vx_m_s, before.vy_m_s) <= STARTS_M_S
        returned = slow and self._reach.holds(back)
        if self._lost and reach.holds(Offset(dx_m, dy_m, turned_rad)) and not returned:
            return self._lost
        self._offset = back
        self._reach = self._reach.wider(reach)
        return self._lost

    @property
    def lost(self) -> bool:
        """Whether the body cannot be at the newest place that was looked at."""
        return bool(self._lost)

    @property
    def _lost(self) -> str:
        if self._doubted:
            return "jumped before the restart"
        if self._offset is NO_OFFSET or self._reach.holds(self._offset):
            return ""
        moved_m = hypot(self._offset.east_m, self._offset.north_m)
        if self._reach.holds(self._offset._replace(turned_rad=0.0)):
            return f"heading jumped by {degrees(self._offset.turned_rad):.0f} degrees"
        return f"jumped by {moved_m:.1f} m"

    def _reach_from(
        self, before: Observation, limits: BodyLimits, unseen: Unseen, told: bool,
        passed_for_s: float,
    ) -> Reach:  # fmt: skip
        """How far a body that lost its senses there can have come, `passed_for_s` ago.

        It drove until its senses were old, for the lifetime of a command, and braked, with no more
        than the acceleration of its limits, and nearly in the direction in which it was driving.
        """
        speed_m_s = hypot(before.vx_m_s, before.vy_m_s)
        stands = speed_m_s <= STANDS_M_S and abs(self._turn_rad_s) <= STANDS_RAD_S
        if stands and not told and unseen is NOTHING_UNSEEN:
            return NO_REACH
        acceleration_m_s2 = limits.acceleration_m_s2
        driving_for_s = (AGE_MAX_US + ACTUATOR_TTL_US) / S
        fastest_m_s = max(speed_m_s, unseen.speed_m_s) + acceleration_m_s2 * driving_for_s
        way_for_s = driving_for_s + fastest_m_s / acceleration_m_s2 / 2  # braking at half the speed
        way_for_s = min(way_for_s, passed_for_s)
        way_m = unseen.way_m + fastest_m_s * way_for_s
        turned_rad = unseen.turned_rad + abs(self._turn_rad_s) * way_for_s + ASIDE
        return Reach(*_course(before), way_m, turned_rad)


def _course(before: Observation) -> tuple[float, float]:
    """The direction in which a body drives, a unit vector; (0, 0) where it is too slow to tell."""
    speed_m_s = hypot(before.vx_m_s, before.vy_m_s)
    if speed_m_s <= STARTS_M_S:
        return 0.0, 0.0
    return before.vx_m_s / speed_m_s, before.vy_m_s / speed_m_s


def _reach_unseen(
    before: Observation, limits: BodyLimits, unseen: Unseen, passed_for_s: float
) -> Reach:
    """How far a body whose place stood still until now can have come. One that turned has no course."""
    way_m = unseen.way_m + FASTER * limits.speed_m_s * passed_for_s
    turned_rad = unseen.turned_rad + TURN_RAD_S * passed_for_s
    course = (0.0, 0.0) if unseen.turned_rad else _course(before)
    return Reach(*course, way_m, turned_rad)


def _in_time(
    limits: BodyLimits, dx_m: float, dy_m: float, turned_rad: float, passed_for_s: float
) -> bool:
    """Whether wheels can drive this in this time."""
    way_m = FASTER * limits.speed_m_s * passed_for_s
    return (
        hypot(dx_m, dy_m) <= JUMP_M + way_m
        and abs(turned_rad) <= JUMP_RAD + TURN_RAD_S * passed_for_s
    )
