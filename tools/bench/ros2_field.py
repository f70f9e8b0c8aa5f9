"""Two ROS 2 robots worked through a field by two peers: `headland robot` with the body `ros2`.

    python -m tools.bench.ros2_field NAMESPACE DOMAIN X_M Y_M TRACE    # one machine

The robots are rclpy nodes with integrators of their own (`sim/machines/ros2_machine.py`), each in a
process. In one with the judge they missed odometry while it computed, and peers stood for old places.
What they worked is computed from their traces, and from nothing that a peer says.

Beside them `headland ros2` publishes the fleet, and an rclpy node of the bench subscribes. What it is
sent is compared, message by message, with the places that a listener hears on the bus.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from itertools import dropwhile
from pathlib import Path
from secrets import randbelow
from typing import Any, Final, NamedTuple

import numpy as np

from sim.files.strict_json import dumps
from sim.fleet.outcome import COVERAGE_MIN
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from sim.world.coverage_truth import coverage, sample_points
from sim.world.ground_truth import TrackPoint
from tools.bench.ros2_reader import Place
from tools.common.child_process import module_command

ROBOTS: Final = 2
LIMIT_S: Final = 600.0
LOOK_S: Final = 5.0
TELL_S: Final = 1.0  # between two writes of a trace
DRAIN_S: Final = 2.0  # for what is on its way when the work is done
POSES_MIN: Final = 100  # compared at least
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
    poses: int  # on the bus, from the first that the reader of the topics was sent
    lost: int  # of these, not sent to the reader as odometry, or another place


def worked_field(limit_s: float = LIMIT_S) -> FieldWorked:
    """Work the field to its end, or for `limit_s` seconds."""
    from tools.bench.ros2_reader import PlacesOfBus, PlacesOfTopics

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain, group = 1 + randbelow(100), f"239.74.162.{1 + randbelow(250)}"
    processes: list[subprocess.Popen[str]] = []
    machines: list[subprocess.Popen[str]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "field.geojson").write_text(dumps({"type": "Polygon", "coordinates": [CORNERS]}))
        (folder / "scenario.toml").write_text(FLEET)
        (folder / "fleet.toml").write_text(FLEET + ROBOT.format(group=group, domain=domain))
        setup = FieldSetup(load(str(folder / "scenario.toml")))
        width_m = setup.field.implement_width_m
        raster = sample_points(setup.field.polygon, width_m, setup.field.overlap_m)
        ground = setup.ground(raster)
        traces = [folder / f"trace{slot}" for slot in range(ROBOTS)]
        topics, heard = PlacesOfTopics(domain, ROBOTS), PlacesOfBus(group)
        headland = module_command("tools.cli.headland")
        try:
            for slot, (x_m, y_m) in enumerate(setup.starts):
                words = (f"/robot_{slot}", str(domain), str(x_m), str(y_m), str(traces[slot]))
                machines.append(_begun(folder, *module_command("tools.bench.ros2_field"), *words))
            door = ("ros2", "-i", "udp_multicast", "-c", group, "--domain", str(domain))
            processes.append(_begun(folder, *headland, *door))
            for slot in range(ROBOTS):
                words = ("robot", "fleet.toml", "--slot", str(slot), "--first-boot")
                processes.append(_begun(folder, *headland, *words))
            begun_s = time.monotonic()
            tracks: dict[int, list[TrackPoint]] = {slot: [] for slot in range(ROBOTS)}
            reached, missed, read = 0.0, list[tuple[float, float]](), [0] * ROBOTS
            while time.monotonic() - begun_s < limit_s and reached < COVERAGE_MIN:
                time.sleep(LOOK_S)
                for slot, path in enumerate(traces):
                    read[slot] = _read_on(path, read[slot], tracks[slot])
                worked = coverage(raster, tracks, width_m, ground.cells)
                reached = worked.reached
                missed = [(round(float(x), 2), round(float(y), 2)) for x, y in worked.missed]
            for_s = time.monotonic() - begun_s
            for robot in processes[1:]:
                robot.terminate()
            for robot in processes[1:]:
                robot.wait(20.0)
            time.sleep(DRAIN_S)
        finally:
            for process in (*processes, *machines):
                process.terminate()
            for process in (*processes, *machines):
                process.wait(20.0)
            heard.close()
            topics.close()
        velocities = sum(int(path.with_suffix(".heard").read_text()) for path in traces)
    closest_m = _closest_m(tracks[0], tracks[1])
    poses, lost = compared(heard.places, topics.places)
    return FieldWorked(reached, for_s, closest_m, velocities, missed, poses, lost)


def compared(bus: dict[int, list[Place]], told: dict[int, list[Place]]) -> tuple[int, int]:
    """How many places of the bus a reader should have been told since its first, and how many it was
    not. Places at which a robot stood at first are all equal, so they count on neither side.

    >>> compared({0: [(9, 9), (0, 0), (0, 0), (1, 0), (2, 0), (2, 0)]}, {0: [(0, 0), (1, 0), (2, 0)]})
    (3, 1)
    """
    poses = lost = 0
    for slot, places in bus.items():
        mine = told.get(slot, [])
        begin = places.index(mine[0]) if mine and mine[0] in places else 0
        expected, rest = _from_the_second(places[begin:]), _from_the_second(mine)
        found = 0
        for place in expected:
            found += found < len(rest) and rest[found] == place
        poses, lost = poses + len(expected), lost + len(expected) - found
    return poses, lost


def _from_the_second(places: list[Place]) -> list[Place]:
    """Without those that are equal to the first one and precede the second."""
    return [*dropwhile(lambda place: place == places[0], places)]


def _closest_m(first: list[TrackPoint], second: list[TrackPoint]) -> float:
    """Between two tracks at the same times."""
    a, b = np.array(first, dtype=float), np.array(second, dtype=float)
    both = a[(a[:, 0] >= b[0, 0]) & (a[:, 0] <= b[-1, 0])]
    x_m, y_m = (np.interp(both[:, 0], b[:, 0], b[:, axis]) for axis in (1, 2))
    return float(np.hypot(both[:, 1] - x_m, both[:, 2] - y_m).min(initial=np.inf))


def _begun(folder: Path, *words: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, text=True)


def _read_on(path: Path, begin: int, track: list[TrackPoint]) -> int:
    """Add the whole lines of a trace from a byte on; where the next ones begin."""
    if not path.exists():
        return begin
    with path.open("rb") as file:
        file.seek(begin)
        text = file.read()
    text = text[: text.rfind(b"\n") + 1]
    for line in text.splitlines():
        at_us, x_m, y_m, down = line.split()
        track.append((int(at_us), float(x_m), float(y_m), down == b"1"))
    return begin + len(text)


def _thinned(trace: list[Any]) -> list[TrackPoint]:
    """Every fifth point of 10 ms, and those at which the implement goes up or down."""
    before = [None, *(point.implement for point in trace)]
    return [
        (p.at_us, p.x_m, p.y_m, p.implement)
        for k, p in enumerate(trace)
        if k % 5 == 0 or p.implement is not before[k]
    ]


def machine(namespace: str, domain: int, x_m: float, y_m: float, trace: Path) -> None:
    """One machine until SIGTERM; its trace in a file, and beside it how many velocities it heard."""
    from sim.machines.ros2_machine import Ros2Machine

    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    one = Ros2Machine(namespace, domain, x_m, y_m, 0.0)
    one.start()
    with trace.open("w") as file:
        told = 0
        while signal.sigtimedwait({signal.SIGTERM}, TELL_S) is None:
            points = one.trace[told:]
            for at_us, east_m, north_m, down in _thinned(points):
                file.write(f"{at_us} {east_m:.4f} {north_m:.4f} {down:d}\n")
            file.flush()
            told += len(points)
    trace.with_suffix(".heard").write_text(str(one.heard))
    one.close()


if __name__ == "__main__":
    machine(
        sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]), Path(sys.argv[5])
    )
