"""What a peer is given before it starts: its own identity and its fleet."""

from enum import Enum
from typing import NamedTuple

from protocol.frames.messages import configuration_hash
from protocol.name import Name


class SilencePolicy(Enum):
    """How a protective stop ends that the silence of a member has caused. Silence always brakes."""

    STOP = "until the member is back, or an operator waives it by name"
    SLOW = "after 2 s of stable membership go on at creep speed"
    CONTINUE = "after 2 s of stable membership go on without it"


class Identity(NamedTuple):
    """What makes a peer a member of its fleet; fixed before the peer starts."""

    slot: int
    members: frozenset[int]  # every configured slot, our own included
    name: Name
    field_hash: int  # u24; peers with another field description do not belong to this fleet
    silence: SilencePolicy = SilencePolicy.STOP
    started: bool = False  # permission to move is given at boot, not by a separate start
    first_boot: bool = False  # a new machine: an empty memory is expected, not a loss
    release: str = ""  # of the software, for diagnostic tools
    # On a bus with devices of other makers: DM1 is sent unasked, a task controller is answered.
    diagnostics: bool = False
    implement_width_mm: int = 0  # for a task controller; 0: not known

    @property
    def config_hash(self) -> int:
        """What members compare before they work together: the field, and the version of their frames."""
        return configuration_hash(self.field_hash)

    @property
    def component(self) -> str:
        """The component identification of SAE J1939-71 (PGN 65259): make, model, serial, unit."""
        return f"Headland*peer*{self.name.identity:07d}*robot {self.slot}*"
