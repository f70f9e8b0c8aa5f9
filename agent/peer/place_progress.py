"""Whether a place that changes leads anywhere: a receiver that hangs beside wheels that are counted.

A driver may add the way of its wheels to the last fix. If its receiver repeats one fix with new times,
the place goes on with the wheels and falls back at each fix. So it changes in every period, by less than
a jump, and stays where it is. What shows this is a longer way: the wheels are told to drive
`NOWHERE_WAY_M`, and the place has gained less than `FOLLOWS` of that, is near where it was, and went
back more than once.

The place of a body that is stuck leads nowhere, too: its wheels spin or are blocked, and the noise of
its receiver moves the place to and fro by some millimetres. All places in this way are within `FOLLOWS`
of it. The place of a body with exchanged antennas leads elsewhere: it drives
`FOLLOWS_BACK` of the way at least, and gains nothing. A person who pushes a machine looks like both. So
the robot stands for `SETTLES_US` and tries again. If it fails again before its place has led on, it
stands until an operator starts it.

A body is expected to drive as fast as it says, in the direction of the command, and no faster than that.
If it points there, it is expected to speed up, too, whatever it says.

A body that brakes before its goal drives further than it is told. So the way that it says itself, by
its velocity, is compared with its place as well: if it says `NOWHERE_WAY_M`, and the place fell back
more than once and has gained less than `FOLLOWS` of that, the place leads nowhere.
"""

from collections import deque
from math import atan2, hypot, pi, radians, remainder
from typing import Final, NamedTuple

from agent.interface.config import ACTUATOR_TTL_US, S
from agent.interface.effects import Drive
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.peer.place_jumps import (
    FASTER,
    JUMP_M,
    NOTHING_UNSEEN,
    POSITION_ACCURACY_M,
    STANDS_M_S,
    Unseen,
)

# The way that wheels are told to drive, and the share of it that the place follows at least. A place that
# fell back once by `JUMP_M` may be right, if the body follows by `FOLLOWS_BACK`. To the way comes the
# accuracy of both places. A body that slips more stands, and people look at it.
NOWHERE_WAY_M: Final = 0.8
FOLLOWS: Final = 0.2
FOLLOWS_BACK: Final = 0.6
ACCURACIES: Final = 2.0
assert JUMP_M <= (FOLLOWS_BACK - FOLLOWS) * NOWHERE_WAY_M
# A person who pushes a machine pushes it away, or back once. A place that falls back by less than a jump
# does so twice in this way, or nearly so, and stays within a jump.
FALLS: Final = 2
# The way of a place that only its noise moves, to and fro, in greatest distances from where it began. A
# receiver that hangs repeats one place, or drifts; `agent/peer/sense_freshness.py` finds these.
WANDERS: Final = 3.0
STEP_M: Final = 0.02  # of the expected way, between two places that are kept
# Places kept of each kind, twice as many as a straight way of `NOWHERE_WAY_M` has. A body that moves to
# and fro gets no further, and would keep more and more.
KEPT_MAX: Final = 128
assert KEPT_MAX * STEP_M >= 2 * (NOWHERE_WAY_M + ACCURACIES * POSITION_ACCURACY_M)
SETTLES_US: Final = 1 * S  # five fixes of a slow receiver
# Share of the wheels' acceleration: allows for slip and drive lag. Brakes are assumed to act instantly.
# Where the most counts, wheels may have as much more.
ACCELERATION_SHARE: Final = 0.5
# Between the command and the heading. A differential drive that is off by more drives slowly
# (`pivot_course`).
ALIGNED_RAD: Final = radians(15.0)
# A body turns back if the cosine of the angle between its way and its command is less. A place that falls
# back at a corner turns the command to either side of the motion in turn.
BACK_COS: Final = -0.25


class _Kept:
    """Ways until a place. Not a tuple: one is made in each period, and its numbers are read often."""

    __slots__ = (
        "expected_x_m", "expected_y_m", "falls", "gone_x_m", "gone_y_m", "wandered_m", "way_m",
    )  # fmt: skip

    def __init__(
        self, gone_x_m: float, gone_y_m: float, expected_x_m: float, expected_y_m: float,
        way_m: float, wandered_m: float, falls: int,
    ) -> None:  # fmt: skip
        """`gone`: by the place while the body was expected to drive. `expected`: at least, as the wheels
        were told to drive. `way_m`: at most. `wandered_m`: by the place, to and fro. `falls`: how often
        the place began to go back."""
        self.gone_x_m: Final = gone_x_m
        self.gone_y_m: Final = gone_y_m
        self.expected_x_m: Final = expected_x_m
        self.expected_y_m: Final = expected_y_m
        self.way_m: Final = way_m
        self.wandered_m: Final = wandered_m
        self.falls: Final = falls


