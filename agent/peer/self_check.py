"""A robot's checks of itself: the state of its bus, whether it is received, whether it is in time.

* The driver reports whether the controller is error passive or off the bus, and whether it accepts
  frames.
* The driver may report how many own frames were sent (`agent.interface.ports.Confirming`). If none
  was sent for a silence timeout, the robot cannot be received. On a bus full of more urgent frames no
  stop can be received either. Both raise UNHEARD. A stop has a higher priority than a robot's other
  frames, so if those were sent, a stop could be sent too.
* Each member names in each beat one other member that it receives, in rotation. If no member names
  this robot for one rotation plus a silence timeout, its frames do not arrive: UNHEARD. This also
  detects a link that is dead in one direction, which no driver can detect.
* A robot that receives no member may go on alone, by its policy, only while its driver confirms that
  its frames are sent. On an interface without confirmation it stands still until it is named again.
* A control period that begins after the last drive command has expired was missed: the actuator has
  stopped, and the surroundings may have changed. So the robot waits before it moves: LATE_TICK.
"""

from collections.abc import Mapping
from typing import Any, Final

from agent.interface.config import ACTUATOR_TTL_US, MS, BeaconTiming, S
from agent.interface.effects import HALT, Trace
from agent.interface.instants import FOREVER_US, NEVER_US
from agent.peer import inputs, notices
from agent.peer.membership import Membership
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, DirectListener, Outputs, Part, StepContext
from agent.safety.standard_stop import SAY_US
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.controller_health import Health
from protocol.frames.frame import Frame

ACTIVE, PASSIVE, OFF = Health.ACTIVE, Health.PASSIVE, Health.OFF  # looked up twenty times a second
PASSIVE_US = 1 * S  # a burst of errors is shorter; a broken wire is not
# Beats. Each of n others names us once in n beats, so the odds that all miss us this long are e^-20.
ROUND_MAX = 20
LATE_HOLD_US = 1 * S  # a robot whose control froze waits this long before it moves
# A robot that was deaf, or has just booted, listens this long before it moves: a stop button that is
# pressed says so once in `SAY_US`, and its frame waits for other frames.
LISTEN_US: Final = SAY_US + 100 * MS
# Frames up to this priority are queued even if no frame is sent: stops, resets, proofs.
URGENT: Final = 3
# One other frame is queued this often, to detect that a bus that lost its queue works again.
PROBE_US: Final = 2 * S


