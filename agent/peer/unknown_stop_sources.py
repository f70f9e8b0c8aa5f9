"""Stops from addresses whose NAME is not known: how long they are in doubt, and what ends the doubt.

Another maker's frame of the same group is not a stop, so such a frame does not latch immediately. But
the sender may be a robot of ours or an operator's device whose claim was missed. The robot stands
still during the doubt and asks for the NAME (`MemberDiscovery.urge`). The claim decides. Without one
within `DOUBT_US` the stop is accepted, because a needless stop costs a reset and driving on may cost
more.
"""

from typing import NamedTuple

from agent.interface.config import MS, S
from agent.interface.instants import FOREVER_US
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.segment_frames import FleetStop

DOUBT_US = 1 * S  # five questions and their answers, each within 0.2 s (J1939-81)
ASK_US = 200 * MS  # between these questions, by all robots together
STOPS_MAX = 16  # stops kept of one address; one is enough to hold us

AnyStop = EmergencyStop | FleetStop


class Doubted(NamedTuple):
    """When a stop was received first and last, microseconds."""

    first_at_us: int
    last_at_us: int


class Doubts:
    """The stops that are in doubt, by the address that they came from."""

    def __init__(self) -> None:
        self._first_at_us: dict[int, int] = {}  # address -> first stop
        self._stops: dict[int, dict[AnyStop, Doubted]] = {}
        self._believed: set[int] = set()  # addresses that have not answered in time
        self.due_at_us = FOREVER_US

    def believes(self, address: int) -> bool:
        """Whether it was asked without an answer, so that its stops are accepted."""
        return address in self._believed

    def hold(self, address: int, stop: AnyStop, now_us: int) -> int:
        """Keep a stop until its sender is known; returns the latest time for that."""
        begin_at_us = self._first_at_us.setdefault(address, now_us)
        if begin_at_us > now_us:  # our clock was set back
            begin_at_us = self._first_at_us[address] = now_us
        self.due_at_us = min(self.due_at_us, begin_at_us + DOUBT_US)
        stops = self._stops.setdefault(address, {})
        if stop in stops:
            stops[stop] = stops[stop]._replace(last_at_us=now_us)
        elif len(stops) < STOPS_MAX:
            stops[stop] = Doubted(now_us, now_us)
        return begin_at_us + DOUBT_US

    def end(self, address: int) -> list[tuple[int, AnyStop]]:
        """Its NAME is known: its stops, each with the times of first and last reception."""
        self._believed.discard(address)
        return self._end(address)

    def overdue(self, now_us: int) -> list[tuple[int, int, AnyStop]]:
        """Stops of addresses that did not answer in time: address, time of reception, stop."""
        if now_us < self.due_at_us:
            return []
        late = [
            a for a, begin_at_us in self._first_at_us.items() if now_us >= begin_at_us + DOUBT_US
        ]
        self._believed.update(late)
        return [(address, t_us, stop) for address in late for t_us, stop in self._end(address)]

    def _end(self, address: int) -> list[tuple[int, AnyStop]]:
        if self._first_at_us.pop(address, None) is None:
            return []
        self.due_at_us = min((t + DOUBT_US for t in self._first_at_us.values()), default=FOREVER_US)
        stops = self._stops.pop(address)
        heard = {(t_us, stop) for stop, times in stops.items() for t_us in times}
        return sorted(heard, key=lambda said: said[0])
