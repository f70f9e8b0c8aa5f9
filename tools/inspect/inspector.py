"""What a listener can know of a fleet from its frames alone, on a live bus, from a log or in a replay.

Nothing here asks a robot. States, sections and clocks are what the robots have sent, with the time at
which they sent it.
"""

from collections import Counter, deque
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from math import inf
from typing import Any

from agent.delivery.task_registry import TASKS_MAX, stop_names
from agent.interface.lifecycle import State
from agent.peer.leader_election import OPERATOR_GATEWAY
from agent.peer.sender_limits import SenderLimits
from agent.peer.told_causes import ToldCauses
from agent.safety.standard_stop import HOLD_US
from agent.safety.stop_cause import StopCause
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import epoch_of, pack
from protocol.frames.codec import UNKNOWN, Malformed, decode_once
from protocol.frames.delivery_frames import NO_TASK, TASK_NUMBERS, Itinerary, TaskOrder
from protocol.frames.fleet_frames import (
    NOWHERE_M,
    Heartbeat,
    LeaderElectionVote,
    Member,
    Pose,
    Standstill,
    VectorSlice,
)  # fmt: skip
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.frames.safety_frames import (
    AllImplementsStop,
    EmergencyReset,
    EmergencyStop,
    HeldReset,
    Switch,
)
from protocol.frames.segment_frames import FleetStop
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from tools.common.frame_makers import Makers
from tools.inspect.bus_load import BIT_RATE, BusLoad, bits_of
from tools.inspect.causality import Causality
from tools.inspect.proven_work import ProvenWork
from tools.inspect.unnamed_stops import UnnamedStops
from tools.operate.foreign_groups import group_name

BUTTON_S = HOLD_US / 1e6  # a shortcut button that is silent this long is forgotten
# Stops kept by name, twice as many as a robot holds by name; with forged names there are millions.
STOPS_MAX = 512
CLEARED_MAX = 1024  # names that were cleared, also of stops that were not heard
LATCHED_TOLD = 16  # names in a line for people; the others are counted
TERMS_MAX = 64  # of elections; a fleet holds one or two elections, and only the newest term counts
TRANSITIONS_MAX = 64  # newest transitions kept of a robot; no person reads a longer list
NO_KEYS = "NO KEYS: any device on the bus can stop and release this fleet"
SILENT_S = 1.0  # a robot not heard for longer is shown as silent
ASKED_S = 2.0  # a release that is asked for is said twice a second
NEVER_S = float("-inf")
FREE_S = 5.0  # a robot that hears a stop says so within half a second
# A robot that says so long after a reset that stops hold it has not taken that reset: it tells each of
# its causes within seconds, and a reset is repeated for less than two.
RESET_TAKEN_S, RESET_REFUSED_S = 2.0, 10.0


@dataclass
class Transition:
    """A change of a robot's state, as it was heard."""

    t_s: float
    source: str
    target: str
    heard_by: str  # which kind of frame showed it


@dataclass
class Seen:
    """One robot, as heard."""

    slot: int
    address: int
    state: str = "?"
    first_s: float = 0.0
    last_s: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    speed_m_s: float = 0.0
    placed: bool = True  # it knows where it is
    has_place: bool = False  # it has told one
    stopped: bool = False
    free_s: float = (
        inf  # since when all its beats say that no stop holds it; inf: the newest does not
    )
    left: bool = False
    started: bool = True  # until a heartbeat says that it is not
    keyed: bool | None = None  # whether its fleet has keys, as it says; None: it has not said
    held: bool = False  # something keeps it from moving
    causes: ToldCauses = field(default_factory=ToldCauses)  # why it stands, as it tells it
    release_asked_s: float = NEVER_S  # when it last said that a release is asked for at a terminal
    question: int = 0  # number of what it asks its operators; 0: nothing
    # Place to which an operator has sent it, until it is there.
    goal: tuple[float, float] | None = None
    incarnation: int = 0
    health: float = 1.0
    operations: int = 0
    digest: int = 0
    digest_s: float = 0.0  # when it said so
    plan_version: int = -1  # of the itinerary that is being told, and its sections by position
    plan: dict[int, int] = field(default_factory=dict)
    battery: float | None = None  # None: it tells of none
    clock: dict[int, int] = field(default_factory=dict)  # low bytes of its vector clock, as sliced
    transitions: deque[Transition] = field(default_factory=lambda: deque(maxlen=TRANSITIONS_MAX))
    frames: Counter[str] = field(default_factory=Counter)