class _Sensed(NamedTuple):
    """Sums until a place, of the way that the body says by its velocity, and of what its place did."""

    said_x_m: float = 0.0
    said_y_m: float = 0.0
    gone_x_m: float = 0.0
    gone_y_m: float = 0.0
    falls: int = 0  # how often the place began to go back against that velocity
    way_m: float = 0.0  # that of `PlaceProgress`


class Nowhere(NamedTuple):
    """A place that led nowhere, and the direction in which the body was told to drive, a unit vector."""

    x_m: float
    y_m: float
    east: float
    north: float
    fell: bool  # again and again, so it is wrong
    elsewhere: bool  # it is right, and the body does not drive where it is told


class PlaceProgress:
    """Compares the progress of one robot's place with its commands."""

    def __init__(self) -> None:
        self._before: Observation | None = None
        # Oldest first: the last `NOWHERE_WAY_M`, and of the way that the body says.
        self._kept: deque[_Kept] = deque(maxlen=KEPT_MAX)
        self._now = _Kept(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)
        self._said: deque[_Sensed] = deque(maxlen=KEPT_MAX)
        self._sensed = _Sensed()
        self._falls_back = False  # against the velocity, in this period
        self._goes_on = True  # in the direction of the command
        self._fell: _Kept | None = None  # before the place went back first, in the last way
        self._velocity_m_s = (0.0, 0.0)  # of the body, if it is slow to follow its commands
        self.hung: Nowhere | None = None  # where the place leads nowhere at present
        self._tried = False  # again, and has not led on since
        self._recalled = False  # how far the body drove before the restart is not known
        self._away_m = (0.0, 0.0)  # by how much the place has jumped since it led nowhere
        self._moved_at_us = 0
        self._fastest_m_s = 0.0  # of the body at most, as its wheels were told and can speed up
        # How the body may have moved at most since the place fell back, if the newest place is a jump: a
        # receiver that answers again says where the body has driven meanwhile.
        self.made_up: Unseen = NOTHING_UNSEEN

    def forget(self, drives_on: bool = False) -> None:
        """Begin again: the next place is right, or nothing is known of how the body came there.

        `drives_on`: the body follows its commands meanwhile. How fast it is stays known then, because
        one that turns back drives on for a while against its commands."""
        velocity_m_s = self._velocity_m_s
        keeps = drives_on and not self.hangs
        self._tried = False
        self._look_again()
        if keeps:
            self._velocity_m_s = velocity_m_s

    def recall(self, hung: Nowhere) -> None:
        """The place led nowhere before a restart, and nobody has started the robot since."""
        self.hung, self._tried, self._recalled = hung, True, True

    def _look_again(self) -> None:
        self._before, self.hung, self._recalled = None, None, False
        self._away_m = (0.0, 0.0)
        self._velocity_m_s = (0.0, 0.0)
        self._said.clear()
        self._begin_again()

    def _begin_again(self) -> None:
        self._kept.clear()
        self._fell = None

    @property
    def hangs(self) -> bool:
        """Whether the place leads nowhere."""
        return self.hung is not None

    @property
    def is_right(self) -> bool:
        """Whether the place led elsewhere, so that its changes are those of the body."""
        return self.hung is not None and self.hung.elsewhere

    @property
    def way_m(self) -> float:
        """How far the body can have driven at most, since the start."""
        return self._now.way_m

    def unseen(self, speed_m_s: float) -> Unseen:
        """How the body may have moved at most since the oldest kept place, and drives now."""
        from_m = self._kept[0].way_m
        if self._said:
            from_m = min(from_m, self._said[0].way_m)
        return Unseen(self._now.way_m - from_m, speed_m_s)

    def is_back(self, here: Observation, way_m: float) -> bool:
        """Whether the place is past the one that led nowhere, or the robot tries again. Then look again.

        While the body brakes, its wheels still move the place, and a filter needs time to fall back. So
        the body has to stand for `SETTLES_US`. `way_m`: how far it can have driven at most. A place
        that changed at once by more has jumped, and may jump back to where it led nowhere.
        """
        hung, before, self._before = self.hung, self._before, here
        assert hung is not None
        if (
            before is not None
            and hypot(here.x_m - before.x_m, here.y_m - before.y_m) > JUMP_M + way_m
        ):
            away_x_m, away_y_m = self._away_m
            self._away_m = away_x_m + here.x_m - before.x_m, away_y_m + here.y_m - before.y_m
        if hypot(here.vx_m_s, here.vy_m_s) > STANDS_M_S:
            self._moved_at_us = here.sensed_at_us
            return False
        past_m = (here.x_m - hung.x_m) * hung.east + (here.y_m - hung.y_m) * hung.north
        if here.sensed_at_us - self._moved_at_us < SETTLES_US:
            return False
        if hypot(*self._away_m) > JUMP_M + way_m and not self._recalled:
            return False
        if past_m <= JUMP_M:
            if hung.fell or self._tried:
                return False
            self._tried = True
        self._look_again()
        return True

    def look(
        self,
        here: Observation,
        drive: Drive,
        limits: BodyLimits,
        acceleration_m_s2: float,
        passed_for_us: int,
    ) -> str:
        """Why this place leads nowhere; empty if it leads on.

        `drive`: the command in force since the place before, which is `passed_for_us` older.
        `acceleration_m_s2`: of the body at least.
        """
        before, self._before = self._before, here
        self.made_up = NOTHING_UNSEEN
        if passed_for_us > ACTUATOR_TTL_US:  # its commands expired meanwhile
            self._velocity_m_s = (0.0, 0.0)
        passed_for_s = min(max(passed_for_us, 0), ACTUATOR_TTL_US) / S
        step_m = self._expected_m_s(here, drive, acceleration_m_s2 * passed_for_s) * passed_for_s
        told_m_s, kept, now = hypot(drive.vx_m_s, drive.vy_m_s), self._kept, self._now
        moved_m = 0.0 if before is None else hypot(here.x_m - before.x_m, here.y_m - before.y_m)
        if moved_m > JUMP_M + FASTER * limits.speed_m_s * passed_for_s:  # a jump is noticed as one
            fell = self._fell
            if fell is not None:
                expected_m, gained_m = _since(fell, now)
                if expected_m <= NOWHERE_WAY_M and gained_m < FOLLOWS * expected_m:
                    self.made_up = Unseen(now.way_m - fell.way_m, told_m_s)
            self._said.clear()
            self._begin_again()
        if not here.under_way or not 0 <= passed_for_us <= ACTUATOR_TTL_US:
            self._begin_again()
        if not 0 <= passed_for_us <= ACTUATOR_TTL_US:
            self._said.clear()
        share, dx_m, dy_m, gained_m, sensed_m = 0.0, 0.0, 0.0, 0.0, 0.0
        # At a corner, a place that falls back may turn the command across the motion at each fix.
        falls_back = before is not None and _fell_back(before, here, passed_for_s)
        fell_back = falls_back and bool(kept)
        if (step_m or fell_back) and before is not None and kept:
            dx_m, dy_m = here.x_m - before.x_m, here.y_m - before.y_m
        if step_m:
            share = step_m / told_m_s
            if before is not None and kept:
                gained_m = (dx_m * drive.vx_m_s + dy_m * drive.vy_m_s) / told_m_s
                sensed_m = here.vx_m_s * drive.vx_m_s + here.vy_m_s * drive.vy_m_s
                sensed_m *= passed_for_s / told_m_s
        self._now = _Kept(
            now.gone_x_m + dx_m, now.gone_y_m + dy_m,
            now.expected_x_m + share * drive.vx_m_s, now.expected_y_m + share * drive.vy_m_s,
            now.way_m + self._most_m_s(here, told_m_s, limits, passed_for_s) * passed_for_s,
            now.wandered_m + hypot(dx_m, dy_m),
            now.falls + self._falls(step_m, gained_m, sensed_m, fell_back),
        )  # fmt: skip
        far = self._fell is not None and _between_m(self._fell, self._now) > NOWHERE_WAY_M
        if self._now.falls > now.falls and (self._fell is None or far):
            self._fell = now
        if kept and self._turned_back(drive):
            self._begin_again()
        if not kept or _between_m(kept[-1], self._now) >= STEP_M:
            kept.append(self._now)
        nowhere_m = NOWHERE_WAY_M + ACCURACIES * here.position_accuracy_m
        while len(kept) > 1 and _between_m(kept[1], self._now) >= nowhere_m:
            kept.popleft()
        if before is not None:
            wrong = self._says_otherwise(before, here, falls_back, passed_for_s, nowhere_m)
            if wrong:
                return wrong
        expected_m, gained_m = _since(kept[0], self._now)
        if expected_m < nowhere_m:
            return ""
        if gained_m >= FOLLOWS * expected_m:
            self._tried = self._tried and gained_m < FOLLOWS_BACK * expected_m
            return ""
        oldest = kept[0]
        gone_m = hypot(self._now.gone_x_m - oldest.gone_x_m, self._now.gone_y_m - oldest.gone_y_m)
        falls_back = self._now.falls - oldest.falls >= FALLS and gone_m <= JUMP_M
        elsewhere = gone_m >= FOLLOWS_BACK * expected_m
        if not falls_back and not elsewhere and not self._is_stuck(expected_m):
            return ""
        self.hung = Nowhere(
            here.x_m,
            here.y_m,
            (self._now.expected_x_m - oldest.expected_x_m) / expected_m,
            (self._now.expected_y_m - oldest.expected_y_m) / expected_m,
            falls_back,
            elsewhere and not falls_back,
        )
        self._moved_at_us = here.sensed_at_us
        return f"told to drive {expected_m:.2f} m, gained {gained_m:.2f} m"

    def _says_otherwise(
        self, before: Observation, here: Observation, falls_back: bool, passed_for_s: float,
        nowhere_m: float,
    ) -> str:  # fmt: skip
        """Why this place leads nowhere by the velocity of the body; empty if it leads on."""
        sums, said = self._sensed, self._said
        began, self._falls_back = falls_back and not self._falls_back, falls_back
        sums = self._sensed = _Sensed(
            sums.said_x_m + here.vx_m_s * passed_for_s, sums.said_y_m + here.vy_m_s * passed_for_s,
            sums.gone_x_m + here.x_m - before.x_m, sums.gone_y_m + here.y_m - before.y_m,
            sums.falls + began, self._now.way_m,
        )  # fmt: skip
        if not said or _said_m(said[-1], sums) >= STEP_M:
            said.append(sums)
        while len(said) > 1 and _said_m(said[1], sums) >= nowhere_m:
            said.popleft()
        first, said_m = said[0], _said_m(said[0], sums)
        gone_x_m, gone_y_m = sums.gone_x_m - first.gone_x_m, sums.gone_y_m - first.gone_y_m
        if (
            said_m < nowhere_m
            or sums.falls - first.falls < FALLS
            or hypot(gone_x_m, gone_y_m) > JUMP_M
        ):
            return ""
        east, north = (
            (sums.said_x_m - first.said_x_m) / said_m,
            (sums.said_y_m - first.said_y_m) / said_m,
        )
        gained_m = gone_x_m * east + gone_y_m * north
        if gained_m >= FOLLOWS * said_m:
            return ""
        self.hung = Nowhere(here.x_m, here.y_m, east, north, True, False)
        self._moved_at_us = here.sensed_at_us
        return f"says that it drove {said_m:.2f} m, gained {gained_m:.2f} m"

    def _most_m_s(
        self, here: Observation, told_m_s: float, limits: BodyLimits, passed_for_s: float
    ) -> float:
        """How fast the body can have been driven in this period."""
        gained_m_s = limits.acceleration_m_s2 / ACCELERATION_SHARE * passed_for_s
        lost_m_s = limits.acceleration_m_s2 * ACCELERATION_SHARE * passed_for_s
        was_m_s, most_m_s = self._fastest_m_s, FASTER * told_m_s
        could_m_s = max(was_m_s, hypot(here.vx_m_s, here.vy_m_s)) + gained_m_s
        self._fastest_m_s = max(min(most_m_s, could_m_s), was_m_s - lost_m_s)
        return min(most_m_s, could_m_s)

    def _falls(self, expected_m: float, gained_m: float, sensed_m: float, back: bool) -> bool:
        """Whether the place begins to go back by more than the body says that it does, in this period.

        `back`: it went back against the motion that the body says."""
        goes_on = not back and gained_m - min(sensed_m, 0.0) >= -expected_m / 2
        falls, self._goes_on = self._goes_on and not goes_on, goes_on
        return falls

    def _is_stuck(self, expected_m: float) -> bool:
        """Whether the place wanders to and fro, as one of an exact receiver that stands."""
        oldest = self._kept[0]
        farthest_m = max(
            hypot(kept.gone_x_m - oldest.gone_x_m, kept.gone_y_m - oldest.gone_y_m)
            for kept in (*self._kept, self._now)
        )
        wandered_m = self._now.wandered_m - oldest.wandered_m
        return farthest_m <= FOLLOWS * expected_m and wandered_m > WANDERS * farthest_m

    def _turned_back(self, drive: Drive) -> bool:
        """Whether the command is clearly against the way that was expected, and the body is slow enough
        to have followed it. A place that falls back makes a robot that passes its goal turn at each fix,
        and its body drives on."""
        oldest, now = self._kept[0], self._now
        x_m, y_m = now.expected_x_m - oldest.expected_x_m, now.expected_y_m - oldest.expected_y_m
        (vx_m_s, vy_m_s), way_m = self._velocity_m_s, hypot(x_m, y_m)
        along = x_m * drive.vx_m_s + y_m * drive.vy_m_s
        still_m_s = (x_m * vx_m_s + y_m * vy_m_s) / max(way_m, 1e-9)
        return (
            along < BACK_COS * way_m * hypot(drive.vx_m_s, drive.vy_m_s) and still_m_s <= STANDS_M_S
        )

    def _expected_m_s(self, here: Observation, drive: Drive, change_m_s: float) -> float:
        """How fast the body drives at least where it is told to."""
        (vx_m_s, vy_m_s), told_m_s = self._velocity_m_s, hypot(drive.vx_m_s, drive.vy_m_s)
        to_x_m_s, to_y_m_s = drive.vx_m_s - vx_m_s, drive.vy_m_s - vy_m_s
        share = min(1.0, change_m_s / max(hypot(to_x_m_s, to_y_m_s), 1e-9))
        vx_m_s, vy_m_s = vx_m_s + share * to_x_m_s, vy_m_s + share * to_y_m_s
        self._velocity_m_s = vx_m_s, vy_m_s
        if told_m_s == 0.0:
            return 0.0
        east, north = drive.vx_m_s / told_m_s, drive.vy_m_s / told_m_s
        fastest_m_s = max(here.vx_m_s * east + here.vy_m_s * north, 0.0)
        off_rad = remainder(here.heading_rad - atan2(north, east), 2 * pi)
        if abs(off_rad) <= ALIGNED_RAD:
            fastest_m_s = max(vx_m_s * east + vy_m_s * north, fastest_m_s)
        return min(fastest_m_s, told_m_s)


