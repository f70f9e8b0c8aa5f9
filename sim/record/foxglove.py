"""A fleet in Foxglove's own schemas, as plain values: what a live fleet and a recording both show.

Places are metres in the frame `field`, x east and y north. The body of a robot is drawn in its own frame,
`robot_N`, which the transforms move.
"""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from math import cos, sin
from typing import Any, Final

from agent.interface.effects import Trace
from crdt import Phase
from sim.files.palette import rgb_of

FRAME_TRANSFORMS, SCENE_UPDATE = "foxglove.FrameTransforms", "foxglove.SceneUpdate"
LOCATION_FIX, GRID, LOG = "foxglove.LocationFix", "foxglove.Grid", "foxglove.Log"
FRAME_ID = "field"
INFO, WARNING, ERROR = 2, 3, 4  # levels of foxglove.Log
LINE_STRIP = 0
MATCHING_ID = 0  # what a foxglove.SceneEntityDeletion deletes
UNKNOWN_COVARIANCE = 0
UINT8 = 1  # of foxglove.PackedElementField
HEIGHT_M, TEXT_PX = 0.6, 14.0
Values = dict[str, Any]
RGB = tuple[float, float, float]
GREY, WHITE, RED = (0.5, 0.5, 0.5), (1.0, 1.0, 1.0), (0.9, 0.1, 0.1)
COLOURS: Final = {
    Phase.FREE: (0.55, 0.55, 0.55), Phase.CLAIMED: (0.9, 0.75, 0.2), Phase.STARTED: (0.2, 0.55, 0.9),
    Phase.DONE: (0.2, 0.65, 0.3),
}  # fmt: skip
STOPPED = "EMERGENCY_STOP"


def transform(t_us: int, slot: int, x_m: float, y_m: float, heading_rad: float) -> Values:
    """Where the frame of a robot is; one of `foxglove.FrameTransforms`."""
    return {
        "timestamp": _time(t_us), "parent_frame_id": FRAME_ID, "child_frame_id": frame_of(slot),
        "translation": _xyz(round(x_m, 3), round(y_m, 3), 0.0), "rotation": _turn(heading_rad),
    }  # fmt: skip


def fix(t_us: int, slot: int, latitude_deg: float, longitude_deg: float) -> Values:
    """A `foxglove.LocationFix`."""
    return {
        "timestamp": _time(t_us), "frame_id": frame_of(slot), "latitude": round(latitude_deg, 8),
        "longitude": round(longitude_deg, 8), "altitude": 0.0, "position_covariance": [0.0] * 9,
        "position_covariance_type": UNKNOWN_COVARIANCE, "color": _rgba(rgb_of(slot)),
    }  # fmt: skip


def update(entities: list[Values], deletions: Iterable[Values] = ()) -> Values:
    """A `foxglove.SceneUpdate`."""
    return {"deletions": list(deletions), "entities": entities}


def outline(t_us: int, number: int, ring: Sequence[Sequence[float]]) -> Values:
    """A fence, or the edge of a hole."""
    lines = [_strip([*ring, ring[0]], GREY, 0.3)]
    return _entity(t_us, f"outline {number}", FRAME_ID, lines=lines)


def section(t_us: int, number: int, swaths: Iterable[Any], phase: Phase) -> Values:
    """The lines of a section, in the colour of its phase."""
    lines = [_strip(swath, COLOURS[phase], 0.4) for swath in swaths]
    return _entity(t_us, f"S{number}", FRAME_ID, lines=lines)


def body(t_us: int, slot: int, state: str, silent: bool, radius_m: float) -> Values:
    """A robot in its own frame, with its number and its state."""
    colour, length_m = GREY if silent else rgb_of(slot), 2.0 * radius_m
    cube = {
        "pose": _at(0.0, 0.0, HEIGHT_M / 2), "size": _xyz(length_m, 0.8 * length_m, HEIGHT_M),
        "color": _rgba(colour),
    }  # fmt: skip
    text = _text(
        HEIGHT_M + 0.5,
        RED if state == STOPPED else WHITE,
        f"{slot} {'SILENT' if silent else state}",
    )
    return _entity(t_us, f"robot {slot}", frame_of(slot), locked=True, cubes=[cube], texts=[text])


