"""Two ROS 2 robots worked through a field by two peers: `headland robot` with the body `ros2`.

The robots are rclpy nodes with integrators of their own (`sim/machines/ros2_machine.py`).
What they worked is computed from their traces, and from nothing that a peer says.
"""

import os
import subprocess
import tempfile
import time
from math import hypot
from pathlib import Path
from secrets import randbelow
from typing import Any, Final, NamedTuple

from sim.files.strict_json import dumps
from sim.fleet.outcome import COVERAGE_MIN
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from sim.world.coverage_truth import coverage, sample_points
from sim.world.ground_truth import TrackPoint
from tools.common.child_process import module_command

ROBOTS: Final = 2
LIMIT_S: Final = 600.0
LOOK_S: Final = 2.0
CORNERS: Final = ((5.0, 52.0), (5.0003, 52.0), (5.0003, 52.00018), (5.0, 52.00018), (5.0, 52.0))
FLEET: Final = """
name = "ros2"
[fleet]
robots = 2
drive = "differential"
radius_m = 0.8
speed_m_s = 1.5
[field]
file = "field.geojson"
implement_width_m = 3.0
"""
ROBOT: Final = """
[bus]
interface = "udp_multicast"
channel = "{group}"
[body]
plugin = "ros2"
options = {{ domain = {domain}, implement_state = "implement_state" }}
"""


class FieldWorked(NamedTuple):
    """What came of the work, from the traces of the machines."""

    reached: float  # share worked of what can be reached
    for_s: float
    closest_m: float  # between the middles of the two
    velocities: int  # received by both
    missed: list[tuple[float, float]]  # centres of the cells that were not worked, metres


def worked_field(limit_s: float = LIMIT_S) -> FieldWorked:
    """Work the field to its end, or for `limit_s` seconds."""
    from sim.machines.ros2_machine import Ros2Machine

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain, group = 1 + randbelow(100), f"239.74.162.{1 + randbelow(250)}"
    machines: list[Any] = []
    robots: list[subprocess.Popen[str]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "field.geojson").write_text(dumps({"type": "Polygon", "coordinates": [CORNERS]}))
        (folder / "scenario.toml").write_text(FLEET)
        (folder / "fleet.toml").write_text(FLEET + ROBOT.format(group=group, domain=domain))
        setup = FieldSetup(load(str(folder / "scenario.toml")))
        raster = sample_points(
            setup.field.polygon, setup.field.implement_width_m, setup.field.overlap_m
        )
        ground = setup.ground(raster)
        try:
            for slot, (x_m, y_m) in enumerate(setup.starts):
                machine = Ros2Machine(f"/robot_{slot}", domain, x_m, y_m, 0.0)
                machines.append(machine)
                machine.start()
            for slot in range(ROBOTS):
                words = module_command("tools.cli.headland")
                robots.append(
                    subprocess.Popen(
                        [*words, "robot", "fleet.toml", "--slot", str(slot), "--first-boot"],
                        cwd=folder, stdout=subprocess.DEVNULL, text=True,
                    )
                )  # fmt: skip
            begun_s = time.monotonic()
            reached, missed = 0.0, []
            while time.monotonic() - begun_s < limit_s and reached < COVERAGE_MIN:
                time.sleep(LOOK_S)
                tracks = {slot: _thinned(machine.trace) for slot, machine in enumerate(machines)}
                width_m = setup.field.implement_width_m
                worked = coverage(raster, tracks, width_m, ground.cells)
                reached = worked.reached
                missed = [(round(float(x), 2), round(float(y), 2)) for x, y in worked.missed]
            for_s = time.monotonic() - begun_s
        finally:
            for robot in robots:
                robot.terminate()
            for robot in robots:
                robot.wait(20.0)
            for machine in machines:
                machine.close()
    closest_m = min(
        hypot(a.x_m - b.x_m, a.y_m - b.y_m)
        for a, b in zip(machines[0].trace, machines[1].trace, strict=False)
    )
    heard = sum(machine.heard for machine in machines)
    return FieldWorked(reached, for_s, closest_m, heard, missed)


def _thinned(trace: list[Any]) -> list[TrackPoint]:
    """Every fifth point of 10 ms, and those at which the implement goes up or down."""
    trace = list(trace)  # it grows meanwhile
    before = [None, *(point.implement for point in trace)]
    return [
        (p.at_us, p.x_m, p.y_m, p.implement)
        for k, p in enumerate(trace)
        if k % 5 == 0 or p.implement is not before[k]
    ]
