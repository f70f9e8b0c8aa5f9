"""An inspector that also counts what a monitoring system asks: bus time by kind, changes of state, and
how long a stop takes to reach each robot and to bring it to a stand.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from typing import Any

from crdt import Phase
from protocol.frames.codec import decode
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import Identifier
from protocol.frames.messages import GROUPS
from protocol.frames.safety_frames import EMERGENCY_STOP, EmergencyStop
from tools.inspect.bus_load import BIT_RATE, BusLoad, bits_of
from tools.inspect.inspector import SILENT_S, Inspector, Seen

NAMES = {group.pgn: group.name for group in GROUPS}
OTHER = "other"  # groups that are not ours, all as one: anybody may put any number on a bus
MOVING_M_S = (
    0.05  # a slower robot counts as standing: the resolution of a speed on the bus is finer
)
# A robot that has not answered by then never will: a press is repeated for 2 s.
ANSWER_MAX_S = 10.0
PRESSES_MAX = (
    64  # measured at the same time: persons do not press more often; a flood of forged stops does
)
Dot = tuple[int, int, int]


class _Press:
    """One stop that was pressed, and the robots that have still to answer."""

    def __init__(self, pressed_s: float, live: set[int], moving: set[int]) -> None:
        self.pressed_s, self.to_echo, self.to_stand = pressed_s, live, moving


class MeasuredInspector(Inspector):
    """An inspector with counters that only grow, by kind of frame and by robot."""

    def __init__(self, sections: AbstractSet[int] = frozenset(), bitrate: int = BIT_RATE) -> None:
        """`sections`: of the field; empty: it is not known. `bitrate`: of the bus, bit/s."""
        super().__init__(sections)
        self.load = BusLoad(bitrate)
        self.frames_by_kind: Counter[str] = Counter()
        self.bits_by_kind: Counter[str] = Counter()  # at worst-case stuffing
        self.entered: Counter[tuple[int, str]] = Counter()  # robot and state -> how often entered
        # Called with the seconds from the first frame of a stop to a robot's echo, and to its stand.
        self.on_echo: Callable[[float], None] = _ignored
        self.on_stand: Callable[[float], None] = _ignored
        self._presses: dict[Dot, _Press] = {}

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, and count it by kind."""
        pgn = Identifier.unpack(frame.identifier).pgn
        kind = NAMES.get(pgn, OTHER)
        self.frames_by_kind[kind] += 1
        self.bits_by_kind[kind] += bits_of(len(frame.data))
        if pgn == EMERGENCY_STOP.pgn:
            self._stop(t_s, frame)
        super().hear(t_s, frame)

    def _stop(self, t_s: float, frame: Frame) -> None:
        source, message = decode(frame)
        if not isinstance(message, EmergencyStop) or message.spent:
            return
        self._presses = {
            dot: press
            for dot, press in self._presses.items()
            if t_s - press.pressed_s <= ANSWER_MAX_S
        }
        dot = message[:3]
        if not message.echo and dot not in self.stops:  # an echo does not tell when it was pressed
            if len(self._presses) >= PRESSES_MAX:
                return
            live = [r for r in self.robots.values() if not r.left and t_s - r.last_s <= SILENT_S]
            presser = self.slot_of.get(source)
            self._presses[dot] = _Press(
                t_s,
                {r.slot for r in live} - {presser},
                {r.slot for r in live if r.speed_m_s > MOVING_M_S},
            )
        elif message.echo and (press := self._presses.get(dot)) is not None:
            slot = self.slot_of.get(source)
            if slot in press.to_echo:
                press.to_echo.discard(slot)
                self.on_echo(t_s - press.pressed_s)

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        if self._presses and isinstance(message, Pose) and message.speed_m_s <= MOVING_M_S:
            for press in self._presses.values():
                if robot.slot in press.to_stand and t_s - press.pressed_s <= ANSWER_MAX_S:
                    press.to_stand.discard(robot.slot)
                    self.on_stand(t_s - press.pressed_s)
        super()._robot(t_s, robot, kind, message)

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        before = robot.state
        super()._state(t_s, robot, state, kind)
        if robot.state != before:
            self.entered[robot.slot, robot.state] += 1

    def load_at(self, now_s: float) -> float:
        """Share of the bus, 0 to 1, in the last whole second; 0 where none was heard since."""
        return self.load.newest if now_s - self.now_s <= 2.0 else 0.0

    def phases(self) -> Iterator[tuple[str, int]]:
        """How many sections are in each phase. Those that were never heard of are FREE, where the
        field is known."""
        heard = self.allocation.sections()
        counts = Counter(dict.fromkeys(Phase.__members__, 0))
        counts.update(self.allocation.phase_of(section).name for section in heard)
        counts["FREE"] += len(self.sections - set(heard))
        yield from counts.items()

    def worked_units(self) -> int:
        """Units of all sections that are known to be covered."""
        return sum(bits.bit_count() for _, _, bits in self.progress.entries())


def _ignored(seconds: float) -> None:
    """Nobody asks for this latency."""
