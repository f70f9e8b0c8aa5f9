"""Which robots have met: needed to decide which robots a silence must stop.

Under the policy that stops where a member is silent, a robot stands if its bus is cut from members
that it has met. A robot that booted behind the cut never met the others, so their silence does not
stop it. Judged from the state of the links alone; no robot is asked.
"""

from collections.abc import Mapping

from agent.interface.config import S
from sim.can.can_wire import Wire

# An address (0.25 s, ten times as much if it is contested), and the frames that identify a member.
MET_US = 3 * S


class ContactHistory:
    """Follows which robots were connected long enough to know each other, and which hang or
    have a double."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self._looked_at_us = 0
        # (receiver, sender): how long they have been connected so far.
        self._together_for_us: dict[tuple[int, int], int] = {}
        self._met: set[tuple[int, int]] = set()
        self._hang_ends_at_us: dict[int, int] = {}
        self._hang_began_at_us: dict[int, int] = {}
        self._doubled_ends_at_us: dict[int, int] = {}
        self._taken_ends_at_us = 0  # until then, robots may be without an address or the bus

    def hangs(self, slot: int, now_us: int, end_at_us: int) -> None:
        """Until then the robot sends nothing; it receives everything at once at the end."""
        if not self.is_hung(slot, now_us):
            self._hang_began_at_us[slot] = now_us
        self._hang_ends_at_us[slot] = max(end_at_us, self._hang_ends_at_us.get(slot, 0))

    def is_hung(self, slot: int, now_us: int) -> bool:
        """Whether the process of this robot does nothing at `now_us`."""
        return now_us < self._hang_ends_at_us.get(slot, 0)

    def hang_began_at_us(self, slot: int, now_us: int) -> int | None:
        """When the process of this robot stopped running; None if it runs."""
        return self._hang_began_at_us[slot] if self.is_hung(slot, now_us) else None

    def doubled(self, slot: int, end_at_us: int) -> None:
        """Until then a second machine claims to be that robot. So whether the robot itself is
        silent cannot be known, and afterwards the others have to meet it again."""
        self._doubled_ends_at_us[slot] = max(end_at_us, self._doubled_ends_at_us.get(slot, 0))
        self._met = {pair for pair in self._met if pair[1] != slot}

    def addresses_taken(self, end_at_us: int) -> None:
        """Until then a device may hold every address, or the bus, so robots that have not met cannot
        meet. Look first."""
        self._taken_ends_at_us = max(end_at_us, self._taken_ends_at_us)

    def boots(self, slot: int) -> None:
        """A restarted robot has met no other; other robots may have met it before."""
        self._met = {pair for pair in self._met if pair[0] != slot}
        self._hang_ends_at_us.pop(slot, None)
        for pair in self._together_for_us:
            if slot in pair:
                self._together_for_us[pair] = 0

    def look(self, now_us: int, node_of: Mapping[int, int]) -> None:
        """Call before anything changes: the links have been as they are now since the last call, or since
        a node at their ends came back from bus-off by itself.

        `node_of`: the nodes of the robots that are switched on.
        """
        passed_for_us, self._looked_at_us = now_us - self._looked_at_us, now_us
        faults, nodes, hangs = self.wire.faults, self.wire.nodes, self._hang_ends_at_us
        lossy = faults.loss > 0 or faults.omission > 0
        for hearer, to in node_of.items():
            for speaker, by in node_of.items():
                if hearer == speaker:
                    continue
                cut = nodes[to].island != nodes[by].island or (by, to) in faults.deaf
                off = nodes[to].off_ends_at_us is not None or nodes[by].off_ends_at_us is not None
                pair = hearer, speaker
                together_for_us = self._together_for_us.get(pair, 0) + passed_for_us
                recovered_at_us = max(nodes[to].recovered_at_us, nodes[by].recovered_at_us)
                together_for_us = min(together_for_us, now_us - recovered_at_us)
                hang_ends_at_us = max(hangs.get(hearer, 0), hangs.get(speaker, 0))
                hang_ends_at_us = max(
                    hang_ends_at_us,
                    self._doubled_ends_at_us.get(speaker, 0),
                    self._taken_ends_at_us,
                )
                if hang_ends_at_us > now_us - passed_for_us:
                    together_for_us = max(0, now_us - hang_ends_at_us)
                self._together_for_us[pair] = 0 if lossy or cut or off else together_for_us
                if self._together_for_us[pair] >= MET_US:
                    self._met.add(pair)

    def met(self, hearer: int, speaker: int) -> bool:
        """Whether the robot `hearer` has met the robot `speaker` since its own power-up."""
        return (hearer, speaker) in self._met