class Inspector:
    """All that a listener knows of a fleet: robots, registers, progress, stops, counts of frames
    and the load."""

    def __init__(self, sections: AbstractSet[int] = frozenset()) -> None:
        """`sections`: of the field; empty: it is not known, and any may be worked."""
        self.sections = sections
        self.beyond = 0  # frames of work in sections that the field does not have
        self.makers = Makers()
        self.robots: dict[int, Seen] = {}
        self.slot_of: dict[int, int] = {}
        self._names: dict[int, int] = {}  # address: NAME of ours that claimed it last
        # Of addresses that another maker has claimed: NAME and slot of the robot that had it.
        self._contested: dict[int, tuple[int, int]] = {}
        self.allocation = FieldAllocationCRDT()
        self.progress = Progress({})
        self.kinds: Counter[str] = Counter()
        self.malformed: Counter[str] = Counter()
        self.unknown: Counter[int] = Counter()  # PGN -> frames of groups that are not ours
        self.others = 0  # frames with an 11-bit identifier, remote and error frames
        self.stops: dict[tuple[int, int, int], float] = {}
        self.cleared: dict[tuple[int, int, int], float] = {}
        self.unnamed = UnnamedStops()  # beyond `STOPS_MAX`
        # How often a stop got its name, a reset cleared some, and robots refused a reset.
        self.presses = self.resets = self.refusals = 0
        self._reset_s = NEVER_S  # when the newest reset was heard
        self._by_reset: set[tuple[int, int, int]] = (
            set()
        )  # what it has cleared, and those just before
        self._segments = False  # stops of other segments hold robots, too
        self.votes: dict[tuple[int, int], dict[int, int]] = {}
        self.transports: dict[int, tuple[int, int]] = {}  # task: cells of its pickup and dropoff
        self._buttons: dict[int, float] = {}  # address of a pressed button: when it was heard last
        self.bits = 0
        self.changed_s = 0.0  # when a frame last brought a new claim or new work
        self.first_s: float | None = None
        self.now_s = 0.0
        self.causality = Causality()
        self.load = BusLoad()
        self.limits: SenderLimits | None = None  # from the first frame on
        self.proven: ProvenWork | None = None  # what counts of work; None: all that the bus says

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, at `t_s` of a clock that never goes back. Frames of other makers and
        malformed ones are only counted."""
        self.first_s = t_s if self.first_s is None else self.first_s
        self.now_s = t_s
        if self.limits is None:
            self.limits = SenderLimits(round(t_s * 1e6))
        self.bits += bits_of(len(frame.data))
        self.load.hear(t_s, len(frame.data))
        self._read(t_s, frame)

    def _read(self, t_s: float, frame: Frame) -> None:
        """What a frame says, once it is counted."""
        if self.makers.refuse(frame):
            return
        source, message = decode_once(frame)
        if message is UNKNOWN:
            group = frame.identifier >> 8 & 0x3FFFF
            self.unknown[group if group >> 8 & 0xFF >= 240 else group & 0x3FF00] += 1
            return
        if isinstance(message, Malformed):
            self.malformed[message.reason] += 1
            return
        kind = type(message).__name__
        self.kinds[kind] += 1
        if isinstance(message, AddressClaimed):
            self._claimed(source, message.name)
        if isinstance(message, Member):
            self._member(t_s, source, message)
        if self.proven is not None:
            for proven in self.proven.hear(source, message, round(t_s * 1e6)):
                self._work(t_s, proven)
        slot = self.slot_of.get(source)
        self._explain(t_s, frame, slot, message)
        if isinstance(message, EmergencyStop):
            if not message.spent:
                self._press_heard(t_s, message[:3])
        elif isinstance(message, HeldReset | EmergencyReset):
            self._reset(t_s, message)
        elif isinstance(message, FleetStop):
            self._segments = True
        elif isinstance(message, AllImplementsStop):
            self._button(t_s, source, message)
        elif isinstance(message, TaskOrder):  # of a tool, or of a robot that says it again
            self._ordered(message)
        if slot is None:
            return
        robot = self.robots[slot]
        robot.last_s = t_s
        robot.frames[kind] += 1
        self._suspect(slot, message, round(t_s * 1e6))
        self._robot(t_s, robot, kind, message)

    def _explain(self, t_s: float, frame: Frame, slot: int | None, message: Any) -> None:
        """Keep what may have led to a claim."""
        self.causality.hear(t_s, frame, slot, message)

    def _suspect(self, slot: int, message: Any, now_us: int) -> None:
        """Count what is more than this robot can honestly say, before it is taken in."""
        assert self.limits is not None
        if isinstance(message, WorkProgress) and self.allocation.owner_of(message.section) == slot:
            new = message.bits & ~self.progress.bits(message.section, message.block)
            self.limits.progress(slot, new.bit_count(), now_us)
        elif isinstance(message, TaskClaim):
            known = self.allocation.key(message.section)
            epoch = 0 if known is None else epoch_of(known)
            self.limits.claim(slot, message.epoch, epoch, now_us)
        elif isinstance(message, EmergencyStop):
            new = self.stops.get(message[:3]) == self.now_s
            if new and message.slot == slot and not message.echo:
                self.limits.stop(slot, now_us)

    def hear_other(self) -> None:
        """Count a frame that no robot reads: an 11-bit identifier, a remote or an error frame."""
        self.others += 1

    def _member(self, t_s: float, source: int, message: Member) -> None:
        self.slot_of = {a: s for a, s in self.slot_of.items() if s != message.slot}
        self.slot_of[source] = message.slot
        robot = self.robots.setdefault(message.slot, Seen(message.slot, source, first_s=t_s))
        robot.address, robot.incarnation, robot.left = source, message.incarnation, False

    def _claimed(self, source: int, name: int) -> None:
        """Another maker's claim: what came from there before was no robot's, unless a robot had claimed
        the address. That one has lost it, or claims it again."""
        was_ours = self.makers.knows(source)
        if self.makers.claimed(source, name):
            said, slot = self._contested.pop(source, (0, -1))
            if said == name and slot in self.robots and slot not in self.slot_of.values():
                self.slot_of[source] = slot
            self._names[source] = name
            return
        slot = self.slot_of.pop(source, -1)
        if slot < 0 or self.robots[slot].address != source:
            return
        if was_ours:
            self._contested[source] = self._names[source], slot
        else:
            del self.robots[slot]

    def _in_field(self, section: int) -> bool:
        if self.sections and section not in self.sections:
            self.beyond += 1
            return False
        return True

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        match message:
            case Pose():
                robot.placed = message.placed
                if message.x_m > NOWHERE_M:
                    robot.x_m, robot.y_m, robot.has_place = message.x_m, message.y_m, True
                robot.speed_m_s = message.speed_m_s if message.placed else 0.0
                robot.stopped = message.stopped
                robot.free_s = inf if message.stopped else min(robot.free_s, t_s)
                self._state(t_s, robot, message.state, kind)
            case Heartbeat():
                robot.health, robot.operations = message.health, message.operations
                robot.digest, robot.left = message.digest, message.leaving
                robot.digest_s = t_s
                robot.started, robot.held = message.started, message.held or message.stopped
                robot.keyed = message.keyed
                if not robot.held:
                    robot.causes.moves()
                robot.clock[robot.slot] = message.operations
                robot.free_s = inf if message.stopped else min(robot.free_s, t_s)
                self._state(t_s, robot, message.state, kind)
            case Standstill():
                robot.causes.hear(message, round(t_s * 1e6))
                self._refused(t_s, message)
            case VectorSlice():
                for offset, count in enumerate(message.counts):
                    if message.base + offset != robot.slot and count:
                        robot.clock[message.base + offset] = count
            case TaskClaim() | StateSyncResponse() | WorkProgress():
                if self.proven is None:
                    self._work(t_s, message)
            case LeaderElectionVote():
                votes = self.votes.setdefault((message.election, message.term), {})
                votes.setdefault(robot.slot, message.candidate)
                if len(self.votes) > TERMS_MAX:
                    self._forget_a_term()
            case Itinerary():
                _itinerary(robot, message)
            case OperatorReport():
                _operator_report(t_s, robot, message)

    def _work(self, t_s: float, message: TaskClaim | StateSyncResponse | WorkProgress) -> None:
        if not self._in_field(message.section):
            return
        if isinstance(message, WorkProgress):
            news = self.progress.apply(message.section, message.block, message.bits)
        else:
            m = message
            key = pack(m.epoch, m.phase, m.bid, m.lamport, m.owner)
            news = self.allocation.apply(m.section, key)
        if news:
            self.changed_s = t_s

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        name = State(state).name
        if name != robot.state:
            robot.transitions.append(Transition(t_s, robot.state, name, kind))
            robot.state = name

    def _ordered(self, m: TaskOrder) -> None:
        if m.task < TASK_NUMBERS:  # no fleet has other tasks
            self.transports[m.task] = (m.pickup, m.dropoff)

    def _forget_a_term(self) -> None:
        """The earliest one of the election with most terms, so that no flood ends another election."""
        (most, _), *_ = Counter(election for election, _ in self.votes).most_common(1)
        del self.votes[min(key for key in self.votes if key[0] == most)]

    def _press_heard(self, t_s: float, dot: tuple[int, int, int]) -> None:
        """A stop that is held keeps its name: a flood of forged stops pushes none out, and is counted."""
        if dot in self.stops:
            return
        if len(self.stops) >= STOPS_MAX:  # without half of those that were cleared, oldest first
            cleared = [old for old in self.cleared if old in self.stops]
            for old in cleared[: (len(cleared) + 1) // 2]:
                del self.stops[old], self.cleared[old]
        if len(self.stops) >= STOPS_MAX:
            if dot not in self.cleared:
                self.unnamed.press(dot, t_s)
            return
        self.unnamed.clear(dot)
        self.stops[dot] = t_s
        self.presses += 1

    def _reset(self, t_s: float, m: HeldReset | EmergencyReset) -> None:
        """Robots of a fleet with keys clear nothing by a reset without a tag. Whether a tag is right a
        listener cannot tell: see `_refused`."""
        if self.keyed and not (m.freshness or m.tag):
            return
        if t_s - self._reset_s > RESET_REFUSED_S:
            self._by_reset.clear()
        self._reset_s = t_s
        # A sum names all that robots hold.
        named = {m[:3]} if isinstance(m, EmergencyReset) else self.stops.keys()
        new = named - self.cleared.keys()
        self._by_reset |= new
        self.resets += bool(new)
        self.cleared |= dict.fromkeys(sorted(new), t_s)
        # A refused reset brings no count back: robots say again what they hold.
        if isinstance(m, EmergencyReset):
            self.unnamed.clear(m[:3])
        else:
            self.unnamed.clear_all()
        if len(self.cleared) > CLEARED_MAX:
            # Those of stops that were heard stay: without them these would hold the fleet again.
            unheard = [old for old in self.cleared if old not in self.stops]
            for old in unheard[: len(self.cleared) - CLEARED_MAX // 2]:
                del self.cleared[old]
                self._by_reset.discard(old)

    def _refused(self, t_s: float, m: Standstill) -> None:
        """A robot that stops still hold, although each was named by a reset, has refused that reset: its
        tag was wrong."""
        told = m.cause == StopCause.STOP_DOT.number and m.number > 0
        due = RESET_TAKEN_S < t_s - self._reset_s < RESET_REFUSED_S
        if told and due and not (self._segments or self.latched):
            self.refusals += bool(self._by_reset)
            for dot in self._by_reset:
                self.cleared.pop(dot, None)
            self._by_reset.clear()

    def _button(self, t_s: float, source: int, m: AllImplementsStop) -> None:
        """Each shortcut button permits for itself alone."""
        if m.switch in (Switch.STOP, Switch.ERROR):
            self._buttons[source] = t_s
        elif m.switch == Switch.PERMIT:
            self._buttons.pop(source, None)

    # ---------------------------------------------------------------- what people ask

    @property
    def implements_stop(self) -> float | None:
        """When the last button that stops implements was heard; None: all permit, or are silent."""
        heard_s = max(self._buttons.values(), default=None)
        held = heard_s is not None and self.now_s - heard_s < BUTTON_S
        return heard_s if held else None

    @property
    def latched(self) -> list[tuple[int, int, int]]:
        """Dots of the stops that were heard and hold robots: slot, incarnation, counter. The one that was
        heard first is the first; `latched_more` more are not kept by name.

        A reset may not have been heard. So a stop holds none either if every robot that is heard has said
        for `FREE_S` that no stop holds it, and each of them was there before."""
        left = self.stops.keys() - self.cleared.keys()
        if self._all_free:
            left = {dot for dot in left if self.now_s - self.stops[dot] < FREE_S}
        return sorted(left, key=lambda dot: (self.stops[dot], dot))

    @property
    def latched_more(self) -> int:
        """How many stops hold robots beyond those of `latched`."""
        past = self._all_free and self.now_s - self.unnamed.heard_s >= FREE_S
        return 0 if past else self.unnamed.count

    @property
    def _all_free(self) -> bool:
        live = [r for r in self.robots.values() if not r.left and self.now_s - r.last_s <= SILENT_S]
        free_s = max((r.free_s for r in live), default=inf)
        return self.now_s - free_s >= FREE_S

    @property
    def keyed(self) -> bool | None:
        """Whether this fleet has keys: False if one robot says that it has none, None if nobody says
        anything."""
        said = [r.keyed for r in self.robots.values() if r.keyed is not None and not r.left]
        return all(said) if said else None

    @property
    def leader(self) -> int | None:
        """The robot that answers for the fleet: a majority of those heard now has voted for it."""
        live = {
            r.slot for r in self.robots.values()
            if not r.left and self.now_s - r.last_s <= SILENT_S
        }  # fmt: skip
        terms = [term for election, term in self.votes if election == OPERATOR_GATEWAY]
        if not terms:
            return None
        cast = self.votes[OPERATOR_GATEWAY, max(terms)]
        votes = Counter(candidate for voter, candidate in cast.items() if voter in live)
        for candidate, count in votes.items():
            if 2 * count > len(live):
                return candidate
        return None

    def why(self, section: int) -> Iterator[dict[str, Any]]:
        """The frames by which a section came to its owner, oldest first; each with what led to it."""
        for step in self.causality.chain(section):
            yield step.to_dict()

    def to_dict(self, zero_s: float = 0.0) -> dict[str, Any]:
        """Everything as plain values for JSON. `zero_s`: from when on its times count, on the clock that
        `hear` is given."""
        span_s = self.now_s - (self.first_s or 0.0)
        carried_s = max(span_s, self.bits / BIT_RATE, 1e-9)  # a single frame has no span
        return {
            "robots": [self._robot_dict(self.robots[slot], zero_s) for slot in sorted(self.robots)],
            "sections": {
                f"S{section}": {
                    "phase": self.allocation.phase_of(section).name,
                    "owner": self.allocation.owner_of(section),
                    "units": self.progress.covered(section),
                }
                for section in self.allocation.sections()
            },
            "frames": dict(self.kinds.most_common()),
            "malformed": dict(self.malformed),
            "unknown": {group_name(pgn): n for pgn, n in self.unknown.most_common()},
            "other_makers": {group_name(pgn): n for pgn, n in self.makers.refused.most_common()},
            "other_frames": self.others,
            "beyond_the_field": self.beyond,
            "suspects": [] if self.limits is None else self.limits.named,
            "latched": [".".join(map(str, dot)) for dot in self.latched],
            "latched_more": self.latched_more,
            "leader": self.leader,
            "keyed": self.keyed,
            "leaders": {
                f"{election}/{term}": dict(sorted(votes.items()))
                for (election, term), votes in sorted(self.votes.items())
            },
            "bus_load_worst_case": round(self.bits / (carried_s * BIT_RATE), 4),
            "seconds": round(span_s, 3),
        }

    def _delivering(self, robot: Seen) -> dict[str, Any]:
        """Of robots that carry parcels alone."""
        if robot.battery is None:
            return {}
        return {"itinerary": self.itinerary(robot), "battery": round(robot.battery, 2)}

    def itinerary(self, robot: Seen) -> list[str]:
        """What it is at and means to do, as far as it has told: [P5, D5, C1]."""
        own = [s for s in self.allocation.assigned_sections(robot.slot) if s < TASKS_MAX]
        ahead = [
            stop for _, stop in sorted(robot.plan.items())
            if stop >= TASKS_MAX or self.allocation.phase_of(stop) is Phase.FREE
        ]  # fmt: skip
        aboard = next((s for s in own if self.progress.bits(s, 0) & 1), -1)
        return stop_names(own, ahead, aboard)

    def replica_of(self, robot: Seen) -> str:
        """What its last heartbeat says of its replica, for people.

        "in step": as every other robot that is there; "before the last change": it was sent before the
        newest claim or work was heard, and says nothing of that; else it differs.
        """
        if robot.digest_s <= self.changed_s:
            return "before the last change"
        newer = {
            other.digest
            for other in self.robots.values()
            if not other.left and other.digest_s > self.changed_s
        }
        return "in step" if newer <= {robot.digest} else "differs"

    def stands(self, robot: Seen) -> list[str]:
        """Why it stands and what a person can do, for each cause that it still tells. A silent robot
        tells nothing: what can be done about its silence comes first."""
        said = robot.causes.sentences(round(self.now_s * 1e6))
        if self.now_s - robot.last_s > SILENT_S and not robot.left:
            said.insert(0, f"SILENT: {StopCause.MEMBER_SILENT.value.do}")
        return said

    def _robot_dict(self, robot: Seen, zero_s: float = 0.0) -> dict[str, Any]:
        peers = sorted(s for s in robot.clock if s != robot.slot)
        return {
            "slot": robot.slot, "address": robot.address, "state": robot.state,
            "silent": self.now_s - robot.last_s > SILENT_S and not robot.left, "left": robot.left,
            "x_m": round(robot.x_m, 2) if robot.has_place else None,
            "y_m": round(robot.y_m, 2) if robot.has_place else None,
            "speed_m_s": round(robot.speed_m_s, 2), "placed": robot.placed and robot.has_place,
            "stopped": robot.stopped, "health": round(robot.health, 3),
            "started": robot.started,
            "release_asked": self.now_s - robot.release_asked_s < ASKED_S,
            "question": robot.question, "goal": robot.goal,
            "stands": self.stands(robot),
            "incarnation": robot.incarnation, "digest": f"{robot.digest:06x}",
            "replica": self.replica_of(robot),
            "peers": peers, "clock": {str(s): robot.clock[s] for s in sorted(robot.clock)},
            "sections": [f"S{s}" for s in self.allocation.assigned_sections(robot.slot)],
            **self._delivering(robot),
            "transitions": [
                {"t_s": round(t.t_s - zero_s, 3), "from": t.source, "to": t.target, "by": t.heard_by}
                for t in robot.transitions
            ],
        }  # fmt: skip


def latched_words(seen: dict[str, Any]) -> str:
    """The stops of `to_dict` in a line for people, empty where there is none: the first few, and how many
    there are beyond these."""
    names = seen["latched"]
    more = len(names[LATCHED_TOLD:]) + seen["latched_more"]
    return ", ".join(names[:LATCHED_TOLD]) + (f" and {more:,} more" if more else "")


def _itinerary(robot: Seen, m: Itinerary) -> None:
    if m.version != robot.plan_version:
        robot.plan_version, robot.plan = m.version, {}
    robot.battery = m.battery / 255
    if m.task != NO_TASK:
        robot.plan[m.first] = m.task
    if m.after != NO_TASK:
        robot.plan[m.first + 1] = m.after


def _operator_report(t_s: float, robot: Seen, m: OperatorReport) -> None:
    """What it asks, and where it was sent."""
    match m.matter:
        case ReportKind.REFUSED:
            return
        case ReportKind.RELEASE_ASKED:
            robot.release_asked_s = t_s
            return
        case ReportKind.ASKING | ReportKind.WAITING:
            robot.question = m.number
            return
        case ReportKind.UNDER_WAY:
            robot.goal = (m.x_m, m.y_m)
        case ReportKind.ARRIVED | ReportKind.WORKING | ReportKind.STOPPED:
            robot.goal = None
    robot.question = 0
