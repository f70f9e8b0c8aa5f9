"""One robot's body: the `Body` port of its peer, hooks for faults, and values for checkers."""

from math import hypot, isfinite, pi, remainder
from typing import Any, Protocol

from numpy.typing import NDArray

from agent.interface.config import ACTUATOR_TTL_US
from agent.interface.effects import HALT, Drive
from agent.interface.geometry import Point
from agent.interface.observation import NOTHING_SEEN, Observation
from sim.world.drive_trains import (
    COLUMNS,
    COMMAND,
    COMMANDED_US,
    EXPIRES_US,
    HEADING,
    JAMMED,
    MOTION,
    SLIP,
    TOOL,
    VX,
    VY,
    WANT_TOOL,
    WANT_TURN,
    WANT_X,
    WANT_Y,
    Chassis,
)
from sim.world.ground_truth import Track

# A push within 2.5 degrees of the course is along it: a bar of 4 m then moves 9 cm along itself on 2 m.
ALONG_COS = 0.999
OBSERVATION = tuple.__new__


class BodyRows(Protocol):
    """The world that holds a body as one row of each array; metres, radians, seconds."""

    motion: NDArray[Any]
    rows: NDArray[Any]
    moved_at_us: NDArray[Any]
    places: Any  # the bytes of `motion`
    commands: Any  # the bytes of `rows`
    now_us: int

    def advance(self, now_us: int) -> None:
        """Make steps until `now_us`."""

    def ranges(self, index: int) -> tuple[float, ...]:
        """Metres that each ray of the robot in that row sees."""

    def place(self, body: "SimulatedBody", x_m: float, y_m: float, heading_rad: float) -> None:
        """Put a body somewhere else, at rest."""


class SimulatedBody:
    """The body of one robot: it senses from, and commands, its row of the world's arrays."""

    def __init__(
        self, world: BodyRows, slot: int, index: int, radius_m: float, chassis: Chassis
    ) -> None:
        self.world, self.slot, self.index = world, slot, index  # index: row in the world's arrays
        self.radius_m, self.chassis = radius_m, chassis
        self.track = Track()
        self.frozen = False  # fault: the actuator gets no new commands
        self.was_down = False  # the implement, when its track was last recorded
        self.lifts = 0  # how often the implement has gone up
        self._lifts_told = 0  # how often when it was last sensed

    @property
    def position(self) -> Point:
        """Metres east and north, at the world's present step."""
        x_m, y_m = self.world.motion[self.index, :2].tolist()
        return x_m, y_m

    @property
    def heading_rad(self) -> float:
        """Counter-clockwise from east, between -pi and pi."""
        return remainder(float(self.world.motion[self.index, HEADING]), 2 * pi)

    @property
    def tool_on(self) -> bool:
        """Whether the implement was down in the last step."""
        return bool(self.world.rows[self.index, TOOL])

    @property
    def speed_m_s(self) -> float:
        """The real speed of the body, whatever the wheels were commanded."""
        if self.index >= len(self.world.motion):  # no step has been made yet
            return 0.0
        vx_m_s, vy_m_s = self.world.motion[self.index, VX : VY + 1].tolist()
        return hypot(vx_m_s, vy_m_s)

    @property
    def commanded_at_us(self) -> int:
        """Beginning of the last step in which a command to move was in force; -1: never."""
        return int(self.world.rows[self.index, COMMANDED_US])

    @property
    def moved_at_us(self) -> int:
        """End of the last step after which the body moved; -1: never."""
        return int(self.world.moved_at_us[self.index])

    def sense(self, now_us: int) -> Observation:
        """Advance the world to `now_us`, and return what the sensors of this body see there.

        An implement that was up for a moment since the last call is said to be up."""
        world = self.world
        world.advance(now_us)
        moved = MOTION.unpack_from(world.places, self.index * MOTION.size)
        x_m, y_m, heading, vx_m_s, vy_m_s, _, _ = moved
        ranges_m = world.ranges(self.index)
        down = self.tool_on and self.lifts == self._lifts_told
        self._lifts_told = self.lifts
        return OBSERVATION(Observation, (
            x_m, y_m, remainder(heading, 2 * pi), vx_m_s, vy_m_s, ranges_m, 1.0, (), -1,
            NOTHING_SEEN, now_us, 1.0, 0.0, 0.0, down, True,
        ))  # fmt: skip

    def drive(self, command: Drive, now_us: int) -> None:
        """The command is in force from the step that contains `now_us`, until it expires."""
        assert isfinite(command.vx_m_s + command.vy_m_s + command.turn_rad_s), command
        self.world.advance(now_us)
        if self.frozen:
            return
        vx_m_s, vy_m_s, turn_rad_s, tool_on, _ = command
        COMMAND(
            self.world.commands, self.index * 8 * COLUMNS, vx_m_s, vy_m_s, turn_rad_s, tool_on,
            now_us + ACTUATOR_TTL_US,
        )  # fmt: skip

    def commanded(self, now_us: int) -> Drive:
        """The command in force; a command that is not renewed expires in the actuator."""
        row = self.world.rows[self.index]
        if now_us >= row[EXPIRES_US]:
            return HALT
        vx_m_s, vy_m_s, turn_rad_s = row[[WANT_X, WANT_Y, WANT_TURN]].tolist()
        return Drive(vx_m_s, vy_m_s, turn_rad_s, bool(row[WANT_TOOL]))

    def slip(self, slip: float | None) -> None:
        """Fault: the grip of each wheel has this standard deviation; None: that of the chassis."""
        self.world.rows[self.index, SLIP] = self.chassis.slip if slip is None else slip

    def jam(self, jammed: bool) -> None:
        """Fault: an implement that is down, or is lowered meanwhile, stays down."""
        self.world.rows[self.index, JAMMED] = float(jammed)

    def push(self, dx_m: float, dy_m: float) -> None:
        """Fault: a person moves the robot on its wheels.

        A lowered implement works the ground on a push along the course of the robot. On a push aside
        the bar moves along itself, and works nothing.
        """
        x_m, y_m = self.position
        vx_m_s, vy_m_s = self.world.motion[self.index, 3:5].tolist()
        forward = vx_m_s * dx_m + vy_m_s * dy_m
        along = forward > 0.0 and forward >= ALONG_COS * hypot(vx_m_s, vy_m_s) * hypot(dx_m, dy_m)
        self._move(x_m + dx_m, y_m + dy_m, self.heading_rad, carried=not along)

    def teleport(self, x_m: float, y_m: float, heading_rad: float | None = None) -> None:
        """Fault: a person carries the robot there."""
        self._move(x_m, y_m, self.heading_rad if heading_rad is None else heading_rad, carried=True)

    def _move(self, x_m: float, y_m: float, heading_rad: float, carried: bool) -> None:
        world, tool_on = self.world, self.tool_on
        self.track.add(world.now_us, *self.position, tool_on)
        world.place(self, x_m, y_m, heading_rad)
        self.track.add(world.now_us, x_m, y_m, tool_on, carried=carried)
