"""A hundred whole robots on one core: range sensors, maps, ways, avoidance, wheels, and no messages.

A warehouse of racks. Each robot has an occupancy grid of its own, into which each of its scans goes,
plans over it when it has a new goal or something solid is on its path, follows the path, and is kept
from the others and the racks by ORCA.
"""

from collections.abc import Iterator
from math import hypot
from random import Random
from time import process_time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.obstacle_tree import obstacle_tree
from agent.interface.config import CONTROL_PERIOD_US, NEIGHBOUR_RANGE_M, NEIGHBOURS_MAX, S
from agent.interface.effects import Drive
from agent.interface.geometry import Point
from agent.mapping.occupancy_grid import CELL_M, OccupancyGrid
from agent.motion.path_tracker import PathTracker
from sim.world.drive_trains import Chassis
from sim.world.lidar import Lidar
from sim.world.world import World
from tools.bench.figure import Figure
from tools.bench.kernels import agent_table as column
from tools.bench.kernels.occupancy_fleet import OccupancyFleet
from tools.bench.kernels.orca_fleet import OrcaFleet

SIDE_M, ROBOTS, RAYS, RANGE_M = 30.0, 100, 36, 4.0
RADIUS_M, SPEED_M_S, ACCELERATION_M_S2 = 0.3, 1.0, 2.0
MARGIN_M = 0.06  # of ORCA: wheels slip and take a period to act
HORIZON_S, WALL_HORIZON_S = 2.0, 0.5
ARRIVED_M, AHEAD_M = 0.4, 2.0
FASTER = 10.0
LOST_M = 1.0  # a robot that is further off its path plans another


def racks() -> list[list[Point]]:
    """Five rows of three, 1 m deep, with aisles of 3.5 m and more."""
    found = []
    for row in range(5):
        for place in range(3):
            # On borders of cells, as the map has them.
            west, south = (3.4 + 8.6 * place, 3.4 + 5.2 * row)
            east, north = west + 6.0, south + 1.0
            found.append([(west, south), (east, south), (east, north), (west, north)])
    return found


def solid() -> NDArray[np.bool_]:
    """The racks as a grid (rows, columns), True where a cell's centre is in one."""
    count = round(SIDE_M / CELL_M)
    middle = (np.arange(count) + 0.5) * CELL_M
    blocked = np.zeros((count, count), dtype=np.bool_)
    for (west, south), _, (east, north), _ in racks():
        rows, columns = (middle > south) & (middle < north), (middle > west) & (middle < east)
        blocked |= rows[:, None] & columns[None, :]
    return blocked


class RobotsResult(NamedTuple):
    """What came of the robots, and how much faster than real time they were simulated."""

    times_real: float
    contacts: int
    goals: int
    closest_m: float


