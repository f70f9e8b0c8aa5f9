"""Tables of values that people declare: the fleet, its vehicles, its field, its warehouse.

A robot file has them, and so has a scenario, which adds what only a simulation needs. An unknown key
and a value out of range are errors of one line (`first_error`).
"""

import re
from collections.abc import Sequence
from difflib import get_close_matches
from math import ceil, radians
from typing import Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema

from agent.exploration.exploration_task import (
    AT_M,
    BEYOND_CELLS,
    ROBOTS_MAX,
    ExplorationOrder,
    TaskKind,
    view_cells,
)
from agent.interface.config import PEERS_MAX, SPEED_MAX_M_S
from agent.interface.geometry import Point
from agent.interface.identity import SilencePolicy
from agent.interface.vehicle import DriveTrain, Vehicle
from crdt.occupancy import EDGE, SIDE_MAX, Geometry
from crdt.sighting import MergeOrder

SAID_MAX = 60  # characters of a wrong value quoted in a message


def _make_strict(schema: Any) -> None:
    """Let no other kind of value pass for a number or a truth value, here and in what is inside."""
    if isinstance(schema, dict):
        if schema.get("type") in ("int", "float", "bool"):
            schema["strict"] = True
        for inner in schema.values():
            _make_strict(inner)
    elif isinstance(schema, list):
        for inner in schema:
            _make_strict(inner)


class Table(BaseModel):
    """A table of a file: no unknown keys, no infinite numbers, never changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: type[BaseModel], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Numbers and truth values are written as such: pydantic takes true for 1 and "3" for 3."""
        schema = handler(source)
        _make_strict(schema)
        return schema


class FieldTable(Table):
    """A field file, the implement, and how the field is divided into sections."""

    file: str
    feature: str | None = None
    implement_width_m: float = Field(default=4.0, gt=0.2, le=60.0)
    overlap_m: float = Field(default=0.2, gt=0.01, le=2.0)
    section_length_m: float = Field(default=250.0, ge=10.0, le=50_000.0)
    unit_m: float = Field(default=5.0, ge=0.5, le=100.0)
    # Metres east and north of the middle; default: a corner.
    gate: Point | None = None


class FleetTable(Table):
    """The robots of a fleet, which are all alike."""

    robots: int = Field(default=6, ge=1, le=PEERS_MAX)
    radius_m: float = Field(default=0.8, gt=0.05, le=5.0)
    speed_m_s: float = Field(default=2.5, gt=0.05, le=SPEED_MAX_M_S)
    acceleration_m_s2: float = Field(default=1.5, gt=0.05, le=10.0)
    drive: Literal["mecanum", "differential", "ackermann"] = "mecanum"
    wheelbase_m: float = Field(default=1.2, gt=0.1, le=6.0)  # with "ackermann"
    track_m: float = Field(default=1.0, gt=0.1, le=4.0)  # with "differential" and "ackermann"
    steer_deg: float = Field(default=40.0, ge=10.0, le=60.0)  # full lock, with "ackermann"
    silence: Literal["stop", "slow", "continue"] = "stop"
    # In a building: stop before an unannounced obstacle and ask; else drive round it. In a field
    # robots always ask.
    asks: bool = False
    keys: str | None = None  # key file or its folder, of `headland keys new`; "drawn": of the seed

    @property
    def vehicle(self) -> Vehicle:
        """Size and limits of each of its vehicles."""
        return Vehicle(
            self.radius_m, self.speed_m_s, self.acceleration_m_s2, DriveTrain[self.drive.upper()],
            self.wheelbase_m, self.track_m, radians(self.steer_deg),
        )  # fmt: skip

    @property
    def silence_policy(self) -> SilencePolicy:
        """What its robots do when a member falls silent."""
        return SilencePolicy[self.silence.upper()]


class BatteryTable(Table):
    """The battery of each carrier."""

    range_m: float = Field(default=0.0, ge=0.0)  # driving range of a full battery; 0: no limit
    # How long a full battery lasts when standing; 0: no limit.
    standby_s: float = Field(default=0.0, ge=0.0)
    dock_s: float = Field(default=5.0, ge=0.0, le=600.0)
    charge_s: float = Field(default=60.0, gt=0.0, le=86_400.0)
    reserve: float = Field(default=0.15, ge=0.0, le=0.5)


class WarehouseTable(Table):
    """A building with charger bays, in which parcels are carried."""

    map: str  # a file in Moving AI format, or the drawing itself
    cell_m: float = Field(default=1.0, ge=0.5, le=10.0)
    bays: list[Point] = Field(default=[])
    handle_s: float = Field(default=2.0, ge=0.1, le=600.0)
    t_max: int = Field(default=4, ge=1, le=100)