def _fell_back(before: Observation, here: Observation, passed_for_s: float) -> bool:
    """Whether the place went back against the motion that the body says, by half of that at least."""
    speed_m_s = hypot(here.vx_m_s, here.vy_m_s)
    if speed_m_s <= STANDS_M_S:
        return False
    dx_m, dy_m = here.x_m - before.x_m, here.y_m - before.y_m
    fell_m = -(dx_m * here.vx_m_s + dy_m * here.vy_m_s) / speed_m_s
    return fell_m > max(STEP_M, speed_m_s * passed_for_s / 2)


def _said_m(first: _Sensed, last: _Sensed) -> float:
    """The way that the body said between two places."""
    return hypot(last.said_x_m - first.said_x_m, last.said_y_m - first.said_y_m)


def _between_m(first: _Kept, last: _Kept) -> float:
    """The way that was expected between two places."""
    return hypot(last.expected_x_m - first.expected_x_m, last.expected_y_m - first.expected_y_m)


def _since(first: _Kept, last: _Kept) -> tuple[float, float]:
    """The way that was expected between two places, and what the place gained in its direction."""
    x_m, y_m = last.expected_x_m - first.expected_x_m, last.expected_y_m - first.expected_y_m
    expected_m = hypot(x_m, y_m)
    if expected_m == 0.0:
        return 0.0, 0.0
    along = (last.gone_x_m - first.gone_x_m) * x_m + (last.gone_y_m - first.gone_y_m) * y_m
    return expected_m, along / expected_m
