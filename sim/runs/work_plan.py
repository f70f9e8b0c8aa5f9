"""The plan of a fleet in a field, without a run: who works what, which way, from when to when.

It is made by what robots use: the division of the field, the times of the bodies, the ways, and the
plan of the fleet (`agent/field/fleet_plan.py`). It is the plan that the peers of a run make first.
Later they plan again, with what has happened.
"""

from collections.abc import Mapping, Sequence
from math import dist
from typing import NamedTuple

import numpy as np
import shapely
from pyproj import Transformer
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from agent.field.field_map import Field, Section
from agent.field.fleet_plan import JOBS_MAX, FleetPlan, FreedRobot, Rows
from agent.field.plan_schedule import Visit, visits
from agent.field.section_shares import SectionJob, shares
from agent.field.travel_times import Remainder, TravelTimes
from agent.interface.geometry import Point, Polyline
from agent.interface.vehicle import DriveTrain
from agent.runtime.files.field_error import LonLat
from agent.runtime.files.field_file import plane
from protocol.frames.codec import decode, encode
from protocol.frames.fleet_frames import NOBODY, Pose
from sim.runs.work_record import Rings, ToDegrees, WorkRecord
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ScenarioError
from sim.world.coverage_truth import sample_points
from sim.world.reachable_ground import Unreached

# A unit is done if this share of its stripe is. The outline of finished work is simplified by 2 cm,
# which is 1 % of a stripe of 2 m at both of its sides.
DONE_SHARE = 0.98
HERE_M = 0.01  # a shorter way is none
ROBOT_ADDRESS = 128  # any: the place in a frame does not depend on its sender
FLEET_PLAN, EQUAL_RUNS = "plan of the fleet", "runs of equal work"


class PlannedSwath(NamedTuple):
    """A swath, or what is left of it, in the direction in which it is driven. Times in seconds."""

    points: tuple[LonLat, ...]
    starts_at_s: float
    ends_at_s: float


class PlannedSection(NamedTuple):
    """One section of a robot's row. Times in seconds from the start of the fleet."""

    section: int
    way: tuple[LonLat, ...]  # to its first swath; empty if that begins where the robot is
    leaves_at_s: float  # for it
    starts_at_s: float
    ends_at_s: float
    swaths: tuple[PlannedSwath, ...]
    ground: tuple[Rings, ...]  # the ground of its swaths


class RobotPlan(NamedTuple):
    """The row of one robot."""

    robot: int
    start: LonLat
    sections: tuple[PlannedSection, ...]

    @property
    def work_for_s(self) -> float:
        """Seconds inside sections, with the turns between their swaths."""
        return sum(s.ends_at_s - s.starts_at_s for s in self.sections)

    @property
    def ways_for_s(self) -> float:
        """Seconds between sections, and from the start to the first one."""
        return sum(s.starts_at_s - s.leaves_at_s for s in self.sections)

    @property
    def ends_at_s(self) -> float:
        """When the last section is worked; 0 without sections."""
        return self.sections[-1].ends_at_s if self.sections else 0.0


class WorkPlan(NamedTuple):
    """The plan of one field. Places are longitudes and latitudes in degrees (WGS 84)."""

    name: str
    hectares: float
    width_mm: int  # of the implement
    boundary: Rings
    method: str  # FLEET_PLAN, or EQUAL_RUNS in a field with very many sections
    sections: int  # of the field
    done: int  # of them, before the plan
    apart: int  # of them, behind passages that are too narrow; not planned
    robots: tuple[RobotPlan, ...]
    unreached: tuple[Unreached, ...]  # ground of the field that these bodies cannot work, and why

    @property
    def ends_at_s(self) -> float:
        """When the last robot has worked its last section."""
        return max(robot.ends_at_s for robot in self.robots)


