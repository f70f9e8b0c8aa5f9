"""Fields of odd shapes, drawn from a seed: stars, combs, the letter U, slivers, and fields with islands.

Seeds from `ACUTE_FIRST` on have acute corners: triangles, and two halves with a neck between them.

    setup = drawn_setup(7, folder)

The shape and its size, the islands and the number of robots (1 to 24) follow from the seed alone.
"""

import json
import random
from math import cos, radians
from pathlib import Path
from typing import Final

from shapely.geometry import Polygon

from sim.scenarios.drawn_field import (
    Shape,
    comb,
    islands,
    letter_u,
    neck,
    sliver,
    star,
    triangle,
)
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

NORTH_DEG, EAST_DEG, DEGREE_M = 48.0, 11.0, 111_320.0
ROBOTS_MAX: Final = 24
# Of a field for one robot. 24 robots get half a hectare at least: less has no room for their bars.
ROOM_M2: Final = 250.0

SHAPES: tuple[Shape, ...] = (star, comb, letter_u, sliver, islands)
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
