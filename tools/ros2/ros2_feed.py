"""A fleet that is heard, published as standard ROS 2 messages, and a stop that comes from there.

What is published, topic by topic, is in docs/use/ros2.md. Callbacks of ROS come in another thread; they
pass what they heard to the loop and touch nothing else.
"""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from math import ceil, cos, sin
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from crdt import Phase
from protocol.frames.fleet_frames import Pose
from sim.files.palette import rgb_of
from sim.record.foxglove import GREY, HEIGHT_M
from sim.record.scene import Scene
from tools.inspect.inspector import NO_KEYS, SILENT_S, Seen
from tools.livemap.map_state import Watcher
from tools.ros2.graph import Graph, Publisher, Quality

FIELD: Final = "map"  # the frame of all coordinates: metres, x east, y north (REP 105)
TELL_S: Final = 1.0  # between two looks at what changes slowly
CELL_M: Final = 0.5  # of the coverage grid, or coarser where the field is large
CELLS_MAX: Final = 1_000_000
UNKNOWN, OPEN, SOLID = -1, 0, 100  # of an occupancy grid
WORKED: Final = {Phase.FREE: 0, Phase.CLAIMED: 10, Phase.STARTED: 50, Phase.DONE: 100}
LINE_M = 0.15
LOOK_S: Final = 0.1  # between two looks whether the feed has been closed
ANSWER_S: Final = 30.0  # for a service that stops or releases: as long as the panel itself may take
Asked = Callable[[], Any]  # makes a coroutine that returns (success, message)


