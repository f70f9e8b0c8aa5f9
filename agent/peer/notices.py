"""What parts of a peer tell each other: values, delivered by `Peer` in the order of its parts.

A notice says what happened. Its sender does not know which parts listen to it.
"""

from typing import NamedTuple

from protocol.authentication import Keys
from protocol.frames.fleet_frames import Heartbeat
from protocol.frames.messages import Message

# ---------------------------------------------------------------- this robot and its bus


class BootRemembered(NamedTuple):
    """The identity of this boot is about to be written for the first time."""


class ClockWentBack(NamedTuple):
    """Our clock shows less than before, so how long ago anything was is not known."""


class AddressGained(NamedTuple):
    """We have an address, and our announcement is among the outputs before this one."""

    address: int


class FleetJoined(NamedTuple):
    """The parts know the new address: we are a member."""

    address: int


class AddressCommanded(NamedTuple):
    """Another device wants this robot to claim that address (ISO 11783-5, commanded address)."""

    address: int


class AddressLost(NamedTuple):
    """Another device has won our address."""


class BusLost(NamedTuple):
    """The controller left the bus, so none of our frames is received."""


class BusBack(NamedTuple):
    """The controller is on the bus again."""


class Rejoining(NamedTuple):
    """We claim an address again, as at power-up."""


class ReceivedAgain(NamedTuple):
    """Our frames are received again, after a while in which no member received them."""


class Leaving(NamedTuple):
    """We are about to leave the fleet on purpose and can still send."""


class Left(NamedTuple):
    """We have left the fleet and send nothing more."""


class BeatDue(NamedTuple):
    """Our beacon is sent in this step: what is sent with beacons goes after it."""

    heartbeat: bool = False  # our heartbeat, too


class ControlDue(NamedTuple):
    """A control period begins, this long after its due time."""

    late_for_us: int


class ImplementLowered(NamedTuple):
    """Our body was told to lower its implement, or to raise it."""

    down: bool


class ImplementMoved(NamedTuple):
    """Our implement is down or soon will be, or no longer."""

    at_work: bool


# ---------------------------------------------------------------- stops and causes


class Latched(NamedTuple):
    """An emergency stop may hold us now; listeners look whether it does."""

    why: str


class CausesExpired(NamedTuple):
    """Stop causes have ended by themselves, so this step's snapshot is out of date."""


class StopsAsked(NamedTuple):
    """A device asks which stops hold us. `question`: 48 bits, used once."""

    question: int
    from_gateway: bool


class StopsChanged(NamedTuple):
    """A stop was pressed or cleared here, or a frame that may do so was received."""


class WasReset(NamedTuple):
    """A person has reset this machine."""


class WasStarted(NamedTuple):
    """An operator has permitted motion."""

    named: bool  # of this robot alone


# ---------------------------------------------------------------- other devices


class HeardAgain(NamedTuple):
    """A message that had to wait until its sender was known; processed as if received then."""

    source: int
    message: Message
    at_us: int


class FleetTimeKnown(NamedTuple):
    """From now on others can verify our proofs: we have learned the fleet's time, or started it."""


class TimeDoubted(NamedTuple):
    """A member's proof could not be verified; our time may differ from the time of others."""


class StrangerHeard(NamedTuple):
    """A frame for members only, from an address that has not announced its slot."""

    address: int


class RobotNamed(NamedTuple):
    """A device of unknown origin has claimed its address. It may be a robot of ours."""

    address: int


class AddressTaken(NamedTuple):
    """A device with another NAME has this address now."""

    address: int


class RequestOverheard(NamedTuple):
    """A request to any device was on the bus. `data`: the packed group number."""

    data: bytes
    destination: int


class GroupRequested(NamedTuple):
    """Our slot or our NAME is requested, by its group."""

    pgn: int
    everybody: bool  # the request was global


# ---------------------------------------------------------------- members


class SignOfLife(NamedTuple):
    """A stop frame of this member was received."""

    slot: int


class MembershipChanged(NamedTuple):
    """The live or silent members have changed, or parts ask for them again."""

    live: frozenset[int]
    silent: frozenset[int]


class HeartbeatHeard(NamedTuple):
    """A member's heartbeat, not its last one."""

    slot: int
    heartbeat: Heartbeat


class KeysChanged(NamedTuple):
    """The fleet has other keys. What the revoked member said after `compromised_at_us` is void."""

    keys: Keys
    revoked: int  # slot; `protocol.rekeying.NOBODY`: the keys were only rotated
    compromised_at_us: int | None  # None: from the beginning


class MemberAnnounced(NamedTuple):
    """The robot at this address has said which slot it has."""

    address: int


class FieldDiffers(NamedTuple):
    """The robot at this address has another field description, or is of a fleet of more robots."""

    address: int
    why: str


class IdentityDoubled(NamedTuple):
    """This address has our own slot or NAME."""

    address: int


class ConflictSettled(NamedTuple):
    """The machine at this address agrees with us, or another device has the address."""

    address: int


class WaiveOrdered(NamedTuple):
    """An operator orders by name to go on without this member."""

    slot: int
    operator: int  # the number of its device


# ---------------------------------------------------------------- work


class SyncDiffers(NamedTuple):
    """Another member's state differs from ours and is arriving."""


class SyncAgrees(NamedTuple):
    """Digests agree, or there is no member to ask."""


class SectionsMerged(NamedTuple):
    """Entries of this member changed these registers."""

    sections: frozenset[int]
    by_slot: int


class WorkGivenBack(NamedTuple):
    """Release every claimed section, because an operator has ordered something else."""
