"""The ground truth: bodies, fences and obstacles in a pymunk space, stepped in fixed steps.

Nobody but a robot's own `sense` and `drive` reaches into it, and the checkers, which see everything.
Time is lazy: whoever asks first brings the world to the instant it asks for. The same steps are made
whoever asks and however often, so a run has one history.

Each step: the wheels answer the commands in force (`sim.vehicle`), pymunk moves the bodies and
resolves what collides, and touches are judged from the new positions (`sim.proximity`).
"""

from collections.abc import Callable, Sequence
from hashlib import blake2b
from math import cos, inf, pi, remainder, sin

import numpy as np
import pymunk
import pymunk.batch as batch

from agent.config import ACTUATOR_TTL_US
from agent.effects import HALT, Drive
from agent.ports import Observation
from sim.lidar import Lidar, scan
from sim.proximity import FENCE, NEAREST_ROBOT, NEAREST_WALL, OBSTACLE, TOUCHES_MAX, crossings, watch
from sim.truth import Contact, Track
from sim.vehicle import (
    COLUMNS, EXPIRES_US, GIVEN_US, HEADING, STEP_S, STEP_US, TOOL, VX, VY, WANT_TOOL, WANT_TURN,
    WANT_X, WANT_Y, X, Y, Chassis, roll, row_of,
)  # fmt: skip
from sim.walls import BOX, DISC, FREE, OBSTACLE_COLUMNS, OBSTACLES_MAX, XY, Grid, Walls, ring_edges

TRACK_US = 100_000  # positions are kept this often
MASS_KG = 120.0
SLOP_M = 0.001  # how deep pymunk lets bodies rest in each other; any overlap counts as a contact
_MOTION = (
    batch.BodyFields.POSITION | batch.BodyFields.ANGLE
    | batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY
)  # fmt: skip


class RobotBody:
    """One robot's body: the `Body` port of its peer, and what the checkers look at."""

    def __init__(self, world: "World", slot: int, index: int, radius_m: float, chassis: Chassis) -> None:
        self.world, self.slot, self.index = world, slot, index
        self.radius_m, self.chassis = radius_m, chassis
        self.track = Track()
        self.frozen = False  # fault: the actuator hears nothing new
        self.started_inside = True
        self._ranges = np.empty(world.lidar.rays if world.lidar is not None else 0)

    @property
    def position(self) -> XY:
        x_m, y_m = self.world.motion[self.index, :2].tolist()
        return x_m, y_m

    @property
    def heading_rad(self) -> float:
        return remainder(float(self.world.motion[self.index, HEADING]), 2 * pi)

    @property
    def tool_on(self) -> bool:
        return bool(self.world.rows[self.index, TOOL])

    def sense(self, now_us: int) -> Observation:
        world = self.world
        world.advance(now_us)
        x_m, y_m, heading, vx_m_s, vy_m_s, _, _ = world.motion[self.index].tolist()
        ranges_m: tuple[float, ...] = ()
        if world.lidar is not None:
            world.scan(self.index, self._ranges)
            ranges_m = tuple(self._ranges.tolist())
        return Observation(x_m, y_m, remainder(heading, 2 * pi), vx_m_s, vy_m_s, ranges_m)

    def drive(self, command: Drive, now_us: int) -> None:
        """In force from the step that `now_us` falls in, until it expires."""
        self.world.advance(now_us)
        if self.frozen:
            return
        row = self.world.rows[self.index]
        row[WANT_X], row[WANT_Y], row[WANT_TURN] = command.vx_m_s, command.vy_m_s, command.turn_rad_s
        row[WANT_TOOL] = command.tool_on
        row[GIVEN_US], row[EXPIRES_US] = now_us, now_us + ACTUATOR_TTL_US

    def commanded(self, now_us: int) -> Drive:
        """The command in force: one that is not renewed expires in the actuator."""
        row = self.world.rows[self.index]
        if now_us >= row[EXPIRES_US]:
            return HALT
        vx_m_s, vy_m_s, turn_rad_s = row[[WANT_X, WANT_Y, WANT_TURN]].tolist()
        return Drive(vx_m_s, vy_m_s, turn_rad_s, bool(row[WANT_TOOL]))

    def push(self, dx_m: float, dy_m: float) -> None:
        """Fault: somebody moves the robot."""
        x_m, y_m = self.position
        self.teleport(x_m + dx_m, y_m + dy_m)

    def teleport(self, x_m: float, y_m: float, heading_rad: float | None = None) -> None:
        """Fault: somebody carries the robot there."""
        world, tool_on = self.world, self.tool_on
        self.track.add(world.now_us, *self.position, tool_on)
        world.motion[self.index, :2] = x_m, y_m
        if heading_rad is not None:
            world.motion[self.index, HEADING] = heading_rad
        self.track.add(world.now_us, x_m, y_m, tool_on, carried=True)


