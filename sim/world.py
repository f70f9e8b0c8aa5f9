"""The ground truth: bodies, fences and boxes in a pymunk space, stepped in fixed steps.

Nobody but a robot's own `sense` and `drive` reaches into it, and the checkers, which see everything.
Time is lazy: whoever asks first brings the world to the instant it asks for; the same steps are made
whoever asks, so a run has one history.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, hypot, inf, sin
from random import Random

import pymunk

from agent.config import ACTUATOR_TTL_US
from agent.effects import HALT, Drive
from agent.ports import Observation
from sim.mecanum import Chassis, Mecanum

STEP_US = 20_000  # five steps of an actuator's life; two robots close in by 0.1 m at most
STEP_S = STEP_US / 1_000_000
TRACK_US = 100_000  # positions are kept this often
WALL_M = 0.02  # half the thickness of a fence
MASS_KG = 120.0
TOUCH_M = 0.001  # an overlap less than this is the solver's tolerance, not a contact

XY = tuple[float, float]


@dataclass(frozen=True)
class Contact:
    t_us: int
    first: int  # slot
    second: int | None  # slot; None: a fence, a hole or a box
    depth_m: float


@dataclass
class Track:
    """Where a robot was, every `TRACK_US`: (time, x, y, implement down)."""

    points: list[tuple[int, float, float, bool]] = field(default_factory=list)
    driven_m: float = 0.0


class RobotBody:
    """One robot's body: the `Body` port of its peer, and what the checkers look at."""

    def __init__(self, world: "World", slot: int, at: XY, radius_m: float, wheels: Mecanum) -> None:
        self.world, self.slot, self.radius_m, self.wheels = world, slot, radius_m, wheels
        self.body = pymunk.Body(MASS_KG, pymunk.moment_for_circle(MASS_KG, 0.0, radius_m))
        self.body.position = at
        self.shape = pymunk.Circle(self.body, radius_m)
        self.shape.elasticity, self.shape.friction = 0.0, 0.3
        self.shape.collision_type = 1
        self.command, self.given_us = HALT, -ACTUATOR_TTL_US
        self.track = Track()
        self.frozen = False  # fault: the actuator hears nothing new

    def sense(self, now_us: int) -> Observation:
        self.world.advance(now_us)
        x_m, y_m = self.body.position
        vx_m_s, vy_m_s = self.body.velocity
        return Observation(x_m, y_m, self.body.angle, vx_m_s, vy_m_s)

    def drive(self, command: Drive, now_us: int) -> None:
        self.world.advance(now_us)
        self.command, self.given_us = command, now_us

    def commanded(self, now_us: int) -> Drive:
        """The command in force: a command that is not renewed expires in the actuator."""
        return self.command if now_us - self.given_us < ACTUATOR_TTL_US else HALT

    def push(self, dx_m: float, dy_m: float) -> None:
        """Fault: somebody moves the robot."""
        x_m, y_m = self.body.position
        self.body.position = (x_m + dx_m, y_m + dy_m)


