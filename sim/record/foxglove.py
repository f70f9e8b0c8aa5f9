"""A run in Foxglove's own schemas: entities of the 3D panel, lines of the log panel."""

from math import cos, hypot, sin
from typing import Any

from agent.interface.effects import Trace
from sim.files.palette import rgb_of
from sim.record.scene import Scene

SCENE_UPDATE, LOG = "foxglove.SceneUpdate", "foxglove.Log"
FRAME_ID = "field"
INFO, WARNING = 2, 3  # levels of foxglove.Log
LINE_STRIP = 0
HEIGHT_M = 0.6
Values = dict[str, Any]
GREY = (0.5, 0.5, 0.5)


def outline(scene: Scene) -> Values:
    """Fences and holes."""
    rings = [[*ring, ring[0]] for ring in scene["rings"] if ring]
    return _entity("outline", 0, lines=[_strip(ring, GREY, 0.3) for ring in rings])


def robot_entity(t_us: int, intent: Values, radius_m: float) -> Values:
    """A robot: its body, its heading, its path, its number."""
    colour = rgb_of(int(intent["slot"]))
    pose = _pose(intent["x"], intent["y"], intent["heading"])
    body = {
        "pose": pose, "size": _xyz(2 * radius_m, 2 * radius_m, HEIGHT_M), "color": _rgba(colour)
    }  # fmt: skip
    speed = hypot(intent["vx"], intent["vy"])
    arrow = {
        "pose": pose, "shaft_length": 0.2 + speed, "shaft_diameter": 0.2, "head_length": 0.4,
        "head_diameter": 0.5, "color": _rgba(colour),
    }  # fmt: skip
    text = {
        "pose": _pose(intent["x"], intent["y"], 0.0, HEIGHT_M + 0.5), "billboard": True,
        "font_size": 14.0, "scale_invariant": True, "color": _rgba((1.0, 1.0, 1.0)),
        "text": str(intent["slot"]),
    }  # fmt: skip
    way = [(intent["x"], intent["y"]), *intent["path"]]
    return _entity(
        f"robot {intent['slot']}", t_us, cubes=[body], arrows=[arrow], texts=[text],
        lines=[_strip(way, colour, 0.15)],
    )  # fmt: skip


def log_line(t_us: int, slot: int, trace: Trace) -> Values:
    """One `foxglove.Log` message: what a robot did and why. A change to EMERGENCY_STOP is a
    warning."""
    parts = (trace.machine, trace.source, trace.event, trace.target, trace.why)
    return {
        "timestamp": _time(t_us), "level": WARNING if trace.target == "EMERGENCY_STOP" else INFO,
        "message": " ".join(part for part in parts if part), "name": f"robot {slot}", "file": "",
        "line": 0,
    }  # fmt: skip


def _entity(name: str, t_us: int, **shapes: list[Values]) -> Values:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": _time(t_us), "frame_id": FRAME_ID, "id": name,
        "lifetime": {"sec": 0, "nsec": 0}, "frame_locked": False, "metadata": [],
        **{kind: shapes.get(kind, []) for kind in kinds},
    }  # fmt: skip


def _strip(points: Any, colour: tuple[float, float, float], thickness_m: float) -> Values:
    return {
        "type": LINE_STRIP, "pose": _pose(0.0, 0.0, 0.0), "thickness": thickness_m,
        "scale_invariant": False, "points": [_xyz(x, y, 0.0) for x, y in points],
        "color": _rgba(colour), "colors": [], "indices": [],
    }  # fmt: skip


def _pose(x_m: float, y_m: float, heading_rad: float, z_m: float = HEIGHT_M / 2) -> Values:
    half = heading_rad / 2
    return {
        "position": _xyz(x_m, y_m, z_m),
        "orientation": {"x": 0.0, "y": 0.0, "z": sin(half), "w": cos(half)},
    }


def _xyz(x: float, y: float, z: float) -> Values:
    return {"x": x, "y": y, "z": z}


def _rgba(colour: tuple[float, float, float]) -> Values:
    return {"r": colour[0], "g": colour[1], "b": colour[2], "a": 1.0}


def _time(t_us: int) -> Values:
    return {"sec": t_us // 1_000_000, "nsec": t_us % 1_000_000 * 1000}
