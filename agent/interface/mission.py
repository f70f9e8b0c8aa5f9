"""The interface of a mission: it names the next section to claim and works the claimed one.

The peer owns claims, time and safety; a mission owns geometry. A mission never sends. It returns
the units it has covered, which the peer records and announces.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from agent.interface.lifecycle import State
from agent.interface.ports import Neighbour, Observation
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.accord_frames import Accord
from protocol.frames.messages import Message

Record = tuple[str, bytes]  # key and value of durable memory


class FleetView(NamedTuple):
    """What a peer knows about the fleet when it decides. Read only."""

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
    )  # places to go round, by an operator's order
    leave_out: bool = False  # the units under these places are skipped
    may_move: bool = True  # no stop cause holds the robot


class ClaimRequest(NamedTuple):
    section: int
    bid: int  # 0 to 31, the private cost of reaching it; less is better
    takeover: bool = False  # the owner is silent and its lease is over


class MotionRequest(NamedTuple):
    """The motion that the mission wants now, before right of way and safety are applied."""

    vx_m_s: float
    vy_m_s: float
    turn_rad_s: float = 0.0
    tool_on: bool = False
    covered: tuple[int, ...] = ()  # units of the current section completed since the last call
    finished: bool = False  # every unit of the section is covered
    given_up: bool = False  # the section is released unfinished and is free to claim
    near_end: bool = False  # claim the next section now, so that no time is lost
    hold: bool = False  # stand still and let the others go round
    handle: int = -1  # number of a parcel to pick up or put down here; -1: none


STILL = MotionRequest(0.0, 0.0)


class Mission(Protocol):
    @property
    def section_units(self) -> Mapping[int, int]:
        """Number of units of each section; this is the total work."""
        ...

    def choose(self, view: FleetView) -> ClaimRequest | None: ...
    def approach(self, section: int, view: FleetView) -> MotionRequest:
        """Drive towards a section whose claim is still contested."""
        ...

    def begin(self, section: int, view: FleetView) -> None: ...
    def work(self, view: FleetView) -> MotionRequest: ...
    def abandon(self) -> None: ...
    def admits(self, goal: tuple[float, float]) -> bool:
        """Whether a robot may be sent there."""
        ...

    def travel(self, goal: tuple[float, float], view: FleetView) -> MotionRequest:
        """Drive to a place without working."""
        ...

    def interrupted(self) -> None:
        """The implement was lifted although the mission wanted it down, so the current leg failed."""
        ...

    def rest(self, view: FleetView) -> MotionRequest:
        """Motion without a section: stand still, or get out of the way."""
        ...


class AgreementChannel(Protocol):
    """Rounds of agreement over ACCORD frames."""

    def hear(self, slot: int, m: Accord, now_us: int) -> None: ...
    def say(self, now_us: int) -> list[Accord]:
        """The frames that are due with this beat."""
        ...


@runtime_checkable
class Replanning(Protocol):
    """A mission that can look for another way when its robot gets nowhere."""

    def stalled(self, view: FleetView) -> None:
        """The robot wanted to drive for seconds and did not: plan again from its current position."""
        ...


@runtime_checkable
class Underway(Protocol):
    """A mission that reports its planned route, for displays to people, not for peers."""

    @property
    def rest_of_way(self) -> Sequence[tuple[float, float]]:
        """The rest of the route, nearest point first, metres."""
        ...


@runtime_checkable
class Agreeing(Protocol):
    """A mission that agrees a joint plan with other robots; stopped robots take part as well."""

    @property
    def accords(self) -> AgreementChannel: ...
    def attend(self, view: FleetView, state: State) -> None:
        """Called each control period, in every state, before any other method of the mission."""
        ...


@runtime_checkable
class Conversing(Protocol):
    """A mission with frames of its own."""

    def hear(self, slot: int | None, message: Message, now_us: int) -> Sequence[Record]:
        """`slot`: None for a device that is not a member. The returned records must be durable before
        the next frame is sent."""
        ...

    def say(self, now_us: int) -> Iterable[Message]:
        """The messages to send with this beat."""
        ...


class CoveredUnits(NamedTuple):
    """Units covered since the last call, as (section, unit), of any section."""

    units: tuple[tuple[int, int], ...]
    at_once: bool  # announce them immediately because an agreement round waits for equal replicas


@runtime_checkable
class Sweeping(Protocol):
    """A mission that covers units wherever it goes, not only those of the section it holds."""

    def swept(self) -> CoveredUnits:
        """Called each control period, in every state, after `attend`."""
        ...
