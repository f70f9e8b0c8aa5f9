"""The topics of a fleet and the schema of each: one table for live viewers and for recordings."""

from functools import cache
from typing import Any, get_type_hints

from protocol.frames.messages import GROUPS, Message
from sim.record.foxglove import FRAME_TRANSFORMS, GRID, LOCATION_FIX, LOG, SCENE_UPDATE, Values
from sim.record.mcap_schema import FLEET, INTENT, SCHEMAS, THINGS, Schema

TF_TOPIC, SCENE_TOPIC, PATHS_TOPIC, GRID_TOPIC = "/tf", "/scene", "/paths", "/grid"
LOG_TOPIC, FLEET_TOPIC, THINGS_TOPIC, ROBOT_TOPICS = "/log", "/fleet", "/things", "/robots/"
FIX = "/fix"  # the end of the topic of a robot's fixes
# What both have, whatever the fleet says. The name of a schema is its title.
TOPICS: dict[str, Schema] = {
    TF_TOPIC: SCHEMAS[FRAME_TRANSFORMS],
    SCENE_TOPIC: SCHEMAS[SCENE_UPDATE],
    PATHS_TOPIC: SCHEMAS[SCENE_UPDATE],
    GRID_TOPIC: SCHEMAS[GRID],
    LOG_TOPIC: SCHEMAS[LOG],
    FLEET_TOPIC: SCHEMAS[FLEET],
}
KINDS: dict[type[Message], str] = {group.kind: f"/can/{group.name}" for group in GROUPS}
_KIND_OF = {topic: kind for kind, topic in KINDS.items()}
_PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string", bytes: "string"}


def fix_topic(slot: int) -> str:
    """Where a robot is on earth."""
    return f"{ROBOT_TOPICS}{slot}{FIX}"


@cache
def schema_of(topic: str) -> Schema:
    """KeyError: there is no such topic."""
    if topic == THINGS_TOPIC:
        return SCHEMAS[THINGS]
    if topic.startswith(ROBOT_TOPICS):
        return SCHEMAS[LOCATION_FIX if topic.endswith(FIX) else INTENT]
    return TOPICS[topic] if topic in TOPICS else _of_kind(_KIND_OF[topic])


def frame_values(source: int, slot: int, message: Any) -> Values:
    """Of a frame: bytes as hexadecimal digits, numbers as they are. `slot`: -1 where it is not known."""
    own = {
        name: value.hex() if isinstance(value, bytes) else value
        for name, value in message._asdict().items()
    }
    return {"source": source, "robot": slot, **own}


def _of_kind(kind: type[Message]) -> Schema:
    """So that fields can be plotted by name."""
    fields = {name: _of_type(hint) for name, hint in get_type_hints(kind).items()}
    own = {"source": {"type": "integer"}, "robot": {"type": "integer"}}
    return {"type": "object", "title": kind.__name__, "properties": {**own, **fields}}


def _of_type(hint: Any) -> Schema:
    if hint == tuple[int, ...]:
        return {"type": "array", "items": {"type": "integer"}}
    return {"type": next(name for each, name in _PLAIN.items() if issubclass(hint, each))}