def plan_work(setup: FieldSetup, done: WorkRecord | None = None, seed: int = 0) -> WorkPlan:
    """Plan what is left of a field for the robots of a setup.

    `done`: finished work; None: none. `seed`: of the search; robots use 0. Raises ScenarioError for
    bodies that steer: they choose the order of their stretches as they drive.
    """
    if setup.vehicle.drive is not DriveTrain.MECANUM:
        raise ScenarioError(
            f"{setup.scenario.name}: fleet.drive: only fleets with 'mecanum' are planned; bodies that "
            "steer choose as they drive"
        )
    field, travel = setup.field, setup.plan.travel
    covered = covered_units(field, done)
    left = left_of(field, travel, covered)
    # As robot 0 knows the fleet: its own place, and those of the others as their frames tell them.
    places = [setup.starts[0], *(_heard(start) for start in setup.starts[1:])]
    robots = {slot: FreedRobot(place, 0) for slot, place in enumerate(places)}
    drawn, method, planned = _Drawing(setup, covered), FLEET_PLAN, []
    parts = [setup.plan.parts.part_at(start) for start in setup.starts]
    for part in sorted(set(parts)):
        mine = {slot: robots[slot] for slot in robots if parts[slot] == part}
        apart = setup.plan.parts.apart_from(setup.starts[min(mine)])
        here = {section: rest for section, rest in left.items() if section not in apart}
        plan = FleetPlan(travel, seed)
        if len(here) <= JOBS_MAX:
            rows = plan.plan(here, mine)
        else:
            starts = {slot: setup.starts[slot] for slot in mine}
            rows, method = _equal_runs(field, travel, here, starts), EQUAL_RUNS
        problem = plan.problem(here, [mine[slot] for slot in sorted(mine)]) if here else None
        jobs = sorted(here)
        job_of = {section: job for job, section in enumerate(jobs)}
        for robot, slot in enumerate(sorted(mine)):
            row = [job_of[section] for section in rows[slot]]
            planned.append(
                drawn.robot(slot, [] if problem is None else visits(problem, robot, row), jobs)
            )
    return WorkPlan(
        field.name, field.polygon.area / 1e4, round(field.implement_width_m * 1000),
        drawn.to_degrees.rings(field.polygon), method,
        len(field.sections), len(field.sections) - len(left),
        len(setup.unreachable & left.keys()),
        tuple(sorted(planned, key=lambda robot: robot.robot)),
        setup.ground(sample_points(field.polygon, field.implement_width_m, field.overlap_m)).unreached,
    )  # fmt: skip


def _heard(place: Point) -> Point:
    """A place of a standing robot as others hear it."""
    _, pose = decode(encode(Pose(*place, 0.0, 0.0, 0, False, NOBODY), ROBOT_ADDRESS))
    assert isinstance(pose, Pose)
    return pose.x_m, pose.y_m


def left_of(
    field: Field, travel: TravelTimes, covered: Mapping[int, frozenset[int]]
) -> dict[int, Remainder | None]:
    """The sections with uncovered units, and what is left of each; None: all.

    `covered`: units of each section.
    """
    left: dict[int, Remainder | None] = {}
    for section in field.sections:
        units = covered.get(section.id, frozenset())
        if not units:
            left[section.id] = None
        elif len(units) < section.units:
            left[section.id] = travel.remainder(section, units.__contains__)
    return left


def covered_units(field: Field, done: WorkRecord | None) -> dict[int, frozenset[int]]:
    """The units whose ground is in the finished work, by section."""
    if done is None or not done.covered:
        return {}
    to_metres = Transformer.from_crs("EPSG:4326", plane(field.origin), always_xy=True).transform
    parts = []
    for rings in done.covered:
        in_metres = []
        for ring in rings:
            east, north = to_metres([p[0] for p in ring], [p[1] for p in ring])
            in_metres.append(list(zip(east, north, strict=True)))
        parts.append(shapely.make_valid(Polygon(in_metres[0], in_metres[1:])))
    worked = shapely.unary_union(parts)
    shapely.prepare(worked)
    half_m = (field.implement_width_m - field.overlap_m) / 2
    # No bar sweeps the ground in a corner beyond this (`sim/world/coverage_truth.py`).
    reach = field.polygon.buffer(-field.implement_width_m / 2).buffer(half_m)
    covered = {}
    for section in field.sections:
        stripes = [LineString(line).buffer(half_m, cap_style="flat") for line in section.unit_lines]
        asked = shapely.intersection(np.array(stripes), field.polygon)
        swept = shapely.intersection(asked, reach)
        asked = np.where(shapely.is_empty(swept), asked, swept)
        share = shapely.area(shapely.intersection(asked, worked)) / np.maximum(
            shapely.area(asked), 1e-9
        )
        covered[section.id] = frozenset(np.flatnonzero(share >= DONE_SHARE).tolist())
    return covered