class FloorTable(Table):
    """The map of a building in which robots drive to goals."""

    map: str  # a file in Moving AI format, or the drawing itself
    cell_m: float = Field(default=1.0, gt=0.05, le=10.0)
    # Distance from walls, in addition to the radius.
    margin_m: float = Field(default=0.1, ge=0.02, le=1.0)


class UnknownPlaceTable(Table):
    """A rectangle round the origin that a fleet explores, and the range sensors of its robots."""

    width_m: float = Field(ge=1.0, le=96.0)
    height_m: float = Field(ge=1.0, le=96.0)
    cell_m: float = Field(default=0.1, ge=0.05, le=1.0)
    range_m: float = Field(default=1.5, gt=0.3, le=30.0)
    merge_strategy: Literal["max_confidence", "latest_update", "decayed"] = "max_confidence"
    robots_max: int = Field(default=ROBOTS_MAX, ge=1, le=32)

    @property
    def merge_order(self) -> MergeOrder:
        """How two readings of a cell are merged."""
        return MergeOrder(self.merge_strategy)

    @property
    def geometry(self) -> Geometry:
        """The cells of the map, with the origin of the place in its middle. They cover all of it."""
        rows, columns = (ceil(m / self.cell_m - EDGE) for m in (self.height_m, self.width_m))
        return Geometry(rows, columns, (-self.width_m / 2, -self.height_m / 2), self.cell_m)

    @property
    def too_fine(self) -> str:
        """What is wrong if the place has more cells than a map; else empty."""
        cells = max(self.geometry[:2])
        return f"{cells} cells from side to side, a map has at most {SIDE_MAX}" * (cells > SIDE_MAX)

    @property
    def too_short(self) -> str:
        """What is wrong if the sensors do not reach beyond a frontier; else empty."""
        if view_cells(self.range_m, self.cell_m):
            return ""
        least_m = AT_M + (BEYOND_CELLS + 1.0) * self.cell_m
        cells = f"cells of {self.cell_m:g} m"
        return f"{self.range_m:g} m is too short for {cells}, which need {least_m:.2f} m"

    def holds(self, x_m: float, y_m: float) -> bool:
        """Whether a point is within the rectangle."""
        return abs(x_m) < self.width_m / 2 and abs(y_m) < self.height_m / 2


class OrderTable(Table):
    """A task for the fleet besides exploration; the nearest free robot does it."""

    kind: Literal["navigate_to", "patrol"]
    points: list[Point] = Field(min_length=1, max_length=64)  # metres east and north of the middle

    @property
    def order(self) -> ExplorationOrder:
        """As the mission takes it."""
        return ExplorationOrder(TaskKind(self.kind), tuple(self.points))


class GridTable(Table):
    """A map whose free cells a fleet covers, one cell after the other."""

    map: str  # a file in Moving AI format, or the drawing itself
    cell_m: float = Field(default=4.0, gt=0.1, le=60.0)  # the working width
    turn_cost: float = Field(default=0.0, ge=0.0, le=10.0)  # in steps from a cell to the next


# What a wrong value is not, in words for people, by pydantic's name of the error.
_NOT = {
    "int_parsing": "not a whole number", "int_type": "not a whole number",
    "int_from_float": "not a whole number", "float_parsing": "not a number",
    "float_type": "not a number", "bool_parsing": "not true or false", "bool_type": "not true or false",
    "string_type": "not a text in quotes", "list_type": "not a list", "tuple_type": "not a list",
    "model_type": "not a table", "dict_type": "not a table", "finite_number": "not a finite number",
}  # fmt: skip

# What a value out of its range should be, by pydantic's name of the error; braces: values that it tells.
_BOUNDS = {
    "greater_than_equal": "should be {ge} or more", "greater_than": "should be more than {gt}",
    "less_than_equal": "should be {le} or less", "less_than": "should be less than {lt}",
    "too_short": "should have {min_length} or more items, has {actual_length}",
    "too_long": "should have {max_length} or fewer items, has {actual_length}",
    "string_too_short": "should have {min_length} or more characters",
    "string_too_long": "should have {max_length} or fewer characters",
}  # fmt: skip


