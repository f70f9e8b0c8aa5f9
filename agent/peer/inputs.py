"""Every fact that enters a peer, as a value: `Peer.step(input, now_us)` is the only entrance.

So a recording of inputs replays a peer, and a fuzzer has one door.
"""

from typing import NamedTuple

from agent.interface.observation import Observation
from protocol.authentication import Keyring
from protocol.controller_health import Health
from protocol.frames.codec import Malformed
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.safety_frames import Reason


class Received(NamedTuple):
    """A frame from the bus. A frame that is addressed to another node is ignored."""

    frame: Frame


class Heard(NamedTuple):
    """A message that is decoded already: simulators decode once for all receivers."""

    source: int
    message: Message | Malformed
    destination: int = GLOBAL_ADDRESS


class Sensed(NamedTuple):
    """The reading of our own sensors; None: there is none. Used at the next control period."""

    observation: Observation | None


class Timer(NamedTuple):
    """Time has passed: each part does what is due."""


class BusState(NamedTuple):
    """The driver's report, before each timer."""

    health: Health
    taken: bool  # it took the last frame
    sent: int | None = None  # own frames that were sent; None: the interface does not report it


class DiskFailed(NamedTuple):
    """Durable memory may have lost a record."""


# ---------------------------------------------------------------- operator calls


class Press(NamedTuple):
    """An emergency stop at this machine."""

    reason: Reason


class ManualReset(NamedTuple):
    """A person resets this machine. Refused while a stop is not cleared or a cause persists."""


class Start(NamedTuple):
    """Permission to move. A latched robot refuses it, because it would start after the reset."""

    named: bool = True  # it is for this robot alone: the operator vouches for its place


class Hold(NamedTuple):
    """The permission to move is withdrawn."""


class ClaimSection(NamedTuple):
    """Claim this section, if this robot may work and the section is free."""

    section: int
    bid: int  # 0 to 31; less is better
    takeover: bool = False


class ReleaseSection(NamedTuple):
    """Give this section back, unfinished."""

    section: int


class Finish(NamedTuple):
    """The section being worked is done."""

    section: int


class Cover(NamedTuple):
    """Units of a section are covered. They are announced with the next progress."""

    section: int
    units: tuple[int, ...]


class Leave(NamedTuple):
    """Release unfinished sections, brake, and when we stand announce that we leave, so that our
    silence stops no robot. A second one announces it at once."""


class ReleaseStops(NamedTuple):
    """A person at this machine releases the fleet's stops: begin, or repeat what is not answered.

    `operator`: the keys of the person; None in a fleet without keys. `question`: 48 bits, used once.
    """

    operator: Keyring | None
    question: int


class EndRelease(NamedTuple):
    """The release is over, whether robots still hold stops or not."""


class DateTold(NamedTuple):
    """What this computer's clock says now. `clock_zero_at_s`: the time of day, seconds since 1970, when
    `now_us` was 0; None: unknown."""

    clock_zero_at_s: int | None


OperatorCall = (
    Press | ManualReset | Start | Hold | ClaimSection | ReleaseSection | Finish | Cover | Leave
    | ReleaseStops | EndRelease
)  # fmt: skip
Input = Received | Heard | Sensed | Timer | BusState | DiskFailed | DateTold | OperatorCall
