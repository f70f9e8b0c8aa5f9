"""Whether the senses of a robot are current: absent, old, frozen or impossible senses stop it.

An observation carries the time at which it was sensed. Without one younger than `AGE_MAX_US` the robot
does not know where it is. A receiver with a hung filter sends the same place with new times. This shows
when the wheels are commanded to drive and the place does not change: two control periods at full speed
are enough to detect it, and a tenth of a metre from standstill. A body that turns on the spot shows it
by its heading. Spinning wheels look the same as a frozen place, so the robot stops in this case as
well. Of a machine that takes orders and does not carry one out, nothing is expected. What is limited is
the way without a believed place, not the time: a slow body takes longer for a tenth of a metre.
`frozen_way_m` says how far it drives, which is less than the plan leaves before a fence at that speed.
A place that changes and leads nowhere is found by `agent/peer/place_progress.py`.

A place is lost when its accuracy is worse than the clearances allow, or when it changes by more than the
wheels can drive in that time. After a step back of its own clock that time is not known, and only the
way to standstill counts. The robot then stands. It goes on when the place is accurate and has jumped
back for `STEADY_US`, or when an operator says by a start of this robot that the new place is right.
"""

from collections.abc import Mapping
from math import atan2, cos, degrees, hypot, isfinite, pi, radians, remainder, sin
from struct import Struct
from typing import Any, Final

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, S
from agent.interface.effects import HALT, Drive, Effect, Persist
from agent.interface.motion_controller import BodyLimits, MotionController
from agent.interface.observation import Observation
from agent.peer import inputs, notices
from agent.peer.part import NOTHING, DirectListener, Listener, Outputs, Part, StepContext
from agent.peer.place_jumps import (
    ACCELERATION_M_S2,
    AGE_MAX_US,
    FASTER,
    FASTEST,
    HEADING_ACCURACY_RAD,
    NOTHING_UNSEEN,
    POSITION_ACCURACY_M,
    TURN_RAD_S,
    PlaceJumps,
    Unseen,
)
from agent.peer.place_progress import ACCELERATION_SHARE, Nowhere, PlaceProgress
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.fleet_frames import NOWHERE_M, PLACE_UNKNOWN_M_S

STEADY_US: Final = 1 * S  # the senses must be in time for this long before it drives on
# A start that comes sooner after a place froze was given by a person who has not seen the robot stand: a
# body at 2.5 m/s rolls for 1.7 s.
SEEN_STANDING_US: Final = 2 * S
STAYS_M: Final = 0.005  # a smaller change is no movement; a hung filter repeats the same place
# Expected displacement without a change of place, over this many periods at least.
FROZEN_M: Final = 0.1
FROZEN_PERIODS: Final = 2
FOLLOWS: Final = 0.1  # share of the expected displacement; a hung filter may still drift
TURNED_RAD: Final = radians(1.0)  # if the heading changes more, it is not frozen with the place
# Expected turn without a change of heading or place: what a heading may be wrong by (`JUMP_RAD`). Half of
# the commanded turn is expected, because nothing is known of how fast a body begins to turn.
FROZEN_RAD: Final = radians(20.0)
TURNS_SHARE: Final = 0.5
# Durable: whether the place has jumped, is frozen and led nowhere, a sum of these. If it is frozen, the
# place follows, (x, y) in millimetres, and the course to where it led nowhere, in milliradians.
PLACE_KEY, BELIEVED = "place", b"\0"
DOUBTED, FROZEN, LED_NOWHERE = 1, 2, 4
FROZEN_RECORD: Final = Struct("<Biih")
NOTHING_RECALLED: Final[Mapping[str, bytes]] = {}
NOT_ON_MAP: Final = "further from the origin than frames can say, or not a number"
NO_VELOCITY: Final = "its velocity is more than frames can say, or not a number"


def blind_way_m(limits: BodyLimits) -> float:
    """How far a body drives at most, from the last place that was right until it stands, metres."""
    driving_for_s = (AGE_MAX_US + CONTROL_PERIOD_US) / S
    braking_m = limits.speed_m_s**2 / (2 * limits.acceleration_m_s2)
    return limits.speed_m_s * driving_for_s + braking_m


