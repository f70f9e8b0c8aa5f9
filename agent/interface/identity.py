"""What a peer is told before it starts: who it is, and in which fleet."""

from typing import NamedTuple

from agent.safety.stop_controller import SilencePolicy
from protocol.name import Name


class Identity(NamedTuple):
    """What a peer is told before it starts."""

    slot: int
    members: frozenset[int]  # every configured slot, our own included
    name: Name
    field_hash: int  # u24; peers of another field description are not of this fleet
    silence: SilencePolicy = SilencePolicy.STOP
    started: bool = False  # permission to move is given at boot, not by a separate start
    first_boot: bool = False  # a new machine: that it remembers nothing is no loss of memory

    @property
    def component(self) -> str:
        """Component identification as SAE J1939-71 writes it."""
        return f"Headland*peer*{self.name.identity:07d}*robot {self.slot}*"
