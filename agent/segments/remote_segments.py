"""What a robot knows about other segments: whether they are reached, and some of their summaries.

The state does not grow with the fleet: a summary is eight bytes, and only the newest `SUMMARIES_MAX`
are kept. Safety does not depend on it.
"""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, NamedTuple

from agent.interface.config import S
from agent.interface.effects import HALT, Trace
from agent.interface.identity import SilencePolicy
from agent.interface.instants import FOREVER_US
from agent.peer.part import NOTHING, Handler, Header, Outputs, Part, StepContext
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from agent.segments.segment_area import Area
from protocol.frames.segment_frames import GatewayBeat, SegmentSummary

# Without a gateway that reaches a segment for this long, none is reached. After a gateway dies, another
# one leads in 2.3 s.
ALONE_US = 3 * S
SUMMARIES_MAX = 64  # summaries of segments that are kept


class ReceivedSummary(NamedTuple):
    """The newest summary of a segment, and when it was received, microseconds."""

    summary: SegmentSummary
    heard_at_us: int


class RemoteSegments(Part):
    """The part of a robot that tracks the other segments and applies the policy to their loss."""

    def __init__(
        self, area: Area, policy: SilencePolicy, safety: StopController, now_us: int
    ) -> None:
        """`policy`: what to do if no other segment is reached any more."""
        self.area, self.policy, self.safety = area, policy, safety
        self.segment = area.segment
        self.reached = 0  # number of other segments that the leading gateway reaches
        self.alone = True  # no other segment is reached
        self.ever = False  # one was reached since we started
        self.summaries: OrderedDict[int, ReceivedSummary] = OrderedDict()
        self._reached_at_us = now_us

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {GatewayBeat: self._gateway, SegmentSummary: self._gateway}

    @property
    def due_at_us(self) -> int:
        return FOREVER_US if self.alone else self._reached_at_us + ALONE_US

    def on_timer(self, ctx: StepContext) -> Outputs:
        return self._changed() if self.on_tick(ctx.now_us) else NOTHING

    def may_claim(self, section: int) -> bool:
        """Whether a section may be claimed: its home decides about a borrowed one, so the home must
        be reached.
        """
        return not self.alone or section not in self.area.borrowed

    def _gateway(
        self, ctx: StepContext, header: Header, m: GatewayBeat | SegmentSummary
    ) -> Outputs:
        return self._changed() if self.on_message(m, ctx.now_us) else NOTHING

    def _changed(self) -> Outputs:
        """Whether other segments are reached has changed: the policy says what that means."""
        held: list[Any] = []
        if self.policy is SilencePolicy.STOP:
            self._cause(StopCause.BACKBONE_LOST)
            held = [HALT] if self.alone else []
        elif self.policy is SilencePolicy.SLOW:
            self._cause(StopCause.BACKBONE_CREEP)
        return [*held, Trace("beyond", "", "ALONE" if self.alone else "REACHED", "", "")]

    def _cause(self, cause: StopCause) -> None:
        if self.alone:
            self.safety.raise_cause(cause, 0, "no other segment is reached")
        else:
            self.safety.clear_cause(cause, 0)

    def on_message(self, m: GatewayBeat | SegmentSummary, now_us: int) -> bool:
        """Take in a gateway's frame; returns whether this changed `alone`."""
        if isinstance(m, SegmentSummary):
            if m.segment != self.segment:
                self.summaries.pop(m.segment, None)
                self.summaries[m.segment] = ReceivedSummary(m, now_us)
                if len(self.summaries) > SUMMARIES_MAX:
                    self.summaries.popitem(last=False)
            return False
        if not m.leads:
            return False
        self.reached = m.reached
        if not m.reached:
            if m.ever and not self.alone:
                self.alone = True  # the gateway had reached a segment and reports that it lost it
                return True
            return self.on_tick(now_us)
        self._reached_at_us = now_us
        was, self.alone, self.ever = self.alone, False, True
        return was

    def on_tick(self, now_us: int) -> bool:
        """Notice that no segment is reached any more; returns whether this changed `alone`."""
        if self.alone or now_us < self._reached_at_us + ALONE_US:
            return False
        self.alone, self.reached = True, 0
        return True
