"""A ROS 2 bag of a run: standard messages of what its robots recorded, by the package `rosbags`.

| topic | type | holds |
|---|---|---|
| /robotN/odom | nav_msgs/Odometry | place and velocity as the robot sensed them |
| /robotN/plan | nav_msgs/Path | the rest of its path, when it changes |
| /tf | tf2_msgs/TFMessage | map to robotN/base_link |
| /diagnostics | diagnostic_msgs/DiagnosticArray | why a robot stands, when it changes |
| /estop | std_msgs/Bool | whether a stop that a person has to clear holds any robot, when it changes |
| /coverage | nav_msgs/OccupancyGrid | where an implement was wanted down, every ten seconds |
| /field | geometry_msgs/PolygonStamped | the outline of the field |

The frame `map` has x east and y north, metres. Time is that of the recording: it begins at 0 for a run in
virtual time, and is the time of day for a launch.
"""

import os
import shutil
from collections import Counter
from collections.abc import Sequence
from math import ceil, cos, hypot, sin
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from agent.safety.stop_cause import Severity, StopCause
from sim.files.whole_file import TOKEN_BYTES
from sim.record.recording import Recording

NS_PER_US: Final = 1000
GRID_EVERY_US: Final = 10_000_000
CELL_M: Final = 0.5
CELLS_MAX: Final = 4_000_000  # a larger field has larger cells
JUMP_M: Final = 5.0  # further apart, two samples are not joined to one swath
WORKED, UNKNOWN = 100, -1  # of an occupancy grid
OK, STANDS = 0, 2  # levels of a diagnostic status
Storage = Literal["mcap", "sqlite3"]


class BagError(Exception):
    """One line: why there is no bag."""


class CoverageGrid:
    """Cells over which an implement was wanted down."""

    def __init__(self, outline: Sequence[Sequence[float]], width_m: float) -> None:
        """`outline`: corners of the field, metres. `width_m`: of the implement."""
        xs, ys = [x for x, _ in outline], [y for _, y in outline]
        self.west_m, self.south_m, self.half_m = min(xs), min(ys), width_m / 2
        across_m, along_m = max(xs) - self.west_m, max(ys) - self.south_m
        self.cell_m = max(CELL_M, (across_m * along_m / CELLS_MAX) ** 0.5)
        columns, rows = ceil(across_m / self.cell_m) + 1, ceil(along_m / self.cell_m) + 1
        self.cells = np.full((rows, columns), UNKNOWN, dtype=np.int8)
        self._last: dict[int, tuple[float, float]] = {}

    def take(self, intent: dict[str, Any]) -> None:
        """Mark what a robot has worked since its last intent."""
        slot, x_m, y_m = intent["slot"], intent["x"], intent["y"]
        last = self._last.pop(slot, None)
        if not intent["tool"]:
            return
        self._last[slot] = x_m, y_m
        begin_x_m, begin_y_m = (x_m, y_m) if last is None else last
        way_m = hypot(x_m - begin_x_m, y_m - begin_y_m)
        if way_m > JUMP_M:
            begin_x_m, begin_y_m, way_m = x_m, y_m, 0.0
        step_m = self.cell_m / 2
        along = np.linspace(0.0, 1.0, ceil(way_m / step_m) + 1)
        aside_m = np.linspace(-self.half_m, self.half_m, ceil(2 * self.half_m / step_m) + 1)
        east, north = -sin(intent["heading"]), cos(intent["heading"])
        if way_m > 0.0:
            east, north = -(y_m - begin_y_m) / way_m, (x_m - begin_x_m) / way_m
        xs = begin_x_m + (x_m - begin_x_m) * along[:, None] + east * aside_m
        ys = begin_y_m + (y_m - begin_y_m) * along[:, None] + north * aside_m
        columns = np.floor((xs - self.west_m) / self.cell_m).astype(np.int64)
        rows = np.floor((ys - self.south_m) / self.cell_m).astype(np.int64)
        height, width = self.cells.shape
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        self.cells[rows[inside], columns[inside]] = WORKED


