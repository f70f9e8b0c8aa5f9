"""Drives a VDA 5050 vehicle by orders that are a step long, so that it does what a robot wants now.

A robot wants a velocity every 50 ms. A vehicle takes orders: nodes, and edges between them. So the
velocity becomes an edge, and the next edge is added before the vehicle reaches the end. To stand, or
to turn away, the order is cancelled. Handling a parcel is an order with one node and an action.

A vehicle that hears nothing any more drives to the end of its edge. Other robots reckon that one which
drives at this velocity needs its stopping distance, so the edge is that long and no longer.

Messages get lost: a broker ends, a vehicle starts again. A step that no state shows in time is given
up, and so is an order that states have shown and show no more. An order to handle a parcel is sent again
as it was: a vehicle that has it already drops the repetition, so that nothing is handled twice.

Sans I/O. The vehicle remembers in the orderId what is aboard, and in the actionId which parcel it
handles, also when this program forgets it.
"""

from enum import Enum
from math import atan2, cos, hypot, pi, remainder, sin
from typing import Any, Final, NamedTuple

from agent.delivery.task_registry import TASKS_MAX
from agent.interface.config import MS, S
from agent.interface.effects import Drive
from agent.interface.vehicle import Vehicle
from agent.runtime.vda5050.messages import (
    ENDED,
    Action,
    ActionParameter,
    ActionState,
    ActionStatus,
    BlockingType,
    InstantActions,
    MasterOrder,
    NodePosition,
    OrderEdge,
    OrderNode,
    VehicleState,
)
from protocol.state_machine import StateMachine, matrix

STEP_S: Final = 0.6  # of driving in one order, at most
STEP_MIN_M: Final = 0.15  # a shorter edge is within the tolerance of most vehicles
AHEAD_S: Final = (
    0.25  # the next edge is sent this long before the end: two messages and a control period
)
# Of driving in one order, at least: a shorter edge ends before the next one can arrive. So a body that
# is declared to brake harder than 1.8 m/s² at 1 m/s is further than other robots reckon.
STEP_MIN_S: Final = 1.5 * AHEAD_S
STANDS_M_S: Final = 0.03  # a slower command is none
TURNED_RAD: Final = pi / 4  # a command this far off the edge cancels it, unless it is nearly over
ACCEPTED_US: Final = 1 * S  # an order, or an update, that no state shows by then is lost or refused
CANCELLED_US: Final = 500 * MS  # between two cancellations of one order
FAILED_US: Final = 2 * S  # after an order to handle a parcel that failed, before the next one
NOTHING_ABOARD: Final = -1
NAME: Final = "headland"  # the first part of our orderIds


class OrderPhase(Enum):
    """How far the newest order is."""

    FREE = "the vehicle has no order of ours"
    SENT = "an order was sent, and no state shows it yet"
    ACTIVE = "the vehicle carries it out"
    CANCELLING = "it was told to give it up"


class OrderEvent(Enum):
    """What the vehicle or we do."""

    ORDERED = "we send an order"
    SHOWN = "a state shows it"
    ENDED = "a state shows it without anything ahead"
    CANCELLED = "we cancel it"
    LOST = "no state shows it in time, or none any more"


F, T, A, C = OrderPhase
stay = None
# fmt: off
ORDER_TABLE = matrix(
    OrderEvent,
    # state  ORDERED SHOWN ENDED CANCELLED LOST
    (F,      T,      stay, stay, stay,     stay),
    (T,      stay,   A,    F,    C,        F),
    (A,      stay,   stay, F,    C,        F),
    (C,      stay,   stay, F,    stay,     F),
)
# fmt: on


class _Sent(NamedTuple):
    """The newest order, and where it ends."""

    order_id: str
    update: int
    end: OrderNode
    begin: tuple[float, float]
    parcel: int  # that is handled; -1: none
    sent_at_us: int
    shown: bool = False  # by a state
    handles: MasterOrder | None = None  # the message itself, to be repeated
    full: bool | None = None  # whether the vehicle said that it has a load; None: it does not say


