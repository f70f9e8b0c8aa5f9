"""The origin of frames: what the NAME that has claimed an address says about its device.

The proprietary groups (PGN 0xFF00 to 0xFFFF, and 0xEF00) belong to the manufacturer in the sender's
NAME: the same number has a different meaning for each maker (ISO 11783-3). Their frames are
accepted only from an address whose claimed NAME is one of ours. All others are counted by PGN and
ignored.

A device whose claim we have missed is asked for it. Its orders and MEMBER frames are kept for a
second and processed if its NAME turns out to be ours. `agent/peer/unknown_stop_sources.py` handles
stops.
"""

from collections import Counter
from enum import Enum, auto

from agent.interface.config import S
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.fleet_frames import Member
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset, OperatorCommand
from protocol.frames.segment_frames import FleetReset, FleetStop
from protocol.frames.work_frames import StateSyncRequest
from protocol.name import OWN_FUNCTIONS, Name, fleet_of, is_ours, is_robot

KEPT_US = 1 * S  # a device that is asked answers within 0.2 s (J1939-81); an older order is void
# Frames kept of one address: an order with its place is four, a reset of a few stops a dozen.
WORDS_MAX = 16
# Addresses whose frames are kept; more unknown devices at the same time are an attack.
KEPT_MAX = 64
PROPRIETARY_A, PROPRIETARY_B = 0xEF00, 0xFF00
PROPRIETARY = frozenset(
    kind for kind, g in GROUP_OF.items() if g.pgn == PROPRIETARY_A or g.pgn >= PROPRIETARY_B
)
MUST_NOT_BE_MISSED = (
    EmergencyStop, FleetStop, EmergencyReset, FleetReset, HeldReset, OperatorCommand,
    OperatorGoal, TaskOrder, Member, StateSyncRequest,
)  # fmt: skip


class Origin(Enum):
    """What kind of device sends from an address, by the NAME that it has claimed."""

    OURS = auto()  # a robot of our fleet, a gateway, an operator's tool
    ANOTHER_FLEET = auto()  # a robot of a fleet with another name
    FOREIGN = auto()  # of another maker, or a device kind that does not send to robots
    UNCLAIMED = auto()  # no claim of this address was received


class Origins:
    """The origin of each address, as seen by the peer with this NAME."""

    def __init__(self, name: Name) -> None:
        self._fleet = fleet_of(name)
        self._own = name if name.function in OWN_FUNCTIONS else None  # a gateway is no robot
        self._of: dict[int, Origin] = {}
        self._names: dict[int, int] = {}
        self._robots: set[int] = set()
        self._kept: dict[int, dict[Message, int]] = {}  # address -> message -> time received
        self.foreign: Counter[int] = Counter()  # PGN -> refused frames of other makers
        self.unclaimed: Counter[int] = Counter()  # PGN -> refused frames of unclaimed addresses
        self.elsewhere: Counter[int] = Counter()  # PGN -> refused frames of another fleet

    def of(self, address: int) -> Origin:
        """The origin of frames from this address."""
        return self._of.get(address, Origin.UNCLAIMED)

    def is_robot(self, address: int) -> bool:
        """Whether a robot of our fleet has claimed this address."""
        return address in self._robots

    def changes(self, address: int, number: int) -> bool:
        """Whether a different NAME than before claims this address."""
        return self._names.get(address, number) != number

    def claimed(self, address: int, number: int) -> Origin:
        """Note that a NAME (64 bits) has claimed the address; returns its origin."""
        self._names[address] = number
        name = Name.unpack(number)
        if not is_ours(name, self._own):
            origin = Origin.FOREIGN
        elif is_robot(name, self._own) and fleet_of(name) != self._fleet:
            origin = Origin.ANOTHER_FLEET
        else:
            origin = Origin.OURS
        self._of[address] = origin
        self._robots.discard(address)
        if origin is Origin.OURS and is_robot(name, self._own):
            self._robots.add(address)
        return origin

    def count(self, origin: Origin, message: Message) -> None:
        """Count a refused frame."""
        counters = {
            Origin.FOREIGN: self.foreign,
            Origin.ANOTHER_FLEET: self.elsewhere,
            Origin.UNCLAIMED: self.unclaimed,
        }
        counters[origin][GROUP_OF[type(message)].pgn] += 1

    def keep(self, address: int, message: Message, now_us: int) -> None:
        """Keep a frame that must not be missed until the NAME of its sender is known."""
        if not isinstance(message, MUST_NOT_BE_MISSED):
            return
        words = self._kept.setdefault(address, {})
        words.pop(message, None)  # a repetition moves to the end, as the newest
        words[message] = now_us
        if len(words) > WORDS_MAX:
            del words[next(iter(words))]
        if len(self._kept) > KEPT_MAX:
            del self._kept[next(iter(self._kept))]

    def kept(self, address: int, now_us: int, stopped_at_us: int) -> list[Message]:
        """Take the kept frames of this address that are not too old, in order of reception.

        A reset or a start that was received before the newest stop, at `stopped_at_us`, is void."""
        words = self._kept.pop(address, {})
        return [
            message
            for message, heard_at_us in words.items()
            if now_us - heard_at_us <= KEPT_US
            and not (isinstance(message, OperatorCommand) and heard_at_us <= stopped_at_us)
        ]
