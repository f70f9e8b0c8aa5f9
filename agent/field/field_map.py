"""A field and its division into sections: pure data, metres in a local east-north frame.

A section is what robots claim; a unit (about 5 m of swath) is what progress counts. Everything here
is computed from the field description alone, so that every peer has the same sections and units.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import hypot
from typing import Final
from zlib import crc32

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import nearest_points, substring

from agent.interface.geometry import Point, Polyline
from agent.paths.regions import regions_of

CORNER = 0.7072  # distance from a cell's middle to its corner, in cells, rounded up
INSIDE_M = 0.01  # how far places of robots are from the edge of the ground where they may be
POCKET_CELLS = 16  # of the path grid: a smaller region that is joined to no other one is no room
UNITS_MAX = 10_240  # units of a section: 256 blocks of 40, as WORK_PROGRESS carries them


@dataclass(frozen=True)
class Section:
    """Neighbouring swaths worked in one go, each driven against the direction of the one before."""

    id: int
    swaths: tuple[Polyline, ...]
    units_of: tuple[int, ...]  # units of each swath; units are numbered through the section

    @property
    def name(self) -> str:
        """The section's name for people."""
        return f"S{self.id}"

    @cached_property
    def units(self) -> int:
        """Number of units of all swaths."""
        return sum(self.units_of)

    @cached_property
    def length_m(self) -> float:
        """Length of all swaths, without the turns between them."""
        return sum(_length(swath) for swath in self.swaths)

    @property
    def ends(self) -> tuple[Point, Point]:
        """Where the first swath begins and where the last one ends, (x, y) metres."""
        return self.swaths[0][0], self.swaths[-1][-1]

    def stretches(
        self, wanted: Callable[[int], bool]
    ) -> Iterator[tuple[Polyline, tuple[int, ...]]]:
        """Each longest run of wanted units of one swath: its polyline, and its units in driving
        order.

        `wanted`: whether to include a unit, by its number in the section.
        """
        first = 0
        for swath, count in zip(self.swaths, self.units_of, strict=True):
            run: list[int] = []
            for unit in range(first, first + count + 1):
                if unit < first + count and wanted(unit):
                    run.append(unit)
                elif run:
                    yield _piece(swath, run[0] - first, run[-1] + 1 - first, count), tuple(run)
                    run = []
            first += count

    def leads(self, first: int, last: int, lead_m: float) -> tuple[Polyline, Polyline]:
        """What of the swath lies `lead_m` before unit `first`, and `lead_m` behind unit `last`.

        Both units are of one swath. A lead is empty where the swath is too short for it. Raises
        AssertionError if the section has no unit `first`.
        """
        before = 0
        for swath, count in zip(self.swaths, self.units_of, strict=True):
            if first < before + count:
                line = LineString(swath)
                from_m = line.length * (first - before) / count
                to_m = line.length * (last + 1 - before) / count
                lead_in = _part(line, from_m - lead_m, from_m) if from_m >= lead_m else ()
                fits = to_m + lead_m <= line.length
                return lead_in, _part(line, to_m, to_m + lead_m) if fits else ()
            before += count
        raise AssertionError("no such unit")

    @cached_property
    def unit_lines(self) -> tuple[Polyline, ...]:
        """The polyline of each unit, in the order of their numbers; computed once."""
        lines: list[Polyline] = []
        for swath, count in zip(self.swaths, self.units_of, strict=True):
            if (
                len(swath) == 2
            ):  # 20,000 units of straight rows take 10 ms so, and 0.5 s each by itself
                line = LineString(swath)
                cuts = [line.length * unit / count for unit in range(count + 1)]
                points = shapely.get_coordinates(shapely.line_interpolate_point(line, cuts))
                ends = [(float(x), float(y)) for x, y in points.tolist()]
                lines += itertools.pairwise(ends)
            else:
                lines += [_piece(swath, unit, unit + 1, count) for unit in range(count)]
        return tuple(lines)


@dataclass(frozen=True)
class Field:
    """A field with its sections. Metres in a local frame, x east and y north of `origin`."""

    name: str
    exterior: Polyline
    holes: tuple[Polyline, ...]
    origin: tuple[float, float]  # latitude, longitude of (0, 0) in degrees
    gate: Point
    implement_width_m: float
    overlap_m: float
    unit_m: float
    sections: tuple[Section, ...]

    @property
    def tracking_tolerance_m(self) -> float:
        """How far from its line a robot may be for a unit to count: half the overlap."""
        return self.overlap_m / 2

    def section(self, number: int) -> Section:
        """The section with this number. Raises IndexError if there is none."""
        return self.sections[number]

    @cached_property
    def polygon(self) -> Polygon:
        """The outline with its holes."""
        return Polygon(self.exterior, self.holes)

    @cached_property
    def work_m(self) -> float:
        """Length of all swaths of the field."""
        return sum(section.length_m for section in self.sections)

    @cached_property
    def config_hash(self) -> int:
        """24 bits of everything that peers must agree on; coordinates in millimetres."""
        mm = [
            round(v * 1000)
            for section in self.sections
            for swath in section.swaths
            for point in swath
            for v in point
        ]
        counts = [n for section in self.sections for n in section.units_of]
        text = f"{self.name}|{self.implement_width_m}|{self.unit_m}|{mm}|{counts}"
        return crc32(text.encode()) & 0xFFFFFF


