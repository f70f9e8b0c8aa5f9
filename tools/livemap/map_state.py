"""An inspector that also knows what a map shows: courses, bus load now, the shared map, islands.

All of it comes from the bus, or from what robots report about themselves beside the bus
(`sim.record.robot_intent`).
"""

from base64 import b64decode
from collections import Counter, deque
from collections.abc import Iterable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from crdt.sighting import VALUE, MergeOrder
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import Identifier
from protocol.frames.map_frames import MapPatch
from protocol.frames.messages import GROUPS
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from sim.can.frame_timing import worst_bits
from sim.record.scene import Scene
from tools.inspect.inspector import STOPS_MAX, Inspector, Seen

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from crdt.occupancy import OccupancyMap

LOAD_S = 1.0  # the load of the bus is averaged over this time
NAMES = {group.pgn: group.name for group in GROUPS}
STALE_S = 1.0  # an intent older than this does not describe the present


class Watcher(Inspector):
    """An inspector that also keeps the newest intents, obstacles, questions, and the load of the
    last second."""

    def __init__(self, scene: Scene | None = None) -> None:
        super().__init__()
        self.course: dict[int, float] = {}
        self.intents: dict[int, tuple[float, dict[str, Any]]] = {}  # when, and what
        self.things: list[list[float]] = []
        self.reasons: dict[tuple[int, int, int], tuple[int, int | None]] = {}  # reason, said by
        self.asking: dict[int, OperatorReport] = {}  # what a robot waits for an operator about
        self.changed_sections: set[int] = set()
        self.changed_blocks: set[tuple[int, int]] = set()
        self.changed_patches: set[int] = set()
        self.scene: Scene = scene or {}
        self.chart = _chart(scene)
        self.bitrate = int((scene or {}).get("bitrate", 250_000))
        self._loads: deque[tuple[float, int, int]] = deque()  # when, bits, group
        self._load = 0
        self._recent: Counter[int] = Counter()

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, and count it for the load of the last second."""
        super().hear(t_s, frame)
        pgn = Identifier.unpack(frame.identifier).pgn
        bits = worst_bits(len(frame.data))
        self._loads.append((t_s, bits, pgn))
        self._load += bits
        self._recent[pgn] += 1
        self.forget(t_s)

    def forget(self, now_s: float) -> None:
        """What is older than a second is not the load of now."""
        while self._loads and self._loads[0][0] < now_s - LOAD_S:
            _, bits, pgn = self._loads.popleft()
            self._load -= bits
            self._recent[pgn] -= 1

    @property
    def share(self) -> float:
        """Share of the bus in the last second, at worst-case stuffing."""
        return self._load / (LOAD_S * self.bitrate)

    @property
    def recent(self) -> dict[str, int]:
        """Frames of each kind in the last second, most first."""
        counts = [(pgn, count) for pgn, count in self._recent.most_common() if count > 0]
        return {NAMES.get(pgn, f"PGN {pgn:04X}"): count for pgn, count in counts}

    def intend(self, t_s: float, intent: dict[str, Any]) -> None:
        """Take the newest intent of a robot, see `sim.record.robot_intent`."""
        self.intents[int(intent["slot"])] = (t_s, intent)

    def intent(self, slot: int, now_s: float) -> dict[str, Any] | None:
        """The newest intent of a robot, if it is not older than `STALE_S`."""
        at_s, intent = self.intents.get(slot, (0.0, None))
        return intent if intent is not None and abs(now_s - at_s) <= STALE_S else None

    def islands(self, now_s: float) -> list[list[int]]:
        """Groups of robots of which each hears another: more than one where the bus is split."""
        hears = {
            slot: set(intent["hears"])
            for slot, (at_s, intent) in self.intents.items()
            if "hears" in intent  # a recording from before the key was written has none
            and abs(now_s - at_s) <= STALE_S
            and self._state_of(slot) != "DISCONNECTED"
        }
        left, found = set(hears), []
        while left:
            group, edge = set(), {min(left)}
            while edge:
                slot = edge.pop()
                group.add(slot)
                edge |= {o for o in hears[slot] & left - group if slot in hears[o]}
            left -= group
            found.append(sorted(group))
        return found

    def _state_of(self, slot: int) -> str:
        robot = self.robots.get(slot)
        return "DISCONNECTED" if robot is None else robot.state

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        match message:
            case Pose():
                if message.placed:
                    self.course[robot.slot] = message.course_rad
            case TaskClaim() | StateSyncResponse():
                self.changed_sections.add(message.section)
            case WorkProgress():
                self.changed_blocks.add((message.section, message.block))
            case MapPatch():
                self._patch(message)
            case OperatorReport(matter=ReportKind.ASKING | ReportKind.WAITING):
                self.asking[robot.slot] = message
            case OperatorReport(matter=ReportKind.RELEASE_ASKED):
                pass  # about the fleet; what this robot itself asks stays
            case OperatorReport():
                self.asking.pop(robot.slot, None)
            case EmergencyStop():
                if message[:3] in self.stops:
                    self.reasons.setdefault(message[:3], (message.reason, robot.slot))
                if len(self.reasons) > 2 * STOPS_MAX:
                    self.reasons = {d: r for d, r in self.reasons.items() if d in self.stops}
        super()._robot(t_s, robot, kind, message)

    def _patch(self, m: MapPatch) -> None:
        if self.chart is None:
            return
        from protocol.sync.map_sync import decode_cells  # needs numpy, as the shared map does

        values = decode_cells(m.cells).astype("int64")
        if self.chart.apply(m.patch, values, m.level, m.time, m.observer):
            self.changed_patches.add(m.patch)

    def cells(self, patches: Iterable[int]) -> list[list[int]]:
        """Row and column of a patch, then the values of its 16 cells, row by row."""
        if self.chart is None:
            return []
        from crdt.occupancy import corner_of

        return [
            [*corner_of(patch), *(self.chart.patch(patch) & VALUE).tolist()] for patch in patches
        ]

    def ground_kinds(self) -> "NDArray[np.int64] | None":
        """The explored map of an arena, or the walls of a building, (rows, columns) from the south west:
        0 unknown, 1 free, 2 solid. None if there is neither."""
        import numpy as np  # a tool that only listens has none, and no grid

        if self.chart is not None:
            geometry = self.chart.geometry
            kinds = np.zeros((geometry.rows, geometry.columns), dtype=np.int64)
            for row, column, *values in self.cells(self.chart.known_patches()):
                block = np.asarray(values).reshape(4, 4)
                part = kinds[row : row + 4, column : column + 4]
                part[:] = block[: part.shape[0], : part.shape[1]]
        elif (told := self.scene.get("grid")) is not None:
            bits = np.unpackbits(np.frombuffer(b64decode(told["walls"]), dtype=np.uint8))
            rows, columns = int(told["rows"]), int(told["columns"])
            kinds = bits[: rows * columns].reshape(rows, columns).astype(np.int64) + 1
        else:
            return None
        return np.minimum(kinds, 2)

    def ground_frame(self) -> tuple[tuple[float, float], float]:
        """The south-western corner and the side of a cell of `ground_kinds`, metres."""
        if self.chart is not None:
            return self.chart.geometry.origin_m, self.chart.geometry.cell_m
        told = self.scene["grid"]
        return (float(told["origin"][0]), float(told["origin"][1])), float(told["cell_m"])

    def all_changed(self) -> None:
        """A viewer knows nothing yet."""
        self.changed_sections = set(self.allocation.sections())
        self.changed_blocks = {(section, block) for section, block, _ in self.progress.entries()}
        if self.chart is not None:
            self.changed_patches = set(self.chart.known_patches())


def _chart(scene: Scene | None) -> "OccupancyMap | None":
    """None where nothing is explored, or numpy is not installed: then the rest is shown."""
    cells = (scene or {}).get("cells")
    if not cells or find_spec("numpy") is None:
        return None
    from crdt.occupancy import Geometry, OccupancyMap

    west, south = cells["origin"]
    geometry = Geometry(int(cells["rows"]), int(cells["columns"]), (west, south), cells["cell_m"])
    return OccupancyMap(geometry, MergeOrder(cells["order"]))
