"""JSON schemas of the topics of an MCAP file, so that readers know the paths of every message.

Foxglove supports a part of JSON Schema: objects with `properties`, arrays of plain values or of
objects. It rejects an array of arrays, so points are objects here. Names, titles and types of the
foxglove schemas are those that Foxglove has published.
"""

from typing import Any

from agent.interface.geometry import Point
from protocol.strict_msgpack import U8, finite, unsigned
from sim.record.foxglove import FRAME_TRANSFORMS, GRID, LOCATION_FIX, LOG, SCENE_UPDATE

INTENT, THINGS, FLEET = "headland.Intent", "headland.Things", "headland.Fleet"
Schema = dict[str, Any]
# The columns of a row of `sim.world.walls`, with names for readers.
THING = ("shape", "x", "y", "half_x", "half_y", "cos", "sin")
POINTS = ("path", "strange")  # of an intent: lists of points
WANTED = "wanted"  # of an intent: a velocity
NUMBERS = ("x", "y", "heading", "vx", "vy")  # of an intent


def _object(title: str, **properties: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": properties}


def _many(items: Schema, description: str = "") -> Schema:
    return {"type": "array", "items": items, **_said(description)}


def _number(description: str = "") -> Schema:
    return {"type": "number", **_said(description)}


def _integer(description: str = "") -> Schema:
    return {"type": "integer", "minimum": 0, **_said(description)}


def _text(description: str = "") -> Schema:
    return {"type": "string", **_said(description)}


def _truth(description: str = "") -> Schema:
    return {"type": "boolean", **_said(description)}


def _choice(title: str, *names: str) -> Schema:
    """A number for each name, from 0."""
    return {"title": title, "oneOf": [{"title": name, "const": k} for k, name in enumerate(names)]}


def _said(description: str) -> Schema:
    return {"description": description} if description else {}


_NSEC = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME = _object("time", sec=_integer(), nsec=_NSEC)
_DURATION = _object("duration", sec={"type": "integer"}, nsec=_NSEC)


def _xyz(title: str) -> Schema:
    return _object(title, x=_number(), y=_number(), z=_number())


_VECTOR, _POINT = _xyz("foxglove.Vector3"), _xyz("foxglove.Point3")
_QUATERNION = _object("foxglove.Quaternion", x=_number(), y=_number(), z=_number(), w=_number())
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOR = _object("foxglove.Color", r=_number(), g=_number(), b=_number(), a=_number())
_BYTES = {"type": "string", "contentEncoding": "base64"}
_INDICES = _many(_integer())
_PRIMITIVES = {
    "arrows": _object(
        "foxglove.ArrowPrimitive", pose=_POSE, shaft_length=_number(), shaft_diameter=_number(),
        head_length=_number(), head_diameter=_number(), color=_COLOR,
    ),
    "cubes": _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR),
    "spheres": _object("foxglove.SpherePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR),
    "cylinders": _object(
        "foxglove.CylinderPrimitive", pose=_POSE, size=_VECTOR, bottom_scale=_number(),
        top_scale=_number(), color=_COLOR,
    ),
    "lines": _object(
        "foxglove.LinePrimitive",
        type=_choice("foxglove.LineType", "LINE_STRIP", "LINE_LOOP", "LINE_LIST"), pose=_POSE,
        thickness=_number(), scale_invariant=_truth(), points=_many(_POINT), color=_COLOR,
        colors=_many(_COLOR), indices=_INDICES,
    ),
    "triangles": _object(
        "foxglove.TriangleListPrimitive", pose=_POSE, points=_many(_POINT), color=_COLOR,
        colors=_many(_COLOR), indices=_INDICES,
    ),
    "texts": _object(
        "foxglove.TextPrimitive", pose=_POSE, billboard=_truth(), font_size=_number(),
        scale_invariant=_truth(), color=_COLOR, text=_text(),
    ),
    "models": _object(
        "foxglove.ModelPrimitive", pose=_POSE, scale=_VECTOR, color=_COLOR,
        override_color=_truth(), url=_text(), media_type=_text(),
        data=_BYTES,
    ),
}  # fmt: skip
_TRANSFORM = _object(
    "foxglove.FrameTransform", timestamp=_TIME, parent_frame_id=_text(), child_frame_id=_text(),
    translation=_VECTOR, rotation=_QUATERNION,
)  # fmt: skip
_ELEMENT = _object(
    "foxglove.PackedElementField", name=_text(), offset=_integer(),
    type=_choice(
        "foxglove.NumericType", "UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32",
        "FLOAT32", "FLOAT64",
    ),
)  # fmt: skip
_XY = _object("headland.Point", x=_number("metres east"), y=_number("metres north"))
_SLOTS = _integer("slot of a robot")
SCHEMAS: dict[str, Schema] = {
    FRAME_TRANSFORMS: _object(FRAME_TRANSFORMS, transforms=_many(_TRANSFORM)),
    LOCATION_FIX: _object(
        LOCATION_FIX, timestamp=_TIME, frame_id=_text(), latitude=_number(), longitude=_number(),
        altitude=_number(),
        position_covariance={"type": "array", "items": _number(), "minItems": 9, "maxItems": 9},
        position_covariance_type=_choice(
            "foxglove.PositionCovarianceType", "UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN"
        ),
        color=_COLOR,
    ),
    GRID: _object(
        GRID, timestamp=_TIME, frame_id=_text(), pose=_POSE, column_count=_integer(),
        cell_size=_object("foxglove.Vector2", x=_number(), y=_number()), row_stride=_integer(),
        cell_stride=_integer(), fields=_many(_ELEMENT), data=_BYTES,
    ),
    SCENE_UPDATE: _object(
        SCENE_UPDATE,
        deletions=_many(
            _object(
                "foxglove.SceneEntityDeletion", timestamp=_TIME,
                type=_choice("foxglove.SceneEntityDeletionType", "MATCHING_ID", "ALL"), id=_text(),
            )
        ),
        entities=_many(
            _object(
                "foxglove.SceneEntity", timestamp=_TIME, frame_id=_text(), id=_text(),
                lifetime=_DURATION, frame_locked=_truth(),
                metadata=_many(_object("foxglove.KeyValuePair", key=_text(), value=_text())),
                **{name: _many(primitive) for name, primitive in _PRIMITIVES.items()},
            )
        ),
    ),
    LOG: _object(
        LOG, timestamp=_TIME,
        level=_choice("foxglove.LogLevel", "UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"),
        message=_text(), name=_text(), file=_text(), line=_integer(),
    ),
    INTENT: _object(
        INTENT,
        slot=_integer("number of the robot"),
        x=_number("metres east, field frame"), y=_number("metres north, field frame"),
        heading=_number("radians from east, counterclockwise"),
        vx=_number("m/s east"), vy=_number("m/s north"),
        wanted=_object("headland.Velocity", x=_number("m/s east"), y=_number("m/s north"))
        | _said("what its mission wants, before others and safety have their say"),
        path=_many(_XY, "what is left of its way, nearest point first"),
        avoids=_many(_SLOTS, "robots that it keeps clear of, nearest first"),
        hears=_many(_SLOTS, "members that it takes for live"),
        strange=_many(_XY, "obstacles that it sees and nobody has announced"),
        holds=_many(_text(), "why it does not move, if it may not"),
        tool=_truth("it wants its implement down"),
    ),
    # What can be plotted of it; the message has all of `headland inspect --json`.
    FLEET: _object(
        FLEET,
        seconds=_number("since the first frame"),
        bus_load_worst_case=_number("share of the bus, at worst-case stuffing"),
        latched=_many(_text(), "stops that nobody has cleared: slot, incarnation, counter"),
        robots=_many(
            _object(
                "headland.Robot", slot=_integer(), state=_text(), silent=_truth(), left=_truth(),
                stopped=_truth(), placed=_truth("it knows where it is"), x_m=_number(),
                y_m=_number(), speed_m_s=_number(), health=_number(), question=_integer(),
            )
        ),
    ),
    THINGS: _object(
        THINGS,
        rows=_many(
            _object(
                "headland.Thing", **{name: _number() for name in THING}
            ) | _said("shape: 1 a box, 2 a disc, 0 no thing; half sides and places in metres")
        ),
    ),
}  # fmt: skip


def intent_message(intent: dict[str, Any]) -> dict[str, Any]:
    """The message of the schema, from a value of `sim.record.robot_intent`."""
    lists = {name: [_xy(point) for point in intent[name]] for name in POINTS if name in intent}
    wanted = {WANTED: _xy(intent[WANTED])} if WANTED in intent else {}
    return {**intent, **wanted, **lists}


def intent_of_message(message: dict[str, Any]) -> dict[str, Any]:
    """The inverse; also for files with pairs, and without `hears`. Raises KeyError, TypeError,
    ValueError or OverflowError for a message that is no intent."""
    points = {name: _pairs(message[name]) for name in POINTS}
    wanted = _pair(message[WANTED])
    unsigned((message["slot"],), (U8,))
    finite([message[name] for name in NUMBERS] + wanted)
    finite([value for each in points.values() for point in each for value in point])
    slots = [*message["avoids"], *message.get("hears", ())]
    unsigned(slots, (U8,) * len(slots))
    if type(message["holds"]) is not list or type(message["tool"]) is not bool:
        raise ValueError("no intent")
    return {**message, WANTED: wanted, **points}


def things_message(rows: list[list[float]]) -> dict[str, Any]:
    """A message with an object for each row of `sim.world.walls` (metres), so that Foxglove accepts
    it."""
    return {"rows": [dict(zip(THING, row, strict=True)) for row in rows]}


def things_of_message(message: dict[str, Any]) -> list[list[float]]:
    """Rows of `sim.world.walls`, metres, from a message, also from older files with rows of
    numbers. Raises KeyError, TypeError, ValueError or OverflowError for anything else."""
    return [
        finite([row[name] for name in THING] if isinstance(row, dict) else list(row))
        for row in message["rows"]
    ]


def _xy(point: Point | list[float]) -> dict[str, float]:
    x, y = point
    return {"x": x, "y": y}


def _pairs(points: Any) -> list[list[float]]:
    try:
        return [[point["x"], point["y"]] for point in points]
    except TypeError:  # pairs, or a mixture
        return [_pair(point) for point in points]


def _pair(point: Any) -> list[float]:
    if isinstance(point, dict):
        return [point["x"], point["y"]]
    x, y = point
    return [x, y]