class World:
    def __init__(
        self,
        rings: Sequence[Sequence[XY]],
        seed: int | str = 0,
        lidar: Lidar | None = None,
        grid: Grid | None = None,
    ) -> None:
        """`rings`: closed outlines that nobody passes, fences and holes alike, metres."""
        self.now_us = 0
        self.lidar = lidar
        self.robots: dict[int, RobotBody] = {}
        self.contacts: list[Contact] = []
        self.on_step: list[Callable[[World], None]] = []  # checkers that must see every step
        self.rows = np.empty((0, COLUMNS))  # see sim.vehicle; one row a robot, in order of adding
        self.motion = np.empty((0, 7))
        self.moved_us = np.empty(0, dtype=np.int64)  # the last step at whose end each robot moved
        self._seed = seed
        self._keys = np.empty(0, dtype=np.uint64)
        self._fences = Walls(ring_edges(rings), grid)
        edges = [*ring_edges(rings), *(grid.edges() if grid is not None else ())]
        self._solid = Walls(edges) if grid is not None else self._fences
        self._grid = grid
        self._rays = lidar.table() if lidar is not None else np.empty((1, 2))
        self._nearest = np.array([inf, inf])
        self._touches = np.empty((TOUCHES_MAX, 3))
        self._touching: dict[tuple[int, int], Contact] = {}
        self._obstacles = np.zeros((OBSTACLES_MAX, OBSTACLE_COLUMNS))
        self._standing = self._obstacles[:0]  # up to the last row in use
        self._shapes: dict[int, tuple[int, pymunk.Shape]] = {}  # number of the obstacle: row, shape
        self._numbers = 0
        self._space = pymunk.Space()
        self._space.collision_slop = SLOP_M
        self._got, self._put = batch.Buffer(), batch.Buffer()
        self._bodies = np.empty((0, 6))
        self._order = np.empty(0, dtype=np.intp)  # row of `_bodies` of each robot
        for a, b in edges:
            wall = pymunk.Segment(self._space.static_body, a, b, 0.0)
            wall.friction = 0.3
            self._space.add(wall)

    @property
    def closest_m(self) -> float:
        """The smallest gap between two robots so far."""
        return float(self._nearest[NEAREST_ROBOT])

    @property
    def closest_wall_m(self) -> float:
        """The smallest gap from a robot to anything else so far; inf where none came within 0.5 m."""
        return float(self._nearest[NEAREST_WALL])

    def add_robot(
        self, slot: int, at: XY, radius_m: float, chassis: Chassis, heading_rad: float = 0.0
    ) -> RobotBody:
        assert slot not in self.robots
        robot = self.robots[slot] = RobotBody(self, slot, len(self.robots), radius_m, chassis)
        key = blake2b(f"{self._seed}/wheels/{slot}".encode(), digest_size=8).digest()
        self._keys = np.append(self._keys, np.frombuffer(key, dtype=np.uint64))
        self.rows = np.vstack((self.rows, row_of(chassis)))
        self.motion = np.vstack((self.motion, (*at, heading_rad, 0.0, 0.0, 0.0, radius_m)))
        self.moved_us = np.append(self.moved_us, np.int64(-1))
        body = pymunk.Body(MASS_KG, pymunk.moment_for_circle(MASS_KG, 0.0, radius_m))
        shape = pymunk.Circle(body, radius_m)
        shape.friction = 0.3
        self._space.add(body, shape)
        self._list_bodies()
        robot.started_inside = bool(self._inside()[robot.index])
        robot.track.add(self.now_us, *at, False)
        return robot

    def _list_bodies(self) -> None:
        """In which order pymunk lists bodies; the static one is among them."""
        buffer = batch.Buffer()
        batch.get_space_bodies(self._space, batch.BodyFields.BODY_ID, buffer)
        listed = np.frombuffer(buffer.int_buf(), dtype=np.uintp).tolist()
        ids = sorted((body for body in self._space.bodies), key=lambda body: int(body.id))
        del ids
        self._bodies = np.zeros((len(listed), 6))
        self._put.set_float_buf(self._bodies)
        order = {number: row for row, number in enumerate(listed)}
        self._order = np.array([order[n] for n in self._ids()], dtype=np.intp)

    def body(self, slot: int) -> RobotBody:
        return self.robots[slot]
