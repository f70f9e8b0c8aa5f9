"""A world without physics, for campaigns about the protocol. Bodies stand still and follow
commands, sections are worked by the clock, and the truth of both is recorded.

It offers a fleet the same interface as `sim/world/world.py`. The world itself records which robot
works where, so no checker has to ask a robot.
"""

from collections.abc import Callable, Collection, Mapping
from math import cos, sin
from typing import NamedTuple

from agent.interface.config import ACTUATOR_TTL_US, CONTENTION_US, LEASE_US, MS, S
from agent.interface.effects import HALT, Drive
from agent.interface.mission import STILL, ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import MotionController
from agent.interface.observation import NOTHING_SEEN, Neighbour, Observation
from crdt import Phase
from sim.world.checkers import VIOLATIONS_MAX, Violation, lapse_for_us
from sim.world.drive_trains import Chassis
from sim.world.robot_body import SimulatedBody
from sim.world.world import World

SPEED_M_S = 2.5
SPACING_M = 12.0  # far enough apart that no robot gives way
CIRCLE_M = 0.1  # a body told to stand still moves too: less than a wrong place (`JUMP_M`)
UNIT_US = 1 * S  # a unit takes this long
UNITS = 20  # of a section; so claims are made three times as often as in a field of short rows
SECTIONS_A_ROBOT = 8
SPRINT_SECTIONS = 3  # per robot, in a sprint
# Two robots in one section within this time work there together. A hand-over takes longer, because
# a claim is contested for 250 ms before work starts.
BOTH_US = 200 * MS


assert BOTH_US < CONTENTION_US
_tuple = tuple.__new__


class Watch(NamedTuple):
    """A stop in force: which robots it binds, and from when."""

    slots: frozenset[int]
    silent_at_us: int  # after this, no command to move may be in force


class CommandChecker:
    """S1 without physics: between a stop's bound and its release no command to move is in force."""

    def __init__(self) -> None:
        self.violations: list[Violation] = []
        self._watches: dict[int, Watch] = {}
        self._lapsed_at_us: dict[int, int] = {}
        self._pressed = 0

    def press(self, t_us: int, bound_for_us: int, slots: Collection[int]) -> int:
        """Returns the number to release it by."""
        self._pressed += 1
        self._watches[self._pressed] = Watch(frozenset(slots), t_us + bound_for_us)
        return self._pressed

    def release(self, number: int, slots: Collection[int] | None = None) -> None:
        """A person released some robots, or all of them, from that stop."""
        watch = self._watches.pop(number)
        if slots is not None and watch.slots - frozenset(slots):
            self._watches[number] = watch._replace(slots=watch.slots - frozenset(slots))

    def bound(self, number: int) -> frozenset[int]:
        """The robots that this stop still binds."""
        return self._watches[number].slots

    def lapses(self, slot: int, now_us: int) -> None:
        """The robot has died or hangs, so its last command holds until it expires in the
        actuator."""
        self._lapsed_at_us[slot] = now_us

    def moved(self, slot: int, end_at_us: int) -> None:
        """A command to move was in force until then."""
        for watch in self._watches.values():
            if end_at_us > watch.silent_at_us and slot in watch.slots:
                late_for_us = lapse_for_us(self._lapsed_at_us.get(slot), watch.silent_at_us)
                if end_at_us <= watch.silent_at_us + late_for_us:
                    continue
                if len(self.violations) < VIOLATIONS_MAX:
                    self.violations.append(
                        Violation("S1", end_at_us, (slot,), "told to move after a stop")
                    )
                return