BESIDE_M: Final = 1e-6  # the crossing of an edge and a row is known far better
BESIDE: Final = np.array([[-BESIDE_M], [BESIDE_M]])


def rasterise(
    field: Field, cell_m: float, clearance_m: float, whole: bool = False
) -> tuple[NDArray[np.bool_], float, float, float]:
    """A path grid: (blocked, x and y of its south-western corner, side of a cell), metres.

    `blocked` [row, column], row 0 in the south, is True where a robot's middle may not be. A border
    of two cells is blocked all round. `clearance_m`: kept from fences and holes. `whole`: every
    point of a free cell keeps the clearance; otherwise only its middle does.
    """
    free = field.polygon.buffer(-clearance_m)
    west, south, east, north = field.polygon.bounds
    origin_x_m, origin_y_m = west - 2 * cell_m, south - 2 * cell_m
    columns = int(np.ceil((east - origin_x_m) / cell_m)) + 2
    rows = int(np.ceil((north - origin_y_m) / cell_m)) + 2
    x_m = origin_x_m + (np.arange(columns) + 0.5) * cell_m
    y_m = origin_y_m + (np.arange(rows) + 0.5) * cell_m
    shapely.prepare(free)
    blocked = ~grid_inside(free, x_m, y_m)
    if whole:
        inner = field.polygon.buffer(-clearance_m - CORNER * cell_m)
        border = ~blocked & ~grid_inside(inner, x_m, y_m)
        border_rows, border_columns = np.nonzero(border)
        x_m, y_m, half_m = x_m[border_columns], y_m[border_rows], cell_m / 2
        squares = shapely.box(x_m - half_m, y_m - half_m, x_m + half_m, y_m + half_m)
        blocked[border] = ~shapely.covers(free, squares)
    return blocked, origin_x_m, origin_y_m, cell_m


