"""What a robot watches about itself: the state of its bus, whether it is heard, whether it is in time.

* The driver says whether the controller is error passive or off the bus, and whether it takes frames.
* The driver may tell which own frames have left (`agent.interface.ports.Confirming`). When none
has for a silence,
  the robot cannot be heard, and on a bus that is full of more urgent frames nobody's stop can be heard
  either: UNHEARD. A stop outranks what a robot says: where its frame has left, a stop could have.
* Each member names in each beat one other that it hears, all of them in turn. Who is named by nobody
  for as long as a round takes, and a silence more, speaks into a dead wire: UNHEARD. A link that is
  dead one way only is found so, which no driver can tell.
* A robot that hears nobody may go on alone, by its policy, only while its driver tells that its frames
  leave. On an interface that cannot tell it stands until it is named again.
* A control period that begins later than a drive command lives was missed: the actuator has stopped,
  and the world may have changed. Look round before moving: LATE_TICK.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from agent.interface.config import ACTUATOR_TTL_US, S
from agent.interface.effects import HALT, Effect, Trace
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.frame import Frame

if TYPE_CHECKING:
    from agent.peer.peer import Peer

ACTIVE, PASSIVE, OFF = Health.ACTIVE, Health.PASSIVE, Health.OFF  # looked up twenty times a second
PASSIVE_US = 1 * S  # a burst of errors passes; a broken wire does not
ROUND_MAX = (
    20  # beats: of n others each names us once in n; that all miss us so long has odds e^-20
)
LATE_HOLD_US = 1 * S  # a robot that was frozen looks around before it moves
NEVER_US: Final = -(1 << 62)
FOREVER_US: Final = 1 << 62
URGENT: Final = (
    3  # frames up to this priority are sent although nothing leaves: stops, resets, proofs
)
PROBE_US: Final = (
    2 * S
)  # one other frame is, so often: a bus that has lost what it took shows it is back


class SelfCheck:
    def __init__(self, peer: "Peer", now_us: int) -> None:
        self.peer = peer
        self.reflected_us = NEVER_US  # when somebody last said that it hears us
        self.clogged = False  # our frames do not leave: do not add to those that wait
        self._health = ACTIVE
        self._passive_us: int | None = None  # since when, where it is so
        self._refused_us: int | None = None
        self._sent: int | None = None  # frames that have left; None: the interface does not tell
        self._left_us = NEVER_US  # one had not left before this
        self._looked_us = now_us  # when the driver was asked last
        self._well_us: int | None = None  # since when we are heard again, while UNHEARD holds on
        self._probed_us = now_us
        self._fresh_us = now_us  # before this nothing that we said as a member can be missed

    def bus(
        self, health: Health, taken: bool, now_us: int, sent: int | None = None
    ) -> Sequence[Effect]:
        """What the driver says: its state, whether it took the last frame, and how many have left."""
        was, self._health = self._health, health
        self._refused_us = None if taken else _first(self._refused_us, now_us)
        self._passive_us = _first(self._passive_us, now_us) if health is PASSIVE else None
        if sent != self._sent:
            if sent is not None and self._sent is not None:
                self._left_us = self._looked_us  # at that time or after it
            self._sent = sent
        self._looked_us = now_us
        if not self.peer.joining.joined:
            self._fresh_us = now_us + self.peer.beat.silence_us
        self.clogged = sent is not None and now_us >= max(self._stall_us, self._fresh_us)
        if health is OFF and was is not OFF:
            return self.peer.bus_lost(now_us)
        if was is OFF and health is not OFF:
            return self.peer.bus_back(now_us)
        return ()

    @property
    def controller(self) -> Health:
        """The state of the controller, as its driver said it last."""
        return self._health

    def lets_out(self, frame: Frame, now_us: int) -> bool:
        """Whether this frame is sent although none of ours leaves."""
        if frame.identifier >> 26 <= URGENT:
            return True
        if now_us - self._probed_us < PROBE_US:
            return False
        self._probed_us = now_us
        return True

    @property
    def _stall_us(self) -> int:
        """From then on none of our frames has left for a silence."""
        return self._left_us + self.peer.beat.silence_us

    @property
    def deadline_us(self) -> int:
        """When our frames may have been stuck for a silence. A control period sees what was so before."""
        stall_us = self._stall_us
        return FOREVER_US if self._sent is None or stall_us <= self._looked_us else stall_us

    def due(self, now_us: int) -> bool:
        stuck = self._sent is not None and now_us >= self._stall_us
        return stuck and not self.peer.safety.holds(StopCause.UNHEARD)

    def look(self, late_us: int, now_us: int) -> list[Effect]:
        """Once a control period, which comes `late_us` after its time, and when our frames are stuck."""
        effects: list[Effect] = []
        passive = self._passive_us is not None and now_us - self._passive_us >= PASSIVE_US
        why = self._unheard(now_us)
        if passive or why or not self.peer.safety.free:
            effects += self._set(StopCause.ERROR_PASSIVE, passive, "", now_us)
            effects += self._set(StopCause.UNHEARD, self._holds_on(why, now_us), why, now_us)
        if late_us > ACTUATOR_TTL_US:
            why = f"{late_us / 1000:.0f} ms late"
            self.peer.safety.raise_cause(StopCause.LATE_TICK, now_us, why, LATE_HOLD_US)
            effects += [HALT, Trace("safety", "", "LATE_TICK", "PROTECTIVE", why)]
        return effects

    def _holds_on(self, why: str, now_us: int) -> bool:
        """A silence longer than its reason: stops that have waited with our frames come first."""
        if why or not self.peer.safety.holds(StopCause.UNHEARD):
            self._well_us = None
            return bool(why)
        self._well_us = _first(self._well_us, now_us)
        return now_us - self._well_us < self.peer.beat.silence_us

    def _unheard(self, now_us: int) -> str:
        """Why nothing we say arrives, as far as we know; empty where it does."""
        peer = self.peer
        if not peer.joining.joined:
            self.reflected_us = self._left_us = NEVER_US  # nothing is said yet
            return ""
        silence_us, others = peer.beat.silence_us, len(peer.membership.live) - 1
        if self._refused_us is not None and now_us - self._refused_us >= silence_us:
            return "the bus takes no frame"
        if self._sent is not None and now_us >= self._stall_us:
            return "none of our frames leaves"
        if not others:
            return "" if self._sent is not None else "nobody is heard, and no frame is confirmed"
        limit_us = silence_us + min(others, ROUND_MAX) * peer.beat.pose_us
        since_us = self.reflected_us
        if self._sent is not None:  # it is heard by the bus; a new member needs its time to name us
            since_us = max(since_us, peer.membership.changed_us)
        return "" if now_us - since_us <= limit_us else f"none of {others} members hears us"

    def _set(self, cause: StopCause, there: bool, why: str, now_us: int) -> list[Effect]:
        safety = self.peer.safety
        if there == safety.holds(cause):
            return []
        if there:
            safety.raise_cause(cause, now_us, why)
            return [HALT, Trace("safety", "", cause.name, "PROTECTIVE", why)]
        safety.clear_cause(cause, now_us)
        return [Trace("safety", "PROTECTIVE", cause.name, "", "gone")]


def _first(since_us: int | None, now_us: int) -> int:
    return now_us if since_us is None else since_us