class World:
    def __init__(self, rings: Sequence[Sequence[XY]], seed: int | str = 0) -> None:
        """`rings`: closed outlines that nobody passes, fences and holes alike, metres."""
        self.now_us = 0
        self.space = pymunk.Space()
        self.space.gravity = (0.0, 0.0)
        self.space.damping = 1.0
        self.space.iterations = 10
        self.robots: dict[int, RobotBody] = {}
        self.contacts: list[Contact] = []
        self.closest_m = inf  # smallest gap between two robots so far
        self._seed = seed
        self._touching: set[tuple[int, int | None]] = set()
        self._fences: list[tuple[float, float, float, float]] = []
        self._boxes: dict[int, list[pymunk.Shape]] = {}
        self._next_box = 0
        for ring in rings:
            for (ax, ay), (bx, by) in zip(ring, [*ring[1:], ring[0]], strict=True):
                wall = pymunk.Segment(self.space.static_body, (ax, ay), (bx, by), WALL_M)
                wall.friction = 0.3
                self.space.add(wall)

    def add_robot(self, slot: int, at: XY, radius_m: float, chassis: Chassis) -> RobotBody:
        wheels = Mecanum(chassis, Random(f"{self._seed}/wheels/{slot}"))
        robot = self.robots[slot] = RobotBody(self, slot, at, radius_m, wheels)
        self.space.add(robot.body, robot.shape)
        return robot

    def body(self, slot: int) -> RobotBody:
        return self.robots[slot]

    def add_box(self, x_m: float, y_m: float, side_m: float) -> int:
        half = side_m / 2
        corners = [(x_m - half, y_m - half), (x_m + half, y_m - half),
                   (x_m + half, y_m + half), (x_m - half, y_m + half)]  # fmt: skip
        box = pymunk.Poly(self.space.static_body, corners)
        self.space.add(box)
        self._next_box += 1
        self._boxes[self._next_box] = [box]
        return self._next_box

    def remove_box(self, number: int) -> None:
        for shape in self._boxes.pop(number, []):
            self.space.remove(shape)

    def advance(self, now_us: int) -> None:
        """Step to the last whole step before `now_us`."""
        while self.now_us + STEP_US <= now_us:
            self._step()

    def _step(self) -> None:
        for robot in self.robots.values():
            command = robot.commanded(self.now_us)
            body = robot.body
            vx_m_s, vy_m_s, turn_rad_s = robot.wheels.step(
                body.angle, command.vx_m_s, command.vy_m_s, command.turn_rad_s, STEP_S
            )
            body.velocity = (vx_m_s, vy_m_s)
            body.angular_velocity = turn_rad_s
        self.space.step(STEP_S)
        self.now_us += STEP_US
        self._watch()
        if self.now_us % TRACK_US == 0:
            self._record()

    def _watch(self) -> None:
        """Contacts from true positions, robot against robot, and from shapes against fences."""
        robots = list(self.robots.values())
        touching: set[tuple[int, int | None]] = set()
        for i, a in enumerate(robots):
            ax, ay = a.body.position
            for b in robots[i + 1 :]:
                bx, by = b.body.position
                dx, dy = ax - bx, ay - by
                if dx * dx + dy * dy > 25.0 and self.closest_m < 3.0:
                    continue
                gap_m = hypot(dx, dy) - a.radius_m - b.radius_m
                self.closest_m = min(self.closest_m, gap_m)
                if gap_m < -TOUCH_M:
                    touching.add((a.slot, b.slot))
                    if (a.slot, b.slot) not in self._touching:
                        self.contacts.append(Contact(self.now_us, a.slot, b.slot, -gap_m))
        if self.now_us % TRACK_US == 0:
            for robot in robots:
                self._watch_fences(robot, touching)
        else:
            touching |= {pair for pair in self._touching if pair[1] is None}
        self._touching = touching

    def _watch_fences(self, robot: RobotBody, touching: set[tuple[int, int | None]]) -> None:
        near = self.space.point_query_nearest(
            robot.body.position, robot.radius_m, pymunk.ShapeFilter(mask=pymunk.ShapeFilter.ALL_MASKS())
        )
        if near is None or near.shape is robot.shape or near.shape.body is not self.space.static_body:
            hits = self.space.point_query(robot.body.position, robot.radius_m, pymunk.ShapeFilter())
            depths = [robot.radius_m - h.distance for h in hits if h.shape.body is self.space.static_body]
        else:
            depths = [robot.radius_m - near.distance]
        for depth_m in depths:
            if depth_m > TOUCH_M:
                touching.add((robot.slot, None))
                if (robot.slot, None) not in self._touching:
                    self.contacts.append(Contact(self.now_us, robot.slot, None, depth_m))

    def _record(self) -> None:
        for robot in self.robots.values():
            x_m, y_m = robot.body.position
            points = robot.track.points
            if points:
                robot.track.driven_m += hypot(x_m - points[-1][1], y_m - points[-1][2])
            points.append((self.now_us, x_m, y_m, robot.commanded(self.now_us).tool_on))

    def heading_of(self, slot: int) -> XY:
        angle = self.robots[slot].body.angle
        return cos(angle), sin(angle)
