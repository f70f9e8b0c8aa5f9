"""Which part of the area asked for a body and its implement can work, from the field and body
alone.

The tracks driven do not matter here. There are two reasons why a body cannot reach ground.

* **It cannot get there.** The ground is behind a passage narrower than the body and its distance
  from fences.
* **It cannot bring its implement there.** A body that turns on the spot swings the bar into any
  corner. A body that steers works in strokes: the bar is lowered, driven, and lifted. A stroke
  bends no tighter than the turning circle. It is at least as long as the implement is wide and the
  body is long, because a shorter one would need shunting. All along a stroke the whole
  bar lies within the outline, and the middle of the body keeps its distance from fences. A cell is
  reachable if one such stroke passes it, in any direction, with half the overlap to spare, which is
  the tolerance of driving. So a body that steers may have to leave a corner or a narrow end, but
  never a strip along a fence.

The check of strokes is sampled: directions every 7.5 degrees and those of the fences near by, nine
curvatures. A cell that only a stroke between the samples passes counts as not reachable.
"""

from collections.abc import Sequence
from math import cos, hypot, pi, sin
from typing import Final, NamedTuple

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Point, Polygon
from shapely.ops import unary_union

from agent.motion.holonomic_motion import FENCE_M
from sim.world.raster import Raster

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

HEADINGS: Final = 24  # of a half turn: the same stroke can be driven both ways
BENDS: Final = (0.0, 1 / 32, 1 / 16, 1 / 4, 1.0)  # of the turning circle's curvature, to both sides
ACROSS: Final = 7  # sample positions of the cell on the bar
ALONG: Final = 5  # and along the stroke
STEP_M: Final = 0.5  # between checked positions of a stroke
SMALL_SHARE: Final = 0.9  # of the longest line in a field that is shorter than a stroke
EDGES_MAX: Final = 64  # of the outline, near a cell; if there are more, the nearest count
TOUCHES_M: Final = 0.02  # a bar that is this much too wide touches the fence; it does not cross it
NEGLIGIBLE_M2: Final = 0.05  # less than a cell: not worth reporting


class WorkingBody(NamedTuple):
    """The dimensions of a robot and its implement that decide where they can work; metres."""

    width_m: float  # of the implement
    overlap_m: float
    radius_m: float  # of the body
    turn_radius_m: float  # 0: it turns on the spot and swings its implement

    @property
    def keep_m(self) -> float:
        """Distance between the middle of the body and a fence."""
        return self.radius_m + FENCE_M

    @property
    def stroke_m(self) -> float:
        """Width of a strip in which the implement and the whole body fit on both sides."""
        return self.width_m + 2 * self.radius_m


class Unreached(NamedTuple):
    """Ground that this body cannot work, and why."""

    area_m2: float
    why: str


class Ground(NamedTuple):
    """`cells`: the reachable cells, on the raster of the area asked for."""

    cells: Flags
    share: float  # of the area asked for
    unreached: tuple[Unreached, ...]


def reachable_ground(
    polygon: Polygon, raster: Raster, body: WorkingBody, starts: Sequence[tuple[float, float]]
) -> Ground:
    """Which cells of `raster` such bodies can work, and how much is left for which reason.

    `raster`: see `coverage_truth.sample_points`; `starts`: where robots are switched on, metres.
    """
    near_fence_m2 = max(polygon.area - raster.area_m2, 0.0)
    joined = _joined(polygon, raster, body, starts)
    cells = joined
    if body.turn_radius_m > 0.0:
        cells = _by_strokes(polygon, raster, joined, body)
    cell_m2, asked = raster.cell_m**2, int(np.count_nonzero(raster.cells))
    apart_m2 = float(asked - np.count_nonzero(joined)) * cell_m2
    corners_m2 = float(np.count_nonzero(joined) - np.count_nonzero(cells)) * cell_m2
    found = (
        Unreached(near_fence_m2, "beside fences and in corners, where the bar would cross them"),
        Unreached(apart_m2, "behind passages that are too narrow for the body"),
        Unreached(corners_m2, "in corners that the turning circle and the implement's width leave"),
    )
    return Ground(
        cells,
        float(np.count_nonzero(cells)) / max(asked, 1),
        tuple(Unreached(round(u.area_m2, 2), u.why) for u in found if u.area_m2 > NEGLIGIBLE_M2),
    )


def _joined(
    polygon: Polygon, raster: Raster, body: WorkingBody, starts: Sequence[tuple[float, float]]
) -> Flags:
    """Cells that a bar reaches if its middle can come from a start."""
    free = shapely.get_parts(polygon.buffer(-body.keep_m))
    own = [part for part in free if any(part.distance(Point(at)) < FENCE_M for at in starts)]
    if len(own) == len(free):
        return raster.cells.copy()
    inset = shapely.get_parts(polygon.buffer(-body.width_m / 2))
    kept = [line for line in inset if any(part.intersects(line) for part in own)]
    area = unary_union(kept).buffer((body.width_m - body.overlap_m) / 2)
    x_m, y_m = raster.centres(raster.cells).T
    cells = np.zeros_like(raster.cells)
    cells[raster.cells] = shapely.contains_xy(area, x_m, y_m)
    return cells


