"""The ground truth: robots, fences and obstacles, moved in fixed steps.

Only a robot's own `sense` and `drive` access it, and the checkers, which see everything. Time is
lazy: the first call for an instant advances the world to it. The same steps are made whatever the
order and number of calls, so a run has one history.

Each step: obstacles come and go, the wheels answer the commands in force
(`sim.world.drive_trains`), bodies move, and touches are judged from the new positions
(`sim.world.contacts`). pymunk moves the bodies (`sim.world.pymunk_engine`). A world of the engine
`contact_free` calls it only if something is near; otherwise `sim.world.contact_free_steps` moves
them, with the same result.
"""

from collections.abc import Callable, Mapping, Sequence
from hashlib import blake2b
from heapq import heappop, heappush
from math import cos, inf, sin
from struct import Struct
from typing import Final, Protocol

import numpy as np
import pymunk
from numpy.typing import NDArray

from agent.interface.geometry import Point
from sim.world.contact_free_steps import (
    CODES,
    GUARDED,
    NEAR,
    NEAR_M,
    SWITCHED,
    TRACK_US,
    glide,
    guarded,
)
from sim.world.contacts import (
    FENCE,
    NEAREST_ROBOT,
    OBSTACLE,
    THING,
    TOUCHES_MAX,
    crossings,
    has_crossed,
    watch,
)
from sim.world.drive_trains import COLUMNS, STEP_S, STEP_US, TOOL, Chassis, roll, row_of
from sim.world.ground_truth import Contact
from sim.world.lidar import RANGE, Lidar, scan, scan_all
from sim.world.pymunk_engine import Physics
from sim.world.robot_body import SimulatedBody
from sim.world.step_engine import Engine
from sim.world.walls import (
    BOX,
    DISC,
    FREE,
    OBSTACLE_COLUMNS,
    OBSTACLES_MAX,
    SHAPE,
    Grid,
    Walls,
    ring_edges,
)

__all__ = ["STEP_US", "SimulatedBody", "World"]

# A run with more has failed long before; the rest is not kept.
CONTACTS_MAX: Final = 10_000
APART_US: Final = 200_000  # a contact is over after this long without overlap
# The engine makes this many steps after something was near or was placed. That is longer than it
# remembers touches (3 steps, `cpSpaceSetCollisionPersistence`).
ENGINE_STEPS: Final = 8


class Guard(Protocol):
    """A checker of robots that must not move."""

    def limits(self) -> Mapping[int, tuple[float, float]]:
        """slot -> times after which no command to move may be in force, and no body may move, in
        us."""
        ...

    def look(self, world: "World") -> None:
        """Called after a step in which a robot broke a limit of a guard."""
        ...