class Ros2Feed(Watcher):
    """An inspector of the bus that tells a ROS graph what it hears."""

    def __init__(self, graph: Graph, scene: Scene | None, stop: Asked, release: Asked) -> None:
        """`stop`, `release`: called in the loop when ROS asks for it."""
        super().__init__(scene)
        self.graph = graph
        self._kinds = graph.kinds
        self._loop = asyncio.get_running_loop()
        self._asked = {"stop": stop, "release": release}
        self._stopped = graph.publisher("Bool", "stopped", Quality.LATCHED)
        self._coverage = graph.publisher("OccupancyGrid", "coverage", Quality.LATCHED)
        self._map = graph.publisher("OccupancyGrid", "map", Quality.LATCHED)
        self._markers = graph.publisher("MarkerArray", "markers", Quality.LATCHED)
        self._diagnostics = graph.publisher("DiagnosticArray", "/diagnostics", Quality.RELIABLE)
        self._tf = None  # where the installation has no tf2_msgs
        if self._kinds.TFMessage is not None:
            self._tf = graph.publisher("TFMessage", "/tf", Quality.COMPLETE)
        self._odom: dict[int, Publisher] = {}
        self._states: dict[int, Publisher] = {}
        self._plans: dict[int, Publisher] = {}
        self._closed = False
        self._told: dict[str, object] = {}  # topic -> what was last published there
        graph.hear("emergency_stop", self._stop_heard)
        for name in self._asked:
            graph.serve(name, self._serve(name))
        self._telling = self._loop.create_task(self._keep_telling())

    def close(self) -> None:
        """Tell nothing more, and leave the graph."""
        self._closed = True
        self._telling.cancel()
        self.graph.close()

    # ---------------------------------------------------------------- what ROS asks

    def _stop_heard(self, message: Any) -> None:
        """In the thread of the graph. False is no release: for that there is the service."""
        if message.data:
            self._loop.call_soon_threadsafe(self._begin, "stop")

    def _begin(self, name: str) -> None:
        self._running = asyncio.ensure_future(self._asked[name]())

    def _serve(self, name: str) -> Callable[[Any, Any], Any]:
        def answer(_: Any, response: Any) -> Any:
            """In the thread of the graph, which waits for the bus."""
            asked = asyncio.run_coroutine_threadsafe(self._asked[name](), self._loop)
            ends_at_s = time.monotonic() + ANSWER_S
            response.success, response.message = False, f"no answer in {ANSWER_S:.0f} s"
            while time.monotonic() < ends_at_s and not self._closed:
                with suppress(TimeoutError):
                    response.success, response.message = asked.result(LOOK_S)
                    break
            return response

        return answer

    # ---------------------------------------------------------------- what is heard

    def intend(self, t_s: float, intent: dict[str, Any]) -> None:
        """Take what a robot of a launch says of itself beside the bus, and publish its path."""
        super().intend(t_s, intent)
        slot = int(intent["slot"])
        path = self._kinds.Path()
        path.header.frame_id, path.header.stamp = FIELD, self.graph.stamp()
        for x_m, y_m in [(intent["x"], intent["y"]), *intent["path"]]:
            pose = self._kinds.PoseStamped(header=path.header)
            pose.pose.position.x, pose.pose.position.y = float(x_m), float(y_m)
            path.poses.append(pose)
        self._of(self._plans, slot, "Path", "plan", Quality.RELIABLE).publish(path)

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        super()._robot(t_s, robot, kind, message)
        if isinstance(message, Pose) and message.placed:
            self._place(t_s, robot)

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        before = robot.state
        super()._state(t_s, robot, state, kind)
        if robot.state != before:
            publisher = self._of(self._states, robot.slot, "String", "state", Quality.LATCHED)
            publisher.publish(self._kinds.String(data=robot.state))
            self._tell_stopped()

    def _of(
        self, publishers: dict[int, Publisher], slot: int, kind: str, name: str, quality: Quality
    ) -> Publisher:
        if slot not in publishers:
            topic = f"robot_{slot}/{name}"
            publishers[slot] = self.graph.publisher(kind, topic, quality)
        return publishers[slot]

    def _place(self, t_s: float, robot: Seen) -> None:
        intent = self.intent(robot.slot, t_s)
        course_rad = self.course.get(robot.slot, 0.0)
        heading_rad = course_rad if intent is None else float(intent["heading"])
        odom = self._kinds.Odometry()
        odom.header.frame_id, odom.header.stamp = FIELD, self.graph.stamp()
        odom.child_frame_id = f"robot_{robot.slot}"
        odom.pose.pose.position.x, odom.pose.pose.position.y = robot.x_m, robot.y_m
        odom.pose.pose.orientation = self._turn(heading_rad)
        off_rad = course_rad - heading_rad
        odom.twist.twist.linear.x = robot.speed_m_s * cos(off_rad)
        odom.twist.twist.linear.y = robot.speed_m_s * sin(off_rad)
        self._of(self._odom, robot.slot, "Odometry", "odom", Quality.COMPLETE).publish(odom)
        if self._tf is not None:
            self._tf.publish(self._transform(odom))

    def _tell_stopped(self) -> None:
        """Whether every robot that is heard is latched, as the fleet's lamp."""
        now_s = self._loop.time()  # also where the whole bus is silent
        live = [r for r in self.robots.values() if now_s - r.last_s <= SILENT_S and not r.left]
        stopped = bool(live) and all(robot.state == "EMERGENCY_STOP" for robot in live)
        if self._new("stopped", stopped):
            self._stopped.publish(self._kinds.Bool(data=stopped))

    # ---------------------------------------------------------------- what changes slowly

    async def _keep_telling(self) -> None:
        while True:
            await asyncio.sleep(TELL_S)
            self.tell()

    def tell(self) -> None:
        """Publish what has changed: markers, the map, the coverage, and the diagnostics always."""
        self._tell_stopped()
        self._diagnostics.publish(self._health())
        phases = tuple(
            (section["id"], self.allocation.phase_of(section["id"]))
            for section in self.scene.get("sections", ())
        )
        if phases and self._new("coverage", phases):
            self._coverage.publish(self._covered(dict(phases)))
        grid = self._charted()
        if grid is not None and self._new("map", grid.tobytes()):
            self._map.publish(self._grid_of(grid, *self.ground_frame()))
        if self.robots or self.scene:
            self._markers.publish(self._marked())

    def _new(self, topic: str, what: object) -> bool:
        if self._told.get(topic) == what:
            return False
        self._told[topic] = what
        return True

    def _health(self) -> Any:
        report = self._kinds.DiagnosticArray()
        report.header.stamp = self.graph.stamp()
        for robot in self.robots.values():
            silent = self._loop.time() - robot.last_s > SILENT_S
            status = self._kinds.DiagnosticStatus(
                name=f"headland: robot {robot.slot}", hardware_id=str(robot.address)
            )
            bad = silent or robot.state == "EMERGENCY_STOP"
            status.level = (
                self._kinds.DiagnosticStatus.ERROR if bad else self._kinds.DiagnosticStatus.OK
            )
            status.message = "silent" if silent else robot.state
            at = (f"{robot.x_m:.2f}", f"{robot.y_m:.2f}") if robot.has_place else ("", "")
            values = {
                "x_m": at[0], "y_m": at[1], "health": f"{robot.health:.2f}",
                "held": str(robot.held), "operations": str(robot.operations),
            }  # fmt: skip
            status.values = [
                self._kinds.KeyValue(key=key, value=value) for key, value in values.items()
            ]
            report.status.append(status)
        if self.keyed is False:
            kind = self._kinds.DiagnosticStatus
            report.status.append(kind(name="headland: keys", level=kind.ERROR, message=NO_KEYS))
        return report

    def _covered(self, phases: dict[int, Phase]) -> Any:
        """Swaths of sections, as wide as the implement: 0 free, 10 claimed, 50 begun, 100 done."""
        swaths = {s["id"]: s["swaths"] for s in self.scene["sections"]}
        points = np.array([p for lines in swaths.values() for line in lines for p in line])
        width_m = float(self.scene.get("width_m") or 2 * CELL_M)
        low, high = points.min(axis=0) - width_m / 2, points.max(axis=0) + width_m / 2
        cell_m = CELL_M
        while np.prod((high - low) / cell_m) > CELLS_MAX:
            cell_m *= 2
        columns, rows = (max(1, ceil(side / cell_m)) for side in (high - low))
        grid = np.full((rows, columns), UNKNOWN, np.int8)
        for section, lines in swaths.items():
            for line in lines:
                _sweep(grid, np.array(line), low, cell_m, width_m, WORKED[phases[section]])
        return self._grid_of(grid, (float(low[0]), float(low[1])), cell_m)

    def _charted(self) -> NDArray[np.int8] | None:
        """The explored map of an arena, or the walls of a building; None if there is neither."""
        kinds = self.ground_kinds()
        return None if kinds is None else np.array((UNKNOWN, OPEN, SOLID), dtype=np.int8)[kinds]

    def _grid_of(self, cells: NDArray[np.int8], origin: tuple[float, float], cell_m: float) -> Any:
        grid = self._kinds.OccupancyGrid()
        grid.header.frame_id, grid.header.stamp = FIELD, self.graph.stamp()
        grid.info.resolution = cell_m
        grid.info.height, grid.info.width = cells.shape
        grid.info.origin.position.x, grid.info.origin.position.y = origin
        grid.info.origin.orientation.w = 1.0
        grid.data = self.graph.octets(cells)
        return grid

    def _marked(self) -> Any:
        marked = self._kinds.MarkerArray()
        for number, ring in enumerate(self.scene.get("rings", ())):
            if ring:
                marked.markers.append(self._line(number, [*ring, ring[0]]))
        length_m = 2.0 * float(self.scene.get("radius_m", 0.8))
        for robot in self.robots.values():
            if not robot.has_place:
                continue
            marker = self._marker("robots", robot.slot, self._kinds.Marker.CUBE)
            if robot.left:
                marker.action = self._kinds.Marker.DELETE
            marker.pose.position.x, marker.pose.position.y = robot.x_m, robot.y_m
            marker.pose.orientation = self._turn(self.course.get(robot.slot, 0.0))
            marker.scale.x, marker.scale.y, marker.scale.z = length_m, 0.8 * length_m, HEIGHT_M
            silent = self._loop.time() - robot.last_s > SILENT_S
            marker.color = self._colour(GREY if silent else rgb_of(robot.slot))
            marked.markers.append(marker)
        return marked

    def _line(self, number: int, points: list[list[float]]) -> Any:
        marker = self._marker("outlines", number, self._kinds.Marker.LINE_STRIP)
        marker.scale.x, marker.color = LINE_M, self._colour(GREY)
        marker.points = [self._kinds.Point(x=float(x), y=float(y), z=0.0) for x, y in points]
        return marker

    def _marker(self, group: str, number: int, kind: int) -> Any:
        marker = self._kinds.Marker(ns=group, id=number, type=kind, action=self._kinds.Marker.ADD)
        marker.header.frame_id, marker.header.stamp = FIELD, self.graph.stamp()
        marker.pose.orientation.w = 1.0
        return marker

    def _transform(self, odom: Any) -> Any:
        made = self._kinds.TransformStamped(header=odom.header, child_frame_id=odom.child_frame_id)
        made.transform.translation.x = odom.pose.pose.position.x
        made.transform.translation.y = odom.pose.pose.position.y
        made.transform.rotation = odom.pose.pose.orientation
        return self._kinds.TFMessage(transforms=[made])

    def _turn(self, heading_rad: float) -> Any:
        return self._kinds.Quaternion(x=0.0, y=0.0, z=sin(heading_rad / 2), w=cos(heading_rad / 2))

    def _colour(self, colour: tuple[float, float, float]) -> Any:
        red, green, blue = map(float, colour)
        return self._kinds.ColorRGBA(r=red, g=green, b=blue, a=1.0)


def _sweep(
    grid: NDArray[np.int8], line: NDArray[np.float64], low: NDArray[np.float64], cell_m: float,
    width_m: float, value: int,
) -> None:  # fmt: skip
    """Write a value into the cells of a line of that width."""
    rows, columns = grid.shape
    reach = width_m / 2
    for a, b in pairwise(line):
        first = np.floor((np.minimum(a, b) - reach - low) / cell_m).astype(int).clip(0)
        last = np.ceil((np.maximum(a, b) + reach - low) / cell_m).astype(int)
        x = low[0] + (np.arange(first[0], min(last[0], columns)) + 0.5) * cell_m
        y = low[1] + (np.arange(first[1], min(last[1], rows)) + 0.5) * cell_m
        dx, dy = b - a
        along = ((x[None, :] - a[0]) * dx + (y[:, None] - a[1]) * dy) / max(dx * dx + dy * dy, 1e-9)
        along = along.clip(0.0, 1.0)
        off = np.hypot(x[None, :] - a[0] - along * dx, y[:, None] - a[1] - along * dy)
        part = grid[first[1] : first[1] + len(y), first[0] : first[0] + len(x)]
        part[off <= reach] = value