def _by_strokes(polygon: Polygon, raster: Raster, joined: Flags, body: WorkingBody) -> Flags:
    """Those of the cells that a stroke passes."""
    free = polygon.buffer(-body.keep_m)
    if free.is_empty:
        return np.zeros_like(joined)
    box = shapely.get_coordinates(free.minimum_rotated_rectangle)
    longest_m = max(hypot(*(box[k + 1] - box[k])) for k in range(min(2, len(box) - 1)))
    stroke_m = min(body.stroke_m, SMALL_SHARE * longest_m)
    rings = shapely.get_parts(shapely.boundary(polygon))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    edges = np.hstack((points[:-1], points[1:]))[ring[:-1] == ring[1:]]
    # A stroke of any direction fits if the fences are farther away than the stroke and the bar
    # reach.
    inner = polygon.buffer(-hypot(stroke_m, body.width_m) - body.keep_m)
    rim = joined & ~_in(inner, raster)
    rows, columns = np.nonzero(rim)
    cells = joined.copy()
    place = np.array([raster.west_m, raster.south_m, raster.cell_m])
    width_m, bar_m = body.width_m - TOUCHES_M, body.width_m - body.overlap_m
    keep_m = body.keep_m + body.overlap_m / 2
    bends = np.array([b / body.turn_radius_m for b in (*BENDS, *(-b for b in BENDS[1:]))])
    _strokes_pass(
        edges, rows, columns, place, width_m, bar_m, keep_m - 1e-6, stroke_m, bends, cells
    )
    return cells


def _in(area: Polygon | MultiPolygon, raster: Raster) -> Flags:
    flags = np.zeros_like(raster.cells)
    if area.is_empty:
        return flags
    shapely.prepare(area)
    rows, columns = np.nonzero(raster.cells)
    x_m, y_m = raster.centres(raster.cells).T
    flags[rows, columns] = shapely.contains_xy(area, x_m, y_m)
    return flags


@njit(cache=True, error_model="numpy")
def _strokes_pass(  # type: ignore[no-untyped-def]
    edges, rows, columns, place, width, bar, keep, stroke, bends, cells
):
    """Clear each of these cells that no stroke passes."""
    near = np.empty((EDGES_MAX, 4))
    headings = np.empty(EDGES_MAX + HEADINGS)
    reach = stroke + width + keep
    for n in range(rows.shape[0]):
        x = place[0] + (columns[n] + 0.5) * place[2]
        y = place[1] + (rows[n] + 0.5) * place[2]
        count = _edges_near(edges, x, y, reach, near)
        for k in range(count):
            headings[k] = np.arctan2(near[k, 3] - near[k, 1], near[k, 2] - near[k, 0])
        for k in range(HEADINGS):
            headings[count + k] = pi * k / HEADINGS
        total = count + HEADINGS
        cells[rows[n], columns[n]] = _passed(
            x, y, near, count, headings, total, width, bar, keep, stroke, bends
        )


@njit(cache=True, error_model="numpy")
def _edges_near(edges, x, y, reach, near):  # type: ignore[no-untyped-def]
    count = 0
    within = reach
    while True:  # if there are too many, take only nearer ones
        count = 0
        for k in range(edges.shape[0]):
            if _distance(x, y, edges[k]) <= within:
                if count == EDGES_MAX:
                    count += 1
                    break
                near[count] = edges[k]
                count += 1
        if count <= EDGES_MAX:
            return count
        within *= 0.8


@njit(cache=True, error_model="numpy")
def _distance(x, y, edge):  # type: ignore[no-untyped-def]
    dx, dy = edge[2] - edge[0], edge[3] - edge[1]
    square = dx * dx + dy * dy
    t = 0.0
    if square > 0.0:
        t = min(max(((x - edge[0]) * dx + (y - edge[1]) * dy) / square, 0.0), 1.0)
    return np.hypot(x - edge[0] - t * dx, y - edge[1] - t * dy)


@njit(cache=True, error_model="numpy")
def _passed(x, y, near, count, headings, total, width, bar, keep, stroke, bends):  # type: ignore[no-untyped-def]
    """Whether some stroke has the point under its bar and stays within the outline."""
    for b in range(bends.shape[0]):
        for h in range(total):
            for i in range(ACROSS):
                across = bar * (i / (ACROSS - 1) - 0.5)
                # The middle of the bar when it is over the point.
                cx, cy = x + across * sin(headings[h]), y - across * cos(headings[h])
                for k in range(ALONG):
                    back = stroke * k / (ALONG - 1)
                    if _stays_in(
                        cx,
                        cy,
                        headings[h],
                        bends[b],
                        -back,
                        stroke - back,
                        near,
                        count,
                        width,
                        keep,
                    ):
                        return True
    return False


@njit(cache=True, error_model="numpy")
def _stays_in(cx, cy, heading, bend, first, last, near, count, width, keep):  # type: ignore[no-untyped-def]
    steps = int(np.ceil((last - first) / STEP_M))
    for k in range(steps + 1):
        s = first + (last - first) * k / steps
        at, px, py = heading + bend * s, cx, cy
        if abs(bend) < 1e-9:
            px, py = px + s * cos(heading), py + s * sin(heading)
        else:
            px += (sin(at) - sin(heading)) / bend
            py -= (cos(at) - cos(heading)) / bend
        half_x, half_y = -sin(at) * width / 2, cos(at) * width / 2
        for e in range(count):
            if _distance(px, py, near[e]) < keep:
                return False
            if _crosses(px - half_x, py - half_y, px + half_x, py + half_y, near[e]):
                return False
    return True


@njit(cache=True, error_model="numpy")
def _crosses(ax, ay, bx, by, edge):  # type: ignore[no-untyped-def]
    ux, uy = bx - ax, by - ay
    vx, vy = edge[2] - edge[0], edge[3] - edge[1]
    a_side = ux * (edge[1] - ay) - uy * (edge[0] - ax)
    b_side = ux * (edge[3] - ay) - uy * (edge[2] - ax)
    c_side = vx * (ay - edge[1]) - vy * (ax - edge[0])
    d_side = vx * (by - edge[1]) - vy * (bx - edge[0])
    return a_side * b_side <= 0.0 and c_side * d_side <= 0.0 and (ux * vy - uy * vx) != 0.0
