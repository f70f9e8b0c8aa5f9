"""What a mission is to a peer: it names the next section to claim, and works the one it is given.

The peer owns claims, time and safety; a mission owns geometry. A mission never sends: what it has
done comes back as units covered, which the peer records and announces.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from agent.interface.lifecycle import State
from agent.interface.ports import Neighbour, Observation
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.accord_frames import Accord
from protocol.frames.messages import Message

Record = tuple[str, bytes]  # of durable memory


class FleetView(NamedTuple):
    """What a peer knows of the fleet when it decides. Read only."""

    slot: int
    now_us: int
    here: Observation
    allocation: FieldAllocationCRDT
    progress: Progress
    live: frozenset[int]  # includes ourselves
    silent_since_us: Mapping[int, int]  # members that fell silent and are not back
    neighbours: Mapping[int, Neighbour]
    things: frozenset[tuple[float, float]] = (
        frozenset()
    )  # places to go round, by an operator's word
    leave_out: bool = False  # and not to work, where they are
    may_move: bool = True  # no cause makes it stand


class ClaimRequest(NamedTuple):
    section: int
    bid: int  # 0 to 31, the private cost of reaching it; less is better
    takeover: bool = False  # the owner is silent and its lease is over


class MotionRequest(NamedTuple):
    """What the mission wants of the drive now, before anybody else's rights and safety."""

    vx_m_s: float
    vy_m_s: float
    turn_rad_s: float = 0.0
    tool_on: bool = False
    covered: tuple[int, ...] = ()  # units of the current section completed since the last call
    finished: bool = False  # every unit of the section is covered
    given_up: bool = False  # the section goes back unfinished, for whoever wants it
    near_end: bool = False  # claim the next section now, so that no time is lost
    hold: bool = False  # stand, and let the others go round
    handle: int = -1  # a parcel to pick up here, or to put down; -1: none


STILL = MotionRequest(0.0, 0.0)


class Mission(Protocol):
    @property
    def section_units(self) -> Mapping[int, int]:
        """How many units each section has; the work there is."""
        ...

    def choose(self, view: FleetView) -> ClaimRequest | None: ...
    def approach(self, section: int, view: FleetView) -> MotionRequest:
        """Go towards a section whose claim is still contested."""
        ...

    def begin(self, section: int, view: FleetView) -> None: ...
    def work(self, view: FleetView) -> MotionRequest: ...
    def abandon(self) -> None: ...
    def admits(self, goal: tuple[float, float]) -> bool:
        """Whether a robot may be sent there."""
        ...

    def travel(self, goal: tuple[float, float], view: FleetView) -> MotionRequest:
        """Go to a place, without work."""
        ...

    def interrupted(self) -> None:
        """The implement was lifted although the mission wanted it down: what is under way failed."""
        ...

    def rest(self, view: FleetView) -> MotionRequest:
        """No section: stand, or get out of the way."""
        ...


class AgreementChannel(Protocol):
    """Rounds of agreement over ACCORD frames."""

    def hear(self, slot: int, m: Accord, now_us: int) -> None: ...
    def say(self, now_us: int) -> list[Accord]:
        """What is due with this beat."""
        ...


@runtime_checkable
class Replanning(Protocol):
    """A mission that can look for another way when its robot gets nowhere."""

    def stalled(self, view: FleetView) -> None:
        """It wanted to drive for seconds and did not: plan again, from where it is."""
        ...


@runtime_checkable
class Underway(Protocol):
    """A mission that can tell where its robot means to drive; for people who watch, not for peers."""

    @property
    def rest_of_way(self) -> Sequence[tuple[float, float]]:
        """What is left of the way, nearest point first, metres."""
        ...


@runtime_checkable
class Agreeing(Protocol):
    """A mission that settles with the others who goes where; also those that stand take part."""

    @property
    def accords(self) -> AgreementChannel: ...
    def attend(self, view: FleetView, state: State) -> None:
        """Each control period, in every state, before anything is asked of the mission."""
        ...


@runtime_checkable
class Conversing(Protocol):
    """A mission with frames of its own."""

    def hear(self, slot: int | None, message: Message, now_us: int) -> Sequence[Record]:
        """`slot`: None for a device that is not a member. What is returned must be durable before
        anything more is said."""
        ...

    def say(self, now_us: int) -> Iterable[Message]:
        """With each beat."""
        ...


class CoveredUnits(NamedTuple):
    """Units covered since the last call, as (section, unit), of whatever section."""

    units: tuple[tuple[int, int], ...]
    at_once: bool  # announce them now: a round waits for equal replicas


@runtime_checkable
class Sweeping(Protocol):
    """A mission that covers units wherever it goes, not only those of the section it holds."""

    def swept(self) -> CoveredUnits:
        """Each control period, in every state, after `attend`."""
        ...