def _equal_runs(
    field: Field,
    travel: TravelTimes,
    left: Mapping[int, Remainder | None],
    starts: Mapping[int, Point],
) -> Rows:
    """Runs of equal work, each begun at the end that is nearer, as robots take too many sections."""
    jobs = []
    for section, rest in sorted(left.items()):
        work_for_ms = int(travel.work_for_ms[section]) if rest is None else rest.work_for_ms
        jobs.append(SectionJob(section, work_for_ms / 1000, field.section(section).ends))
    runs = shares(jobs, dict(starts), travel.speed_m_s)
    return {slot: [job.section for job in run] for slot, run in runs.items()}


class _Drawing:
    """Geometry of a plan, in degrees."""

    def __init__(self, setup: FieldSetup, covered: Mapping[int, frozenset[int]]) -> None:
        self.setup, self.covered = setup, covered
        self.to_degrees = ToDegrees(setup.field.origin)

    def robot(self, slot: int, row: Sequence[Visit], jobs: Sequence[int]) -> RobotPlan:
        at, planned = self.setup.starts[slot], []
        for visit in row:
            section = self.setup.field.section(jobs[visit.job])
            lines = self._lines(section, visit.entry)
            goal = lines[0][0]
            way = () if dist(at, goal) < HERE_M else self.setup.plan.route.path(at, goal)
            planned.append(
                PlannedSection(
                    section.id, self.to_degrees.points(way), visit.leaves_at_ms / 1000,
                    visit.begins_at_ms / 1000, visit.ends_at_ms / 1000,
                    self._swaths(lines, visit.begins_at_ms, visit.ends_at_ms), self._ground(lines),
                )
            )  # fmt: skip
            at = lines[-1][-1]
        return RobotPlan(slot, self.to_degrees.points([self.setup.starts[slot]])[0], tuple(planned))

    def _lines(self, section: Section, entry: int) -> list[Polyline]:
        """What is left of a section, as it is driven from one of its ends."""
        units = self.covered.get(section.id, frozenset())
        lines = [line for line, _ in section.stretches(lambda unit: unit not in units)]
        return lines if entry == 0 else [line[::-1] for line in reversed(lines)]

    def _swaths(
        self, lines: Sequence[Polyline], begins_at_ms: int, ends_at_ms: int
    ) -> tuple[PlannedSwath, ...]:
        travel, now_ms, found = self.setup.plan.travel, float(begins_at_ms), []
        for k, line in enumerate(lines):
            if k:
                turn_m = dist(lines[k - 1][-1], line[0])
                now_ms += 1000 * float(travel.straight_for_s(np.array([turn_m]))[0])
            starts_at_ms, now_ms = now_ms, now_ms + travel.driven_for_ms([line])
            # Milliseconds of each swath are rounded; the last one ends with its section.
            end_at_ms = ends_at_ms if k + 1 == len(lines) else now_ms
            found.append(
                PlannedSwath(
                    self.to_degrees.points(line),
                    round(starts_at_ms / 1000, 3),
                    round(end_at_ms / 1000, 3),
                )
            )
        return tuple(found)

    def _ground(self, lines: Sequence[Polyline]) -> tuple[Rings, ...]:
        field = self.setup.field
        half_m = field.implement_width_m / 2
        stripes = [
            LineString(line).buffer(half_m, cap_style="flat", join_style="mitre") for line in lines
        ]
        ground: BaseGeometry = shapely.unary_union(stripes).intersection(field.polygon)
        parts = getattr(ground, "geoms", [ground])
        return tuple(
            self.to_degrees.rings(p) for p in parts if isinstance(p, Polygon) and p.area > 0.0
        )
