"""What a robot knows about other segments: whether they are reached, and some of their summaries.

The state does not grow with the fleet: a summary is eight bytes, and only the newest `SUMMARIES_MAX`
are kept. Safety does not depend on it.
"""

from collections import OrderedDict
from typing import NamedTuple

from agent.interface.config import S
from protocol.frames.segment_frames import GatewayBeat, SegmentSummary

ALONE_US = (
    3 * S
)  # time without a gateway that reaches a segment; after a gateway dies, another leads in 2.3 s
SUMMARIES_MAX = 64


class Heard(NamedTuple):
    summary: SegmentSummary
    heard_us: int


class RemoteSegments:
    def __init__(self, segment: int, now_us: int) -> None:
        self.segment = segment
        self.reached = 0  # other segments, as the leading gateway says
        self.alone = True  # no other segment is reached
        self.ever = False  # one was reached since we started
        self.summaries: OrderedDict[int, Heard] = OrderedDict()
        self._reached_us = now_us

    @property
    def deadline_us(self) -> int | None:
        return None if self.alone else self._reached_us + ALONE_US

    def hear(self, m: GatewayBeat | SegmentSummary, now_us: int) -> bool:
        """Returns whether this changed `alone`."""
        if isinstance(m, SegmentSummary):
            if m.segment != self.segment:
                self.summaries.pop(m.segment, None)
                self.summaries[m.segment] = Heard(m, now_us)
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
            return self.tick(now_us)
        self._reached_us = now_us
        was, self.alone, self.ever = self.alone, False, True
        return was

    def tick(self, now_us: int) -> bool:
        if self.alone or now_us < self._reached_us + ALONE_US:
            return False
        self.alone, self.reached = True, 0
        return True