class Crowd:
    """The robots and what each of them knows."""

    def __init__(self, seed: int) -> None:
        self.rng = Random(f"{seed}/whole robots")
        boundary: list[Point] = [(0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M)]
        self.world = World([boundary, *racks()], seed, Lidar(RAYS, RANGE_M))
        chassis = Chassis(speed_m_s=SPEED_M_S, acceleration_m_s2=ACCELERATION_M_S2)
        blocked = solid()
        self.maps = OccupancyFleet(ROBOTS, blocked, (0.0, 0.0), RADIUS_M, RADIUS_M + CELL_M)
        for slot in range(ROBOTS):
            self.world.add_robot(slot, self._start(), RADIUS_M, chassis)
        agents = np.zeros((ROBOTS, column.AGENT_COLUMNS), dtype=np.float32)
        agents[:, column.RADIUS] = RADIUS_M + MARGIN_M
        agents[:, column.SPEED_MAX], agents[:, column.RANGE] = SPEED_M_S, NEIGHBOUR_RANGE_M
        agents[:, column.NEIGHBOURS] = NEIGHBOURS_MAX
        agents[:, column.HORIZON], agents[:, column.WALL_HORIZON] = HORIZON_S, WALL_HORIZON_S
        walls = obstacle_tree([boundary[::-1], *racks()])
        self.fleet = OrcaFleet(agents, CONTROL_PERIOD_US / S, walls)
        self.trackers: list[PathTracker | None] = [None] * ROBOTS
        self.goals = [self._goal() for _ in range(ROBOTS)]
        self.reached = 0

    def _start(self) -> Point:
        while True:
            spot = self._goal()
            others = (body.position for body in self.world.robots.values())
            if all(hypot(spot[0] - x, spot[1] - y) > 3 * RADIUS_M for x, y in others):
                return spot

    def _goal(self) -> Point:
        clear_m = RADIUS_M + 0.5
        while True:
            x = self.rng.uniform(clear_m, SIDE_M - clear_m)
            y = self.rng.uniform(clear_m, SIDE_M - clear_m)
            if not any(
                ring[0][0] - clear_m < x < ring[2][0] + clear_m
                and ring[0][1] - clear_m < y < ring[2][1] + clear_m
                for ring in racks()
            ):
                return x, y

    def tick(self) -> None:
        """One control period of all robots."""
        world, agents = self.world, self.fleet.agents
        now_us = world.now_us
        motion = world.motion
        agents[:, column.X : column.Y + 1] = motion[:, :2]
        agents[:, column.VX : column.VY + 1] = motion[:, 3:5]
        news = self.maps.observe(motion[:, :3], world.ranges_of_all(), RANGE_M)
        wanted = []
        for slot, at in enumerate(motion[:, :2].tolist()):
            tracker = self._way(slot, tuple(at), self.maps.grids[slot], news[slot] > 0)
            wanted.append(tracker.velocity(*at))
        agents[:, column.WANT_X : column.WANT_Y + 1] = wanted
        self.fleet.step(move=False)
        chosen = agents[:, column.NEW_VX : column.NEW_VY + 1].tolist()
        for slot, (vx_m_s, vy_m_s) in enumerate(chosen):
            world.body(slot).drive(Drive(vx_m_s, vy_m_s), now_us)
        world.advance(now_us + CONTROL_PERIOD_US)

    def _way(self, slot: int, at: Point, grid: OccupancyGrid, news: bool) -> PathTracker:
        goal = self.goals[slot]
        if hypot(goal[0] - at[0], goal[1] - at[1]) < ARRIVED_M:
            self.reached += 1
            self.goals[slot], self.trackers[slot] = self._goal(), None
        tracker = self.trackers[slot]
        if tracker is not None:
            tracker.locate(*at)
            if abs(tracker.off_m) < LOST_M and not (news and self._blocked(tracker, grid)):
                return tracker
        path = grid.plan(at, self.goals[slot]) or [at, self.goals[slot]]
        tracker = self.trackers[slot] = PathTracker(path, SPEED_M_S, ACCELERATION_M_S2 / 2)
        tracker.locate(*at)
        return tracker

    def _blocked(self, tracker: PathTracker, grid: OccupancyGrid) -> bool:
        blocked, ahead = grid.tight.blocked, tracker.ahead(AHEAD_M)
        return any(blocked[int(y / CELL_M), int(x / CELL_M)] for x, y, _, _ in ahead)


def race(seed: int, seconds: float) -> RobotsResult:
    """Simulate so many seconds of a hundred robots on one core."""
    crowd = Crowd(seed)
    for _ in range(20):  # compiles, and fills the first maps
        crowd.tick()
    ticks = round(seconds * S / CONTROL_PERIOD_US)
    start_s = process_time()
    for _ in range(ticks):
        crowd.tick()
    spent_s = process_time() - start_s
    world = crowd.world
    return RobotsResult(seconds / spent_s, len(world.contacts), crowd.reached, world.closest_m)


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """How many times faster than real time a hundred robots run, and whether they touch."""
    seconds = 10.0 if quick else 60.0
    result = race(seed, seconds)
    scope = (
        f"{SIDE_M:g} m of racks, {RAYS} rays, {seconds:g} s, one core; {result.goals} goals reached"
    )
    yield Figure(
        f"{ROBOTS} whole robots without messages", result.times_real, "x real time",
        f">= {FASTER:g}", result.times_real >= FASTER, "", scope,
    )  # fmt: skip
    yield Figure(
        f"{ROBOTS} whole robots: contacts", result.contacts, "", "= 0", not result.contacts, "",
        f"smallest gap {result.closest_m:.2f} m",
    )  # fmt: skip
