"""Discovers which member sends from which address: requests to unknown addresses, and our answers.

However many robots are switched on or come back together, discovery costs about one frame a robot.
An answer is sent with the next beat, so answers are spread like beats, and one answer serves all
robots that asked in between. Only the first robot in slot order asks; the others overhear it.
"""

from collections.abc import Sequence

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send
from agent.peer.unknown_stop_sources import ASK_US
from protocol.frames.fleet_frames import Member
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import REQUEST, AddressClaimed, Request

MEMBER_PGN = GROUP_OF[Member].pgn
CLAIM_PGN = GROUP_OF[AddressClaimed].pgn
MEMBER_REQUEST, CLAIM_REQUEST = REQUEST.pack(Request(MEMBER_PGN)), REQUEST.pack(Request(CLAIM_PGN))
PATIENCE_US = 250 * MS  # a stranger has one beat period of the largest fleet to announce itself
SLOT_US = 2 * MS  # between the turns of two robots to ask: two frame times with margin
AGAIN_US = 2 * S  # before the same address is asked again; doubles
# Up to 8 s. The device may not be a robot, and 250 that never answer take 2 % of the bus. It may also
# be one whose frames were lost: nobody hears that a link is whole again.
DOUBLINGS_MAX = 2
STRANGERS_MAX = 256  # number of addresses
ASKED_ENOUGH = 3  # requests, in 6 s; without an answer to these we stop waiting for the address


class MemberDiscovery:
    """Which addresses are unknown, when each is asked, and whether we have to answer."""

    def __init__(self, slot: int, pgn: int = MEMBER_PGN) -> None:
        """`pgn`: the requested group: MEMBER for the slot, or the address claim for the NAME."""
        self.slot, self.pgn = slot, pgn
        self.answer_due = False  # announce our slot with the next beat
        self._everybody_asked = False  # a global request was received since we joined the bus
        self._ask_at_us: dict[int, int] = {}  # stranger's address -> when it is our turn to ask it
        self._asked: dict[int, int] = {}  # stranger's address -> times any robot asked it
        self._urgent: set[int] = set()  # asked every `ASK_US`, because a stop came from there

    @property
    def due_at_us(self) -> int | None:
        """When the next request is due; None: no address is unknown."""
        return min(self._ask_at_us.values()) if self._ask_at_us else None

    @property
    def wonders(self) -> bool:
        """Whether an unknown address may be a member at work, in a section that we do not know of."""
        asked = self._asked
        return any(asked.get(address, 0) < ASKED_ENOUGH for address in self._ask_at_us)

    def power_up(self) -> None:
        """Forget everything: we join the bus again."""
        self.answer_due = self._everybody_asked = False
        self._ask_at_us.clear()
        self._asked.clear()
        self._urgent.clear()

    def joined(self) -> Sequence[Effect]:
        """We have an address: ask all, unless we overheard a global request and its answers."""
        return () if self._everybody_asked else [Send(Request(self.pgn))]

    def tick(self, now_us: int) -> Sequence[Effect]:
        """Send at most one request."""
        for address, due_at_us in self._ask_at_us.items():
            if now_us >= due_at_us:
                self.overheard(address, now_us)
                return [Send(Request(self.pgn), address)]
        return ()

    def stranger(self, address: int, now_us: int, wait_for_us: int = PATIENCE_US) -> None:
        """A robot's frame from an address that has not announced its member slot."""
        if address < NULL_ADDRESS and address not in self._ask_at_us:
            self._ask_at_us[address] = now_us + wait_for_us + self.slot * SLOT_US
            assert len(self._ask_at_us) <= STRANGERS_MAX

    def urge(self, address: int, now_us: int) -> None:
        """A stop came from this address: ask it immediately, and again soon."""
        if address < NULL_ADDRESS and address not in self._urgent:
            self._urgent.add(address)
            self._ask_at_us.pop(address, None)
            self.stranger(address, now_us, 0)

    def calm(self, address: int) -> None:
        """The address does not answer: ask it as rarely as other strangers."""
        self._urgent.discard(address)

    def known(self, address: int) -> bool:
        """The address has announced itself; returns whether it was unknown before."""
        self._urgent.discard(address)
        self._asked.pop(address, None)
        return self._ask_at_us.pop(address, None) is not None

    def asked(self, everybody: bool) -> None:
        """A device requests our slot or NAME."""
        self.answer_due = True
        self._everybody_asked |= everybody

    def overheard(self, address: int, now_us: int) -> None:
        """A robot asked that address, so no robot asks it again soon."""
        if address == GLOBAL_ADDRESS or address not in self._ask_at_us:
            return
        times = self._asked[address] = self._asked.get(address, 0) + 1
        wait_for_us = AGAIN_US << min(times - 1, DOUBLINGS_MAX)
        if address in self._urgent:
            wait_for_us = ASK_US
        self._ask_at_us[address] = now_us + wait_for_us + self.slot * SLOT_US
