"""Tables of values that people declare: the fleet, its vehicles, its field, its warehouse.

A robot file has them, and so has a scenario, which adds what only a simulation needs. An unknown key
and a value out of range are errors of one line (`first_error`).
"""

from difflib import get_close_matches
from math import radians
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from agent.interface.config import PEERS_MAX, SPEED_MAX_M_S
from agent.interface.identity import SilencePolicy
from agent.interface.vehicle import DriveTrain, Vehicle

XY = tuple[float, float]  # metres east and north
SAID_MAX = 60  # characters of a wrong value quoted in a message


class Table(BaseModel):
    """A table of a file: no unknown keys, no infinite numbers, never changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class FieldTable(Table):
    """A field file, the implement, and how the field is divided into sections."""

    file: str
    feature: str | None = None
    implement_width_m: float = Field(default=4.0, gt=0.2, le=60.0)
    overlap_m: float = Field(default=0.2, gt=0.01, le=2.0)
    section_length_m: float = Field(default=250.0, ge=10.0, le=50_000.0)
    unit_m: float = Field(default=5.0, ge=0.5, le=100.0)
    # Metres east and north of the middle; default: a corner.
    gate: XY | None = None


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
    keys: str | None = None  # key file, made by `headland keys new`

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
    bays: list[XY] = Field(default=[])
    handle_s: float = Field(default=2.0, ge=0.1, le=600.0)
    t_max: int = Field(default=4, ge=1, le=100)


def first_error(problem: ValidationError, model: type[BaseModel]) -> str:
    """One line: the first wrong key, what is wrong with it, and the key that was probably meant.

    `model`: the model of the whole file."""
    error = problem.errors()[0]
    path = [str(part) for part in error["loc"]]
    key = ".".join(path)
    if error["type"] == "extra_forbidden":
        meant = get_close_matches(path[-1], _keys_beside(path, model), n=1)
        return f"{key}: unknown key" + (f"; did you mean {meant[0]!r}?" if meant else "")
    if error["type"] == "missing":
        return f"{key}: is missing"
    message = error["msg"][0].lower() + error["msg"][1:]
    more = len(problem.errors()) - 1
    tail = f" (and {more} more)" if more else ""
    return f"{key}: {message}, not {_said(error['input'])}{tail}"


def _said(value: object) -> str:
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits
        return "a value that long"
    return text if len(text) <= SAID_MAX else f"{text[: SAID_MAX - 4]} ..."


def _keys_beside(path: list[str], whole: type[BaseModel]) -> list[str]:
    model: Any = whole
    for part in path[:-1]:
        field = getattr(model, "model_fields", {}).get(part)
        if field is None or not isinstance(field.annotation, type):
            return []
        model = field.annotation
    return (
        list(model.model_fields) if isinstance(model, type) and issubclass(model, BaseModel) else []
    )
