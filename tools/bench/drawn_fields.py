"""Fields of odd shapes, drawn from a seed: stars, combs, the letter U, slivers, and fields with islands.

Seeds from `ACUTE_FIRST` on have acute corners: triangles, and two halves with a neck between them.

    setup = drawn_setup(7, folder)

The shape and its size, the islands and the number of robots (1 to 24) follow from the seed alone.
"""

import json
import random
from collections.abc import Callable
from math import cos, pi, radians, sin
from pathlib import Path
from typing import Final

from shapely.geometry import Polygon

from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

NORTH_DEG, EAST_DEG, DEGREE_M = 48.0, 11.0, 111_320.0
ROBOTS_MAX: Final = 24
# Of a field for one robot. 24 robots get half a hectare at least: less has no room for their bars.
ROOM_M2: Final = 250.0

Ring = list[tuple[float, float]]  # metres east and north


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


SHAPES: tuple[Callable[[random.Random], list[Ring]], ...] = (star, comb, letter_u, sliver, islands)
ACUTE = (triangle, neck)
ACUTE_FIRST: Final = 1000  # seeds before keep their shapes


def drawn_setup(seed: int, folder: Path) -> FieldSetup:
    """The field of a seed as a file in `folder`, and the fleet that works it."""
    draw = random.Random(seed)
    shapes = ACUTE if seed >= ACUTE_FIRST else SHAPES
    shape = shapes[seed % len(shapes)]
    rings = shape(draw)
    room = int(Polygon(rings[0], rings[1:]).area / ROOM_M2)
    robots = draw.randint(1, max(1, min(ROBOTS_MAX, room)))
    east_m = DEGREE_M * cos(radians(NORTH_DEG))
    degrees = [
        [(EAST_DEG + x / east_m, NORTH_DEG + y / DEGREE_M) for x, y in [*ring, ring[0]]]
        for ring in rings
    ]
    path = folder / f"{shape.__name__}-{seed}.geojson"
    path.write_text(json.dumps({"type": "Polygon", "coordinates": degrees}))
    return FieldSetup(load(str(path)).changed(robots, seed))
