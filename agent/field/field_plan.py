"""A field as one fleet's vehicles drive in it: its division, path grids, fences, and curves.

It is computed from the outline and the declared values alone, so every robot computes the same. It
is immutable, so peers of one process may share it without exchanging information.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from agent.field.field_division import divide
from agent.field.field_map import Field, joins, rasterise, without_pockets
from agent.field.fleet_plan import JOBS_MAX
from agent.field.ground_parts import GroundParts
from agent.field.narrow_lanes import narrow_lanes
from agent.field.steered_travel_times import SteeredTravelTimes
from agent.field.travel_times import TravelTimes
from agent.interface.geometry import Point
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.holonomic_motion import FENCE_M, FENCE_SPARE_M
from agent.motion.path_tracker import ALIGN_M
from agent.motion.tractor_tracker import SteeringLimits
from agent.paths.route import Route
from agent.paths.tractor_route import TurnRoute

ROUTE_CELLS_MAX = 1_500_000  # of the path grid; larger fields get larger cells
ROUTE_CELL_M = 0.5  # usual side of its cells
CLEARANCE_M = 0.3  # paths keep this distance from fences and holes, in addition to the radius
assert CLEARANCE_M + 1e-9 > FENCE_M + FENCE_SPARE_M + ALIGN_M / 2, (
    "avoidance permits what was planned, a little off it too, also with an inaccurate place"
)
CORNER_M = 0.5  # corners of the field less far from the line past them are left out of ways
TURN_CELL_M = 0.25  # the same for bodies that steer, because turns need decimetres
# Planned circles are wider than the tightest one by this factor; the rest is for corrections.
TURN_SPARE = 1.2
# A body that can turn on the spot need not do so, and driving a curve is faster.
PIVOT_RADIUS_M = 0.6
PIVOT_STEER_1_M_S = 6.0  # its curvature changes as fast as its wheels turn
# From so many robots on, sections are shorter than declared. Each begins with a way and turns, which a
# small fleet pays for without gain: one tractor on 9 by 100 m took 259 s with short ones, now 203 s.
SHORTER_FROM_ROBOTS = 12
# About as many sections as a robot of a large fleet works, at least. Two or three each, in `oxted` with
# 24 robots, are a third of a robot's work, and the others wait for the last (docs/measured/fields.md).
SECTIONS_EACH = 5
# Shorter ones save nothing: in `small` with 6 robots, plans with 50 m take 9 % longer than with 60 m.
SECTION_LEAST_M = 60.0
# Most sections for the sake of many robots. A section ends at three quarters of the wanted length, and
# plans of the whole fleet are made for `JOBS_MAX`.
SECTIONS_MAX = JOBS_MAX * 3 // 4
# Half of it is how far a body may be off its line, or the unit does not count. With less, fleets worked
# `small` until the time limit. Bodies are off by 0.04, 0.07 and 0.08 m where pieces end and in bends.
OVERLAP_LEAST_M = {
    DriveTrain.MECANUM: 0.1,
    DriveTrain.DIFFERENTIAL: 0.15,
    DriveTrain.ACKERMANN: 0.2,
}
GATE_OUTSIDE_M = 0.5  # a gate may be this far outside of the outline


class FieldError(ValueError):
    """A declared value that does not fit the field; the message is one line that names it."""

    def __init__(self, key: str, why: str) -> None:
        """`key`: where the value is declared, for example "field.gate"."""
        super().__init__(f"{key}: {why}")


class FieldValues(NamedTuple):
    """What is declared of the work in a field. Equal for all robots of a fleet."""

    implement_width_m: float = 4.0
    overlap_m: float = 0.2  # of neighbouring swaths
    section_length_m: float = 250.0  # of swath in one section; shorter for many robots
    unit_m: float = 5.0  # of swath in one unit of progress
    gate: Point | None = None  # metres east and north of the middle; default: a corner
    robots: int = 1  # of the whole fleet, also those that join later


def planned_radius_m(vehicle: Vehicle) -> float:
    """The radius of planned curves; 0 for a vehicle that moves in any direction without turning."""
    if vehicle.drive is DriveTrain.MECANUM:
        return 0.0
    return max(vehicle.turn_radius_m * TURN_SPARE, PIVOT_RADIUS_M)


def divided(
    name: str, polygon: Polygon, origin: tuple[float, float], values: FieldValues, vehicle: Vehicle
) -> Field:
    """The field of these vehicles, in sections. Raises FieldError.

    `polygon`: its outline, metres east and north. `origin`: latitude and longitude of (0, 0).
    """
    least_m = OVERLAP_LEAST_M[vehicle.drive]
    if values.overlap_m < least_m:
        off_m, drive = values.overlap_m / 2, vehicle.drive.name.lower()
        why = f"{drive} bodies cannot keep to {off_m:g} m of their line; use {least_m:g} m at least"
        raise FieldError("field.overlap_m", f"{values.overlap_m:g} m: {why}")
    gate = values.gate or _corner(polygon)
    if not polygon.buffer(GATE_OUTSIDE_M).contains(shapely.Point(gate)):
        raise FieldError("field.gate", f"{gate} is not in the field")
    try:
        return divide(
            name, polygon, origin, gate, values.implement_width_m, values.overlap_m,
            _section_m(polygon, values), values.unit_m, planned_radius_m(vehicle),
            vehicle.radius_m + FENCE_M, vehicle.drive is DriveTrain.DIFFERENTIAL,
        )  # fmt: skip
    except ValueError as problem:
        raise FieldError("field.implement_width_m", str(problem)) from None


def _section_m(polygon: Polygon, values: FieldValues) -> float:
    """The length of swath wanted in a section: as declared, or a small share of a robot's work in a large
    fleet.

    A robot that ends first waits for the last one for about half a section, so a section is to be
    short against what a robot works in all.
    """
    if values.robots < SHORTER_FROM_ROBOTS:
        return values.section_length_m
    work_m = float(polygon.area) / (values.implement_width_m - values.overlap_m)
    share_m = work_m / min(values.robots * SECTIONS_EACH, SECTIONS_MAX)
    return min(values.section_length_m, max(share_m, SECTION_LEAST_M))


def _corner(polygon: Polygon) -> Point:
    """The gate if none is declared: the south-western corner of the outline."""
    points = [(float(p[0]), float(p[1])) for p in polygon.exterior.coords]
    return min(points, key=lambda p: (p[0] + p[1], p))


class FieldPlan:
    """One field and one kind of vehicle, with all that missions and motion derive from them."""

    def __init__(self, field: Field, vehicle: Vehicle) -> None:
        """Raises FieldError if the vehicle is too wide for the field's swaths."""
        self.field, self.vehicle = field, vehicle
        beside_m = (field.implement_width_m - field.overlap_m) / 2
        if vehicle.radius_m + FENCE_M > beside_m:
            raise FieldError(
                "fleet.radius_m",
                f"{vehicle.radius_m} m is too wide for swaths "
                f"{beside_m:.2f} m from fences; use {beside_m - FENCE_M:.2f} m at most",
            )

    @cached_property
    def route(self) -> Route:
        """The planner of paths for a body that turns on the spot.

        Its grid is finer if cells of the usual size close a passage that robots fit through.
        """
        clearance_m = self.vehicle.radius_m + CLEARANCE_M
        cell_m = self._cells(ROUTE_CELL_M)
        grid = rasterise(self.field, cell_m, clearance_m, whole=True)
        while grid[0].size * 4 <= ROUTE_CELLS_MAX and not joins(self.field, grid, clearance_m):
            cell_m /= 2
            grid = rasterise(self.field, cell_m, clearance_m, whole=True)
        grid = without_pockets(self.field, grid)
        # A neck that is too narrow for that clearance may still be wide enough for avoidance.
        least_m = self.vehicle.radius_m + FENCE_M
        if joins(self.field, grid, least_m):
            return Route(*grid)
        return Route(*grid, narrow_lanes(self.field, grid, clearance_m, least_m))

    @cached_property
    def parts(self) -> GroundParts:
        """The parts of the field between which such vehicles cannot drive."""
        return GroundParts(self.field, self.vehicle.radius_m + FENCE_M)

    @cached_property
    def travel(self) -> TravelTimes:
        """How long the vehicle takes in each section and between them."""
        vehicle = self.vehicle
        if self.turn_radius_m:
            return SteeredTravelTimes(
                self.field, self.route, self.steering, vehicle.acceleration_m_s2, self.turn_radius_m,
                self._corners(),
            )  # fmt: skip
        return TravelTimes(
            self.field,
            self.route,
            vehicle.speed_m_s,
            vehicle.acceleration_m_s2,
            vehicle.braking_m_s2,
            self._corners(),
        )

    def _corners(self) -> list[Point]:
        """Places, metres, by which a body goes round the corners of the field and of its holes."""
        clear_m = self.vehicle.radius_m + CLEARANCE_M + self.route.cell_m
        free = self.field.polygon.buffer(-clear_m, join_style="mitre").simplify(CORNER_M)
        found: list[Point] = []
        for part in getattr(free, "geoms", [free]):
            if part.is_empty:
                continue
            part = orient(part)  # free ground is to the left of all rings
            for ring in (part.exterior, *part.interiors):
                points = [(float(x), float(y)) for x, y in ring.coords[:-1]]
                for k, (x_m, y_m) in enumerate(points):
                    (ax, ay), (bx, by) = points[k - 1], points[(k + 1) % len(points)]
                    turn = (x_m - ax) * (by - y_m) - (y_m - ay) * (bx - x_m)
                    if turn < 0.0:
                        found.append((x_m, y_m))
        return found

    @cached_property
    def fences(self) -> NDArray[np.float64]:
        """Every outline as segments (n, 4) in metres."""
        segments = [
            (*a, *b)
            for ring in (self.field.exterior, *self.field.holes)
            for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
            if a != b
        ]
        return np.array(segments, dtype=np.float64)

    @property
    def turn_radius_m(self) -> float:
        """The radius of planned curves; see `planned_radius_m`."""
        return planned_radius_m(self.vehicle)

    @cached_property
    def steering(self) -> SteeringLimits:
        """The limits of a vehicle that steers."""
        vehicle = self.vehicle
        rate = vehicle.steer_rad_s / vehicle.wheelbase_m
        if vehicle.drive is DriveTrain.DIFFERENTIAL:
            rate = PIVOT_STEER_1_M_S
        return SteeringLimits(vehicle.speed_m_s, vehicle.braking_m_s2, rate)

    @cached_property
    def turns(self) -> TurnRoute:
        """Paths of a vehicle that steers, on a finer grid than `route`."""
        cell_m, clearance_m = self._cells(TURN_CELL_M), self.vehicle.radius_m + FENCE_M
        return TurnRoute(*rasterise(self.field, cell_m, clearance_m), self.turn_radius_m)

    def _cells(self, cell_m: float) -> float:
        west, south, east, north = self.field.polygon.bounds
        while (east - west) * (north - south) / cell_m**2 > ROUTE_CELLS_MAX:
            cell_m *= 2
        return cell_m