class SelfCheck(Part):
    """The part that stops this robot while its bus, its reception or its timing fails."""

    def __init__(
        self,
        safety: StopController,
        joining: NetworkJoin,
        membership: Membership,
        beat: BeaconTiming,
        now_us: int,
    ) -> None:
        self.safety, self.joining, self.membership = safety, joining, membership
        self.beat = beat
        self.clogged = False  # our frames are not sent: do not add to the queue
        self._health = ACTIVE
        self._passive_at_us: int | None = None  # since when it is error passive; None: it is not
        self._refused_at_us: int | None = None
        self._sent: int | None = None  # frames sent; None: the interface does not report it
        self._sent_at_us = NEVER_US  # the newest confirmed frame was sent at this time or later
        self._looked_at_us = now_us  # when the driver was asked last
        self._well_at_us: int | None = None  # since when we are received again, while UNHEARD holds
        self._probed_at_us = now_us
        # before this, missing confirmations mean nothing: we just joined
        self._confirms_at_us = now_us
        self._deaf_at_us = now_us  # the newest time at which we may have received nothing

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {inputs.BusState: self._bus, notices.ControlDue: self._period}

    def _bus(self, fact: inputs.BusState, now_us: int) -> Outputs:
        """The driver's report."""
        health, taken, sent = fact
        was, self._health = self._health, health
        self._refused_at_us = None if taken else _first(self._refused_at_us, now_us)
        self._passive_at_us = _first(self._passive_at_us, now_us) if health is PASSIVE else None
        if sent != self._sent:
            if sent is not None and self._sent is not None:
                self._sent_at_us = self._looked_at_us  # at that time or after it
            self._sent = sent
        self._looked_at_us = now_us
        if health is OFF:
            self._deaf_at_us = now_us
        if not self.joining.joined:
            self._confirms_at_us = now_us + self.beat.silence_for_us
        self.clogged = sent is not None and now_us >= max(self._stall_at_us, self._confirms_at_us)
        if health is OFF and was is not OFF:
            return [HALT, notices.BusLost()]
        if was is OFF and health is not OFF:
            return [notices.BusBack()]
        return NOTHING

    @property
    def controller(self) -> Health:
        """The state of the controller, as last reported by its driver."""
        return self._health

    def lets_out(self, frame: Frame, now_us: int) -> bool:
        """Whether this frame is queued although none of our frames is being sent."""
        if frame.identifier >> 26 <= URGENT:
            return True
        if now_us - self._probed_at_us < PROBE_US:
            return False
        self._probed_at_us = now_us
        return True

    @property
    def _stall_at_us(self) -> int:
        """The time at which no frame of ours was sent for a silence timeout."""
        return self._sent_at_us + self.beat.silence_for_us

    @property
    def due_at_us(self) -> int:
        """When our frames may be stuck for a silence timeout; later checks run each control period."""
        if self._sent is None or not self.joining.joined:
            return FOREVER_US
        stall_at_us = self._stall_at_us
        return FOREVER_US if stall_at_us <= self._looked_at_us else stall_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        stuck = self._sent is not None and ctx.now_us >= self._stall_at_us
        if not stuck or self.safety.holds(StopCause.UNHEARD):
            return NOTHING
        return self.look(0, ctx.now_us)

    def _period(self, notice: notices.ControlDue, now_us: int) -> Outputs:
        return self.look(notice.late_for_us, now_us)

    def look(self, late_for_us: int, now_us: int) -> Outputs:
        """Called once a control period, `late_for_us` after its due time, and when frames are stuck."""
        outputs: list[Any] = []
        passive = self._passive_at_us is not None and now_us - self._passive_at_us >= PASSIVE_US
        why = self._unheard(now_us)
        if passive or why or not self.safety.free:
            outputs += self._set(StopCause.ERROR_PASSIVE, passive, "", now_us)
            outputs += self._set(StopCause.UNHEARD, self._holds_on(why, now_us), why, now_us)
        if late_for_us > ACTUATOR_TTL_US:
            why = f"{late_for_us / 1000:.0f} ms late"
            self.safety.raise_cause(StopCause.LATE_TICK, now_us, why, LATE_HOLD_US)
            outputs += [HALT, Trace("safety", "", "LATE_TICK", "PROTECTIVE", why)]
        return outputs

    def _holds_on(self, why: str, now_us: int) -> bool:
        """Hold UNHEARD longer, so that stops arrive first: those queued with our frames, and those of
        buttons that were pressed while we heard nothing. A robot that only claims its address again,
        as it does after a reset, has heard all the time."""
        if why and now_us >= self._confirms_at_us:
            self._deaf_at_us = now_us
        if why or not self.safety.holds(StopCause.UNHEARD):
            self._well_at_us = None
            return bool(why)
        self._well_at_us = _first(self._well_at_us, now_us)
        listens = now_us - self._deaf_at_us < LISTEN_US
        return listens or now_us - self._well_at_us < self.beat.silence_for_us

    def _unheard(self, now_us: int) -> str:
        """Why our frames do not arrive, as far as we know; empty if they do."""
        membership = self.membership
        if not self.joining.joined:
            membership.forget_reflection()  # we have sent nothing yet
            self._sent_at_us = NEVER_US
            return ""
        silence_for_us, others = self.beat.silence_for_us, len(membership.live) - 1
        if self._refused_at_us is not None and now_us - self._refused_at_us >= silence_for_us:
            return "the bus takes no frame"
        if self._sent is not None and now_us >= self._stall_at_us:
            return "none of our frames leaves"
        if not others:
            return "" if self._sent is not None else "no member is heard, and no frame is confirmed"
        limit_for_us = silence_for_us + min(others, ROUND_MAX) * self.beat.pose_period_us
        start_at_us = membership.reflected_at_us
        if self._sent is not None:  # frames are sent; a new member needs time to name us
            start_at_us = max(start_at_us, membership.changed_at_us)
        return "" if now_us - start_at_us <= limit_for_us else f"no member of {others} hears us"

    def _set(self, cause: StopCause, there: bool, why: str, now_us: int) -> Outputs:
        outputs = self.safety.hold_while(cause, there, why, now_us)
        if outputs and not there and cause is StopCause.UNHEARD:
            return [notices.ReceivedAgain(), *outputs]
        return outputs


def _first(start_at_us: int | None, now_us: int) -> int:
    return now_us if start_at_us is None else start_at_us