def warning(t_us: int, name: str, text: str) -> Values:
    """A text in red, over the middle of the field."""
    return _entity(t_us, name, FRAME_ID, texts=[_text(HEIGHT_M, RED, text)])


def path(t_us: int, intent: Values) -> Values:
    """Where a robot wants to drive."""
    slot = int(intent["slot"])
    way = [(intent["x"], intent["y"]), *intent["path"]]
    return _entity(t_us, f"path {slot}", FRAME_ID, lines=[_strip(way, rgb_of(slot), 0.15)])


def deletion(t_us: int, name: str) -> Values:
    """Of the entity with this name."""
    return {"timestamp": _time(t_us), "type": MATCHING_ID, "id": name}


def grid(t_us: int, origin_m: Sequence[float], cell_m: float, columns: int, rgba: bytes) -> Values:
    """A `foxglove.Grid`; `rgba`: four bytes for each cell, row by row from the south west."""
    names = ("red", "green", "blue", "alpha")
    return {
        "timestamp": _time(t_us), "frame_id": FRAME_ID, "pose": _at(origin_m[0], origin_m[1], 0.0),
        "column_count": columns, "cell_size": {"x": cell_m, "y": cell_m},
        "row_stride": 4 * columns, "cell_stride": 4,
        "fields": [{"name": n, "offset": k, "type": UINT8} for k, n in enumerate(names)],
        "data": b64encode(rgba).decode(),
    }  # fmt: skip


def said(t_us: int, name: str, level: int, text: str) -> Values:
    """A `foxglove.Log`."""
    return {
        "timestamp": _time(t_us), "level": level, "message": text, "name": name, "file": "", "line": 0
    }  # fmt: skip


def log_line(t_us: int, slot: int, trace: Trace) -> Values:
    """What a robot did and why. A change to EMERGENCY_STOP is a warning."""
    parts = (trace.machine, trace.source, trace.event, trace.target, trace.why)
    text = " ".join(part for part in parts if part)
    return said(t_us, f"robot {slot}", level_of(trace.target), text)


def level_of(state: str) -> int:
    """Of a line about a change to this state."""
    return WARNING if state == STOPPED else INFO


def frame_of(slot: int) -> str:
    """The frame of a robot's body."""
    return f"robot_{slot}"


def _entity(
    t_us: int, name: str, frame_id: str, locked: bool = False, **shapes: list[Values]
) -> Values:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": _time(t_us), "frame_id": frame_id, "id": name,
        "lifetime": {"sec": 0, "nsec": 0}, "frame_locked": locked, "metadata": [],
        **{kind: shapes.get(kind, []) for kind in kinds},
    }  # fmt: skip


def _strip(points: Iterable[Sequence[float]], colour: RGB, thickness_m: float) -> Values:
    return {
        "type": LINE_STRIP, "pose": _at(0.0, 0.0, 0.0), "thickness": thickness_m,
        "scale_invariant": False, "points": [_xyz(x, y, 0.05) for x, y in points],
        "color": _rgba(colour), "colors": [], "indices": [],
    }  # fmt: skip


def _text(z_m: float, colour: RGB, text: str) -> Values:
    return {
        "pose": _at(0.0, 0.0, z_m), "billboard": True, "font_size": TEXT_PX,
        "scale_invariant": True, "color": _rgba(colour), "text": text,
    }  # fmt: skip


def _at(x_m: float, y_m: float, z_m: float) -> Values:
    return {"position": _xyz(x_m, y_m, z_m), "orientation": _turn(0.0)}


def _turn(heading_rad: float) -> Values:
    half_rad = heading_rad / 2
    return {"x": 0.0, "y": 0.0, "z": round(sin(half_rad), 5), "w": round(cos(half_rad), 5)}


def _xyz(x: float, y: float, z: float) -> Values:
    return {"x": x, "y": y, "z": z}


def _rgba(colour: RGB) -> Values:
    return {"r": round(colour[0], 3), "g": round(colour[1], 3), "b": round(colour[2], 3), "a": 1.0}


def _time(t_us: int) -> Values:
    return {"sec": t_us // 1_000_000, "nsec": t_us % 1_000_000 * 1000}
