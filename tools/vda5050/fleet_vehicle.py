"""One robot of a fleet as a VDA 5050 vehicle: its order, its instant actions, and its state.

Sans I/O: messages and what was heard on the bus go in, the state comes out. What is said of an order is
what the fleet's registers say of its task, whichever robot carries it.
"""

from collections import deque
from collections.abc import Callable, Sequence
from math import pi
from typing import NamedTuple

from agent.delivery.task_outcome import TaskOutcome, TaskPhase
from agent.runtime.vda5050.messages import (
    ACTIONS_MAX,
    NODES_MAX,
    Action,
    ActionState,
    ActionStatus,
    AgvPosition,
    BatteryState,
    EdgeState,
    ErrorLevel,
    ErrorReference,
    EStop,
    InfoReference,
    Information,
    Load,
    MasterOrder,
    NodeState,
    OrderNode,
    SafetyState,
    Topic,
    VehicleError,
    VehicleState,
    Velocity,
    Visualization,
)
from tools.vda5050.order_book import BookedOrder
from tools.vda5050.transport_rules import (
    OrderRefused,
    ParcelOrder,
    by_sequence,
    check_graph,
    in_order,
)

MOVES_M_S = 0.05  # a robot that is slower stands; the step of speeds in POSE
THETA_MAX_RAD = 3.1415  # a rounded pi would be beyond the limit of the standard
ERRORS_MAX = 8  # newest refusals that are reported
INSTANT_MAX = 16  # newest instant actions that are reported
INSTANT_ERROR, NO_ORDER = "instantActionError", "noOrderToCancel"  # error types of the standard
BEGUN_MAX = 256  # newest instant actions whose repetition is known: a broker may deliver one twice


class HeardRobot(NamedTuple):
    """What the bus says of one robot now. Metres, radians; the map's x is east."""

    heard: bool  # it is not silent
    placed: bool  # it knows where it is
    x_m: float
    y_m: float
    course_rad: float
    speed_m_s: float
    battery: float | None  # share of a full charge; None: it has not told
    latched: bool  # by an emergency stop
    started: bool
    causes: Sequence[str]  # why it stands, for people
    loads: Sequence[int]  # tasks whose parcels are aboard


UNHEARD = HeardRobot(False, False, 0.0, 0.0, 0.0, 0.0, None, False, True, (), ())