class World:
    """Robots, fences and obstacles, moved in steps of fixed length; what is sensed and judged comes
    from here."""

    def __init__(
        self,
        rings: Sequence[Sequence[Point]],
        seed: int | str = 0,
        lidar: Lidar | None = None,
        grid: Grid | None = None,
        engine: Engine = "pymunk",
    ) -> None:
        """`rings`: closed outlines that no robot passes, fences and holes alike, metres."""
        self.now_us = 0
        self.lidar = lidar
        self.robots: dict[int, SimulatedBody] = {}
        self.contacts: list[Contact] = []
        self.guards: list[Guard] = []  # call `guard` when their limits change
        self.engine: Engine = engine
        self.pymunk_steps = 0  # steps of `STEP_US` made by pymunk
        # See sim.world.drive_trains; one row a robot, in order of adding.
        self.rows = np.empty((0, COLUMNS))
        self.motion = np.empty((0, 7))
        # Byte views of both arrays, to read or write one row.
        self.commands = self.places = memoryview(b"")
        # The last step at whose end each robot moved.
        self.moved_at_us = np.empty(0, dtype=np.int64)
        self._seed = seed
        self._keys = np.empty(0, dtype=np.uint64)
        self._side = np.empty(0, dtype=np.int8)  # of the fences, where each robot was placed
        self._push = np.empty((0, 3))
        self._limits = np.empty((0, 2))  # see sim.world.contact_free_steps
        self._engine_steps = 0  # steps that must be made by the engine
        self._put = True  # bodies were placed elsewhere than where the engine has them
        self._fences = Walls(ring_edges(rings), grid)
        self._grid = grid
        edges = [*ring_edges(rings), *(grid.edges() if grid is not None else ())]
        self._solid = Walls(edges) if grid is not None else self._fences
        self._beams = (lidar or Lidar()).beams()
        self._seen = self._beams.data.cast("B")
        self._echoes = Struct(f"{(lidar or Lidar()).rays}f").unpack_from
        self._nearest = np.array([inf, inf])
        self._touches = np.empty((TOUCHES_MAX, 3))
        self._touching: dict[tuple[int, int], Contact] = {}
        self._obstacles = np.zeros((OBSTACLES_MAX, OBSTACLE_COLUMNS))
        self._standing = self._obstacles[:0]  # rows up to the last one in use
        self._shapes: dict[int, tuple[int, pymunk.Shape]] = {}  # number: row, shape
        # Boxes, people and vehicles from each of these times on, microseconds, where they changed.
        self.things: list[tuple[int, list[list[float]]]] = []
        self._stirred = False  # things came, went or moved since the last track point
        self._numbers = 0
        self._due: list[tuple[int, int, Callable[[], object]]] = []  # see `at`
        self._asked = 0
        self._outside: set[int] = set()
        self._physics = Physics()
        for a, b in edges:
            self._physics.add_wall(a, b)

    def body(self, slot: int) -> SimulatedBody:
        """The body of a robot that was added."""
        return self.robots[slot]

    @property
    def closest_m(self) -> float:
        """The smallest gap between two robots so far."""
        return float(self._nearest[NEAREST_ROBOT])

    def add_robot(
        self, slot: int, at: Point, radius_m: float, chassis: Chassis, heading_rad: float = 0.0
    ) -> SimulatedBody:
        """Put a robot at `at`, metres east and north, at rest. Its slot may not be in the world
        yet."""
        assert slot not in self.robots
        robot = self.robots[slot] = SimulatedBody(self, slot, len(self.robots), radius_m, chassis)
        key = blake2b(f"{self._seed}/wheels/{slot}".encode(), digest_size=8).digest()
        self._keys = np.append(self._keys, np.frombuffer(key, dtype=np.uint64))
        self.rows = np.vstack((self.rows, row_of(chassis)))
        self.motion = np.vstack((self.motion, (*at, heading_rad, 0.0, 0.0, 0.0, radius_m)))
        self.commands, self.places = self.rows.data.cast("B"), self.motion.data.cast("B")
        self.moved_at_us = np.append(self.moved_at_us, np.int64(-1))
        self._side = np.append(self._side, np.int8(0))
        self._side[-1] = self._sides()[-1]
        self._physics.add_robot(*at, heading_rad, radius_m)
        self._push = np.zeros((len(self.motion), 3))
        self.guard()
        robot.track.add(self.now_us, *at, False)
        return robot

    def place(self, robot: SimulatedBody, x_m: float, y_m: float, heading_rad: float) -> None:
        """Place a robot elsewhere: a fault, not a drive."""
        self.motion[robot.index, :3] = x_m, y_m, heading_rad
        self._put = True

    def resume(self, now_us: int, poses: Mapping[int, tuple[float, float, float]]) -> None:
        """Continue at that instant, with every robot standing at its given pose: metres east and
        north, heading in radians.

        For a world restored by `sim.world.world_memory`; call before the first step.
        """
        self.now_us = now_us - now_us % STEP_US
        for slot, pose in poses.items():
            self.place(self.robots[slot], *pose)
        self._side = self._sides()

    def add_box(
        self, x_m: float, y_m: float, side_m: float, depth_m: float | None = None,
        heading_rad: float = 0.0,
    ) -> int:  # fmt: skip
        """Add a box that no robot passes, from now on; returns the number to remove it by."""
        half_x, half_y = side_m / 2, (side_m if depth_m is None else depth_m) / 2
        c, s = cos(heading_rad), sin(heading_rad)
        corners = [
            (x_m + c * u - s * v, y_m + s * u + c * v)
            for u, v in ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))
        ]
        return self._add((BOX, x_m, y_m, half_x, half_y, c, s), self._physics.add_box(corners))

    def add_disc(self, x_m: float, y_m: float, radius_m: float) -> int:
        """Put a disc into the world; the number that is returned can be removed."""
        row = (DISC, x_m, y_m, radius_m, radius_m, 1.0, 0.0)
        return self._add(row, self._physics.add_disc(x_m, y_m, radius_m))

    def _add(self, row: tuple[float, ...], shape: pymunk.Shape) -> int:
        free = next((k for k in range(OBSTACLES_MAX) if self._obstacles[k, 0] == FREE), None)
        assert free is not None, f"more than {OBSTACLES_MAX} obstacles at once: make them fences"
        self._obstacles[free] = row
        self._stirred = True
        self._numbers += 1
        self._shapes[self._numbers] = (free, shape)
        self._standing = self._obstacles[: max(k for k, _ in self._shapes.values()) + 1]
        return self._numbers

    @property
    def newest_thing(self) -> int:
        """The number of the box or disc that came last; 0 before the first. Numbers grow."""
        return self._numbers

    def remove_box(self, number: int) -> None:
        """Remove a box or a disc; removing one that is already gone is allowed."""
        if number in self._shapes:
            row, shape = self._shapes.pop(number)
            self._obstacles[row] = 0.0
            self._stirred = True
            self._physics.remove(shape)

    def obstacles(self) -> list[list[float]]:
        """What is in the world besides fences and robots, as rows of `sim.world.walls`, metres."""
        rows: list[list[float]] = self._standing.tolist()
        return rows

    def at(self, t_us: int, action: Callable[[], object]) -> None:
        """Call an action at the first step at or after `t_us`; in order of time, then of the
        requests."""
        heappush(self._due, (t_us, self._asked, action))
        self._asked += 1

    def guard(self) -> None:
        """The limits of a guard have changed."""
        self._limits = np.full((len(self.motion), 2), inf)
        for guard in self.guards:
            for slot, limits in guard.limits().items():
                row = self._limits[self.robots[slot].index]
                np.minimum(row, limits, out=row)

    def advance(self, now_us: int) -> None:
        """Step to the last whole step before `now_us`."""
        while self.now_us + STEP_US <= now_us:
            while self._due and self._due[0][0] <= self.now_us:
                heappop(self._due)[2]()
            if self._engine_steps or self._touching or (self.engine == "pymunk" and self.robots):
                self._collide(self._roll())
            else:
                due_at_us = self._due[0][0] + STEP_US - 1 if self._due else now_us
                self._glide(min(now_us, due_at_us), False)

    def _glide(self, end_at_us: int, rolled: bool) -> None:
        """Advance to that time, or until something must be handled."""
        fences = self._solid
        came = glide(
            self.rows, self.motion, self._keys, self._push, self._physics.inertia, fences.floats,
            fences.ints, self._standing, self.moved_at_us, self._nearest, self._limits, self.now_us,
            end_at_us, rolled, NEAR_M,
        )  # fmt: skip
        self.now_us, why = divmod(came, CODES)
        self._put = True
        if why == SWITCHED:
            self._record()
            self._glide(end_at_us, True)
        elif why == NEAR:
            self._engine_steps = ENGINE_STEPS
            self._collide(False)
        else:
            self._end_step(why == GUARDED)

    def _roll(self) -> bool:
        """Turn the wheels for a step that the engine makes."""
        return bool(roll(self.rows, self.motion, self._keys, self.now_us, self._push))

    def _collide(self, switched: bool) -> None:
        """Make the rest of a step in which bodies may touch."""
        if switched:
            self._record()
        if self._put:
            self._physics.put(self.motion)
            self._put = False
        self._physics.step(self.motion, self._push, STEP_S)
        self.pymunk_steps += 1
        self.now_us += STEP_US
        self._engine_steps = max(0, self._engine_steps - 1)
        found, is_near = divmod(
            watch(
                self.motion, self._solid.floats, self._solid.ints, self._standing, self._nearest,
                self._touches, NEAR_M,
            ),
            2,
        )  # fmt: skip
        if is_near:
            self._engine_steps = ENGINE_STEPS
        if found or self._touching:
            self._judge(self._touches[:found].tolist())
        self._end_step(guarded(self.rows, self.motion, self._limits, self.moved_at_us, self.now_us))

    def _end_step(self, is_guarded: bool) -> None:
        if is_guarded:
            for guard in self.guards:
                guard.look(self)
        if self.now_us % TRACK_US == 0:
            self._judge_sides()
            self._record()

    def _record(self) -> None:
        if self._stirred:
            self._stirred = False
            things = [row for row in self.obstacles() if row[SHAPE] != FREE]
            self.things.append((self.now_us, things))
        tools = self.rows[:, TOOL].tolist()
        for robot, place, tool in zip(
            self.robots.values(), self.motion.tolist(), tools, strict=True
        ):
            down = tool != 0.0
            robot.lifts += robot.was_down and not down
            robot.was_down = down
            robot.track.add(self.now_us, place[0], place[1], down)

    def _judge(self, touches: list[list[float]]) -> None:
        """Begin, deepen and end contacts; bodies that rest on each other stay one contact."""
        for first, second, depth_m in touches:
            key = (int(first), int(second))
            contact = self._touching.get(key) or self._begin(*key)
            contact.depth_m = max(contact.depth_m, depth_m)
            contact.last_at_us = self.now_us
            self._touching[key] = contact
        for key, contact in list(self._touching.items()):
            if contact.last_at_us + APART_US < self.now_us:
                del self._touching[key]

    def _begin(self, first: int, second: int) -> Contact:
        slots = list(self.robots)
        if second >= 0:
            against = f"robot {slots[second]}"
        elif second == FENCE:
            against = "fence"
        else:
            row = OBSTACLE - second
            against = next(f"{THING} {n}" for n, (k, _) in self._shapes.items() if k == row)
        x_m, y_m = self.motion[first, :2].tolist()
        other = slots[second] if second >= 0 else None
        return self._note(Contact(self.now_us, slots[first], other, 0.0, against, x_m, y_m))

    def _note(self, contact: Contact) -> Contact:
        if len(self.contacts) < CONTACTS_MAX:
            self.contacts.append(contact)
        return contact

    def _sides(self) -> NDArray[np.int8]:
        """On which side of all fences, and whether in a blocked cell, each robot's centre is."""
        side = np.empty(len(self.motion), dtype=np.int8)
        crossings(self.motion, self._fences.floats, side)
        if self._grid is not None:
            side += [2 * self._grid.is_blocked(x, y) for x, y in self.motion[:, :2].tolist()]
        return side

    def _judge_sides(self) -> None:
        """A robot that got through a fence, or was carried over it, no longer touches it."""
        known = self._grid is None and not self._outside
        if known and not has_crossed(self.motion, self._fences.floats, self._side):
            return
        through = set(np.flatnonzero(self._sides() != self._side).tolist())
        for index in sorted(through - self._outside):
            robot = next(r for r in self.robots.values() if r.index == index)
            x_m, y_m = robot.position
            self._note(Contact(self.now_us, robot.slot, None, robot.radius_m, "outside", x_m, y_m))
        self._outside = through

    def ranges(self, index: int) -> tuple[float, ...]:
        """The present ranges in metres of the robot in that row; empty without sensors."""
        if self.lidar is None:
            return ()
        fences = self._fences
        scan(self.motion, index, fences.floats, fences.ints, fences.blocked, self._standing,
             self.lidar.range_m, self._beams)  # fmt: skip
        ranges_m: tuple[float, ...] = self._echoes(self._seen, RANGE * self._beams.strides[0])
        return ranges_m

    def ranges_of_all(self) -> NDArray[np.float32]:
        """(robots, rays): the ranges of every robot at once, in order of adding."""
        assert self.lidar is not None
        fences, found = self._fences, np.empty((len(self.motion), self.lidar.rays), np.float32)
        scan_all(self.motion, fences.floats, fences.ints, fences.blocked, self._standing,
                 self.lidar.range_m, self._beams, found)  # fmt: skip
        return found