class BagWriter:
    """Writes the messages of a recording into an open bag."""

    def __init__(self, writer: Any, typestore: Any) -> None:
        self.writer, self.typestore, self.types = writer, typestore, typestore.types
        self.counts: Counter[str] = Counter()  # messages by topic
        self._connections: dict[str, Any] = {}

    def write(self, recording: Recording) -> None:
        """All of it, in the order of time."""
        scene = recording.scene or {}
        rings = scene.get("rings") or []
        grid = CoverageGrid(rings[0], scene.get("width_m") or 0.0) if rings else None
        intents = recording.intents
        if rings:
            self._field(intents[0][0] if intents else 0, rings[0])
        plans: dict[int, Any] = {}
        holds: dict[int, Any] = {}
        stopped: bool | None = None
        grid_at_us = (intents[0][0] if intents else 0) + GRID_EVERY_US
        for t_us, intent in intents:
            slot = intent["slot"]
            self._odometry(t_us, intent)
            if plans.get(slot) != intent["path"]:
                plans[slot] = intent["path"]
                self._plan(t_us, slot, intent["path"])
            if holds.get(slot) != intent["holds"]:
                holds[slot] = intent["holds"]
                self._diagnostics(t_us, slot, intent["holds"])
                now = any(_is_latched(name) for each in holds.values() for name in each)
                if now != stopped:
                    stopped = now
                    self._put("/estop", "std_msgs/msg/Bool", t_us, data=now)
            if grid is not None and grid.half_m:
                if t_us >= grid_at_us:
                    self._coverage(t_us, grid)
                    grid_at_us = t_us + GRID_EVERY_US
                grid.take(intent)
        if grid is not None and grid.half_m and intents:
            self._coverage(intents[-1][0], grid)

    def _put(self, topic: str, kind: str, t_us: int, **fields: Any) -> None:
        connection = self._connections.get(topic)
        if connection is None:
            connection = self.writer.add_connection(topic, kind, typestore=self.typestore)
            self._connections[topic] = connection
        message = self.types[kind](**fields)
        self.writer.write(connection, t_us * NS_PER_US, self.typestore.serialize_cdr(message, kind))
        self.counts[topic] += 1

    def _new(self, kind: str, **fields: Any) -> Any:
        return self.types[kind](**fields)

    def _time(self, t_us: int) -> Any:
        return self._new(
            "builtin_interfaces/msg/Time",
            sec=t_us // 1_000_000,
            nanosec=t_us % 1_000_000 * NS_PER_US,
        )

    def _header(self, t_us: int) -> Any:
        return self._new("std_msgs/msg/Header", stamp=self._time(t_us), frame_id="map")

    def _vector(self, x: float, y: float, z: float = 0.0) -> Any:
        return self._new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def _turned(self, heading_rad: float) -> Any:
        return self._new(
            "geometry_msgs/msg/Quaternion",
            x=0.0,
            y=0.0,
            z=sin(heading_rad / 2),
            w=cos(heading_rad / 2),
        )

    def _pose(self, x_m: float, y_m: float, heading_rad: float = 0.0) -> Any:
        point = self._new("geometry_msgs/msg/Point", x=float(x_m), y=float(y_m), z=0.0)
        return self._new(
            "geometry_msgs/msg/Pose", position=point, orientation=self._turned(heading_rad)
        )

    def _odometry(self, t_us: int, intent: dict[str, Any]) -> None:
        slot, heading_rad = intent["slot"], intent["heading"]
        frame, unknown = f"robot{slot}/base_link", np.zeros(36)
        cos_h, sin_h = cos(heading_rad), sin(heading_rad)
        vx, vy = intent["vx"], intent["vy"]
        # A twist is in the frame of the body.
        linear = self._vector(cos_h * vx + sin_h * vy, cos_h * vy - sin_h * vx)
        twist = self._new("geometry_msgs/msg/Twist", linear=linear, angular=self._vector(0.0, 0.0))
        pose = self._pose(intent["x"], intent["y"], heading_rad)
        header = self._header(t_us)
        self._put(
            f"/robot{slot}/odom", "nav_msgs/msg/Odometry", t_us, header=header, child_frame_id=frame,
            pose=self._new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=unknown),
            twist=self._new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=unknown),
        )  # fmt: skip
        moved = self._new(
            "geometry_msgs/msg/Transform", translation=self._vector(intent["x"], intent["y"]),
            rotation=pose.orientation,
        )  # fmt: skip
        stamped = self._new(
            "geometry_msgs/msg/TransformStamped",
            header=header,
            child_frame_id=frame,
            transform=moved,
        )
        self._put("/tf", "tf2_msgs/msg/TFMessage", t_us, transforms=[stamped])

    def _plan(self, t_us: int, slot: int, path: Sequence[Sequence[float]]) -> None:
        header = self._header(t_us)
        poses = [
            self._new("geometry_msgs/msg/PoseStamped", header=header, pose=self._pose(x_m, y_m))
            for x_m, y_m in path
        ]
        self._put(f"/robot{slot}/plan", "nav_msgs/msg/Path", t_us, header=header, poses=poses)

    def _diagnostics(self, t_us: int, slot: int, holds: Sequence[str]) -> None:
        status = self._new(
            "diagnostic_msgs/msg/DiagnosticStatus", level=STANDS if holds else OK,
            name=f"robot{slot}", message=", ".join(holds) or "free to move",
            hardware_id=f"robot{slot}", values=[],
        )  # fmt: skip
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        self._put("/diagnostics", kind, t_us, header=self._header(t_us), status=[status])

    def _field(self, t_us: int, ring: Sequence[Sequence[float]]) -> None:
        points = [
            self._new("geometry_msgs/msg/Point32", x=float(x_m), y=float(y_m), z=0.0)
            for x_m, y_m in ring
        ]
        polygon = self._new("geometry_msgs/msg/Polygon", points=points)
        kind = "geometry_msgs/msg/PolygonStamped"
        self._put("/field", kind, t_us, header=self._header(t_us), polygon=polygon)

    def _coverage(self, t_us: int, grid: CoverageGrid) -> None:
        height, width = grid.cells.shape
        info = self._new(
            "nav_msgs/msg/MapMetaData", map_load_time=self._time(t_us), resolution=grid.cell_m,
            width=width, height=height, origin=self._pose(grid.west_m, grid.south_m),
        )  # fmt: skip
        self._put(
            "/coverage", "nav_msgs/msg/OccupancyGrid", t_us, header=self._header(t_us), info=info,
            data=grid.cells.reshape(-1).copy(),
        )  # fmt: skip


def _is_latched(name: str) -> bool:
    return name in StopCause.__members__ and StopCause[name].value.severity is Severity.LATCHED


def check_package() -> None:
    """Raises BagError where `rosbags` is not installed."""
    try:
        import rosbags  # noqa: F401
    except ImportError:
        raise BagError("a bag needs the ros extra: pip install 'headland[ros]'") from None


def write_bag(recording: Recording, folder: Path, storage: Storage) -> Counter[str]:
    """Write a new folder; returns the number of messages by topic. Raises BagError and
    OSError.

    What is interrupted leaves no folder of that name.
    """
    check_package()
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if folder.exists():
        raise BagError(f"{folder}: exists; a bag is written into a new folder")
    if not recording.intents:
        raise BagError("the run has no recorded places of robots")
    beside = folder.with_name(f".headland-{os.urandom(TOKEN_BYTES).hex()}")
    # The files of a bag have the name of its folder, and its metadata names them.
    part = beside / folder.name
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    try:
        with Writer(part, version=Writer.VERSION_LATEST, storage_plugin=plugin) as writer:
            bag = BagWriter(writer, get_typestore(Stores.ROS2_JAZZY))
            bag.write(recording)
        part.rename(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return bag.counts