def grid_inside(
    area: Polygon | MultiPolygon, x_m: NDArray[np.float64], y_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which points of a grid, [row, column], are inside of an area, not on its border.

    `x_m` (columns,) and `y_m` (rows,), metres, ascending. The same as `shapely.contains_xy` of all
    points, in a fraction of the time: along each row the area begins and ends where edges cross it. Only
    points nearer than `BESIDE_M` to a crossing, and rows through a corner, are asked for one by one.
    """
    rings = [
        shapely.get_coordinates(ring)
        for part in getattr(area, "geoms", [area])
        if not part.is_empty
        for ring in (part.exterior, *part.interiors)
    ]
    toggles = np.zeros((len(y_m), len(x_m) + 1), np.uint8)
    asked = np.zeros((len(y_m), len(x_m)), np.bool_)
    for ring in rings:
        at_corner = np.searchsorted(y_m, ring[:, 1] + BESIDE)
        for first, last in at_corner.T:
            asked[first:last] = True
        low, high = ring[:-1], ring[1:]
        down = low[:, 1] > high[:, 1]
        low, high = np.where(down[:, None], high, low), np.where(down[:, None], low, high)
        # Half-open: a row through a corner crosses one of its edges, or both or none.
        first_rows = np.searchsorted(y_m, low[:, 1])
        counts = np.searchsorted(y_m, high[:, 1]) - first_rows
        edges = np.repeat(np.arange(len(low)), counts)
        rows = np.arange(len(edges)) - np.repeat(np.cumsum(counts) - counts, counts)
        rows += first_rows[edges]
        run, rise = (high - low)[edges].T
        crossings_m = low[edges, 0] + (y_m[rows] - low[edges, 1]) / rise * run
        np.add.at(toggles, (rows, np.searchsorted(x_m, crossings_m)), 1)
        first, last = np.searchsorted(x_m, crossings_m + BESIDE)
        for near in np.flatnonzero(last > first):
            asked[rows[near], first[near] : last[near]] = True
    inside: NDArray[np.bool_] = np.cumsum(toggles[:, :-1], axis=1, dtype=np.uint8) % 2 == 1
    asked_rows, asked_columns = np.nonzero(asked)
    shapely.prepare(area)
    inside[asked] = shapely.contains_xy(area, x_m[asked_columns], y_m[asked_rows])
    return inside


def joins(
    field: Field, grid: tuple[NDArray[np.bool_], float, float, float], clearance_m: float
) -> bool:
    """Whether the path grid connects all section ends that the free ground connects.

    `grid`: as from `rasterise`, metres. `clearance_m`: kept from fences and holes.
    """
    blocked, origin_x_m, origin_y_m, cell_m = grid
    free = field.polygon.buffer(-clearance_m)
    parts = [part for part in getattr(free, "geoms", [free]) if not part.is_empty]
    if not parts:
        return True
    regions = regions_of(blocked)
    region_of: dict[int, int] = {}
    for x_m, y_m in {end for section in field.sections for end in section.ends}:
        part = min(range(len(parts)), key=lambda k: parts[k].distance(shapely.Point(x_m, y_m)))
        row, column = int((y_m - origin_y_m) // cell_m), int((x_m - origin_x_m) // cell_m)
        region = int(regions[row, column])
        if region == 0 or region_of.setdefault(part, region) != region:
            return False
    return True


def without_pockets(
    field: Field, grid: tuple[NDArray[np.bool_], float, float, float]
) -> tuple[NDArray[np.bool_], float, float, float]:
    """The path grid without regions of a few free cells that have no end of a section.

    In a sharp corner, the last cell that keeps the clearance is often alone. A robot beside it would
    have no way to anywhere. `grid`: as from `rasterise`, metres.
    """
    blocked, origin_x_m, origin_y_m, cell_m = grid
    regions = regions_of(blocked)
    cells = np.bincount(regions.ravel())
    cells[0] = 0
    is_pocket = (cells <= POCKET_CELLS) & (cells < cells.max())
    for section in field.sections:
        for x_m, y_m in section.ends:
            row, column = int((y_m - origin_y_m) // cell_m), int((x_m - origin_x_m) // cell_m)
            is_pocket[regions[row, column]] = False
    is_pocket[0] = True
    return is_pocket[regions], origin_x_m, origin_y_m, cell_m


def start_poses(field: Field, count: int, spacing_m: float, clearance_m: float) -> list[Point]:
    """Places for robots side by side, (x, y) metres, as near to the gate as spacing and fences
    allow.

    They are in rows and columns through the gate; or, where a field is so narrow that these miss it,
    through the free place that is nearest to the gate. Raises ValueError if there is no room for `count`
    of them.
    """
    free = field.polygon.buffer(-clearance_m)
    inner = free.buffer(-INSIDE_M)  # a point on the edge of free ground is not in it
    if inner.is_empty:
        inner = free
    anchors = [field.gate]
    if not inner.is_empty:
        nearest, _ = nearest_points(inner, shapely.Point(field.gate))
        anchors.append((float(nearest.x), float(nearest.y)))
    for anchor in anchors:
        spots = _spots(free, anchor, count, spacing_m)
        if len(spots) >= count:
            spots.sort(key=lambda s: (hypot(s[0] - field.gate[0], s[1] - field.gate[1]), s))
            return spots[:count]
    raise ValueError(f"no room for {count} robots near the gate of {field.name}")


def _spots(free: BaseGeometry, anchor: Point, count: int, spacing_m: float) -> list[Point]:
    """Places on free ground in rows and columns through one place, (x, y) metres.

    At least `count` of them, if there are so many within 400 rows."""
    if free.is_empty:
        return []
    shapely.prepare(free)
    west, south, east, north = free.bounds
    far_m = max(anchor[0] - west, east - anchor[0], anchor[1] - south, north - anchor[1])
    reach = 2
    while True:
        steps = range(-reach, reach + 1)
        spots = [
            (anchor[0] + i * spacing_m, anchor[1] + j * spacing_m) for i in steps for j in steps
        ]
        x_m, y_m = zip(*spots, strict=True)
        is_free = shapely.contains_xy(free, x_m, y_m).tolist()
        inside = [spot for spot, free_there in zip(spots, is_free, strict=True) if free_there]
        if len(inside) >= count or reach > 200 or reach * spacing_m > far_m:
            return inside
        reach *= 2


def _length(line: Polyline) -> float:
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(line))


def _piece(swath: Polyline, first: int, last: int, count: int) -> Polyline:
    line = LineString(swath)
    return _part(line, line.length * first / count, line.length * last / count)


def _part(line: LineString, from_m: float, to_m: float) -> Polyline:
    return tuple((float(x), float(y)) for x, y in substring(line, from_m, to_m).coords)
