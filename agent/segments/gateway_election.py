"""Coordination of the gateways of one segment: numbers, signs of life, and electing a leader.

A candidate listens first and takes the lowest free number, and with it an address. Of two with the
same number, the one with the higher random lot takes another number. The leader is elected by votes
(`agent/peer/leader_election.py`). A silent candidate is no longer counted, and a new term fences it
off. Stopping does not depend on this: every candidate forwards stops.
"""

from collections.abc import Sequence
from enum import Enum

from agent.interface.config import MS
from agent.interface.effects import Effect, Send, Trace
from agent.interface.instants import NEVER_US
from agent.peer.leader_election import Election
from protocol.frames.fleet_frames import LeaderElectionVote
from protocol.frames.messages import Message
from protocol.frames.segment_frames import (
    CANDIDATES_MAX,
    GATEWAY_ADDRESS,
    GATEWAY_SLOT,
    SEGMENT_GATEWAY,
    GatewayBeat,
)
from protocol.state_machine import StateMachine, matrix

BEAT_US = 250 * MS  # period of GATEWAY_BEAT
SILENT_US = 800 * MS  # a candidate counts as silent after this: three beats are missing
LISTEN_US = 600 * MS  # before a candidate takes a number: two beats of those already present
NUMBERS = range(GATEWAY_SLOT, GATEWAY_SLOT + CANDIDATES_MAX)


class CandidateState(Enum):
    """How far a gateway is on its way to an address."""

    LISTENING = "no number yet: the beats of the candidates already present are awaited"
    CROWDED = "every number is taken, so this gateway stays without an address"
    CANDIDATE = "it has a number and an address, forwards stops, and may be elected"


class CandidateEvent(Enum):
    """What moves a candidate from one state to another."""

    NUMBER_FREE = "a number is free, and is taken"
    NONE_FREE = "no number is free"
    YIELDED = "another candidate has this number and the lower lot, or another device the address"


LISTENING, CROWDED, CANDIDATE = CandidateState
stay = None

# Whether a candidate leads is no state of its own: it follows from the votes that were received.
# fmt: off
CANDIDATE_TABLE = matrix(
    CandidateEvent,
    # state      NUMBER_FREE  NONE_FREE  YIELDED
    (LISTENING,  CANDIDATE,   CROWDED,   stay),
    (CROWDED,    CANDIDATE,   stay,      stay),
    (CANDIDATE,  stay,        stay,      LISTENING),
)
# fmt: on


class GatewayElection:
    """One candidate's view of the gateways of its segment."""

    def __init__(self, lot: int, name_hash: int, now_us: int) -> None:
        """`lot`: a random number that settles which of two candidates keeps a number. `name_hash`:
        16 bits of our NAME, which settle elections.
        """
        self.lot = lot & 0xFFFF
        self.number: int | None = None
        self.election = Election(SEGMENT_GATEWAY, NUMBERS[0], name_hash)
        self.machine = StateMachine("gateway candidate", CANDIDATE_TABLE, LISTENING)
        self._heard: dict[int, tuple[int, int]] = {}  # number -> last beat, lot
        # Number -> when a device that is no gateway claimed its address last.
        self._lost_at_us: dict[int, int] = {}
        self._live: frozenset[int] = frozenset()
        self._beat_at_us = now_us + LISTEN_US
        self._led = False

    @property
    def address(self) -> int | None:
        """Our bus address; None without a number."""
        return None if self.number is None else GATEWAY_ADDRESS + self.number - GATEWAY_SLOT

    @property
    def leads(self) -> bool:
        """Whether this candidate is the elected leader."""
        leader = self.election.leader
        return leader is not None and self.number == leader.slot

    @property
    def term(self) -> int:
        """The term of the current leader, a count of elections."""
        return self.election.term

    @property
    def due_at_us(self) -> int:
        """When `on_tick` has something to do next."""
        return self._beat_at_us

    # ---------------------------------------------------------------- from the bus

    def on_message(self, number: int, message: Message, now_us: int) -> None:
        """A frame of another candidate. `number`: the one that its address stands for."""
        if isinstance(message, GatewayBeat) and message.candidate == number:
            if number == self.number and message.lot != self.lot:
                if message.lot > self.lot:
                    return  # it yields
                self._give_up(now_us)
            self._heard[number] = now_us, message.lot
            if message.term > self.term:
                self.election.fence(message.term - 1, now_us)
        elif self.number is None:
            return  # without a number it has no vote; it learns the term from beats
        elif isinstance(message, LeaderElectionVote) and message.election == SEGMENT_GATEWAY:
            self.election.heard(number, message, self._live)

    def _give_up(self, now_us: int) -> None:
        self.machine.fire(CandidateEvent.YIELDED)
        self.number = None
        self._beat_at_us = now_us + LISTEN_US

    def lose(self, number: int, now_us: int) -> None:
        """A device that is no gateway has the address of that number, and keeps it."""
        self._lost_at_us[number] = now_us
        if number == self.number:
            self._give_up(now_us)

    def on_fence(self, term: int, now_us: int) -> None:
        """Other segments know a gateway of ours with a later term."""
        self.election.fence(term, now_us)

    # ---------------------------------------------------------------- to the bus

    def on_tick(self, reached: int, ever: bool, now_us: int) -> Sequence[Effect]:
        """Our beat and our vote, if they are due.

        `reached`: how many other segments are reached now. `ever`: whether one was reached since
        the start.
        """
        if now_us < self._beat_at_us:
            return ()
        self._beat_at_us = now_us + BEAT_US
        if self.machine.state is not CANDIDATE:
            self._choose(now_us)
        if self.machine.state is not CANDIDATE:
            return ()
        self._observe_candidates(now_us)
        election = self.election
        election.tick(self._live, now_us)
        assert self.number is not None
        flags = self.leads | ever << 1
        effects: list[Effect] = [
            Send(GatewayBeat(self.number, flags, self.term, reached, self.lot), source=self.address)
        ]
        vote = election.speak(now_us)
        if vote is not None:
            effects.append(Send(vote, source=self.address))
        if self._led != self.leads:
            self._led = self.leads
            state = "LEADS" if self._led else "STANDS BY"
            effects.append(Trace("gateway", "", state, f"{self.number}", f"term {self.term}"))
        return effects

    def _choose(self, now_us: int) -> None:
        """Take the lowest number that is free, and one whose address was lost only if there is no other:
        the device that had it may be gone.
        """
        taken = {
            n for n, (heard_at_us, _) in self._heard.items() if now_us - heard_at_us < SILENT_US
        }
        free = [number for number in NUMBERS if number not in taken]
        self.machine.fire(CandidateEvent.NUMBER_FREE if free else CandidateEvent.NONE_FREE)
        if not free:
            return
        self.number = min(free, key=lambda number: (self._lost_at_us.get(number, NEVER_US), number))
        self.election.take_slot(self.number, bool(self._heard), now_us)

    def _observe_candidates(self, now_us: int) -> None:
        """Check which candidates are live; a change causes a vote."""
        assert self.number is not None
        heard = {
            n for n, (heard_at_us, _) in self._heard.items() if now_us - heard_at_us < SILENT_US
        }
        live = frozenset(heard | {self.number})
        if live != self._live:
            self._live = live
            self.election.see(now_us)
