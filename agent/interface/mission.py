"""The interface of a mission: it names the next section to claim and works the claimed one.

The peer owns claims, time and safety; a mission owns geometry. A mission never sends. It returns
the units it has covered, which the peer records and announces, and the messages of its own that
the peer sends with its next beat.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from math import inf
from typing import Final, NamedTuple

from agent.interface.lifecycle import State
from agent.interface.observation import Neighbour, Observation
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.messages import Message

Record = tuple[str, bytes]  # key and value of durable memory
NO_SECTIONS: Mapping[int, int] = {}


class FleetView(NamedTuple):
    """What a peer knows about the fleet when it decides. Read only; robots are named by slots."""

    slot: int
    now_us: int
    here: Observation
    allocation: FieldAllocationCRDT
    progress: Progress
    live: frozenset[int]  # includes ourselves
    fell_silent_at_us: Mapping[int, int]  # members that fell silent and are not back
    neighbours: Mapping[int, Neighbour]
    # Places to go round by an operator's order, (x, y) metres.
    things: frozenset[tuple[float, float]] = frozenset()
    leave_out: bool = False  # the units under these places are skipped
    may_move: bool = True  # no stop cause holds the robot
    placed: bool = True  # `here` is where the robot is; else it is a place that is not believed
    # Places of things that have kept our implement up for some time, (x, y) metres.
    under_bar: frozenset[tuple[float, float]] = frozenset()


class ClaimRequest(NamedTuple):
    """The section that a mission wants to claim, with its bid."""

    section: int
    bid: int  # 0 to 31, the private cost of reaching it; less is better
    takeover: bool = False  # the owner is silent and its lease is over, or it stands
    why: str = ""  # of a takeover, for the trace


class MotionRequest(NamedTuple):
    """The motion that the mission wants now, before right of way and safety are applied.

    Field frame: x east, y north, metres a second; the turn rate is counter-clockwise.
    """

    vx_m_s: float
    vy_m_s: float
    turn_rad_s: float = 0.0
    tool_on: bool = False
    covered: tuple[int, ...] = ()  # units of the current section completed since the last call
    finished: bool = False  # every unit of the section is covered
    given_up: bool = False  # the section is released unfinished and is free to claim
    near_end: bool = False  # claim the next section now, so that no time is lost
    hold: bool = False  # stand still and let the others go round
    parcel_action: int = -1  # number of a parcel to pick up or put down here; -1: none


STILL = MotionRequest(0.0, 0.0)
THERE_M: Final = 0.5  # a robot within this distance of its goal has arrived


class CoveredUnits(NamedTuple):
    """Units covered since the last call, as (section, unit), of any section."""

    units: tuple[tuple[int, int], ...]
    at_once: bool  # announce them immediately because an agreement round waits for equal replicas


NOTHING_COVERED = CoveredUnits((), False)


class Mission(ABC):
    """What every mission offers its peer. The defaults suit a mission without the hook.

    The peer calls every method from one thread, with the time of the call in `FleetView.now_us` or
    in an argument. A mission reads no clock and no random source of its own.
    """

    # A robot whose place is less accurate than this stands; standard deviation. Inf: the mission
    # asks for no more than the clearances do.
    position_accuracy_max_m = inf
    replans = False  # `on_stalled` finds another path; False: no watchdog looks for stalls
    given_up_why = ""  # why the last section was given up, for the trace

    @property
    def at_work(self) -> bool:
        """Whether the implement is down or soon will be, so that others keep as far away as it
        reaches.
        """
        return False

    @property
    def section_units(self) -> Mapping[int, int]:
        """Number of units of each section; this is the total work. It is read once, at power-up.

        It is empty if sections appear during the run.
        """
        return NO_SECTIONS

    @property
    def sections(self) -> Collection[int]:
        """The sections that exist or may appear; others are refused. Empty: any may."""
        return frozenset(self.section_units)

    # ---------------------------------------------------------------- sections

    @abstractmethod
    def choose(self, view: FleetView) -> ClaimRequest | None:
        """The section to claim next; None if there is none at present."""

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        """Drive towards a section whose claim is still contested."""
        return STILL

    def begin(self, section: int, view: FleetView) -> None:
        """The claim has won, so `work` is called next."""

    @abstractmethod
    def work(self, view: FleetView) -> MotionRequest:
        """Called each control period in which the robot holds a section and may move.

        A section is kept through a stop and a restart, so `begin` may not have been called."""

    def abandon(self) -> None:
        """The section was lost or given back: forget the plan for it."""

    def idle(self, view: FleetView) -> MotionRequest:
        """Motion without a section: stand still, or get out of the way."""
        return STILL

    # ---------------------------------------------------------------- an operator's goal

    def accepts_goal(self, goal: tuple[float, float]) -> bool:
        """Whether an operator may send the robot to this place, (x, y) metres."""
        return False

    def travel(self, goal: tuple[float, float], view: FleetView) -> MotionRequest:
        """Drive to an accepted goal, (x, y) metres, without working."""
        return STILL

    # ---------------------------------------------------------------- every control period

    def on_control_period(self, view: FleetView, state: State) -> None:
        """Called each control period, in every state, before any other method of the mission."""

    def covered_units(self) -> CoveredUnits:
        """What the robot covered anywhere, not only in the section that it holds.

        Called each control period, in every state, after `on_control_period`."""
        return NOTHING_COVERED

    def on_implement_raised(self) -> None:
        """The implement was not down in this period, so what is worked now does not count."""

    def on_stalled(self, view: FleetView) -> None:
        """The robot wanted to drive for seconds and did not: plan again from its current position."""

    # ---------------------------------------------------------------- frames of its own

    def on_message(self, slot: int | None, message: Message, now_us: int) -> Sequence[Record]:
        """A frame of this mission from member `slot`; None: from a device that is not a member.

        The returned records become durable before the next frame is sent."""
        return ()

    def outgoing(self, now_us: int) -> Iterable[Message]:
        """The messages to send with this beat, in their order. Called in every state."""
        return ()

    # ---------------------------------------------------------------- for displays to people

    @property
    def outline(self) -> Sequence[tuple[float, float]]:
        """The outline of the place of work, (x, y) metres; empty if there is none. Peers never
        read it.
        """
        return ()

    def worked_lines(self, progress: Progress) -> Iterable[Sequence[tuple[float, float]]]:
        """Lines along which the work is done, (x, y) metres; none for work without lines. Peers never
        read them.
        """
        return ()

    @property
    def remaining_path(self) -> Sequence[tuple[float, float]]:
        """The rest of the planned route, nearest point first, (x, y) metres. Peers never
        read it.
        """
        return ()