def frozen_way_m(speed_m_s: float, limits: BodyLimits, late_for_s: float) -> float:
    """How far a body drives at most, from the moment at which its place freezes until it stands, metres.

    `speed_m_s`: its greatest speed meanwhile. `late_for_s`: from a place to its arrival. The first
    frozen place is sensed up to a period later. What the last one decides is sent `late_for_s` and up to
    a period later. In between the body drives what is expected, or twice that while it speeds up, and up
    to a period more. The rest is braking.
    """
    period_s = CONTROL_PERIOD_US / S
    unnoticed_m = max(FROZEN_M / ACCELERATION_SHARE, FROZEN_PERIODS * period_s * speed_m_s)
    braking_m = speed_m_s**2 / (2 * limits.acceleration_m_s2)
    return unnoticed_m + speed_m_s * (3 * period_s + late_for_s) + braking_m


def frozen_for_s(speed_m_s: float, late_for_s: float) -> float:
    """How long a body is commanded to move at most after its place has frozen, seconds.

    `speed_m_s`: at which it drives all that time, above zero. `late_for_s`: as above.
    """
    period_s = CONTROL_PERIOD_US / S
    unnoticed_for_s = max(FROZEN_M / speed_m_s + period_s, FROZEN_PERIODS * period_s)
    return unnoticed_for_s + 2 * period_s + late_for_s


