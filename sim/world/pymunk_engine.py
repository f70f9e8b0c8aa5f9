"""pymunk, with all bodies read and written at once: wheels push, bodies move, collisions resolve.

Wheels act as forces, never as velocities. pymunk moves bodies before it resolves collisions, so a
velocity written before a step would carry a body into the wall.
"""

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk import batch

from agent.interface.geometry import Point

Floats = NDArray[np.float64]

MASS_KG = 120.0
SLOP_M = 0.001  # how deep bodies may rest in each other; any overlap at all counts as a contact
FRICTION = 0.3
_GOT = (
    batch.BodyFields.POSITION | batch.BodyFields.ANGLE
    | batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY
)  # fmt: skip
_PUT = batch.BodyFields.FORCE | batch.BodyFields.TORQUE


class Physics:
    """Robots are discs, numbered from 0 in order of adding; everything else stands still."""

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self.space.collision_slop = SLOP_M
        self._robots: list[pymunk.Body] = []
        self.inertia = np.zeros((0, 3))  # a row a robot: kg, kg, kg m2
        self._got, self._put = batch.Buffer(), batch.Buffer()
        self._forces = np.zeros((0, 3))
        self._order: slice | NDArray[np.intp] = slice(0)  # the rows of the robots
        self._pushed: Floats | None = None  # those rows of `_forces`, where they are in one piece
        self._stale = True  # bodies were added since the rows were laid out

    def add_robot(self, x_m: float, y_m: float, heading_rad: float, radius_m: float) -> None:
        """Add a disc with the mass of a robot. It gets the next number from 0."""
        moment = pymunk.moment_for_circle(MASS_KG, 0.0, radius_m)
        body = pymunk.Body(MASS_KG, moment)
        body.position, body.angle = (x_m, y_m), heading_rad
        self._robots.append(body)
        self.inertia = np.vstack((self.inertia, (MASS_KG, MASS_KG, moment)))
        self._add(pymunk.Circle(body, radius_m), body)

    def add_wall(self, a: Point, b: Point) -> pymunk.Shape:
        """A wall without thickness from `a` to `b`, metres; the shape that is returned can be
        removed."""
        return self._add(pymunk.Segment(self.space.static_body, a, b, 0.0))

    def add_box(self, corners: list[Point]) -> pymunk.Shape:
        """A box that stands still, by its corners in metres."""
        return self._add(pymunk.Poly(self.space.static_body, corners))

    def add_disc(self, x_m: float, y_m: float, radius_m: float) -> pymunk.Shape:
        """A disc that stands still."""
        return self._add(pymunk.Circle(self.space.static_body, radius_m, (x_m, y_m)))

    def _add(self, shape: pymunk.Shape, *bodies: pymunk.Body) -> pymunk.Shape:
        shape.friction = FRICTION
        self.space.add(*bodies, shape)
        self._stale = True
        return shape

    def remove(self, shape: pymunk.Shape) -> None:
        """Take away a wall, a box or a disc."""
        self.space.remove(shape)

    def put(self, motion: Floats) -> None:
        """Set all bodies to `motion`, (robots, at least 6), see `step`: they were moved without the
        engine."""
        for body, (x_m, y_m, angle, vx, vy, turn) in zip(
            self._robots, motion[:, :6].tolist(), strict=True
        ):
            body.position, body.angle = (x_m, y_m), angle
            body.velocity, body.angular_velocity = (vx, vy), turn

    def _lay_out(self) -> None:
        """pymunk lists the static body among the others: find each robot's row by its number."""
        buffer = batch.Buffer()
        batch.get_space_bodies(self.space, batch.BodyFields.BODY_ID, buffer)
        listed = np.frombuffer(buffer.int_buf(), dtype=np.uintp).tolist()
        row_of = {number: row for row, number in enumerate(listed)}
        rows = [row_of[body.id] for body in self._robots]
        in_front = rows == list(range(len(rows)))  # and then no copy is needed
        self._order = slice(len(rows)) if in_front else np.array(rows)
        self._forces = np.zeros((len(listed), 3))
        self._put.set_float_buf(self._forces)
        self._pushed = self._forces[: len(rows)] if in_front else None
        self._stale = False

    def step(self, motion: Floats, push: Floats, dt_s: float) -> None:
        """One step under accelerations `push` (robots, 3): x, y in m/s2, turn in rad/s2.

        `motion` (robots, at least 6) is written: x, y, heading, velocity x and y, turn rate.
        """
        if self._stale:
            self._lay_out()
        if self._pushed is None:
            self._forces[self._order] = push * self.inertia
        else:
            np.multiply(push, self.inertia, out=self._pushed)
        batch.set_space_bodies(self.space, _PUT, self._put)
        self.space.step(dt_s)
        self._got.clear()
        batch.get_space_bodies(self.space, _GOT, self._got)
        motion[:, :6] = np.frombuffer(self._got.float_buf()).reshape(-1, 6)[self._order]
