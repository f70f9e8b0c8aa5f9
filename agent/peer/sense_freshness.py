"""Whether what a robot senses is of now: senses that are absent, old or frozen stop it.

An observation says when it was sensed. Without a younger one than `AGE_MAX_US` the robot does not know
where it is. A receiver whose filter hangs sends the same place with new times: that shows when the wheels
are told to drive and the place stays. Two control periods of a drive at full speed are enough to tell,
and from standing a tenth of a metre. A robot whose wheels spin cannot be told from one whose place is
frozen, and stands as well.
"""

from math import cos, hypot, pi, radians, remainder, sin
from typing import TYPE_CHECKING, Final

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, S
from agent.interface.effects import HALT, Drive, Effect, Trace
from agent.interface.ports import Observation
from agent.safety.stop_cause import StopCause

if TYPE_CHECKING:
    from agent.peer.peer import Peer

# Two missed control periods, as long as a drive command lives. Noticed one period later at most, a robot
# drives 0.15 s: 0.38 m at 2.5 m/s. It plans to brake with 0.7 of what it has (`BRAKING_SHARE`), so that
# 0.89 m of its way before a fence are spare at that speed; below 1 m/s `MARGIN_M`, 0.15 m, is enough.
AGE_MAX_US: Final = 2 * CONTROL_PERIOD_US
STEADY_US: Final = 1 * S  # so long they must be in time again before it drives on
STAYS_M: Final = 0.005  # a place that moves less has not moved; a filter that hangs repeats itself
FROZEN_M: Final = 0.1  # so much way without a change of place, in two periods at least
TURNED_RAD: Final = radians(1.0)  # a heading that changes more is not frozen with the place
# Of what wheels can accelerate: slip, and a drive that follows late. Brakes are expected to act at once.
ACCELERATION_SHARE: Final = 0.5
ACCELERATION_M_S2: Final = 0.5  # where the body's own is not known
assert AGE_MAX_US <= ACTUATOR_TTL_US


class Senses:
    """One robot's: watched in each control period, before anything is decided."""

    def __init__(self, peer: "Peer") -> None:
        self.peer = peer
        self.current = False  # the place that we tell is the one that we are at
        self._sensed_us: int | None = None  # of the newest observation
        self._compared_us: int | None = (
            None  # of the observation that was last compared with the wheels
        )
        self._late_us = 0  # when they were last old
        self._drive: Drive = HALT  # in force since the last period
        self._anchor: Observation | None = None  # the place since which nothing has changed
        self._anchor_us = 0
        self._periods = 0  # observations since then
        self._changed = False  # the place, in this period
        self._expected_m_s = self._expected_m = 0.0  # what the wheels must have done since then

    def take(self, seen: Observation | None) -> None:
        """What the body senses now, or that it senses nothing."""
        if seen is not None:
            self._sensed_us = seen.sensed_at_us

    def age_us(self, now_us: int) -> int | None:
        """Of the newest observation; None: nothing was ever sensed."""
        return None if self._sensed_us is None else now_us - self._sensed_us

    @property
    def expected(self) -> bool:
        """The robot drives by its senses, or has sensed before."""
        peer = self.peer
        drives = peer.mission is not None and peer.motion is not None
        return drives or self._sensed_us is not None

    def drove(self, drive: Drive) -> None:
        """What the wheels were told."""
        self._drive = drive

    def started(self) -> None:
        """An operator's start: look again whether the place follows the wheels."""
        self._anchor = None

    def look(self, now_us: int) -> list[Effect]:
        """Once a control period. What has neither a drive nor senses is not held by them."""
        peer = self.peer
        if not self.expected:
            self.current = False
            return []
        old = self._old(now_us)
        if old:
            self._late_us = now_us
        safety = peer.safety
        steady = safety.holds(StopCause.SENSES_OLD) and now_us - self._late_us < STEADY_US
        effects = self._set(StopCause.SENSES_OLD, bool(old) or steady, old, now_us)
        self._changed = False
        frozen = ""
        if self._sensed_us is not None and self._sensed_us != self._compared_us and not old:
            frozen = self._frozen(self._sensed_us)
            self._compared_us = self._sensed_us
        if frozen or self._changed:
            effects += self._set(StopCause.PLACE_FROZEN, bool(frozen), frozen, now_us)
        self.current = not (old or safety.holds(StopCause.PLACE_FROZEN))
        return effects

    def _old(self, now_us: int) -> str:
        """Why what is sensed is not of now; empty where it is."""
        if self._sensed_us is None:
            return "nothing is sensed"
        age_us = now_us - self._sensed_us
        if 0 <= age_us <= AGE_MAX_US:
            return ""
        return f"sensed {age_us / 1000:.0f} ms ago" if age_us > 0 else "sensed in the future"

    def _frozen(self, sensed_us: int) -> str:
        """Why the place does not follow the wheels; empty where it does, or need not."""
        here, anchor = self.peer.here, self._anchor
        assert here is not None
        away_m = 0.0
        if anchor is not None:
            away_m = hypot(here.x_m - anchor.x_m, here.y_m - anchor.y_m)
        self._changed = away_m > STAYS_M
        if anchor is None or self._changed:
            passed_us = sensed_us - self._anchor_us
            self._expected_m_s = away_m * S / passed_us if passed_us > 0 else 0.0
            self._anchor, self._anchor_us = here, sensed_us
            self._periods, self._expected_m = 0, 0.0
            return ""
        since_us = sensed_us if self._compared_us is None else self._compared_us
        passed_s = (
            min(max(sensed_us - since_us, 0), ACTUATOR_TTL_US) / S
        )  # then the command is void
        told_m_s = self._told_m_s(here, anchor)
        faster_m_s = self._expected_m_s + self._acceleration_m_s2 * passed_s
        self._expected_m_s = min(told_m_s, faster_m_s)
        self._expected_m += self._expected_m_s * passed_s
        self._periods += 1
        if self._expected_m < FROZEN_M or self._periods < 2:
            return ""
        return f"told to drive {self._expected_m:.2f} m, moved {away_m * 1000:.0f} mm"

    def _told_m_s(self, here: Observation, anchor: Observation) -> float:
        """The speed that the wheels were told. A body that steers drives along its heading only: while it
        turns, that part counts."""
        vx_m_s, vy_m_s = self._drive.vx_m_s, self._drive.vy_m_s
        if abs(remainder(here.heading_rad - anchor.heading_rad, 2 * pi)) <= TURNED_RAD:
            return hypot(vx_m_s, vy_m_s)
        ahead_m_s = vx_m_s * cos(here.heading_rad) + vy_m_s * sin(here.heading_rad)
        return max(ahead_m_s, 0.0)

    @property
    def _acceleration_m_s2(self) -> float:
        motion = self.peer.motion
        limits = None if motion is None else motion.body_limits
        if limits is None:
            return ACCELERATION_M_S2
        return ACCELERATION_SHARE * limits.acceleration_m_s2

    def _set(self, cause: StopCause, there: bool, why: str, now_us: int) -> list[Effect]:
        safety = self.peer.safety
        if there == safety.holds(cause):
            return []
        if there:
            safety.raise_cause(cause, now_us, why)
            return [HALT, Trace("safety", "", cause.name, "PROTECTIVE", why)]
        safety.clear_cause(cause, now_us)
        return [Trace("safety", "PROTECTIVE", cause.name, "", "gone")]
