"""Fields of odd shapes, drawn from a seed: `drawn:7` is the field of seed 7, in place of a file.

    rings = ring_shape(random.Random(7))

A shape is a list of rings of (east, north) metres, the outline first, and then the islands.
"""

import random
from collections.abc import Callable
from math import cos, exp, log, pi, radians, sin, sqrt
from typing import Final

from shapely import affinity
from shapely.geometry import Point, Polygon, box
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from agent.runtime.files.field_file import Boundary
from sim.scenarios.scenario import DRAWN_FIELD, ScenarioError

SEED_DIGITS_MAX: Final = 20
ORIGIN_DEG: Final = 48.0, 11.0  # latitude and longitude of the middle

AREA_M2: Final = 500.0, 5_000.0  # a fleet of chaos works the largest in 5 minutes
ROOM_M: Final = 2.5  # half of an implement's bar, and what it keeps to a fence
ROOM_SHARE: Final = 0.3  # of a field, at least, that bodies may stand on
TRIES: Final = 100

Ring = list[tuple[float, float]]  # metres east and north
Shape = Callable[[random.Random], list[Ring]]


def star(draw: random.Random) -> list[Ring]:
    """Five to eight tips."""
    tips, turn = draw.randint(5, 8), draw.uniform(0, 2 * pi)
    far_m, near = draw.uniform(40, 80), draw.uniform(0.4, 0.65)
    return [
        [
            (r * cos(turn + pi * k / tips), r * sin(turn + pi * k / tips))
            for k in range(2 * tips)
            for r in (far_m if k % 2 == 0 else far_m * near,)
        ]
    ]


def comb(draw: random.Random) -> list[Ring]:
    """Three to five teeth on a base."""
    teeth, tooth_m, gap_m = draw.randint(3, 5), draw.uniform(9, 20), draw.uniform(5, 15)
    high_m, base_m = draw.uniform(25, 60), draw.uniform(9, 20)
    ring = [(0.0, 0.0), (teeth * tooth_m + (teeth - 1) * gap_m, 0.0)]
    for k in reversed(range(teeth)):
        x_m = k * (tooth_m + gap_m)
        ring += [(x_m + tooth_m, base_m + high_m), (x_m, base_m + high_m)]
        if k:
            ring += [(x_m, base_m), (x_m - gap_m, base_m)]
    return [ring]


def letter_u(draw: random.Random) -> list[Ring]:
    """Two arms of different width and height, and what joins them."""
    a_m, b_m, c_m = (draw.uniform(12, 40) for _ in range(3))
    left_m, right_m, base_m = draw.uniform(35, 90), draw.uniform(35, 90), draw.uniform(9, 25)
    wide_m = a_m + b_m + c_m
    return [
        [
            (0.0, 0.0), (wide_m, 0.0), (wide_m, right_m), (a_m + b_m, right_m), (a_m + b_m, base_m),
            (a_m, base_m), (a_m, left_m), (0.0, left_m),
        ]
    ]  # fmt: skip


def sliver(draw: random.Random) -> list[Ring]:
    """Long and narrow, with ends that are pointed or blunt."""
    long_m, blunt_m, middle_m = draw.uniform(80, 200), draw.uniform(0, 8), draw.uniform(9, 20)
    at_m, turn = draw.uniform(0.3, 0.7) * long_m, draw.uniform(0, pi)
    ring = [(0.0, -blunt_m / 2), (at_m, -middle_m / 2), (long_m, 0.0), (at_m, middle_m / 2)]
    if blunt_m > 1.0:
        ring.append((0.0, blunt_m / 2))
    return [[(x * cos(turn) - y * sin(turn), x * sin(turn) + y * cos(turn)) for x, y in ring]]


def islands(draw: random.Random) -> list[Ring]:
    """A rounded outline with one to three islands."""
    sides, far_m = draw.randint(7, 14), draw.uniform(45, 80)
    outline = [
        (far_m * r * cos(2 * pi * k / sides), far_m * r * sin(2 * pi * k / sides))
        for k in range(sides)
        for r in (draw.uniform(0.8, 1.0),)
    ]
    count, turn = draw.randint(1, 3), draw.uniform(0, 2 * pi)
    holes = []
    for k in range(count):
        at = turn + 2 * pi * k / count
        x_m, y_m = 0.4 * far_m * cos(at), 0.4 * far_m * sin(at)
        size_m, corners, turned = draw.uniform(2, 9), draw.randint(3, 7), draw.uniform(0, 6)
        holes.append(
            [
                (x_m + size_m * cos(turned + 2 * pi * j / corners),
                 y_m + size_m * sin(turned + 2 * pi * j / corners))
                for j in range(corners)
            ]
        )  # fmt: skip
    return [outline, *holes]


def triangle(draw: random.Random) -> list[Ring]:
    """One corner of 15 to 70 degrees."""
    turn, first_m, second_m = draw.uniform(0, 2 * pi), draw.uniform(60, 150), draw.uniform(60, 150)
    end = turn + draw.uniform(radians(15), radians(70))
    ring = [(0.0, 0.0), (first_m * cos(turn), first_m * sin(turn))]
    return [[*ring, (second_m * cos(end), second_m * sin(end))]]


