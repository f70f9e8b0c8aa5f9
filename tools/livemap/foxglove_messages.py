"""Plain values of a schema of Foxglove as messages of foxglove-sdk: one description serves both.

The schemas (`sim.record.mcap_schema`) say by their titles which class each part is.
"""

from base64 import b64decode
from collections.abc import Callable
from typing import Any, Final

from foxglove import channels, messages

from sim.record.mcap_schema import Schema

PREFIX: Final = "foxglove."
Maker = Callable[[Any], Any]
# What the SDK calls the numbered choices of the schemas.
CHOICES: Final[dict[str, Any]] = {
    "foxglove.LineType": messages.LinePrimitiveLineType,
    "foxglove.LogLevel": messages.LogLevel,
    "foxglove.NumericType": messages.PackedElementFieldNumericType,
    "foxglove.PositionCovarianceType": messages.LocationFixPositionCovarianceType,
    "foxglove.SceneEntityDeletionType": messages.SceneEntityDeletionType,
}
TIMES: Final[dict[str, Maker]] = {
    "time": lambda value: messages.Timestamp(value["sec"], value["nsec"]),
    "duration": lambda value: messages.Duration(value["sec"], value["nsec"]),
}


def is_typed(schema: Schema) -> bool:
    """Whether it is one of Foxglove's own."""
    title: str = schema["title"]
    return title.startswith(PREFIX)


def channel_of(schema: Schema) -> Any:
    """The class of the SDK for topics with this schema."""
    return getattr(channels, schema["title"].removeprefix(PREFIX) + "Channel")


def maker_of(schema: Schema) -> Maker:
    """What makes the message of a value that has this schema."""
    title = schema.get("title", "")
    if title in TIMES:
        return TIMES[title]
    if "oneOf" in schema:
        names = ["".join(map(str.capitalize, each["title"].split("_"))) for each in schema["oneOf"]]
        members = [getattr(CHOICES[title], name) for name in names]
        return members.__getitem__
    if schema["type"] == "array":
        make = maker_of(schema["items"])
        return lambda values: [make(value) for value in values]
    if schema["type"] == "object":
        kind = getattr(messages, title.removeprefix(PREFIX))
        makers = {name: maker_of(each) for name, each in schema["properties"].items()}
        return lambda value: kind(**{name: makers[name](each) for name, each in value.items()})
    return b64decode if "contentEncoding" in schema else lambda value: value