class StationaryBody(SimulatedBody):
    """A body that never leaves its place and records whether it was commanded to move or to work."""

    def __init__(self, parade: "ProtocolWorld", slot: int) -> None:
        super().__init__(parade, slot, slot, 0.5, Chassis())
        self.parade = parade
        self.x_m, self.y_m = SPACING_M * (slot % 12), SPACING_M * (slot // 12)
        self._tool_on = False
        self._moving_at_us = -ACTUATOR_TTL_US  # the newest command to move
        self._moving = False

    def sense(self, now_us: int) -> Observation:
        """A position that circles within `CIRCLE_M`, so that no two frames are equal. The body is not
        under way: it does not drive what it is told."""
        angle = now_us * 1e-6 + self.slot
        x, y = CIRCLE_M * cos(angle), CIRCLE_M * sin(angle)
        x_m, y_m, course_rad = self.x_m + x, self.y_m + y, 0.0
        seen = (
            x_m,
            y_m,
            course_rad,
            -y,
            x,
            (),
            1.0,
            (),
            -1,
            NOTHING_SEEN,
            now_us,
            1.0,
            0.0,
            0.0,
            None,
            False,
        )
        return _tuple(Observation, seen)

    def drive(self, command: Drive, now_us: int) -> None:
        if self._moving:
            end_at_us = self._moving_at_us + ACTUATOR_TTL_US
            self.parade.moved(self.slot, now_us if now_us < end_at_us else end_at_us)
        self._moving = command.vx_m_s != 0.0 or command.vy_m_s != 0.0 or command.turn_rad_s != 0.0
        if self._moving:
            self._moving_at_us = now_us
        self._tool_on = command.tool_on

    @property
    def tool_on(self) -> bool:
        return self._tool_on

    @property
    def position(self) -> tuple[float, float]:
        """Metres east and north of the place that it circles."""
        return self.x_m, self.y_m

    def slip(self, slip: float | None) -> None:
        """It has no wheels."""

    def push(self, dx_m: float, dy_m: float) -> None:
        """Fault: a person moves the robot."""
        self.x_m, self.y_m = self.x_m + dx_m, self.y_m + dy_m


class ProtocolWorld(World):
    """Every body, the units worked, and which robot worked where and when. No physics is
    computed."""

    def __init__(self, robots: int, sections: int) -> None:
        super().__init__([])
        self._checkers: list[CommandChecker] = []
        self.stands = {slot: StationaryBody(self, slot) for slot in range(robots)}
        self.robots.update(self.stands)
        self.units = dict.fromkeys(range(sections), UNITS)
        self.worked: set[tuple[int, int]] = set()
        self.together: list[Violation] = []  # S7
        # Whether these two robots in a section are a violation at present.
        self.counts: Callable[[int, int], bool] = lambda one, other: True
        self._at_work: dict[int, tuple[int, int]] = {}  # section -> robot and when it last worked

    def advance(self, now_us: int) -> None:
        self.now_us = max(self.now_us, now_us)

    def add_box(
        self, x_m: float, y_m: float, side_m: float, depth_m: float | None = None,
        heading_rad: float = 0.0,
    ) -> int:  # fmt: skip
        """Has no effect, because robots meet nothing here."""
        return 0

    def add_disc(self, x_m: float, y_m: float, radius_m: float) -> int:
        """Has no effect, as `add_box`."""
        return 0

    def remove_box(self, number: int) -> None: ...

    def checker(self) -> CommandChecker:
        """A new checker, which receives every command."""
        self._checkers.append(CommandChecker())
        return self._checkers[-1]

    def moved(self, slot: int, end_at_us: int) -> None:
        """Tell the checkers that a robot has a command to move that is in force until `end_at_us`."""
        for checker in self._checkers:
            checker.moved(slot, end_at_us)

    def works(self, slot: int, section: int, now_us: int) -> None:
        """A robot has its implement down in a section."""
        other, last_at_us = self._at_work.get(section, (slot, 0))
        both = other != slot and now_us - last_at_us < BOTH_US
        if both and len(self.together) < VIOLATIONS_MAX and self.counts(slot, other):
            what = f"section {section} worked by both"
            self.together.append(Violation("S7", now_us, (other, slot), what))
        self._at_work[section] = (slot, now_us)

    @property
    def share(self) -> float:
        """The share of all units that were really worked."""
        return len(self.worked) / (UNITS * len(self.units))


class TimedMission(Mission):
    """The mission: the next free section from its own start, unit after unit by the clock.

    `crowded`: all robots search from the first section on, so every claim is contested. `unit_for_us`:
    how long a unit takes.
    """

    def __init__(
        self, parade: ProtocolWorld, slot: int, crowded: bool = False, unit_for_us: int = UNIT_US
    ) -> None:
        self.parade, self.slot, self._unit_for_us = parade, slot, unit_for_us
        sections = len(parade.units)
        first = 0 if crowded else slot * sections // len(parade.stands)
        self._order = [(first + k) % sections for k in range(sections)]
        self._section: int | None = None
        self._worked: set[int] = set()  # units worked of this section, since it was started
        self._unit_ends_at_us = 0  # when the present unit will be done
        self._lifted = True

    @property
    def section_units(self) -> Mapping[int, int]:
        """Units of each section, as the world has them."""
        return self.parade.units

    def choose(self, view: FleetView) -> ClaimRequest | None:
        """The next free section from its own start on; else one that a robot holds that has been
        silent for a lease."""
        for section in self._order:
            if view.allocation.phase_of(section) is Phase.FREE:
                return ClaimRequest(section, 3)
        for slot, silent_at_us in sorted(view.fell_silent_at_us.items()):
            if view.now_us - silent_at_us >= LEASE_US:
                for section in sorted(view.allocation.assigned_sections(slot)):
                    return ClaimRequest(section, 3, takeover=True)
        return None

    def begin(self, section: int, view: FleetView) -> None:
        """Start a section with the implement up."""
        self._section, self._lifted = section, True
        self._worked.clear()

    def abandon(self) -> None:
        """Forget the section."""
        self._section = None

    def on_implement_raised(self) -> None:
        self._lifted = True

    def work(self, view: FleetView) -> MotionRequest:
        """Work unit after unit by the clock, each for as long as the implement is down."""
        if self._section is None:  # continues after a stop or a sync
            self.begin(view.allocation.assigned_sections(view.slot)[0], view)
        section, now_us = self._section, view.now_us
        assert section is not None
        down = self.parade.stands[self.slot].tool_on  # what the body did in the period that ends
        if self._lifted:
            self._lifted, self._unit_ends_at_us = False, now_us + self._unit_for_us
        elif down:
            self.parade.works(self.slot, section, now_us)
        if now_us < self._unit_ends_at_us or not down:
            return WORKING
        return self._next(section, view)

    def _next(self, section: int, view: FleetView) -> MotionRequest:
        covered: tuple[int, ...] = ()
        left = [u for u in range(UNITS)
                if u not in self._worked and not view.progress.has(section, u)]  # fmt: skip
        if left:
            covered = (left.pop(0),)
            self._worked.update(covered)
            self.parade.worked.add((section, covered[0]))
        self._unit_ends_at_us = view.now_us + self._unit_for_us
        if not left:
            self._section = None
        return WORKING._replace(covered=covered, finished=not left, near_end=len(left) <= 2)


WORKING = MotionRequest(SPEED_M_S, 0.0, 0.0, True)


class PassThroughMotion(MotionController):
    """Motion without obstacles: no robot is in the way of another."""

    def __init__(self) -> None:
        self._wish: MotionRequest = STILL
        self._drive: Drive = HALT

    def drive(
        self,
        here: Observation,
        wish: MotionRequest,
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> Drive:
        if wish is not self._wish:
            self._wish = wish
            self._drive = Drive(wish.vx_m_s, wish.vy_m_s, wish.turn_rad_s, wish.tool_on)
        return self._drive