def _task_of(word: str) -> int:
    """The task whose number a word is; -1: of none. A vehicle may say any text."""
    if len(word) > len(str(TASKS_MAX)) or not word.isdecimal():
        return NOTHING_ABOARD
    task = int(word)
    return task if task < TASKS_MAX else NOTHING_ABOARD


def aboard_of(order_id: str) -> int:
    """The parcel that was aboard when one of our orders was sent; -1: none, or not ours.

    >>> aboard_of("headland/5f/12/7"), aboard_of("other-9"), aboard_of("other/9")
    (7, -1, -1)
    """
    return _task_of(order_id.rpartition("/")[2]) if _is_ours(order_id) else NOTHING_ABOARD


def _is_ours(order_id: str) -> bool:
    return order_id.startswith(f"{NAME}/")


def _kind_of(act: ActionState) -> str | None:
    """What an action does. A vehicle need not say the type, so it is also in the ids of our actions."""
    if act.action_type is None and _parcel_of(act.action_id) != NOTHING_ABOARD:
        return act.action_id.split("/")[-2]
    return act.action_type


def _handling(state: VehicleState) -> ActionState | None:
    """The newest pick or drop of the order that a vehicle has; None: it has none."""
    acts = [each for each in state.action_states if _kind_of(each) in ("pick", "drop")]
    return acts[-1] if acts else None


def _parcel_of(action_id: str) -> int:
    """The parcel of one of our picks and drops; -1: not ours.

    >>> _parcel_of("headland/5f/12/-1/drop/7"), _parcel_of("other-7")
    (7, -1)
    """
    return _task_of(action_id.rpartition("/")[2]) if _is_ours(action_id) else NOTHING_ABOARD