def first_error(problem: ValidationError, model: type[BaseModel], text: str = "") -> str:
    """One line: the wrong key, what is wrong with it, and the key or value that was probably meant.

    `model`: the model of the whole file. `text`: of the file; with it the line is named. An unknown key
    comes before a missing one, because it is often the missing one with a typing error.
    """
    errors = problem.errors()
    error = next((each for each in errors if each["type"] == "extra_forbidden"), errors[0])
    path = _without_tags(error["loc"], model)
    key = ".".join(map(str, path))
    number = line_of(text, path)
    where = key if number is None else f"line {number}: {key}"
    if error["type"] == "extra_forbidden":
        meant = get_close_matches(str(path[-1]), _keys_beside(list(error["loc"]), model), n=1)
        return f"{where}: unknown key" + (f"; did you mean {meant[0]!r}?" if meant else "")
    if error["type"] == "missing":
        return f"{where}: is missing"
    context = error.get("ctx", {})
    choices = str(context.get("expected_tags" if "tag" in context else "expected", ""))
    if error["type"] in ("union_tag_invalid", "literal_error"):
        known = [choice.strip().strip("'") for choice in choices.replace(" or ", ", ").split(", ")]
        given = context.get("tag", error["input"])
        place = f"{where}.kind" if "tag" in context else where
        meant = get_close_matches(str(given), known, n=1)
        hint = f"did you mean {meant[0]!r}?" if meant else f"it is one of {', '.join(known)}"
        return f"{place}: not {_said(given)}; {hint}"
    if error["type"] == "union_tag_not_found":
        return f"{where}.kind: is missing"
    more = len(errors) - 1
    tail = f" (and {more} more)" if more else ""
    if error["type"] in _NOT:
        return f"{where}: {_NOT[error['type']]}: {_said(error['input'])}{tail}"
    if error["type"] in _BOUNDS:
        bounds = {key: f"{at:g}" if isinstance(at, float) else at for key, at in context.items()}
        told = _BOUNDS[error["type"]].format(**bounds)
        counted = "" if "has" in told.split() else f", not {_said(error['input'])}"
        return f"{where}: {told}{counted}{tail}"
    message = error["msg"][0].lower() + error["msg"][1:]
    return f"{where}: {message}, not {_said(error['input'])}{tail}"


def line_of(text: str, path: Sequence[str | int]) -> int | None:
    """The line of a file on which a key stands, or the table that lacks it; counted from 1."""
    tables: dict[str, int] = {}
    here: list[str | int] = []
    best: tuple[int, int] | None = None  # how many parts of the path fit, and the line
    for number, line in enumerate(text.splitlines(), start=1):
        if head := _HEAD.match(line):
            name = head["list"] or head["table"]
            here = [part.strip().strip("\"'") for part in name.split(".")]
            if head["list"]:
                tables[name] = tables.get(name, -1) + 1
                here.append(tables[name])
            found = here
        elif key := _KEY.match(line):
            found = [*here, *(part.strip().strip("\"'") for part in key[1].split("."))]
        else:
            continue
        if found == list(path[: len(found)]) and (best is None or len(found) > best[0]):
            best = (len(found), number)
    return None if best is None else best[1]


_HEAD = re.compile(r"\s*(?:\[\[(?P<list>[^]]+)\]\]|\[(?P<table>[^][]+)\])\s*(?:#.*)?$")
_KEY = re.compile(r"\s*([\w\"'.-]+)\s*=")


def _said(value: object) -> str:
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits
        return "a value that long"
    return text if len(text) <= SAID_MAX else f"{text[: SAID_MAX - 4]} ..."


def _tags(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """The models of a list of kinds, by the word that `kind` has for each."""
    found: dict[str, type[BaseModel]] = {}
    for field in model.model_fields.values():
        for each in _models(field.annotation):
            kind = each.model_fields.get("kind")
            if kind is not None:
                found |= {str(word): each for word in get_args(kind.annotation)}
    return found


def _without_tags(loc: Sequence[str | int], model: type[BaseModel]) -> list[str | int]:
    """The keys of a path of pydantic, without the word of `kind` that it puts behind a list's index."""
    tags = _tags(model)
    return [
        part
        for before, part in zip([None, *loc[:-1]], loc, strict=True)
        if not (isinstance(before, int) and part in tags)
    ]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Every model in a type: `list[A | B]`, `A | None`, `A`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _keys_beside(path: list[str | int], whole: type[BaseModel]) -> list[str]:
    """The keys of the table in which the last part of a path stands."""
    model, tags = whole, _tags(whole)
    for part in path[:-1]:
        if isinstance(part, int):
            continue
        field = model.model_fields.get(part)
        models = [tags[part]] if part in tags and field is None else []
        models = models or ([] if field is None else _models(field.annotation))
        if not models:
            return []
        model = models[0]
    return list(model.model_fields)
