"""What a robot watches about itself: the state of its bus, whether it is heard, whether it is in time.

* The driver says whether the controller is error passive or off the bus, and whether it takes frames.
* Each member names in each beat one other that it hears, all of them in turn. Who is named by nobody
  for as long as a round takes, and a silence more, speaks into a dead wire: UNHEARD. A link that is
  dead one way only is found so, which no driver can tell.
* A control period that begins later than a drive command lives was missed: the actuator has stopped,
  and the world may have changed. Look round before moving: LATE_TICK.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from agent.cause import Cause
from agent.config import ACTUATOR_TTL_US, S
from agent.effects import HALT, Effect, Trace
from protocol.health import Health

if TYPE_CHECKING:
    from agent.core import Peer

ACTIVE, PASSIVE, OFF = Health  # names of their own: looked up twenty times a second
PASSIVE_US = 1 * S  # a burst of errors passes; a broken wire does not
ROUND_MAX = (
    20  # beats: of n others each names us once in n; that all miss us so long has odds e^-20
)
LATE_HOLD_US = 1 * S  # a robot that was frozen looks around before it moves


class SelfCheck:
    def __init__(self, peer: "Peer", now_us: int) -> None:
        self.peer = peer
        self.reflected_us = now_us  # when somebody last said that it hears us
        self._health = ACTIVE
        self._passive_us: int | None = None  # since when, where it is so
        self._refused_us: int | None = None

    def bus(self, health: Health, taken: bool, now_us: int) -> Sequence[Effect]:
        """What the driver says: its state, and whether it took the last frame."""
        was, self._health = self._health, health
        self._refused_us = None if taken else _first(self._refused_us, now_us)
        self._passive_us = _first(self._passive_us, now_us) if health is PASSIVE else None
        if health is OFF and was is not OFF:
            return self.peer.bus_lost(now_us)
        if was is OFF and health is not OFF:
            return self.peer.bus_back(now_us)
        return ()

    def look(self, late_us: int, now_us: int) -> list[Effect]:
        """Once a control period, which comes `late_us` after its time."""
        effects: list[Effect] = []
        passive = self._passive_us is not None and now_us - self._passive_us >= PASSIVE_US
        why = self._unheard(now_us)
        if passive or why or not self.peer.safety.free:
            effects += self._set(Cause.ERROR_PASSIVE, passive, "", now_us)
            effects += self._set(Cause.UNHEARD, bool(why), why, now_us)
        if late_us > ACTUATOR_TTL_US:
            why = f"{late_us / 1000:.0f} ms late"
            self.peer.safety.raise_cause(Cause.LATE_TICK, now_us, why, LATE_HOLD_US)
            effects += [HALT, Trace("safety", "", "LATE_TICK", "PROTECTIVE", why)]
        return effects

    def _unheard(self, now_us: int) -> str:
        """Why nothing we say arrives, as far as we know; empty where it does."""
        peer = self.peer
        if not peer.joining.joined:
            self.reflected_us = now_us  # nothing is said yet
            return ""
        if self._refused_us is not None and now_us - self._refused_us >= peer.beat.silence_us:
            return "the bus takes no frame"
        others = len(peer.membership.live) - 1
        if not others:
            return ""
        limit_us = peer.beat.silence_us + min(others, ROUND_MAX) * peer.beat.pose_us
        since_us = max(self.reflected_us, peer.membership.changed_us)
        return "" if now_us - since_us <= limit_us else f"none of {others} members hears us"

    def _set(self, cause: Cause, there: bool, why: str, now_us: int) -> list[Effect]:
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