def neck(draw: random.Random) -> list[Ring]:
    """Two halves that are narrow where they meet, with acute corners outside."""
    half_m, high_m, wide_m = draw.uniform(2, 7), draw.uniform(30, 70), draw.uniform(25, 60)
    low, far = draw.uniform(0.7, 1), draw.uniform(0.6, 1)
    return [
        [
            (-wide_m, -high_m), (wide_m, -high_m * low), (half_m, 0.0), (wide_m * far, high_m),
            (-wide_m, high_m), (-half_m, draw.uniform(-5, 5)),
        ]
    ]  # fmt: skip


def rectangles(draw: random.Random) -> list[Ring]:
    """Two to four rectangles of different angles that overlap."""
    field: BaseGeometry = box(0, 0, draw.uniform(30, 90), draw.uniform(20, 60))
    for _ in range(draw.randint(1, 3)):
        x_m, y_m = draw.uniform(0, 80), draw.uniform(0, 50)
        part = box(x_m, y_m, x_m + draw.uniform(15, 60), y_m + draw.uniform(15, 50))
        part = affinity.rotate(part, draw.uniform(-40, 40))
        if field.intersects(part):
            field = field.union(part)
    return rings_of(field)


def quadrilateral(draw: random.Random) -> list[Ring]:
    """No two sides are parallel."""
    return [
        [
            (0.0, 0.0),
            (draw.uniform(40, 110), draw.uniform(-20, 20)),
            (draw.uniform(50, 120), draw.uniform(40, 80)),
            (draw.uniform(-20, 30), draw.uniform(30, 90)),
        ]
    ]


def strip(draw: random.Random) -> list[Ring]:
    """Two to five bars wide, and long."""
    return rings_of(box(0, 0, draw.uniform(120, 300), draw.uniform(9, 22)))


def ring_shape(draw: random.Random) -> list[Ring]:
    """Round a large island, wider on one side."""
    outside = Point(0, 0).buffer(draw.uniform(30, 50), quad_segs=draw.choice((4, 16)))
    middle = Point(draw.uniform(-5, 5), draw.uniform(-5, 5))
    return rings_of(outside.difference(middle.buffer(draw.uniform(8, 18))))


def holes(draw: random.Random) -> list[Ring]:
    """A rectangle with one to four islands, of which some are bays of its outline."""
    field: BaseGeometry = box(0, 0, draw.uniform(50, 100), draw.uniform(40, 80))
    for _ in range(draw.randint(1, 4)):
        middle = Point(draw.uniform(10, 80), draw.uniform(10, 60))
        field = field.difference(
            middle.buffer(draw.uniform(1, 8), quad_segs=draw.choice((1, 2, 8)))
        )
    return rings_of(field)


SHAPES: Final[tuple[Shape, ...]] = (
    star, comb, letter_u, sliver, islands, triangle, neck, rectangles, quadrilateral, strip,
    ring_shape, holes,
)  # fmt: skip


def rings_of(field: BaseGeometry) -> list[Ring]:
    """The rings of a polygon, or of the largest of several."""
    parts = [each for each in getattr(field, "geoms", [field]) if isinstance(each, Polygon)]
    largest = max(parts, key=lambda each: each.area)
    return [list(ring.coords)[:-1] for ring in (largest.exterior, *largest.interiors)]


def drawn_boundary(file: str) -> Boundary:
    """The field of a name such as `drawn:7`, with its middle at (0, 0). ScenarioError without a seed."""
    text = file.removeprefix(DRAWN_FIELD)
    if not text.isdecimal() or len(text) > SEED_DIGITS_MAX:
        raise ScenarioError(
            f"field.file: {file[:40]!r} has no seed; a drawn field is {DRAWN_FIELD}7"
        )
    seed = int(text)
    for again in range(TRIES):
        found = _tried(random.Random(f"{seed}/{again}/field"))
        if found is not None:
            name, polygon = found
            return Boundary(f"{name} {seed}", polygon, ORIGIN_DEG)
    raise AssertionError(f"{TRIES} fields of seed {seed} without room")


def _tried(draw: random.Random) -> tuple[str, Polygon] | None:
    """The name of a shape and the field; none where it has too little room for bodies."""
    shape = draw.choice(SHAPES)
    rings = shape(draw)
    field = affinity.rotate(Polygon(rings[0], rings[1:]), draw.uniform(0, 360))
    area_m2 = exp(draw.uniform(*map(log, AREA_M2)))
    scale = sqrt(area_m2 / field.area)
    field = affinity.scale(field, scale, scale)
    west, south, east, north = field.bounds
    field = orient(affinity.translate(field, -(west + east) / 2, -(south + north) / 2))
    has_room = field.is_valid and field.buffer(-ROOM_M).area >= ROOM_SHARE * area_m2
    return (shape.__name__, field) if has_room else None
