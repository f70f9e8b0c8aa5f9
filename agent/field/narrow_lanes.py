"""Lines through ground that is too narrow for the cells of the path grid: necks, lanes and gateways.

A cell of the path grid is free only if all of it keeps the clearance, and in a large field cells are
metres wide. A neck that bodies fit through may have no free cell. Here such ground gets lines along its
middle: between the rooms that it joins, and to ends of sections in it. They depend on the width of the
ground alone, and not on the grid.

The middle is that of a Delaunay triangulation of the ground: the line passes through the middles of the
edges that lead across.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from heapq import heappop, heappush
from math import dist, inf
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import nearest_points

from agent.field.field_map import Field
from agent.interface.geometry import Point, Polyline
from agent.paths.regions import regions_of

Grid = tuple[NDArray[np.bool_], float, float, float]
DIAGONAL: Final = 1.42  # of a cell, rounded up
TOUCHES_M: Final = 0.01  # parts of ground nearer to each other than this touch
SPECK_M2: Final = 0.01  # a smaller piece of ground is an error of rounded corners
STEP_LEAST_M: Final = 0.1  # between places on the border of narrow ground
STEPS_MAX: Final = 4000  # such places of one piece; a longer piece gets fewer
STRAIGHT_M: Final = 0.1  # by how much a line may leave the middle to have fewer corners
DIGITS: Final = 6  # of the coordinates by which a place is known


class _Room(NamedTuple):
    """Ground of which each place is in a free cell, and what is around it."""

    ground: BaseGeometry
    around: BaseGeometry  # as far as straight lines lead out of it
    region: int  # of the grid


def narrow_lanes(field: Field, grid: Grid, clearance_m: float, least_m: float) -> list[Polyline]:
    """Lines along the middle of ground that the path grid does not join, each of (x, y) metres.

    They meet at their ends. An end is in a free cell, at an end of a section, or where lines meet.
    `grid`: as from `rasterise`, with whole cells free. `clearance_m`: kept by it. `least_m`: that lines
    keep from fences and holes.
    """
    blocked, west_m, south_m, cell_m = grid
    regions = regions_of(blocked)

    def region_at(x_m: float, y_m: float) -> int:
        return int(regions[int((y_m - south_m) // cell_m), int((x_m - west_m) // cell_m)])

    keep_m = clearance_m + DIAGONAL * cell_m
    free = field.polygon.buffer(-least_m)
    rooms = []
    for part in shapely.get_parts(field.polygon.buffer(-keep_m)).tolist():
        if part.is_empty:
            continue
        inside = part.representative_point()
        around = part.buffer(keep_m - least_m)
        rooms.append(_Room(part, around, region_at(float(inside.x), float(inside.y))))
    lines = list(_between(rooms))
    ends = sorted({end for section in field.sections for end in section.ends})
    narrow = free.difference(shapely.union_all([room.around for room in rooms]))
    for piece in shapely.get_parts(narrow).tolist():
        if not isinstance(piece, Polygon) or piece.area < SPECK_M2:
            continue
        near = [room for room in rooms if room.around.distance(piece) < TOUCHES_M]
        known = {room.region for room in near}
        inside = shapely.dwithin(piece, shapely.points(ends), TOUCHES_M).tolist()
        lost = [
            end
            for end, here in zip(ends, inside, strict=True)
            if here and _new(region_at(*end), known)
        ]
        if len(known) + len(lost) > 1:
            lines += _Middle(piece, free, near).lines(lost)
    return lines


def _new(region: int, known: set[int]) -> bool:
    return region == 0 or region not in known


def _between(rooms: Sequence[_Room]) -> Iterable[Polyline]:
    """Lines between rooms whose surroundings meet."""
    for k, a in enumerate(rooms):
        for b in rooms[:k]:
            if a.region != b.region and a.around.intersects(b.around):
                meeting = nearest_points(a.around.intersection(b.around), a.ground)[0]
                yield (
                    _xy(nearest_points(a.ground, meeting)[0]), _xy(meeting),
                    _xy(nearest_points(b.ground, meeting)[0]),
                )  # fmt: skip


def _xy(point: shapely.Point) -> Point:
    return round(float(point.x), DIGITS), round(float(point.y), DIGITS)


class _Middle:
    """The middle of one piece of narrow ground."""

    def __init__(self, piece: Polygon, free: BaseGeometry, rooms: Sequence[_Room]) -> None:
        """`free`: the ground on which lines may be, metres. `rooms`: those at the piece."""
        self.free, self.rooms = free.buffer(TOUCHES_M), rooms
        shapely.prepare(self.free)
        width_m = 2 * piece.area / piece.length
        step_m = max(STEP_LEAST_M, width_m / 3, piece.length / STEPS_MAX)
        border = piece.segmentize(step_m)
        ground = piece.buffer(TOUCHES_M)
        shapely.prepare(ground)
        triangles = shapely.get_parts(shapely.delaunay_triangles(border))
        corners = shapely.get_coordinates(triangles[shapely.covers(ground, triangles)])
        corners = corners.reshape(-1, 4, 2)[:, :3]
        middles = np.round((corners + np.roll(corners, -1, axis=1)) / 2, DIGITS)
        sides = [[(float(x), float(y)) for x, y in triple] for triple in middles.tolist()]
        count: dict[Point, int] = defaultdict(int)
        for triple in sides:
            for side in triple:
                count[side] += 1
        # An edge of one triangle alone is on the border: of a fence, or of a room.
        outer = [side for side, triangles_of in count.items() if triangles_of == 1]
        self.doors: dict[Point, _Room] = {}
        for room in rooms:
            touches = shapely.dwithin(room.around, shapely.points(outer), TOUCHES_M).tolist()
            self.doors.update(
                {side: room for side, there in zip(outer, touches, strict=True) if there}
            )
        self.ways: dict[Point, list[Point]] = defaultdict(list)
        for triple in sides:
            open_sides = [side for side in triple if count[side] > 1 or side in self.doors]
            for side in open_sides:
                self.ways[side] += [other for other in open_sides if other != side]

    def lines(self, ends: Sequence[Point]) -> list[Polyline]:
        """Lines that join the regions at this piece and these places in it."""
        for end in ends:
            self._join(end)
        door = self._middle_door()
        start = ends[0] if door is None else door
        before, length_m = self._from(start)
        goals = [end for end in ends if end in before and end != start]
        nearest: dict[int, Point] = {}
        for side, room in self.doors.items():
            here = self.doors.get(start)
            if side in before and (here is None or room.region != here.region):
                best = nearest.setdefault(room.region, side)
                if length_m[side] < length_m[best]:
                    nearest[room.region] = side
        goals += nearest.values()
        return [self._drawn(line) for line in _branches(start, goals, before)]

    def _join(self, end: Point) -> None:
        for side in sorted(self.ways, key=lambda at: (dist(at, end), at))[:STEPS_MAX]:
            if self.free.covers(LineString((side, end))):
                self.ways[end].append(side)
                self.ways[side].append(end)
                return

    def _middle_door(self) -> Point | None:
        """The place in the middle of the border to one room; None without rooms."""
        doors = [side for side in self.doors if side in self.ways]
        if not doors:
            return None
        region = self.doors[min(doors)].region
        same = [side for side in doors if self.doors[side].region == region]
        return min(same, key=lambda at: (sum(dist(at, other) for other in same), at))

    def _from(self, start: Point) -> tuple[dict[Point, Point], dict[Point, float]]:
        """The place before each one on the shortest way from the start, and the length of that way."""
        before, length_m, waiting = {start: start}, {start: 0.0}, [(0.0, start)]
        while waiting:
            at_m, at = heappop(waiting)
            if at_m > length_m[at]:
                continue
            for to in self.ways[at]:
                to_m = at_m + dist(at, to)
                if to_m < length_m.get(to, inf):
                    before[to], length_m[to] = at, to_m
                    heappush(waiting, (to_m, to))
        return before, length_m

    def _drawn(self, line: list[Point]) -> Polyline:
        """With few corners, and into the room where it ends at one."""
        few = LineString(line).simplify(STRAIGHT_M)
        corners = [_xy(shapely.Point(at)) for at in few.coords[1:-1]]
        points = [line[0], *corners, line[-1]] if self.free.covers(few) else line
        into = [self._within(points[0]), *points, self._within(points[-1])]
        return tuple(at for at in into if at is not None)

    def _within(self, door: Point) -> Point | None:
        room = self.doors.get(door)
        return None if room is None else _xy(nearest_points(room.ground, shapely.Point(door))[0])


def _branches(
    start: Point, goals: Sequence[Point], before: dict[Point, Point]
) -> list[list[Point]]:
    """The ways from the start to all goals, cut where they part and at goals."""
    after: dict[Point, set[Point]] = defaultdict(set)
    for goal in goals:
        at = goal
        while at != start:
            after[before[at]].add(at)
            at = before[at]
    ends = {start, *goals, *(at for at, following in after.items() if len(following) > 1)}
    found = []
    for end in sorted(ends - {start}):
        line = [end]
        while len(line) == 1 or line[-1] not in ends:
            line.append(before[line[-1]])
        found.append(line)
    return found