class FleetVehicle:
    """The order and the instant actions of one vehicle."""

    def __init__(
        self, slot: int, booked: BookedOrder | None, transport: ParcelOrder | None
    ) -> None:
        """`booked`: the order from before a restart, and `transport` what it asks for."""
        self.slot, self.booked, self.transport = slot, booked, transport
        self.robot = UNHEARD
        self.outcome: TaskOutcome | None = None  # of the task of its order
        self.errors: list[VehicleError] = []
        self.instant: dict[str, ActionState] = {}
        self._begun: deque[str] = deque(maxlen=BEGUN_MAX)  # instant actions, by their ids
        self._last_node = ("", 0)  # of earlier orders

    # ---------------------------------------------------------------- orders

    @property
    def busy(self) -> bool:
        """Whether its order is neither done nor given up."""
        booked = self.booked
        if booked is None or (booked.number is None and booked.cancelled):
            return False
        return self.outcome is None or not self.outcome.final

    def takes(self, order: MasterOrder) -> MasterOrder | None:
        """The order to book, joined with the one that it updates; None for a repetition.

        Raises OrderRefused."""
        order, booked = by_sequence(order), self.booked
        if booked is None or booked.order.order_id != order.order_id:
            if self.busy:
                raise OrderRefused("orderError", "the order before it is not done; cancel it first")
            return order
        mine = booked.order
        if order.order_update_id == mine.order_update_id:
            return None
        if order.order_update_id < mine.order_update_id:
            raise OrderRefused("orderUpdateError", "a newer update is known")
        if booked.number is not None or booked.cancelled:
            raise OrderRefused(
                "orderUpdateError", "the transport is ordered, and has no more to come"
            )
        return stitched(mine, order)

    def accept(self, booked: BookedOrder, transport: ParcelOrder | None) -> None:
        """Take an order that is booked; what was said of the one before it is over."""
        before = self.booked
        if before is not None and before.order.order_id != booked.order.order_id:
            self._last_node = self._passed_node()
            self.errors, self.instant = [], {}
        self.booked, self.transport, self.outcome = booked, transport, None

    def refuse(self, error: VehicleError) -> None:
        """Report a refusal until the next order is accepted."""
        self.errors = [*self.errors, error][-ERRORS_MAX:]

    def invalid(self, topic: str, why: str) -> None:
        """Report a message that could not be read."""
        kind = "validationError"
        reference = ErrorReference(reference_key="topic", reference_value=topic)
        self.refuse(
            VehicleError(
                error_type=kind, error_level=ErrorLevel.WARNING,
                error_description=why, error_references=[reference],
            )
        )  # fmt: skip

    # ---------------------------------------------------------------- instant actions

    def begin(self, action: Action) -> bool:
        """Whether an instant action is new; then it is INITIALIZING."""
        if action.action_id in self._begun:
            return False
        self._begun.append(action.action_id)
        self.report(action, ActionStatus.INITIALIZING)
        return True

    def report(
        self, action: Action, status: ActionStatus, result: str | None = None,
        kind: str = INSTANT_ERROR,
    ) -> None:  # fmt: skip
        """How far an instant action is, and what a person should know of it. `kind`: the type of the
        error if it has FAILED."""
        self.instant[action.action_id] = ActionState(
            action_id=action.action_id, action_type=action.action_type, action_status=status,
            result_description=result,
        )  # fmt: skip
        while len(self.instant) > INSTANT_MAX:
            del self.instant[next(iter(self.instant))]
        if status is ActionStatus.FAILED:
            references = (
                ("topic", str(Topic.INSTANT_ACTIONS)), ("actionId", action.action_id),
                ("actionType", action.action_type),
            )  # fmt: skip
            self.refuse(
                VehicleError(
                    error_type=kind, error_level=ErrorLevel.WARNING,
                    error_description=result,
                    error_references=[
                        ErrorReference(reference_key=key, reference_value=value)
                        for key, value in references
                    ],
                )
            )  # fmt: skip

    # ---------------------------------------------------------------- state

    def state(self, map_id: str, name_of: Callable[[int], str]) -> VehicleState:
        """The state now. `name_of`: the serial number of a slot."""
        booked, robot = self.booked, self.robot
        last, number = self._passed_node()
        order = None if booked is None else booked.order
        left = (
            [] if order is None else [e for e in in_order(order) if self._is_ahead(e.sequence_id)]
        )
        return VehicleState(
            order_id="" if order is None else order.order_id,
            order_update_id=0 if order is None else order.order_update_id,
            last_node_id=last, last_node_sequence_id=number,
            driving=robot.heard and robot.placed and robot.speed_m_s > MOVES_M_S,
            paused=not robot.started,
            new_base_request=bool(booked is not None and self.busy and self.transport is None),
            node_states=[
                NodeState(node_id=n.node_id, sequence_id=n.sequence_id, released=n.released)
                for n in left if isinstance(n, OrderNode)
            ],
            edge_states=[
                EdgeState(edge_id=e.edge_id, sequence_id=e.sequence_id, released=e.released)
                for e in left if not isinstance(e, OrderNode)
            ],
            agv_position=self._position(map_id), velocity=self._velocity(),
            loads=[Load(load_id=f"task {task}") for task in robot.loads],
            action_states=[*self._action_states(), *self.instant.values()],
            battery_state=BatteryState(
                battery_charge=100.0 if robot.battery is None else round(100 * robot.battery, 1)
            ),
            errors=[*self.errors, *self._standing()],
            information=self._information(name_of),
            safety_state=SafetyState(e_stop=EStop.REMOTE if robot.latched else EStop.NONE),
        )  # fmt: skip

    def visualization(self, map_id: str) -> Visualization:
        """Where it is and how it moves."""
        return Visualization(agv_position=self._position(map_id), velocity=self._velocity())

    @property
    def _phase(self) -> TaskPhase:
        return TaskPhase.OPEN if self.outcome is None else self.outcome.phase

    def _is_ahead(self, sequence: int) -> bool:
        booked, phase, transport = self.booked, self._phase, self.transport
        if phase in (TaskPhase.DELIVERED, TaskPhase.WITHDRAWN):
            return False
        if booked is not None and booked.cancelled and booked.number is None:
            return False
        if phase is TaskPhase.ABOARD and transport is not None:
            return sequence > transport.pick_sequence
        return True

    def _passed_node(self) -> tuple[str, int]:
        """The last node that was reached, and its number; ("", 0): none."""
        booked, transport, phase = self.booked, self.transport, self._phase
        if booked is None or transport is None or phase not in (
            TaskPhase.ABOARD, TaskPhase.DELIVERED,
        ):  # fmt: skip
            return self._last_node
        at = transport.pick_sequence
        if phase is TaskPhase.DELIVERED:
            at = booked.order.nodes[-1].sequence_id
        return next((n.node_id, at) for n in booked.order.nodes if n.sequence_id == at)

    def _action_states(self) -> list[ActionState]:
        booked = self.booked
        if booked is None:
            return []
        found = []
        for each in in_order(booked.order):
            for action in each.actions if each.released else ():
                found.append(
                    ActionState(
                        action_id=action.action_id, action_type=action.action_type,
                        action_status=self._status(action),
                    )
                )  # fmt: skip
        return found

    def _status(self, action: Action) -> ActionStatus:
        phase, booked = self._phase, self.booked
        assert booked is not None
        given_up = booked.cancelled and booked.number is None
        if phase is TaskPhase.WITHDRAWN or given_up:
            return ActionStatus.FAILED
        picks = self.transport is not None and action is self.transport.pick
        if phase is TaskPhase.DELIVERED or (phase is TaskPhase.ABOARD and picks):
            return ActionStatus.FINISHED
        return ActionStatus.WAITING

    def _position(self, map_id: str) -> AgvPosition | None:
        robot = self.robot
        if robot is UNHEARD:
            return None
        course_rad = (robot.course_rad + pi) % (2 * pi) - pi
        course_rad = max(-THETA_MAX_RAD, min(round(course_rad, 4), THETA_MAX_RAD))
        return AgvPosition(
            x=round(robot.x_m, 3), y=round(robot.y_m, 3), theta=course_rad,
            map_id=map_id, position_initialized=robot.placed,
        )  # fmt: skip

    def _velocity(self) -> Velocity | None:
        """In the frame of a vehicle that looks where it drives; a beat has no heading besides."""
        if self.robot is UNHEARD or not self.robot.placed:
            return None
        return Velocity(vx=round(self.robot.speed_m_s, 3), vy=0.0)

    def _standing(self) -> list[VehicleError]:
        robot = self.robot
        found = [("standstill", cause) for cause in robot.causes]
        if robot is not UNHEARD and not robot.heard:
            found.append(("silent", "the robot is not heard on the bus; others take over its work"))
        return [
            VehicleError(error_type=kind, error_level=ErrorLevel.WARNING, error_description=why)
            for kind, why in found
        ]

    def _information(self, name_of: Callable[[int], str]) -> list[Information]:
        """The outcome of the order: the task, how far it is, and who carries it."""
        booked = self.booked
        if booked is None or booked.number is None:
            return []
        references = [("task", str(booked.number)), ("outcome", str(self._phase))]
        if self.outcome is not None and self.outcome.carrier is not None:
            references.append(("carrier", name_of(self.outcome.carrier)))
        return [
            Information(
                info_type="transport",
                info_references=[
                    InfoReference(reference_key=key, reference_value=value)
                    for key, value in references
                ],
            )
        ]