class Senses(Part):
    """Watches one robot's senses in each control period, before any decision."""

    def __init__(
        self,
        safety: StopController,
        motion: MotionController | None,
        drives: bool,
        accuracy_max_m: float = POSITION_ACCURACY_M,
        recalled: Mapping[str, bytes] = NOTHING_RECALLED,
    ) -> None:
        """`drives`: the robot has a mission and can move. `accuracy_max_m`: what the mission needs.
        `recalled`: durable memory as it was before the start; the key is `PLACE_KEY`."""
        self.accuracy_max_m = min(accuracy_max_m, POSITION_ACCURACY_M)
        self.safety, self.drives = safety, drives
        known = None if motion is None else motion.body_limits
        self.limits = FASTEST if known is None else known  # of the body, or those of the fastest
        self._acceleration_m_s2 = ACCELERATION_M_S2  # at least
        if known is not None:
            self._acceleration_m_s2 = ACCELERATION_SHARE * known.acceleration_m_s2
        self.here: Observation | None = None  # the newest observation
        self.known: Observation | None = None  # the newest observation that was believed
        self._no_velocity = False  # whether the velocity of it was none
        self._on_map = False  # whether the place of it is one that frames can carry
        self.current = False  # whether the sensed place is our current place
        self._sensed_at_us: int | None = None  # time of the newest observation
        # time of the observation last compared with the wheels
        self._compared_at_us: int | None = None
        self._late_at_us = 0  # when the senses were last old
        self._drive: Drive = HALT  # the command in force since the last period
        self._anchor: Observation | None = None  # the last observation at which the place changed
        self._anchor_at_us = 0
        self._anchor_way_m = 0.0  # by then, of the place's progress
        self._periods = 0  # observations since the anchor
        self._changed = False  # whether the place changed in this period
        self._expected_m_s = 0.0  # speed expected since the anchor
        self._step_m_s = 0.0  # at which the place changed to the anchor
        # The displacement expected since then, (x, y) metres. Small commands to and fro, as of a robot
        # that waits before another one, lead nowhere.
        self._expected: tuple[float, float] = (0.0, 0.0)
        # How the body may have moved since the anchor, at most: what it did before and what it was told.
        self._since = NOTHING_UNSEEN
        self._most_m_s = 0.0  # commanded since the last comparison
        # The heading when it or the place changed last, and the turn expected since then. Small turns to
        # and fro lead nowhere.
        self._turn_anchor_rad = self._expected_rad = 0.0
        self._turn_frozen = False  # PLACE_FROZEN was noticed by the heading
        self._frozen_at_us: int | None = None  # when the place was found frozen; None: it follows
        self._unseen = NOTHING_UNSEEN  # before the last change of the place
        # A restart is no reason to believe a place that had jumped or stood still.
        record = recalled.get(PLACE_KEY, BELIEVED)
        self._remembered, self._doubts = record[0], bool(record[0] & DOUBTED)
        self._was_frozen: Nowhere | None = None  # before the restart, and nobody has started it
        if len(record) == FROZEN_RECORD.size:
            _, x_mm, y_mm, course_mrad = FROZEN_RECORD.unpack(record)
            course_rad = course_mrad / 1000
            at_m = x_mm / 1000, y_mm / 1000
            self._was_frozen = Nowhere(*at_m, cos(course_rad), sin(course_rad), True, False)
        self.jumps = PlaceJumps(self._doubts)
        self.progress = PlaceProgress()
        self._lost_at_us = 0  # when the place was last wrong

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.WasStarted: self._started}

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {
            inputs.Sensed: self._take,
            notices.ControlDue: self._period,
            notices.ClockWentBack: self._went_back,
        }

    def _take(self, fact: inputs.Sensed, now_us: int) -> Outputs:
        """The current observation, or None.

        A place that frames cannot carry is replaced by the last one, so no other part meets a place
        that it cannot compute with."""
        seen = fact.observation
        if seen is not None:
            self._on_map = _is_on_map(seen)
            sound, self._no_velocity = _sound(seen)
            last = self.here
            if self._on_map:
                self.here = sound
            elif last is not None:
                self.here = sound._replace(x_m=last.x_m, y_m=last.y_m, heading_rad=last.heading_rad)
            self._sensed_at_us = seen.sensed_at_us
        return NOTHING

    def _went_back(self, notice: notices.ClockWentBack, now_us: int) -> Outputs:
        """The robot did nothing until its clock showed again what it had shown. Its body drove on
        until the last command expired, and braked."""
        self.jumps.gap()
        self.progress.forget()
        return NOTHING

    def age_us(self, now_us: int) -> int | None:
        """Age of the newest observation; None if there never was one."""
        return None if self._sensed_at_us is None else now_us - self._sensed_at_us

    @property
    def expected(self) -> bool:
        """Whether the robot needs its senses to drive, or has sensed before."""
        return self.drives or self._sensed_at_us is not None

    def drove(self, drive: Drive) -> None:
        """The command that the wheels were given."""
        self._drive = drive
        speed_m_s = hypot(drive.vx_m_s, drive.vy_m_s)
        self._most_m_s = max(self._most_m_s, speed_m_s)
        if speed_m_s or drive.turn_rad_s:
            self.jumps.drove()
            if self.current:
                self.jumps.trust()

    @property
    def implement_told_down(self) -> bool:
        """Whether the command in force lowers the implement."""
        return self._drive.tool_on

    def _started(self, ctx: StepContext, notice: notices.WasStarted) -> Outputs:
        """Restart the checks. If the start is for this robot alone, its place is believed.

        A place that froze just before is found frozen again before the robot drives.
        What the body may have driven while its place stood still remains: the place may be frozen yet."""
        frozen_at_us = self._frozen_at_us
        if frozen_at_us is None or ctx.now_us - frozen_at_us >= SEEN_STANDING_US:
            self._expected_m_s, self._expected, self._expected_rad = 0.0, (0.0, 0.0), 0.0
            self._periods, self._turn_frozen = 0, False
            self.progress.forget(drives_on=True)
        self._was_frozen = None
        if notice.named:
            self.jumps.forget()
            self._doubts = False
        return self._remember()

    def _remember(self) -> list[Effect]:
        """Make durable what a restart must not make good, if it has changed.

        Until the first place is sensed, the record of the last boot holds: a second restart before it
        must not lose that the place was frozen."""
        if self._was_frozen is not None:
            return []
        now = DOUBTED * self._doubts + LED_NOWHERE * self.progress.hangs
        now += FROZEN * self.safety.holds(StopCause.PLACE_FROZEN)
        if now == self._remembered:
            return []
        self._remembered, anchor, hung = now, self._anchor, self.progress.hung
        if not now & FROZEN or anchor is None:
            return [Persist(PLACE_KEY, bytes((now & DOUBTED,)))]
        x_m, y_m = (anchor.x_m, anchor.y_m) if hung is None else (hung.x_m, hung.y_m)
        course_rad = 0.0 if hung is None else atan2(hung.north, hung.east)
        record = FROZEN_RECORD.pack(
            now, round(x_m * 1000), round(y_m * 1000), round(course_rad * 1000)
        )
        return [Persist(PLACE_KEY, record)]

    def _period(self, notice: notices.ControlDue, now_us: int) -> Outputs:
        return self.look(now_us)

    def look(self, now_us: int) -> list[Effect]:
        """Called once a control period. A robot with neither drive nor senses is not held."""
        if not self.expected:
            self.current = False
            return []
        old = self._old(now_us)
        if old:
            self._late_at_us = now_us
        safety = self.safety
        steady = safety.holds(StopCause.SENSES_OLD) and now_us - self._late_at_us < STEADY_US
        effects = self.safety.hold_while(StopCause.SENSES_OLD, bool(old) or steady, old, now_us)
        if self._was_frozen is not None and self.here is not None:
            was, self._was_frozen = self._was_frozen, None
            why = "as before the restart"
            effects += self.safety.hold_while(StopCause.PLACE_FROZEN, True, why, now_us)
            self._anchor = self.here._replace(x_m=was.x_m, y_m=was.y_m)
            self._anchor_at_us = now_us
            if self._remembered & LED_NOWHERE:
                self.progress.recall(was)
        self._changed = False
        frozen = ""
        if (
            self._sensed_at_us is not None
            and self._sensed_at_us != self._compared_at_us
            and not old
            and self._on_map
        ):
            frozen = self._hangs(self._sensed_at_us) or self._frozen(self._sensed_at_us)
            if not frozen:
                self._frozen_at_us = None
            elif self._frozen_at_us is None:
                self._frozen_at_us = now_us
            self._compared_at_us = self._sensed_at_us
        if frozen or self._changed:
            effects += self.safety.hold_while(StopCause.PLACE_FROZEN, bool(frozen), frozen, now_us)
        frozen_yet = safety.holds(StopCause.PLACE_FROZEN) and not self._changed
        if not frozen_yet or self.progress.is_right:
            effects += self._believe(now_us, bool(old))
        elif self.here is not None and not old:
            if self.progress.hangs:
                self.jumps.follows(self.here, self.limits)
            else:
                self.jumps.stays(self.here)
        doubted = safety.holds(StopCause.PLACE_FROZEN) or safety.holds(StopCause.PLACE_LOST)
        self.current = not (old or doubted)
        if self.current:
            self.known = self.here
        return effects + self._remember()

    def _believe(self, now_us: int, old: bool) -> list[Effect]:
        """Believe the newest place, or find it lost."""
        here = self.here
        if old:
            return []
        wrong = NOT_ON_MAP if here is None else self._unfit(here)
        if here is not None and (not wrong or self._shows_jumps(here)):
            jumped = self._jumped(here, now_us)
            wrong = wrong or jumped
        if wrong:
            self._lost_at_us = now_us
        elif not self.safety.holds(StopCause.PLACE_LOST):
            return []
        back = not wrong and now_us - self._lost_at_us >= STEADY_US
        effects = self.safety.hold_while(StopCause.PLACE_LOST, not back, wrong, now_us)
        self._doubts = not back and (self._doubts or self.jumps.lost)
        return effects

    def _unfit(self, here: Observation) -> str:
        """Why the place is no number or too inaccurate to drive by; empty if it is neither."""
        if not self._on_map:
            return NOT_ON_MAP
        if self._no_velocity:
            return NO_VELOCITY
        return _inaccurate(here, self.accuracy_max_m)

    def _shows_jumps(self, here: Observation) -> bool:
        """Whether the place is accurate enough to notice a jump by it, if not for the mission.

        If a place jumped that is too inaccurate to work by, and was accurate again, it would pass for the
        end of a gap, and its return would be a jump for ever."""
        return self._on_map and not self._no_velocity and not _inaccurate(here, POSITION_ACCURACY_M)

    def _jumped(self, here: Observation, now_us: int) -> str:
        """Why the body cannot have driven to this accurate place; empty if it can."""
        unseen, self._unseen = self._unseen, NOTHING_UNSEEN
        return self.jumps.look(here, self.limits, unseen, now_us)

    def _old(self, now_us: int) -> str:
        """Why the senses are not current; empty if they are."""
        if self._sensed_at_us is None:
            return "nothing is sensed"
        return _not_now(now_us - self._sensed_at_us)

    def _hangs(self, sensed_at_us: int) -> str:
        """Why a place that changes leads nowhere; empty if it leads on, or has not led nowhere before."""
        here, progress = self.here, self.progress
        assert here is not None
        if progress.hangs:
            if progress.is_back(here, self._since.way_m):
                # What `_frozen` finds next is a change of the place, from this one on.
                return ""
            self._drive_on(here, sensed_at_us)
            return "the place led nowhere"
        start_at_us = sensed_at_us if self._compared_at_us is None else self._compared_at_us
        passed_for_us = sensed_at_us - start_at_us
        # What it was told since the anchor is counted once: `_since` has it.
        counted_m = progress.way_m - self._anchor_way_m
        wrong = progress.look(
            here, self._drive, self.limits, self._acceleration_m_s2, passed_for_us
        )
        if progress.made_up is not NOTHING_UNSEEN:
            self._unseen = self._unseen.then(progress.made_up.without(counted_m))
        if wrong:
            self._drive_on(here, sensed_at_us)
            self._since = self._since.then(progress.unseen(self._since.speed_m_s))
        return wrong

    def _frozen(self, sensed_at_us: int) -> str:
        """Why the place does not follow the wheels; empty if it does or need not."""
        here, anchor = self.here, self._anchor
        assert here is not None
        start_at_us = sensed_at_us if self._compared_at_us is None else self._compared_at_us
        away_m = 0.0
        if anchor is not None:
            away_m = hypot(here.x_m - anchor.x_m, here.y_m - anchor.y_m)
        self._changed = away_m > max(STAYS_M, FOLLOWS * hypot(*self._expected))
        heading_rad = remainder(here.heading_rad - self._turn_anchor_rad, 2 * pi)
        turned = abs(heading_rad) > max(TURNED_RAD, FOLLOWS * abs(self._expected_rad))
        if anchor is None or self._changed or turned:
            self._turn_anchor_rad, self._expected_rad = here.heading_rad, 0.0
        if anchor is None or self._changed:
            passed_for_us = sensed_at_us - self._anchor_at_us
            step_m_s = away_m * S / passed_for_us if passed_for_us > 0 else 0.0
            # A place that freezes between two fixes cuts the last step short: the one before tells
            # how fast the body was.
            before_m_s = self._step_m_s if anchor and passed_for_us <= AGE_MAX_US else 0.0
            self._expected_m_s, self._step_m_s = max(step_m_s, before_m_s), step_m_s
            self._anchor, self._anchor_at_us = here, sensed_at_us
            self._anchor_way_m = self.progress.way_m
            self._periods = 0
            self._expected = (0.0, 0.0)
            self._turn_frozen = False
            drive, fastest_m_s = self._drive, FASTER * self.limits.speed_m_s
            told_m_s = max(self._most_m_s, hypot(drive.vx_m_s, drive.vy_m_s))
            if anchor is not None:
                passed_for_s = (sensed_at_us - start_at_us) / S
                fastest_m_s = min(fastest_m_s, self._could_m_s(told_m_s, passed_for_s))
            self._most_m_s = hypot(drive.vx_m_s, drive.vy_m_s)
            before_m_s = max(self._expected_m_s, hypot(here.vx_m_s, here.vy_m_s))
            self._moved_on(min(before_m_s, fastest_m_s))  # a jump is no speed
            return ""
        self._drive_on(here, sensed_at_us)
        if turned and self._turn_frozen:
            self._changed, self._turn_frozen = True, False
            self._moved_on(self._since.speed_m_s)
            return ""
        if turned:
            self._unseen = self._unseen.then(Unseen(0.0, 0.0, self._since.turned_rad))
            self._since = self._since._replace(turned_rad=0.0)
        if not here.under_way:
            self._expected_m_s, self._expected, self._expected_rad = 0.0, (0.0, 0.0), 0.0
            self._periods = 0
            return ""
        # After the lifetime of the command it is void.
        passed_for_s = min(max(sensed_at_us - start_at_us, 0), ACTUATOR_TTL_US) / S
        (ux, uy), told_m_s = self._told(here, anchor)
        faster_m_s = self._expected_m_s + self._acceleration_m_s2 * passed_for_s
        self._expected_m_s = min(told_m_s, faster_m_s)
        step_m = self._expected_m_s * passed_for_s
        self._expected = self._expected[0] + step_m * ux, self._expected[1] + step_m * uy
        turn_rad = self._drive.turn_rad_s * passed_for_s
        self._expected_rad += TURNS_SHARE * turn_rad
        self._periods += 1
        expected_m = hypot(*self._expected)
        by_turn = abs(self._expected_rad) >= FROZEN_RAD
        if (expected_m < FROZEN_M and not by_turn) or self._periods < FROZEN_PERIODS:
            return ""
        if expected_m < FROZEN_M:
            self._turn_frozen = True
            return (
                f"told to turn by {degrees(abs(self._expected_rad) / TURNS_SHARE):.0f} degrees, "
                f"turned by {degrees(abs(heading_rad)):.1f}"
            )
        return f"told to drive {expected_m:.2f} m, moved {away_m * 1000:.0f} mm"

    def _moved_on(self, speed_m_s: float) -> None:
        """The place follows again, at this speed: what was not seen until now is compared with it."""
        if self._since.way_m > STAYS_M or self._since.turned_rad:
            self._unseen = self._unseen.then(self._since)
        self._since = Unseen(0.0, speed_m_s, 0.0)

    def _drive_on(self, here: Observation, sensed_at_us: int) -> None:
        """How the body may have moved since the last comparison, although its place did not change.

        It is no faster than it was and than it was told. It drives that fast until the last command has
        expired, and brakes. A body that pivots turns without being told."""
        start_at_us = sensed_at_us if self._compared_at_us is None else self._compared_at_us
        passed_for_s = max(sensed_at_us - start_at_us, 0) / S
        way_m, speed_m_s, turned_rad = self._since
        drive, told_m_s = self._drive, self._most_m_s
        self._most_m_s = hypot(drive.vx_m_s, drive.vy_m_s)
        fastest_m_s = max(speed_m_s, self._could_m_s(told_m_s, passed_for_s))
        acceleration_m_s2 = self.limits.acceleration_m_s2
        driving_for_s = min(passed_for_s, (AGE_MAX_US + ACTUATOR_TTL_US) / S)
        braking_for_s = passed_for_s - (driving_for_s if told_m_s else 0.0)
        slowest_m_s = max(fastest_m_s - acceleration_m_s2 * braking_for_s, 0.0)
        way_m += fastest_m_s * driving_for_s
        way_m += (fastest_m_s**2 - slowest_m_s**2) / (2 * acceleration_m_s2)
        off_rad = remainder(atan2(drive.vy_m_s, drive.vx_m_s) - here.heading_rad, pi)
        pivots = told_m_s > 0.0 and abs(off_rad) > TURNED_RAD
        turn_rad_s = TURN_RAD_S if pivots else abs(drive.turn_rad_s)
        self._since = Unseen(way_m, slowest_m_s, turned_rad + turn_rad_s * driving_for_s)

    def _could_m_s(self, told_m_s: float, passed_for_s: float) -> float:
        """How fast the body may have become: it speeds up to what it was told, and brakes otherwise."""
        was_m_s, acceleration_m_s2 = self._since.speed_m_s, self.limits.acceleration_m_s2
        gained_m_s = acceleration_m_s2 / ACCELERATION_SHARE * passed_for_s
        lost_m_s = acceleration_m_s2 * ACCELERATION_SHARE * passed_for_s
        return max(min(told_m_s, was_m_s + gained_m_s), was_m_s - lost_m_s)

    def _told(self, here: Observation, anchor: Observation) -> tuple[tuple[float, float], float]:
        """The commanded motion of the wheels: its direction, a unit vector or (0, 0), and its speed.

        A steered body drives along its heading only, so while it turns only that component counts."""
        vx_m_s, vy_m_s = self._drive.vx_m_s, self._drive.vy_m_s
        if abs(remainder(here.heading_rad - anchor.heading_rad, 2 * pi)) <= TURNED_RAD:
            speed_m_s = hypot(vx_m_s, vy_m_s)
            if speed_m_s == 0.0:
                return (0.0, 0.0), 0.0
            return (vx_m_s / speed_m_s, vy_m_s / speed_m_s), speed_m_s
        ahead = cos(here.heading_rad), sin(here.heading_rad)
        return ahead, max(vx_m_s * ahead[0] + vy_m_s * ahead[1], 0.0)


