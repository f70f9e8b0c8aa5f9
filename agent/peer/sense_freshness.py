"""Whether the senses of a robot are current: absent, old or frozen senses stop it.

An observation carries the time at which it was sensed. Without one younger than `AGE_MAX_US` the
robot does not know where it is. A receiver with a hung filter sends the same place with new times.
This shows when the wheels are commanded to drive and the place does not change: two control periods
at full speed are enough to detect it, and a tenth of a metre from standstill. Spinning wheels look
the same as a frozen place, so the robot stops in this case as well.
"""

from collections.abc import Mapping
from math import cos, hypot, pi, radians, remainder, sin
from typing import Any, Final

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, S
from agent.interface.effects import HALT, Drive, Effect, Trace
from agent.interface.motion_controller import MotionController
from agent.interface.observation import Observation
from agent.peer import inputs, notices
from agent.peer.part import NOTHING, DirectListener, Listener, Outputs, Part, StepContext
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController

# Two missed control periods, the lifetime of a drive command. It is detected at most one period later,
# so the robot drives 0.15 s: 0.38 m at 2.5 m/s. It plans to brake with 0.7 of its deceleration
# (`BRAKING_SHARE`), which leaves 0.89 m of reserve before a fence at that speed. Below 1 m/s
# `MARGIN_M`, 0.15 m, is enough.
AGE_MAX_US: Final = 2 * CONTROL_PERIOD_US
STEADY_US: Final = 1 * S  # the senses must be in time for this long before it drives on
STAYS_M: Final = 0.005  # a smaller change is no movement; a hung filter repeats the same place
FROZEN_M: Final = 0.1  # expected travel without a change of place, over two periods at least
TURNED_RAD: Final = radians(1.0)  # if the heading changes more, it is not frozen with the place
# Share of the wheels' acceleration: allows for slip and drive lag. Brakes are assumed to act instantly.
ACCELERATION_SHARE: Final = 0.5
ACCELERATION_M_S2: Final = 0.5  # used if the acceleration of the body is not known
assert AGE_MAX_US <= ACTUATOR_TTL_US


class Senses(Part):
    """Watches one robot's senses in each control period, before any decision."""

    def __init__(
        self, safety: StopController, motion: MotionController | None, drives: bool
    ) -> None:
        """`drives`: the robot has a mission and can move."""
        self.safety, self.motion, self.drives = safety, motion, drives
        self.here: Observation | None = None  # the newest observation
        self.current = False  # whether the sensed place is our current place
        self._sensed_at_us: int | None = None  # time of the newest observation
        # time of the observation last compared with the wheels
        self._compared_at_us: int | None = None
        self._late_at_us = 0  # when the senses were last old
        self._drive: Drive = HALT  # the command in force since the last period
        self._anchor: Observation | None = None  # the last observation at which the place changed
        self._anchor_at_us = 0
        self._periods = 0  # observations since the anchor
        self._changed = False  # whether the place changed in this period
        self._expected_m_s = self._expected_m = 0.0  # speed and travel expected since the anchor

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.WasStarted: self._started}

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {inputs.Sensed: self._take, notices.ControlDue: self._period}

    def _take(self, fact: inputs.Sensed, now_us: int) -> Outputs:
        """The current observation, or None."""
        if fact.observation is not None:
            self.here = fact.observation
            self._sensed_at_us = fact.observation.sensed_at_us
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

    def _started(self, ctx: StepContext, notice: notices.WasStarted) -> Outputs:
        """Restart the check whether the place follows the wheels."""
        self._anchor = None
        return NOTHING

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
        effects = self._set(StopCause.SENSES_OLD, bool(old) or steady, old, now_us)
        self._changed = False
        frozen = ""
        if (
            self._sensed_at_us is not None
            and self._sensed_at_us != self._compared_at_us
            and not old
        ):
            frozen = self._frozen(self._sensed_at_us)
            self._compared_at_us = self._sensed_at_us
        if frozen or self._changed:
            effects += self._set(StopCause.PLACE_FROZEN, bool(frozen), frozen, now_us)
        self.current = not (old or safety.holds(StopCause.PLACE_FROZEN))
        return effects

    def _old(self, now_us: int) -> str:
        """Why the senses are not current; empty if they are."""
        if self._sensed_at_us is None:
            return "nothing is sensed"
        age_us = now_us - self._sensed_at_us
        if 0 <= age_us <= AGE_MAX_US:
            return ""
        return f"sensed {age_us / 1000:.0f} ms ago" if age_us > 0 else "sensed in the future"

    def _frozen(self, sensed_at_us: int) -> str:
        """Why the place does not follow the wheels; empty if it does or need not."""
        here, anchor = self.here, self._anchor
        assert here is not None
        away_m = 0.0
        if anchor is not None:
            away_m = hypot(here.x_m - anchor.x_m, here.y_m - anchor.y_m)
        self._changed = away_m > STAYS_M
        if anchor is None or self._changed:
            passed_for_us = sensed_at_us - self._anchor_at_us
            self._expected_m_s = away_m * S / passed_for_us if passed_for_us > 0 else 0.0
            self._anchor, self._anchor_at_us = here, sensed_at_us
            self._periods, self._expected_m = 0, 0.0
            return ""
        start_at_us = sensed_at_us if self._compared_at_us is None else self._compared_at_us
        # After the lifetime of the command it is void.
        passed_for_s = min(max(sensed_at_us - start_at_us, 0), ACTUATOR_TTL_US) / S
        told_m_s = self._told_m_s(here, anchor)
        faster_m_s = self._expected_m_s + self._acceleration_m_s2 * passed_for_s
        self._expected_m_s = min(told_m_s, faster_m_s)
        self._expected_m += self._expected_m_s * passed_for_s
        self._periods += 1
        if self._expected_m < FROZEN_M or self._periods < 2:
            return ""
        return f"told to drive {self._expected_m:.2f} m, moved {away_m * 1000:.0f} mm"

    def _told_m_s(self, here: Observation, anchor: Observation) -> float:
        """The commanded speed of the wheels.

        A steered body drives along its heading only, so while it turns only that component counts."""
        vx_m_s, vy_m_s = self._drive.vx_m_s, self._drive.vy_m_s
        if abs(remainder(here.heading_rad - anchor.heading_rad, 2 * pi)) <= TURNED_RAD:
            return hypot(vx_m_s, vy_m_s)
        ahead_m_s = vx_m_s * cos(here.heading_rad) + vy_m_s * sin(here.heading_rad)
        return max(ahead_m_s, 0.0)

    @property
    def _acceleration_m_s2(self) -> float:
        motion = self.motion
        limits = None if motion is None else motion.body_limits
        if limits is None:
            return ACCELERATION_M_S2
        return ACCELERATION_SHARE * limits.acceleration_m_s2

    def _set(self, cause: StopCause, there: bool, why: str, now_us: int) -> list[Effect]:
        safety = self.safety
        if there == safety.holds(cause):
            return []
        if there:
            safety.raise_cause(cause, now_us, why)
            return [HALT, Trace("safety", "", cause.name, "PROTECTIVE", why)]
        safety.clear_cause(cause, now_us)
        return [Trace("safety", "PROTECTIVE", cause.name, "", "gone")]
