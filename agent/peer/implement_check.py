"""Whether the implement rises when it is told to: one that stays down stops the robot.

A plough, a mower or a weeder that stays down works ground that it must not work: what another robot has
worked, the headland, a crop. Only a body that senses its implement shows this. Where an observation says
nothing of it, nothing is checked, and `docs/use/own_machine.md` says so.
"""

from collections.abc import Mapping
from typing import Any, Final

from agent.interface.config import S
from agent.peer import notices
from agent.peer.part import NOTHING, DirectListener, Outputs, Part
from agent.peer.sense_freshness import Senses
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController

# Hydraulics lift a small implement in less. A robot at 2.5 m/s drives 2.5 m in this time, and a metre
# until it stands. The driver of a slower implement says that it is up as soon as it begins to rise.
RISES_WITHIN_US: Final = 1 * S


class ImplementCheck(Part):
    """Compares in each control period what the implement was told with what is sensed of it."""

    def __init__(self, safety: StopController, senses: Senses) -> None:
        self.safety, self.senses = safety, senses
        self._stays_since_at_us: int | None = None  # down, and told to be up

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {notices.ControlDue: self._period}

    def _period(self, notice: notices.ControlDue, now_us: int) -> Outputs:
        here = self.senses.here
        if here is None or here.implement_down is None or not self.senses.current:
            return NOTHING  # a robot without senses stands
        if self.senses.implement_told_down or not here.implement_down:
            self._stays_since_at_us = None
        elif self._stays_since_at_us is None:
            self._stays_since_at_us = now_us
        begun_at_us, held = self._stays_since_at_us, self.safety.holds(StopCause.IMPLEMENT_DOWN)
        if begun_at_us is None and not held:
            return NOTHING
        stays = begun_at_us is not None and (held or now_us - begun_at_us > RISES_WITHIN_US)
        why = "" if begun_at_us is None else f"down for {(now_us - begun_at_us) / S:.1f} s"
        return self.safety.hold_while(StopCause.IMPLEMENT_DOWN, stays, why, now_us)