def unusable(seen: Observation, accuracy_max_m: float, now_us: int) -> str:
    """Why a robot stands with this observation alone; empty if it drives by it.

    `accuracy_max_m`: what its mission needs."""
    if not _is_on_map(seen):
        return NOT_ON_MAP
    here, no_velocity = _sound(seen)
    if no_velocity:
        return NO_VELOCITY
    return _not_now(now_us - seen.sensed_at_us) or _inaccurate(here, accuracy_max_m)


def _not_now(age_us: int) -> str:
    """Why a place of this age is not the current one; empty if it is."""
    if 0 <= age_us <= AGE_MAX_US:
        return ""
    return f"sensed {age_us / 1000:.0f} ms ago" if age_us > 0 else "sensed in the future"


def _inaccurate(here: Observation, accuracy_max_m: float) -> str:
    """Why the place is too inaccurate to drive by; empty if it is not."""
    # Not a number is inaccurate, too, and so is less than nothing.
    if not 0.0 <= here.position_accuracy_m <= accuracy_max_m:
        return f"accurate to {here.position_accuracy_m:.2f} m, needed {accuracy_max_m:.2f} m"
    if not here.heading_accuracy_rad <= HEADING_ACCURACY_RAD:
        return f"heading accurate to {degrees(here.heading_accuracy_rad):.0f} degrees"
    return ""