def stitched(mine: MasterOrder, update: MasterOrder) -> MasterOrder:
    """An order with its update: the base that was known, then what the update says from there.

    Raises OrderRefused if the update does not begin at the last node of the base, or the whole is longer
    than an order may be.
    """
    base = [node for node in mine.nodes if node.released]
    join, first = base[-1], update.nodes[0]
    if (join.node_id, join.sequence_id) != (first.node_id, first.sequence_id):
        raise OrderRefused(
            "orderUpdateError", f"it does not begin at node {join.node_id}, where the base ends",
            ("nodeId", first.node_id),
        )  # fmt: skip
    seen = {action.action_id for action in join.actions}
    more = [action for action in first.actions if action.action_id not in seen]
    joint = join.model_copy(update={"actions": [*join.actions, *more]})
    edges = [edge for edge in mine.edges if edge.sequence_id < join.sequence_id]
    whole = update.model_copy(
        update={"nodes": [*base[:-1], joint, *update.nodes[1:]], "edges": [*edges, *update.edges]}
    )
    check_graph(whole)
    if len(whole.nodes) > NODES_MAX or len(joint.actions) > ACTIONS_MAX:
        raise OrderRefused(
            "orderUpdateError",
            f"with its updates it is longer than {NODES_MAX} nodes, or {ACTIONS_MAX} actions at one",
        )
    return whole
