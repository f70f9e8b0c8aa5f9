"""What a part of a peer is: it has its own state, and knows neither the peer nor the runner.

A part says which messages it handles, which notices it listens to, which inputs it accepts, and when
it next has something to do. Each call gets a snapshot of this step and returns *outputs*: effects for
the world, and notices for other parts (`agent/peer/notices.py`). `Peer` delivers notices depth first,
in the order of the outputs, so an output takes effect exactly where it stands in the list.

A part may hold another part that it works with closely, given in its constructor. These references
go one way, so there is no cycle between modules.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Any, Final, NamedTuple

from agent.interface.instants import FOREVER_US
from agent.interface.lifecycle import State
from agent.interface.observation import Observation


class StepContext:
    """What every part may know in this step. It is rebuilt after each part that had an output.

    Not a tuple: several are made in each step, and a compiled class is made and read faster."""

    __slots__ = ("here", "joined", "live", "may_move", "now_us", "slot", "state")

    def __init__(
        self,
        slot: int,
        now_us: int,
        state: State,
        may_move: bool,
        here: Observation | None,
        live: frozenset[int],
        joined: bool,
    ) -> None:
        """`may_move`: no stop cause holds the robot. `here`: the newest reading of our own sensors.
        `live`: members that are received, with ourselves. `joined`: we have an address and it is
        announced, so the others know our slot."""
        self.slot: Final = slot
        self.now_us: Final = now_us
        self.state: Final = state
        self.may_move: Final = may_move
        self.here: Final = here
        self.live: Final = live
        self.joined: Final = joined


class Header(NamedTuple):
    """Where a received message comes from, and to whom it goes."""

    source: int  # address
    slot: int | None  # member at that address; None: not a member, or not known yet
    destination: int
    from_gateway: bool = False  # carried from another segment


class Senders(Enum):
    """Which senders a message is taken from. A frame of another maker is refused before that."""

    URGENT = "anyone, before all checks"
    DEVICE = "any device, also of other makers"
    ANYONE = "anyone"
    MEMBER = "a member; another sender is asked for its slot"
    MEMBER_ONLY = "a member; of another sender it is ignored"
    GATEWAY = "a gateway to other segments"


Output = Any  # an effect or a notice: `Effect | Notice`
Outputs = Sequence[Output]
Handler = Callable[[StepContext, Header, Any], Outputs]
DirectHandler = Callable[[int, int | None, Any, int], Outputs]  # source, slot, message, now_us
Listener = Callable[[StepContext, Any], Outputs]
DirectListener = Callable[[Any, int], Outputs]  # notice or input, now_us
NOTHING: Outputs = ()


class Part:
    """Defaults: a part that handles nothing, listens to nothing and has no deadline."""

    @property
    def due_at_us(self) -> int:
        """When `on_timer` next has something to do if nothing else happens; FOREVER_US: never."""
        return FOREVER_US

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        """Message -> handler. Read once."""
        return {}

    @property
    def direct(self) -> Mapping[type[Any], DirectHandler]:
        """Message -> handler that gets no snapshot.

        For what arrives a thousand times a second, and for stops, which wait for nothing."""
        return {}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        """Notice or input -> listener. Read once."""
        return {}

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        """Notice or input -> listener that gets no snapshot. Read once.

        For what comes in each control period. All listeners of a kind are direct, or none is."""
        return {}

    def on_timer(self, ctx: StepContext) -> Outputs:
        """Called at every timer of the peer, in the order of its parts, not only at our deadline."""
        return NOTHING
