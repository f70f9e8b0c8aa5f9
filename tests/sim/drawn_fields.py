"""Fields with inner corners and narrow places, drawn from a seed, as scenario files."""

import json
import random
from collections.abc import Callable, Sequence
from math import cos, pi, radians, sin
from pathlib import Path

from sim.scenarios.scenario import Scenario, load

Ring = Sequence[tuple[float, float]]
NORTH_DEG, EAST_DEG, DEGREE_M = 48.0, 11.0, 111_320.0


def rectangle(width_m: float, height_m: float) -> Ring:
    return [(0, 0), (width_m, 0), (width_m, height_m), (0, height_m)]


def letter_l(draw: random.Random) -> Ring:
    a, b, c, d = (draw.uniform(20, 45) for _ in range(4))
    return [(0, 0), (a + b, 0), (a + b, c), (a, c), (a, c + d), (0, c + d)]


def letter_u(draw: random.Random) -> Ring:
    a, b, c = (draw.uniform(12, 22) for _ in range(3))
    h, g = draw.uniform(35, 55), draw.uniform(10, 18)
    return [
        (0, 0), (a + b + c, 0), (a + b + c, h), (a + b, h), (a + b, g), (a, g), (a, h), (0, h),
    ]  # fmt: skip


def star(draw: random.Random) -> Ring:
    points, turn = draw.randint(5, 7), draw.uniform(0, 6)
    far, near = draw.uniform(35, 45), draw.uniform(0.45, 0.6)
    return [
        (r * cos(turn + pi * k / points), r * sin(turn + pi * k / points))
        for k in range(2 * points)
        for r in (far if k % 2 == 0 else far * near,)
    ]


def comb(draw: random.Random) -> Ring:
    teeth, tooth, gap = 3, draw.uniform(9, 14), draw.uniform(6, 10)
    high, base = draw.uniform(25, 35), draw.uniform(10, 14)
    ring: list[tuple[float, float]] = [(0, 0), (teeth * tooth + (teeth - 1) * gap, 0)]
    for k in reversed(range(teeth)):
        x = k * (tooth + gap)
        ring += [(x + tooth, base + high), (x, base + high)]
        if k:
            ring += [(x, base), (x - gap, base)]
    return ring


SHAPES: tuple[Callable[[random.Random], Ring], ...] = (letter_l, letter_u, star, comb)


def scenario(
    folder: Path, ring: Ring, robots: int, seed: int, *, hole: Ring = (),
    implement_width_m: float = 4.0, time_limit_s: float = 1200.0, drive: str = "mecanum",
) -> Scenario:  # fmt: skip
    """The field as a file in that folder, and a fleet in it; the ring in metres."""

    def degrees(ring: Ring) -> list[tuple[float, float]]:
        east_m = DEGREE_M * cos(radians(NORTH_DEG))
        places = [(EAST_DEG + x / east_m, NORTH_DEG + y / DEGREE_M) for x, y in ring]
        return [*places, places[0]]

    rings = [degrees(ring), *([degrees(hole)] if hole else [])]
    (folder / "drawn.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": rings}))
    (folder / "drawn.toml").write_text(
        f'name = "drawn"\n[field]\nfile = "drawn.geojson"\n'
        f"implement_width_m = {implement_width_m}\n"
    )
    return load(str(folder / "drawn.toml")).changed(
        robots, seed, drive=drive, time_limit_s=time_limit_s
    )
