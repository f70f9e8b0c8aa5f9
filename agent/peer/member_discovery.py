"""Who speaks from which address: asking those that have not said it, and answering in turn.

However many robots are switched on together, or come back together, who-is-who costs about one frame a
robot. An answer rides on the next beat, so that answers are as spread as beats are, and one answer
serves everybody who asked in between. One robot asks, the first in slot order; the others overhear it.
"""

from collections.abc import Sequence

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send
from agent.peer.unknown_stop_sources import ASK_US
from protocol.frames.fleet_frames import Member
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request

MEMBER_PGN = GROUP_OF[Member].pgn
CLAIM_PGN = GROUP_OF[AddressClaimed].pgn
MEMBER_REQUEST, CLAIM_REQUEST = Request(MEMBER_PGN).pack(), Request(CLAIM_PGN).pack()
PATIENCE_US = 250 * MS  # a stranger has a beat's time, of the largest fleet, to say who it is
SLOT_US = (
    2 * MS
)  # between the turns of two robots to ask: a frame's time, and that of one in its way
AGAIN_US = 2 * S  # before the same address is asked again; doubles
DOUBLINGS_MAX = 5  # up to a minute: a device that is no robot is left alone
STRANGERS_MAX = 256  # addresses there are
ASKED_ENOUGH = 3  # questions, in 6 s: who does not answer them is not waited for


class MemberDiscovery:
    def __init__(self, slot: int, pgn: int = MEMBER_PGN) -> None:
        """`pgn`: what is asked for: which slot speaks from there, or which NAME."""
        self.slot, self.pgn = slot, pgn
        self.answer_due = False  # say who we are with the next beat
        self._everybody_asked = False  # since we came on the bus
        self._ask_us: dict[int, int] = {}  # stranger's address -> when it is our turn to ask it
        self._asked: dict[int, int] = {}  # stranger's address -> times it was asked, by anybody
        self._urgent: set[int] = set()  # asked every `ASK_US`: a stop came from there

    @property
    def deadline_us(self) -> int | None:
        return min(self._ask_us.values()) if self._ask_us else None

    @property
    def wonders(self) -> bool:
        """Somebody here may be a member at work, in a section of which we do not know."""
        asked = self._asked
        return any(asked.get(address, 0) < ASKED_ENOUGH for address in self._ask_us)

    def power_up(self) -> None:
        self.answer_due = self._everybody_asked = False
        self._ask_us.clear()
        self._asked.clear()
        self._urgent.clear()

    def joined(self) -> Sequence[Effect]:
        """We have an address: nobody who was asked since we listen has to be asked again."""
        return () if self._everybody_asked else [Send(Request(self.pgn))]

    @property
    def everybody_asked(self) -> bool:
        """Somebody has asked all, since we listen."""
        return self._everybody_asked

    def tick(self, now_us: int) -> Sequence[Effect]:
        """At most one question."""
        for address, due_us in self._ask_us.items():
            if now_us >= due_us:
                self.overheard(address, now_us)
                return [Send(Request(self.pgn), address)]
        return ()

    def stranger(self, address: int, now_us: int, patience_us: int = PATIENCE_US) -> None:
        """A robot's frame from an address that has not said which member it is."""
        if address < NULL_ADDRESS and address not in self._ask_us:
            self._ask_us[address] = now_us + patience_us + self.slot * SLOT_US
            assert len(self._ask_us) <= STRANGERS_MAX

    def urge(self, address: int, now_us: int) -> None:
        """It has said a stop: it is asked at once, and soon again."""
        if address < NULL_ADDRESS and address not in self._urgent:
            self._urgent.add(address)
            self._ask_us.pop(address, None)
            self.stranger(address, now_us, 0)

    def calm(self, address: int) -> None:
        """It does not answer: it is asked as seldom as other strangers."""
        self._urgent.discard(address)

    def known(self, address: int) -> bool:
        """Whether it was one that we did not know."""
        self._urgent.discard(address)
        self._asked.pop(address, None)
        return self._ask_us.pop(address, None) is not None

    def asked(self, everybody: bool) -> None:
        """Somebody wants to know who we are."""
        self.answer_due = True
        self._everybody_asked |= everybody

    def overheard(self, address: int, now_us: int) -> None:
        """Somebody asked that address; it is not asked again soon, by nobody."""
        if address == GLOBAL_ADDRESS or address not in self._ask_us:
            return
        times = self._asked[address] = self._asked.get(address, 0) + 1
        pause_us = AGAIN_US << min(times - 1, DOUBLINGS_MAX)
        if address in self._urgent:
            pause_us = ASK_US
        self._ask_us[address] = now_us + pause_us + self.slot * SLOT_US
