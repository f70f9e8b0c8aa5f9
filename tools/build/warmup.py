"""`headland compile --kernels`: compile the kernels once, so that no robot waits for it in the field."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing import Pool
from threading import Thread

import numpy as np
from rich.console import Console

from sim.files.strict_json import dumps
from tools.build.kernel_cache import kernels_kept
from tools.common.child_process import module_command
from tools.common.compiled_caches import end_with_temporary


def _paths() -> None:
    from agent.paths.any_angle_planner import Planner

    blocked = np.zeros((8, 8), dtype=bool)
    blocked[3:5, 3:5] = True
    planner = Planner(blocked)
    planner.plan((0, 0), (7, 7))
    planner.update([(4, 4, False)])


def _plain_paths() -> None:
    from agent.paths.any_angle_planner import Planner

    Planner(np.zeros((8, 8), dtype=bool)).plan_plain((0, 0), (7, 7))  # the last resort of a search


def _map() -> None:
    from agent.mapping.occupancy_grid import OccupancyGrid

    grid = OccupancyGrid(30, 30, (0.0, 0.0), 0.3)
    grid.observe((1.0, 1.0), 0.0, [2.0] * 8, 4.0)
    grid.plan((1.0, 1.0), (5.0, 5.0))


def _avoidance() -> None:
    from agent.avoidance.fence_braking import braking_first
    from agent.avoidance.fence_distance import gap_m, way_gap_m
    from agent.avoidance.orca import OrcaSolver

    fences = np.array([[0.0, 0.0, 9.0, 0.0]])
    gap_m(1.0, 1.0, fences)
    way_gap_m(1.0, 1.0, 1.0, 0.0, 0.5, 3, fences)
    braking_first(1.0, 1.0, 1.0, 0.0, 0.5, 0.0, 1.0, 0.0, fences, 0.5, 1.0)
    robot = OrcaSolver(0.5, 2.0, 1.0, 4.0, 0.05, fences)
    rows: list[tuple[float, ...]] = [
        (1.5, 0.1, -1.0, 0.0, 1.0, 0.5),
        (0.1, 1.2, 0.0, -1.0, 1.0, 0.5),
    ]
    robot.velocity((3.0, 1.0), (1.0, 0.0), (1.5, 0.0), rows)


def _coverage() -> None:
    from agent.coverage.approach import lay
    from agent.coverage.team import Team

    team = Team(np.zeros((6, 6), dtype=np.bool_), [(0, 0), (3, 3)])
    grid = team.grid  # paths to far runs, which only larger places have
    lay(grid.free, grid.free, grid.width, team.number((0, 0)), team.number((5, 5)), grid.queue)
    while team.remaining():
        team.advance()


def _agreement() -> None:
    from agent.interface.observation import Observation
    from agent.mapf import sum_of_costs
    from agent.mapf.lacam import planned
    from agent.mapf.linear_assignment import assigned
    from agent.mapping.building import Floor
    from agent.motion.unexplained_echoes import UnexplainedEchoes

    assigned(np.ones((2, 3)))
    floor = Floor.drawn("...\n...", 1.0, 0.35)
    # One of them has to wait, so its route is put back as well.
    planned(floor.lattice.near, [0, 2], [2, 0])
    sum_of_costs.planned(floor.lattice.near, [0, 2], [2, 0])
    hall = Floor.drawn("\n".join(["....."] * 4), 1.0, 0.35)
    planned(hall.lattice.near, list(range(12)), list(range(11, -1, -1)))  # many: in groups
    here = Observation(1.5, 0.5, 0.0, 0.0, 0.0, (0.5, 1.0, 1.5))
    UnexplainedEchoes(floor.fences, 0.35).strange(here, 5.0, [(0.5, 0.5)])


def _exploration() -> None:
    from agent.exploration.frontier import frontiers, wave_from

    values = np.zeros((12, 12), dtype=np.int64)
    values[:, :6] = 1  # free; the rest is unknown
    frontiers(values, wave_from(values == 1, (5, 1)), 3)


def _delivery() -> None:
    from agent.delivery.cost_matrix import Carrier, CostMatrix, Trip, workload
    from agent.delivery.tour_auction import RoutingPlanner
    from agent.mapping.building import Floor
    from agent.paths.nav_mesh import Mesh

    floor = Floor.drawn("......\n..##..\n......", 1.0, 0.3)
    costs = CostMatrix(Mesh(floor.inflated, floor.origin, floor.fine_m))
    trips = [Trip((0.5, 0.5), (5.5, 0.5)), Trip((5.5, 2.5), (0.5, 2.5))]
    planner = RoutingPlanner(workload(costs, Carrier(1.0, 2.0), trips, [(0.5, 1.5)], [0]))
    first = planner.auctioned()
    planner.inserted(0, first[0][:1], first[0][1])
    planner.improved(first, 1, 10)
    planner.hastened(first, 1, 10)


def _wire() -> None:
    from sim.can.frame_timing import frame_bits

    frame_bits(0x18FF1080, bytes(8))


def _world() -> None:
    from agent.interface.effects import Drive
    from sim.world.drive_trains import Chassis
    from sim.world.lidar import Lidar
    from sim.world.world import World

    ring = [(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]
    world = World([ring], 0, Lidar(8, 4.0), engine="contact_free")
    world.add_robot(0, (5.0, 5.0), 0.5, Chassis())
    world.ranges(0)
    world.body(0).drive(Drive(1.0, 0.0, 0.0, True), 0)
    world.advance(1_000_000)
    world.engine = "pymunk"
    world.advance(1_100_000)


def _verdict() -> None:
    """What a run is judged by when it is over."""
    from shapely.geometry import box

    from sim.world.coverage_truth import coverage, sample_points
    from sim.world.reachable_ground import WorkingBody, reachable_ground

    raster = sample_points(box(0, 0, 20, 20), 2.0, 0.2)
    coverage(raster, {0: [(0, 5.0, 5.0, True), (1_000_000, 6.0, 5.0, True)]}, 2.0)
    reachable_ground(box(0, 0, 20, 20), raster, WorkingBody(2.0, 0.2, 0.5, 1.5), [(5.0, 5.0)])


def _wheels() -> None:
    from agent.interface.effects import Drive
    from agent.interface.vehicle import DriveTrain, Vehicle
    from agent.motion.wheel_kinematics import WheelBase, WheelDrive

    for drive in DriveTrain:
        wheels = WheelDrive(WheelBase.of(Vehicle(drive=drive), 0.3))
        wheels.speeds(Drive(1.0, 0.5, 0.1), 0.2)


def _fields() -> None:
    """Half a minute of two robots in a yard, of each drive train: plans, ways, and avoidance."""
    from sim.runs.field_run import FieldRun
    from sim.scenarios.field_setup import FieldSetup
    from sim.scenarios.scenario import load

    yard = load("yard").with_engine("contact_free")
    for drive in ("mecanum", "differential", "ackermann"):
        FieldRun(FieldSetup(yard.changed(2, 1, drive=drive, time_limit_s=YARD_S))).run()


def _plans() -> None:
    from agent.field.fleet_plan import PlanProblem, solve

    ready, work = np.zeros(2, dtype=np.int64), np.full(3, 1000, dtype=np.int64)
    lead, link = np.ones((2, 6), dtype=np.int64), np.ones((6, 6), dtype=np.int64)
    solve(PlanProblem(ready, lead, work, link), None)


def _fleets() -> None:
    """What simulations of many robots compute for all of them at once."""
    from agent.avoidance.obstacle_tree import obstacle_tree
    from agent.avoidance.orca import OrcaSolver
    from sim.world.drive_trains import Chassis
    from sim.world.lidar import Lidar
    from sim.world.world import World

    ring = [(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]
    walls = obstacle_tree([ring[::-1]])
    OrcaSolver(0.5, 2.0, 1.0, 4.0, 0.05, np.zeros((0, 4)), walls=walls).among_known(
        (5.0, 5.0), (0.0, 0.0), (1.0, 0.0), 0.0
    )
    world = World([ring], 0, Lidar(8, 4.0))
    world.add_robot(0, (5.0, 5.0), 0.5, Chassis())
    try:
        from tools.bench.kernels.agent_table import AGENT_COLUMNS
        from tools.bench.kernels.occupancy_fleet import OccupancyFleet
        from tools.bench.kernels.orca_fleet import OrcaFleet
    except ModuleNotFoundError:
        return  # a wheel has no benches
    OrcaFleet(np.ones((2, AGENT_COLUMNS), dtype=np.float32), 0.05, walls).step()
    maps = OccupancyFleet(1, np.zeros((100, 100), dtype=np.bool_), (0.0, 0.0), 0.5, 0.7)
    maps.observe(world.motion[:, :3], world.ranges_of_all(), 4.0)


def _turns() -> None:
    from agent.paths.tractor_route import TurnRoute, VehiclePose

    blocked = np.zeros((80, 80), dtype=bool)
    blocked[:4] = True
    route = TurnRoute(blocked, 0.0, 0.0, 0.25, 1.8)
    route.way(VehiclePose(3.0, 3.0, 0.0), VehiclePose(9.0, 9.0, 1.0))
    route.way(VehiclePose(9.0, 1.2, -1.57), VehiclePose(9.0, 1.2, 1.57))


YARD_S = 30.0  # in virtual time: a section is done, and the next one begun

# Longest first: two processes then end at about the same time.
PARTS: tuple[tuple[str, Callable[[], None]], ...] = (
    ("coverage", _coverage),
    ("fields", _fields),
    ("paths", _paths),
    ("plain paths", _plain_paths),
    ("plans", _plans),
    ("delivery", _delivery),
    ("fleets", _fleets),
    ("agreement", _agreement),
    ("turns", _turns),
    ("world", _world),
    ("verdict", _verdict),
    ("avoidance", _avoidance),
    ("map", _map),
    ("exploration", _exploration),
    ("wire", _wire),
    ("wheels", _wheels),
)


# Of a field's run: each half takes about as long as the other, and they share hardly a kernel.
FIELD_HERE, FIELD_BESIDE = ("plans", "world"), ("paths", "avoidance")
FIELD_LATER = ("plain paths", "verdict")  # not needed before the end


NO_LAUNCH = ("coverage", "exploration")  # missions that `headland launch` has not
Step = Callable[[int, int, str], object]  # parts done, of how many, the name of the next one


def warm(steering: bool, delivering: bool = False, on_step: Step | None = None) -> None:
    """Compile what a launch needs and is not compiled; a fraction of a second where everything is.

    `on_step` is called before each part. On a new machine a second process compiles every other part.
    """
    # Only bodies that steer plan turns, and only simulations compute for all robots at once.
    # Playing in fields takes seconds also where everything is compiled.
    left_out = {"fleets", "fields", *NO_LAUNCH}
    left_out |= (set() if steering else {"turns"}) | (set() if delivering else {"delivery"})
    parts = [each for each in PARTS if each[0] not in left_out]
    other = _beside([name for name, _ in parts[1::2]]) if kernels_kept() == 0 else None
    # Those that the other process compiles come last: they are found compiled then, or nearly so.
    ordered = parts if other is None else parts[::2] + parts[1::2]
    try:
        for done, (name, part) in enumerate(ordered):
            if on_step is not None:
                on_step(done, len(ordered), name)
            if other is not None and done == len(parts[::2]):
                other.wait()
            part()
    finally:
        if other is not None and other.poll() is None:
            other.kill()


def rehearse() -> None:
    """Call every kernel as robots do."""
    for name, part in PARTS:
        if name not in ("fleets", "wire", "world", "verdict"):  # of simulations alone
            part()


def warm_field() -> None:
    """Compile what a run of a field needs, half of it in a second process.

    What only its end needs is compiled while it goes on. What another process could not do, the run
    does when it comes to it.
    """
    with _beside(FIELD_BESIDE) as other:
        try:
            _compile(FIELD_HERE)
        except BaseException:
            other.kill()
            raise
    later = _beside(FIELD_LATER)
    end_with_temporary(later)
    Thread(target=later.wait, daemon=True).start()


def _beside(names: Sequence[str]) -> "subprocess.Popen[bytes]":
    words = [*module_command("tools.build.warmup"), *names]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _compile(names: Sequence[str]) -> None:
    parts = dict(PARTS)
    for name in names:
        parts[name]()


def main(jobs: int, as_json: bool = False) -> int:
    """`jobs`: processes beside each other, 0: one for each core. `as_json`: then the lines for people go
    to standard error."""
    console, begun_s = Console(stderr=as_json), time.perf_counter()
    spent: dict[str, float] = {}
    numbers = range(len(PARTS))
    with (
        Pool(min(jobs or os.cpu_count() or 1, len(PARTS)), _leave_signals) as pool,
        console.status("compiling ..."),
    ):
        for name, spent_s in pool.imap_unordered(_compiled, numbers):
            console.print(f"{name:11} {spent_s:6.1f} s")
            spent[name] = round(spent_s, 1)
    # In a process of its own, which has imported no kernel: it finds them compiled.
    subprocess.run(module_command("tools.build.kernel_module"), check=False)
    total_s = time.perf_counter() - begun_s
    console.print(f"ready after {total_s:.1f} s; a first start without this takes longer")
    if as_json:
        print(dumps({"spent_s": spent, "total_s": round(total_s, 1)}))
    return 0


def _leave_signals() -> None:
    """Called in a worker: it leaves Ctrl-C to the process in front, which ends it by SIGTERM.

    The handler of a command is not kept: Python runs it between two instructions, so a worker that had
    just begun to wait for a lock would not end, and the command neither."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _compiled(number: int) -> tuple[str, float]:
    name, part = PARTS[number]
    start_s = time.perf_counter()
    part()
    return name, time.perf_counter() - start_s


if __name__ == "__main__":
    _compile(sys.argv[1:])