def _is_on_map(seen: Observation) -> bool:
    """Whether the place is one that frames can carry."""
    return abs(seen.x_m) < -NOWHERE_M and abs(seen.y_m) < -NOWHERE_M and isfinite(seen.heading_rad)


def _sound(seen: Observation) -> tuple[Observation, bool]:
    """What a robot can compute with, and whether the velocity was none. A driver, or somebody on the
    network of a receiver, may say anything.

    A scan with a distance that is none is no scan. A charge or a health that is none is an empty or a
    failed one. The place is left to `_is_on_map`.
    """
    ranges_m = seen.ranges_m
    # The sum is no number where one of them is none.
    if ranges_m and not (sum(ranges_m) >= 0.0 and min(ranges_m) >= 0.0):
        seen = seen._replace(ranges_m=())
    if not 0.0 <= seen.battery <= 1.0:
        seen = seen._replace(battery=1.0 if seen.battery > 1.0 else 0.0)
    if not 0.0 <= seen.health <= 1.0:
        seen = seen._replace(health=1.0 if seen.health > 1.0 else 0.0)
    if hypot(seen.vx_m_s, seen.vy_m_s) < PLACE_UNKNOWN_M_S:
        return seen, False
    return seen._replace(vx_m_s=0.0, vy_m_s=0.0), True
