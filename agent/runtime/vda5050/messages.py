"""The messages of VDA 5050, version 2.1, as the official JSON schemas have them.

Names on the wire are those of the standard, in camel case. Fields that the standard does not have are
ignored. SI units, angles in radians, counter-clockwise from the x axis of the map.

A message that cannot be read raises pydantic's ValidationError, which is a ValueError.
Source: VDA 5050 2.1.0, chapter 6, and https://github.com/VDA5050/VDA5050 (json_schemas).
"""

import json
from datetime import UTC, datetime
from enum import StrEnum
from typing import Annotated, Any, Final, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field
from pydantic.alias_generators import to_camel

# What we say and send is the same in both. A client of 2.0 may drop what says 2.1 (vda-5050-lib does).
VERSIONS: Final = ("2.0.0", "2.1.0")
VERSION: Final = VERSIONS[0]
MAJOR: Final = "v2"  # level of each topic
# Limits that we state in a factsheet, and to which we hold others. A master that says more is refused.
MESSAGE_BYTES_MAX: Final = 256 * 1024
ID_CHARS_MAX: Final = 128
NODES_MAX: Final = 64
ACTIONS_MAX: Final = 16  # of one node or edge, and of one message of instant actions

Id = Annotated[str, Field(max_length=ID_CHARS_MAX)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Topic(StrEnum):
    """The last level of a topic."""

    ORDER = "order"
    INSTANT_ACTIONS = "instantActions"
    STATE = "state"
    VISUALIZATION = "visualization"
    CONNECTION = "connection"
    FACTSHEET = "factsheet"


class _Model(BaseModel):
    model_config = ConfigDict(
        alias_generator=to_camel, populate_by_name=True, extra="ignore", frozen=True
    )


class MessageHeader(_Model):
    """What each message begins with."""

    header_id: int = 0
    timestamp: str = ""
    version: str = VERSION
    manufacturer: str = ""
    serial_number: str = ""

    def to_json(self) -> str:
        """The message as it is sent; fields without a value are left out."""
        return self.model_dump_json(by_alias=True, exclude_none=True)


# ---------------------------------------------------------------- order


class ActionParameter(_Model):
    """One named value that an action takes."""

    key: str
    value: Any


class BlockingType(StrEnum):
    """What else a vehicle may do during an action; HARD: nothing."""

    NONE = "NONE"
    SOFT = "SOFT"
    HARD = "HARD"


class Action(_Model):
    """Something that a vehicle does at a node, on an edge, or at once."""

    action_type: str
    action_id: Id
    action_description: str | None = None
    blocking_type: BlockingType
    action_parameters: list[ActionParameter] | None = None

    def parameter(self, key: str) -> Any:
        """The value of a parameter; None if there is none."""
        found = self.action_parameters or []
        return next((each.value for each in found if each.key == key), None)


class NodePosition(_Model):
    """Metres on a map."""

    x: Finite
    y: Finite
    theta: Finite | None = None
    allowed_deviation_xy: Annotated[Finite | None, Field(alias="allowedDeviationXY")] = None
    allowed_deviation_theta: Finite | None = None
    map_id: str = ""
    map_description: str | None = None


class OrderNode(_Model):
    """A place of an order, with what to do there. Places in the horizon are not released."""

    node_id: Id
    sequence_id: int
    released: bool
    node_description: str | None = None
    node_position: NodePosition | None = None
    actions: Annotated[list[Action], Field(max_length=ACTIONS_MAX)] = []


class OrderEdge(_Model):
    """The way between two nodes. `max_speed`: metres a second; `orientation`: radians."""

    edge_id: Id
    sequence_id: int
    released: bool
    start_node_id: Id
    end_node_id: Id
    edge_description: str | None = None
    max_speed: Finite | None = None
    orientation: Finite | None = None
    actions: Annotated[list[Action], Field(max_length=ACTIONS_MAX)] = []


class MasterOrder(MessageHeader):
    """Nodes to be visited in order, the edges between them, and actions at both."""

    order_id: Id
    order_update_id: Annotated[int, Field(ge=0)]
    zone_set_id: str | None = None
    nodes: Annotated[list[OrderNode], Field(min_length=1, max_length=NODES_MAX)]
    edges: Annotated[list[OrderEdge], Field(max_length=NODES_MAX)]


class InstantActions(MessageHeader):
    """Actions to be executed at once. Some libraries for 2.0 use the name of the list of 1.1."""

    actions: Annotated[
        list[Action],
        Field(
            max_length=ACTIONS_MAX,
            validation_alias=AliasChoices("actions", "instantActions"),
            serialization_alias="actions",
        ),
    ]

    def to_json(self) -> str:
        """The message as it is sent, with the list under both of its names."""
        plain = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        return json.dumps({**plain, "instantActions": plain["actions"]})


# ---------------------------------------------------------------- state


class NodeState(_Model):
    """A node that is still ahead."""

    node_id: str
    sequence_id: int
    released: bool


class EdgeState(_Model):
    """An edge that is still ahead."""

    edge_id: str
    sequence_id: int
    released: bool


class AgvPosition(_Model):
    """Where a vehicle is on its map, metres and radians."""

    x: Finite
    y: Finite
    theta: Finite
    map_id: str
    position_initialized: bool
    localization_score: Finite | None = None


class Velocity(_Model):
    """Metres and radians a second, in the frame of the vehicle."""

    vx: Finite | None = None
    vy: Finite | None = None
    omega: Finite | None = None


class Load(_Model):
    """A parcel that the vehicle carries, by its own name for it."""

    load_id: str | None = None
    load_type: str | None = None


class ActionStatus(StrEnum):
    """How far an action is; FINISHED and FAILED are final."""

    WAITING = "WAITING"
    INITIALIZING = "INITIALIZING"
    RUNNING = "RUNNING"
    PAUSED = "PAUSED"
    FINISHED = "FINISHED"
    FAILED = "FAILED"


ENDED: Final = (ActionStatus.FINISHED, ActionStatus.FAILED)


class ActionState(_Model):
    """How far one action of an order or of the instant actions is."""

    action_id: str
    action_type: str | None = None
    action_status: ActionStatus
    action_description: str | None = None
    result_description: str | None = None


class BatteryState(_Model):
    """Charge of the battery in per cent, and whether it rises."""

    battery_charge: Finite  # per cent
    charging: bool = False


class ErrorReference(_Model):
    """What an error is about: as a key `orderId` and its value."""

    reference_key: str
    reference_value: str


class ErrorLevel(StrEnum):
    """Whether a vehicle goes on by itself."""

    WARNING = "WARNING"  # the vehicle goes on by itself
    FATAL = "FATAL"  # a person is needed


class VehicleError(_Model):
    """Something that a master should know or that a person has to mend."""

    error_type: str
    error_level: ErrorLevel
    error_description: str | None = None
    error_references: list[ErrorReference] | None = None


class InfoReference(_Model):
    """What a piece of information is about, as a key and a value."""

    reference_key: str
    reference_value: str


class Information(_Model):
    """For people and logs; no master acts by it."""

    info_type: str
    info_level: Literal["DEBUG", "INFO"] = "INFO"
    info_description: str | None = None
    info_references: list[InfoReference] | None = None


class EStop(StrEnum):
    """Which kind of emergency stop is active, by how it ends."""

    AUTOACK = "AUTOACK"  # ends by itself
    MANUAL = "MANUAL"  # a person releases it at the vehicle
    REMOTE = "REMOTE"  # a person releases it from somewhere else
    NONE = "NONE"


class SafetyState(_Model):
    """Whether an emergency stop is active, or something is in a protective field."""

    e_stop: EStop = EStop.NONE
    field_violation: bool = False


class OperatingMode(StrEnum):
    """Who directs a vehicle; AUTOMATIC: its master control."""

    AUTOMATIC = "AUTOMATIC"
    SEMIAUTOMATIC = "SEMIAUTOMATIC"
    MANUAL = "MANUAL"
    SERVICE = "SERVICE"
    TEACHIN = "TEACHIN"


class VehicleState(MessageHeader):
    """Everything about one vehicle and its order."""

    order_id: str = ""
    order_update_id: int = 0
    last_node_id: str = ""
    last_node_sequence_id: int = 0
    driving: bool = False
    paused: bool | None = None
    new_base_request: bool | None = None
    operating_mode: OperatingMode = OperatingMode.AUTOMATIC
    node_states: list[NodeState] = []
    edge_states: list[EdgeState] = []
    agv_position: AgvPosition | None = None
    velocity: Velocity | None = None
    loads: list[Load] | None = None
    action_states: list[ActionState] = []
    battery_state: BatteryState
    errors: list[VehicleError] = []
    information: list[Information] | None = None
    safety_state: SafetyState = SafetyState()


class Visualization(MessageHeader):
    """Place and velocity alone, more often than the state."""

    agv_position: AgvPosition | None = None
    velocity: Velocity | None = None


class ConnectionState(StrEnum):
    """Whether a vehicle is at the broker."""

    ONLINE = "ONLINE"
    OFFLINE = "OFFLINE"  # it left in an orderly way
    CONNECTIONBROKEN = "CONNECTIONBROKEN"  # the last will


class Connection(MessageHeader):
    """Retained at the broker, and also the last will."""

    connection_state: ConnectionState


# ---------------------------------------------------------------- factsheet


class TypeSpecification(_Model):
    """Which kind of vehicle it is. `max_load_mass`: kilograms."""

    series_name: str
    series_description: str | None = None
    agv_kinematic: Literal["DIFF", "OMNI", "THREEWHEEL"]
    agv_class: Literal["FORKLIFT", "CONVEYOR", "TUGGER", "CARRIER"]
    max_load_mass: float
    localization_types: list[str]
    navigation_types: list[str]


class PhysicalParameters(_Model):
    """Metres, metres a second."""

    speed_min: float
    speed_max: float
    acceleration_max: float
    deceleration_max: float
    height_max: float
    width: float
    length: float


class Timing(_Model):
    """Least and usual times between messages, seconds."""

    min_order_interval: float
    min_state_interval: float
    default_state_interval: float | None = None
    visualization_interval: float | None = None


class ProtocolLimits(_Model):
    """Names with dots are the standard's: they name the list that they limit."""

    max_string_lens: dict[str, int | bool]
    max_array_lens: dict[str, int]
    timing: Timing


class OptionalParameter(_Model):
    """A field that the standard leaves open, and whether orders need it."""

    parameter: str
    support: Literal["SUPPORTED", "REQUIRED"]
    description: str | None = None


class FactsheetParameter(_Model):
    """What an action takes, by name and type."""

    key: str
    value_data_type: Literal["BOOL", "NUMBER", "INTEGER", "FLOAT", "STRING", "OBJECT", "ARRAY"]
    description: str | None = None
    is_optional: bool | None = None


class AgvAction(_Model):
    """An action that a vehicle can do, and where."""

    action_type: str
    action_description: str | None = None
    action_scopes: list[Literal["INSTANT", "NODE", "EDGE"]]
    action_parameters: list[FactsheetParameter] | None = None
    result_description: str | None = None


class ProtocolFeatures(_Model):
    """Which fields and actions a vehicle knows."""

    optional_parameters: list[OptionalParameter]
    agv_actions: list[AgvAction]


class LoadSpecification(_Model):
    """Where loads can lie; none: the whole vehicle."""

    load_positions: list[str] | None = None


class Factsheet(MessageHeader):
    """What a vehicle can do; sent when it is asked for."""

    type_specification: TypeSpecification
    physical_parameters: PhysicalParameters
    protocol_limits: ProtocolLimits
    protocol_features: ProtocolFeatures
    agv_geometry: dict[str, Any] = {}
    load_specification: LoadSpecification = LoadSpecification()


Sent = MasterOrder | InstantActions | VehicleState | Visualization | Connection | Factsheet
MODELS: Final[dict[Topic, type[MessageHeader]]] = {
    Topic.ORDER: MasterOrder,
    Topic.INSTANT_ACTIONS: InstantActions,
    Topic.STATE: VehicleState,
    Topic.VISUALIZATION: Visualization,
    Topic.CONNECTION: Connection,
    Topic.FACTSHEET: Factsheet,
}


def timestamp(now_s: float) -> str:
    """Seconds since 1970 as the standard writes them.

    >>> timestamp(0.25)
    '1970-01-01T00:00:00.250Z'
    """
    text = datetime.fromtimestamp(now_s, UTC).isoformat(timespec="milliseconds")
    return text.removesuffix("+00:00") + "Z"


def told_at_us(text: str) -> int | None:
    """Microseconds since 1970 of a time as the standard writes it; None: it is none.

    >>> told_at_us("1970-01-01T00:00:00.250Z"), told_at_us("soon")
    (250000, None)
    """
    try:
        said = datetime.fromisoformat(text)
        return round((said if said.tzinfo else said.replace(tzinfo=UTC)).timestamp() * 1e6)
    except (ValueError, OverflowError):
        return None