class VehicleOrders:
    """The orders of one vehicle, from the commands of a robot and the states of the vehicle."""

    def __init__(self, boot: str, map_id: str, parameters: dict[str, Any]) -> None:
        """`boot`: a word that no two starts share. `parameters`: that the vehicle wants with pick and
        drop."""
        self.boot, self.map_id = boot, map_id
        self.parameters = [ActionParameter(key=k, value=v) for k, v in parameters.items()]
        self.vehicle: Vehicle | None = None  # as the fleet declares it
        self.load = NOTHING_ABOARD
        # Parcels that we have put down, and where.
        self.dropped: dict[int, tuple[float, float]] = {}
        self.machine = StateMachine("order of a vehicle", ORDER_TABLE, OrderPhase.FREE)
        self._sent: _Sent | None = None
        self._count = 0
        self._cancelled_at_us = 0
        self._failed_at_us = -FAILED_US
        self._begun = False  # whether the vehicle has said a state
        self._full: bool | None = None  # whether it has a load, by its newest state
        self._learnt = ""  # the newest pick or drop whose end is known, or that was adopted
        self._given_up_drives = False  # the vehicle carries out an order that was given up

    @property
    def phase(self) -> OrderPhase:
        """How far the newest order is."""
        return self.machine.state

    # ---------------------------------------------------------------- what the vehicle says

    def on_state(self, state: VehicleState, now_us: int) -> None:
        """Learn from what the vehicle says how far our order is, and what is aboard."""
        self._adopt(state, now_us)
        self._full = None if state.loads is None else bool(state.loads)
        sent = self._sent
        if sent is None or sent.parcel < 0:  # while a parcel is handled, loads may be either
            self._loaded(state)
        self._begun = True
        ahead = any(node.released for node in state.node_states)
        self._given_up_drives = sent is None and ahead and _is_ours(state.order_id)
        if sent is None:
            return
        if state.order_id != sent.order_id or state.order_update_id < sent.update:
            self._unshown(sent, state, now_us)
            return
        self._sent = sent._replace(shown=True)
        self.machine.fire(OrderEvent.SHOWN)
        act = _handling(state)
        if ahead or (act is not None and act.action_status not in ENDED):
            return
        if sent.parcel >= 0 and act is not None:
            if act.action_status is ActionStatus.FINISHED:
                self._handled(sent, _kind_of(act) == "drop")
            else:
                self._failed_at_us = now_us
            self._learnt = act.action_id
            self._loaded(state)
        self.machine.fire(OrderEvent.ENDED)
        self._sent = None

    def _loaded(self, state: VehicleState) -> None:
        if state.loads is not None and not state.loads:
            self.load = NOTHING_ABOARD
        elif self.load == NOTHING_ABOARD and (state.loads or not self._begun):
            self.load = aboard_of(state.order_id)  # from before we began

    def _adopt(self, state: VehicleState, now_us: int) -> None:
        """Take over an order to handle a parcel that is ours and not the newest: from before we began,
        or one that arrived after it was given up."""
        act, at, sent = _handling(state), state.agv_position, self._sent
        if act is None or at is None or act.action_id == self._learnt:
            return
        parcel = _parcel_of(act.action_id)
        if sent is not None and (parcel != sent.parcel or state.order_id == sent.order_id):
            return
        if parcel < 0 or not act.action_id.startswith(f"{state.order_id}/"):
            return
        self._learnt = act.action_id
        if _kind_of(act) == "drop":
            self.load = parcel
        node = self._node(0, (at.x, at.y))
        self.machine.fire(OrderEvent.ORDERED)
        self._sent = _Sent(
            state.order_id, state.order_update_id, node, (at.x, at.y), parcel, now_us, shown=True
        )

    def _unshown(self, sent: _Sent, state: VehicleState, now_us: int) -> None:
        """A state shows another order than the newest."""
        if sent.parcel < 0:
            if sent.shown or now_us - sent.sent_at_us >= ACCEPTED_US:
                self._lose()
            return
        forgotten = sent.shown or now_us - sent.sent_at_us >= ACCEPTED_US
        if forgotten and None not in (sent.full, self._full) and sent.full is not self._full:
            self._handled(sent, sent.full is True)  # and the vehicle has started again since
            self._lose()
        elif sent.shown or (forgotten and self.phase is OrderPhase.CANCELLING):
            self._lose()

    def _handled(self, sent: _Sent, dropped: bool) -> None:
        if dropped:
            self.load = NOTHING_ABOARD
            self.dropped[sent.parcel] = sent.begin
        else:
            self.load = sent.parcel
            self.dropped.pop(sent.parcel, None)

    # ---------------------------------------------------------------- what the robot wants

    def want(
        self, command: Drive, at: tuple[float, float], now_us: int
    ) -> MasterOrder | InstantActions | None:
        """What to send for a command. `at`: where the vehicle is, metres on its map."""
        self._expire(now_us)
        if self.phase is OrderPhase.CANCELLING:
            return self._cancel(now_us)
        speed_m_s = hypot(command.vx_m_s, command.vy_m_s)
        stands = speed_m_s < STANDS_M_S
        sent = self._sent
        if sent is None:
            if self._given_up_drives:
                return self._cancel(now_us)
            if stands and command.parcel_action >= 0:
                if now_us - self._failed_at_us < FAILED_US:
                    return None
                return self._handle(command.parcel_action, at, now_us)
            return None if stands else self._step(command, at, now_us)
        if sent.parcel >= 0:
            asked = stands and command.parcel_action == sent.parcel
            return self._repeat(sent, at, now_us) if asked else self._cancel(now_us)
        if stands:
            return self._cancel(now_us)
        assert sent.end.node_position is not None
        dx_m, dy_m = sent.end.node_position.x - at[0], sent.end.node_position.y - at[1]
        left_m = hypot(dx_m, dy_m)
        off_rad = remainder(atan2(command.vy_m_s, command.vx_m_s) - atan2(dy_m, dx_m), 2 * pi)
        if left_m > STEP_MIN_M and abs(off_rad) > TURNED_RAD:
            return self._cancel(now_us)
        if self.phase is OrderPhase.ACTIVE and left_m < AHEAD_S * speed_m_s:
            return self._step(command, at, now_us)
        return None

    def _expire(self, now_us: int) -> None:
        sent = self._sent
        if sent is None or sent.shown or sent.parcel >= 0:
            return
        if now_us - sent.sent_at_us >= ACCEPTED_US:
            self._lose()

    def _repeat(self, sent: _Sent, at: tuple[float, float], now_us: int) -> MasterOrder | None:
        """The same order once more, if no state shows it in time; another one if it is elsewhere now."""
        if sent.shown or now_us - sent.sent_at_us < ACCEPTED_US:
            return None
        if hypot(at[0] - sent.begin[0], at[1] - sent.begin[1]) > STEP_MIN_M:
            self._lose()
            return self._handle(sent.parcel, at, now_us)
        self._sent = sent._replace(sent_at_us=now_us)
        return sent.handles

    def _lose(self) -> None:
        self.machine.fire(OrderEvent.LOST)
        self._sent = None

    def _cancel(self, now_us: int) -> InstantActions | None:
        self.machine.fire(OrderEvent.CANCELLED)
        if now_us - self._cancelled_at_us < CANCELLED_US:
            return None
        self._cancelled_at_us = now_us
        self._count += 1
        action_id = f"{self.boot}-{self._count}"
        action = Action(
            action_type="cancelOrder", action_id=action_id, blocking_type=BlockingType.HARD
        )
        return InstantActions(actions=[action])

    def _step(self, command: Drive, at: tuple[float, float], now_us: int) -> MasterOrder:
        speed_m_s = hypot(command.vx_m_s, command.vy_m_s)
        course_rad = atan2(command.vy_m_s, command.vx_m_s)
        length_m = self._step_m(speed_m_s)
        sent = self._sent
        # The next edge begins where the vehicle will be, and leads to where the robot wants to go.
        goal = at[0] + length_m * cos(course_rad), at[1] + length_m * sin(course_rad)
        if sent is not None:
            begin, order_id, update = sent.end, sent.order_id, sent.update + 1
            begin = begin.model_copy(update={"actions": []})
        else:
            order_id, update = self._next_id(), 0
            begin = self._node(0, at)
        end = self._node(begin.sequence_id + 2, goal)
        edge = OrderEdge(
            edge_id=f"e{begin.sequence_id + 1}", sequence_id=begin.sequence_id + 1, released=True,
            start_node_id=begin.node_id, end_node_id=end.node_id, max_speed=round(speed_m_s, 3),
        )  # fmt: skip
        if sent is None:
            self.machine.fire(OrderEvent.ORDERED)
        self._sent = _Sent(order_id, update, end, at, -1, now_us)
        return MasterOrder(
            order_id=order_id, order_update_id=update, nodes=[begin, end], edges=[edge]
        )

    def _step_m(self, speed_m_s: float) -> float:
        longest_m, shortest_m = STEP_S * speed_m_s, max(STEP_MIN_M, STEP_MIN_S * speed_m_s)
        if self.vehicle is None:
            return max(shortest_m, longest_m)
        return max(shortest_m, min(self.vehicle.stopping_m(speed_m_s), longest_m))

    def _handle(self, parcel: int, at: tuple[float, float], now_us: int) -> MasterOrder:
        kind = "drop" if self.load == parcel else "pick"
        order_id = self._next_id(NOTHING_ABOARD if kind == "drop" else parcel)
        action = Action(
            action_type=kind, action_id=f"{order_id}/{kind}/{parcel}", blocking_type=BlockingType.HARD,
            action_description=f"task {parcel}", action_parameters=self.parameters or None,
        )  # fmt: skip
        node = self._node(0, at, action)
        self.machine.fire(OrderEvent.ORDERED)
        order = MasterOrder(order_id=order_id, order_update_id=0, nodes=[node], edges=[])
        self._sent = _Sent(order_id, 0, node, at, parcel, now_us, False, order, self._full)
        return order

    def _next_id(self, load: int | None = None) -> str:
        self._count += 1
        return f"{NAME}/{self.boot}/{self._count}/{self.load if load is None else load}"

    def _node(self, sequence: int, at: tuple[float, float], *actions: Action) -> OrderNode:
        self._count += 1
        position = NodePosition(x=round(at[0], 4), y=round(at[1], 4), map_id=self.map_id)
        return OrderNode(
            node_id=f"{self.boot}-{self._count}", sequence_id=sequence, released=True,
            node_position=position, actions=list(actions),
        )  # fmt: skip
