"""A whole run from its frames: the inspector again, but it remembers when everything was so.

Times are seconds since the run began. A robot that says nothing for a second is silent, whatever its
last state was: what a listener cannot know is not guessed.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from agent.interface.lifecycle import State
from crdt import Phase
from protocol.frames.codec import Malformed, decode
from protocol.frames.fleet_frames import Member, Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import Identifier
from protocol.frames.messages import GROUP_OF
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.frames.safety_frames import Command, EmergencyStop, OperatorCommand, Reason
from protocol.frames.work_frames import StateSyncResponse, TaskClaim
from sim.can.frame_timing import worst_bits
from sim.record.recording import Recording
from tools.inspect.inspector import ASKED_S, NEVER_S, SILENT_S, Inspector, Seen
from tools.livemap.map_state import NAMES

SILENT = "SILENT"
GROUPS_MAX = 10_000  # identifiers that are remembered; a fleet has some hundreds
STATE_NAMES = {int(state): state.name for state in State}
STANDS_M_S = 0.05  # one step of a POSE; a speed of 0.0 there is at most half of it


class TimelineSpan(NamedTuple):
    """A robot in a state, or a section in the hands of an owner."""

    subject: int  # robot or section
    what: str  # state or phase
    owner: int | None  # of a section
    from_s: float
    until_s: float


class TimelineEvent(NamedTuple):
    """Something that happened at one instant: a fault, a stop, a silence, a command."""

    t_s: float
    kind: str
    who: str
    what: str


class BusAddress(NamedTuple):
    """A robot as its beat reported it, to 5 cm."""

    t_s: float
    x_m: float
    y_m: float
    speed_m_s: float
    stopped: bool


@dataclass
class Stop:
    """One press, and when each robot that was there said it again and stood."""

    dot: tuple[int, int, int]
    reason: str
    by: str
    t_s: float
    present: tuple[int, ...]  # the robots heard in the second before it, without the pressed one
    echo_s: dict[int, float] = field(default_factory=dict)  # since the press
    latch_s: dict[int, float] = field(default_factory=dict)  # first beat that says: stopped
    still_s: dict[int, float] = field(default_factory=dict)  # first such beat with no speed
    cleared_s: float | None = None  # when, in the run


class History(Inspector):
    """An inspector that also keeps every position, every state with its span, and the load of each
    second."""

    def __init__(self, zero_at_us: int = 0) -> None:
        super().__init__()
        self.zero_at_s = zero_at_us / 1e6
        self.places: dict[int, list[BusAddress]] = {}
        self.states: list[TimelineSpan] = []
        self.held: list[TimelineSpan] = []  # sections
        self.pressed: list[Stop] = []
        self.seen: list[TimelineEvent] = []
        self.loads: dict[int, Counter[str]] = {}  # worst-case bits by kind, by second
        self._second: int | None = None  # whose bits `_bits` are
        self._bits: Counter[str] = Counter()
        self._groups: dict[int, _Group] = {}  # by identifier
        self._since: dict[int, tuple[str, float]] = {}
        self._release_asked_s = NEVER_S
        self._holding: dict[int, tuple[str, int | None, float]] = {}

    def hear_all(self, recording: Recording) -> "History":
        """Every frame of a recording, and its end."""
        for t_us, frame in recording.rows():
            self.hear(t_us / 1e6, frame)
        return self.close()

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, and note what has changed by it. `t_s` is seconds on the clock of the
        recording."""
        t_s -= self.zero_at_s
        self.now_s = t_s
        identifier, data = frame
        group = self._groups.get(identifier) or self._group(identifier)
        second = int(t_s // 1)
        if second != self._second:
            self._second, self._bits = second, self.loads.setdefault(second, Counter())
        self._bits[group.kind] += worst_bits(len(data))
        slot = self.slot_of.get(identifier & 0xFF)
        if slot is not None:
            last_s = self.robots[slot].last_s
            if t_s - last_s > SILENT_S:
                self._silent(slot, last_s, t_s)
        if group.pgn == POSE_PGN:
            self._pose(t_s, slot, frame)
            return
        presses, resets, refusals = self.presses, self.resets, self.refusals
        self._read(t_s, frame)
        if self.presses > presses:
            self._press(t_s, frame)
        if self.resets > resets:
            self._clear(t_s)
        elif self.refusals > refusals:
            self._refuse(t_s)
        if group.pgn == OPERATOR_PGN:
            self._command(t_s, frame)

    def _group(self, identifier: int) -> "_Group":
        pgn = Identifier.unpack(identifier).pgn
        group = _Group(pgn, NAMES.get(pgn, f"PGN {pgn:04X}"))
        if len(self._groups) < GROUPS_MAX:
            self._groups[identifier] = group
        return group

    def _pose(self, t_s: float, slot: int | None, frame: Frame) -> None:
        """`_read` of a pose: nine frames in ten are one, and it says nothing else."""
        if self.makers.refuse(frame):
            return
        _, message = decode(frame)
        if isinstance(message, Malformed):
            self.malformed[message.reason] += 1
        elif slot is not None:
            robot = self.robots[slot]
            robot.last_s = t_s
            assert isinstance(message, Pose)
            self._placed(t_s, robot, message)

    def _explain(self, t_s: float, frame: Frame, slot: int | None, message: Any) -> None:
        """A report does not ask for causes, nor who is suspected."""

    def _suspect(self, slot: int, message: Any, now_us: int) -> None:
        pass

    def close(self) -> "History":
        """After the last frame: what lasts, lasts until now."""
        for slot, robot in self.robots.items():
            if self.now_s - robot.last_s > SILENT_S:
                self._silent(slot, robot.last_s, None)
            self._end_state(slot, self.now_s)
        for section in list(self._holding):
            self._end_section(section, self.now_s)
        self.states.sort(key=lambda span: (span.subject, span.from_s))
        self.held.sort(key=lambda span: (span.from_s, span.subject))
        self.seen.sort(key=lambda event: event.t_s)
        return self

    # ---------------------------------------------------------------- states

    def _member(self, t_s: float, source: int, message: Member) -> None:
        known = self.robots.get(message.slot)
        if known is not None and known.incarnation != message.incarnation:
            what = f"incarnation {message.incarnation}: it has lost its memory"
            self.seen.append(TimelineEvent(t_s, "restart", f"robot {message.slot}", what))
        super()._member(t_s, source, message)

    def _silent(self, slot: int, last_s: float, until_s: float | None) -> None:
        if not self.robots[slot].left:
            self._end_state(slot, last_s)
            self._since[slot] = (SILENT, last_s)
            how = "until the end" if until_s is None else f"for {until_s - last_s:.1f} s"
            self.seen.append(TimelineEvent(last_s, "silence", f"robot {slot}", how))
        if until_s is not None:
            self._end_state(slot, until_s)
            self.robots[slot].state = "?"  # so that its next frame begins a state

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        before = robot.state
        super()._state(t_s, robot, state, kind)
        if robot.state != before:
            self._end_state(robot.slot, t_s)
            self._since[robot.slot] = (robot.state, t_s)

    def _end_state(self, slot: int, t_s: float) -> None:
        name, from_s = self._since.pop(slot, ("", t_s))
        if t_s > from_s:
            self.states.append(TimelineSpan(slot, name, None, from_s, t_s))

    # ---------------------------------------------------------------- places, sections, stops

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        if type(message) is Pose:
            self._placed(t_s, robot, message)
            return
        super()._robot(t_s, robot, kind, message)
        match message:
            case TaskClaim() | StateSyncResponse():
                self._section(t_s, message.section)
            case EmergencyStop(echo=True):
                for stop in self.pressed:
                    if stop.dot == message[:3] and robot.slot in stop.present:
                        stop.echo_s.setdefault(robot.slot, t_s - stop.t_s)
            case OperatorReport(matter=ReportKind.ASKING):
                where = f"at {message.x_m:.1f}, {message.y_m:.1f}"
                self.seen.append(TimelineEvent(t_s, "question", f"robot {robot.slot}", where))
            case OperatorReport(matter=ReportKind.RELEASE_ASKED):
                if t_s - self._release_asked_s > ASKED_S:
                    what = "a release is asked for at its terminal"
                    self.seen.append(TimelineEvent(t_s, "question", f"robot {robot.slot}", what))
                self._release_asked_s = t_s

    def _placed(self, t_s: float, robot: Seen, pose: Pose) -> None:
        x_m, y_m, _, speed_m_s, state, stopped, *_ = pose
        placed = pose.placed
        if placed:
            track = self.places.get(robot.slot)
            if track is None:
                track = self.places[robot.slot] = []
            track.append(BusAddress(t_s, x_m, y_m, speed_m_s, stopped))
        if STATE_NAMES[state] != robot.state:
            self._state(t_s, robot, state, "Pose")
        if stopped and placed:
            self._stands(t_s, robot.slot, speed_m_s <= STANDS_M_S / 2)

    def _section(self, t_s: float, section: int) -> None:
        phase, owner = self.allocation.phase_of(section), self.allocation.owner_of(section)
        held = self._holding.get(section)
        if held is None or held[:2] != (phase.name, owner):
            self._end_section(section, t_s)
            self._holding[section] = (phase.name, owner, t_s)

    def _end_section(self, section: int, t_s: float) -> None:
        phase, owner, from_s = self._holding.pop(section, (Phase.FREE.name, None, t_s))
        if phase != Phase.FREE.name:
            self.held.append(TimelineSpan(section, phase, owner, from_s, t_s))

    def _press(self, t_s: float, frame: Frame) -> None:
        _, message = decode(frame)
        assert isinstance(message, EmergencyStop)
        dot = message[:3]
        known = message.reason in Reason._value2member_map_
        reason = Reason(message.reason).name if known else f"reason {message.reason}"
        by = f"robot {dot[0]}" if dot[0] in self.robots else f"device {dot[0]}"
        present = tuple(
            slot for slot, robot in sorted(self.robots.items())
            if slot != dot[0] and not robot.left and t_s - robot.last_s <= SILENT_S
        )  # fmt: skip
        self.pressed.append(Stop(dot, reason, by, t_s, present))
        self.seen.append(TimelineEvent(t_s, "stop", by, reason))

    def _stands(self, t_s: float, slot: int, still: bool) -> None:
        for stop in self.pressed:
            if slot in stop.present and stop.cleared_s is None:
                stop.latch_s.setdefault(slot, t_s - stop.t_s)
                if still:
                    stop.still_s.setdefault(slot, t_s - stop.t_s)

    def _clear(self, t_s: float) -> None:
        for stop in self.pressed:
            if stop.cleared_s is None and stop.dot in self.cleared:
                stop.cleared_s = t_s
                self.seen.append(
                    TimelineEvent(t_s, "reset", "an operator", f"clears {_dotted(stop.dot)}")
                )

    def _refuse(self, t_s: float) -> None:
        for stop in self.pressed:
            held = stop.dot in self.stops and stop.dot not in self.cleared
            if stop.cleared_s is not None and held:
                stop.cleared_s = None
                self.seen.append(
                    TimelineEvent(t_s, "reset", "robots", f"refuse to clear {_dotted(stop.dot)}")
                )

    def _command(self, t_s: float, frame: Frame) -> None:
        _, message = decode(frame)
        if isinstance(message, OperatorCommand):
            target = "all" if message.target == 255 else f"robot {message.target}"
            event = TimelineEvent(t_s, "command", target, Command(message.command).name)
            recent = (e for e in reversed(self.seen) if t_s - e.t_s < AGAIN_S)
            if all(e[1:] != event[1:] for e in recent):  # a command is said several times
                self.seen.append(event)

    def bins(self, count: int) -> tuple[int, list[tuple[int, Counter[str]]]]:
        """Bits by kind in at most so many bins: their width in seconds, and (second, bits) of each."""
        if not self.loads:
            return 1, []
        first, last = min(self.loads), max(self.loads)
        width_s = (last - first) // count + 1
        found = [(second, Counter[str]()) for second in range(first, last + 1, width_s)]
        for second, bits in self.loads.items():
            found[(second - first) // width_s][1].update(bits)
        return width_s, found


class _Group(NamedTuple):
    pgn: int
    kind: str  # its name, for people


AGAIN_S = 1.0
POSE_PGN = GROUP_OF[Pose].pgn
OPERATOR_PGN = next(pgn for pgn, name in NAMES.items() if name == "OPERATOR_COMMAND")


def _dotted(dot: tuple[int, int, int]) -> str:
    return ".".join(map(str, dot))
