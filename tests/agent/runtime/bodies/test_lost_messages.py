"""A robot whose body is a VDA 5050 vehicle, on a wire that loses, repeats or holds back one message.

The vehicle follows the rules of VDA 5050 2.0 for orders: an order is new, an update that begins where the
base ends, or a repetition, which is dropped. Robot and vehicle speak by the real body and its models.
"""

from collections.abc import Callable
from math import hypot
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.lifecycle import State
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.inputs import Sensed
from agent.peer.sense_freshness import Senses
from agent.runtime.bodies.vda5050_body import Vda5050Body
from agent.runtime.vda5050.messages import (
    Action,
    ActionState,
    ActionStatus,
    AgvPosition,
    BatteryState,
    InstantActions,
    Load,
    MasterOrder,
    MessageHeader,
    NodeState,
    OrderNode,
    VehicleState,
    Visualization,
    timestamp,
)
from agent.safety.stop_cause import StopCause
from tests.agent.lone_peer import peer_in

PARCEL = 7
PICKUP, DROPOFF = (1.2, 0.0), (1.2, -1.0)
THERE_M = 0.1
SPEED_M_S = 0.8
HANDLE_US = 400 * MS
STATE_US, SHOWN_US = S, 100 * MS
ENDS_US = 60 * S  # the story takes 8 s if nothing is lost
HELD_US = 1500 * MS  # a message that is late
SEEDS = (340, 742, 1322, *range(20))  # the first three stood for ever
Spans = list[tuple[int, int]]  # from and until, microseconds


class Vehicle:
    """Drives and handles by orders, and says what it does; `say` takes each message."""

    def __init__(self, say: Callable[[MessageHeader], None], reports_loads: bool) -> None:
        self.say, self.reports_loads = say, reports_loads
        self.x_m = self.y_m = 0.0
        self.loaded = False
        self.done = {"pick": 0, "drop": 0}
        self.starts()

    def starts(self) -> None:
        """It forgets its order; the parcel stays where it is."""
        self.order_id, self.update = "", 0
        self.ahead: list[OrderNode] = []
        self.last: tuple[str, int] = ("", 0)
        self.actions: dict[str, ActionState] = {}
        self.acting: tuple[Action, int] | None = None
        self.said_at_us = self.shown_at_us = -S
        self.numbers = 0

    def take(self, message: MessageHeader, now_us: int) -> None:
        if isinstance(message, InstantActions):
            self.ahead = []  # an action that runs cannot be interrupted
            self._say_state(now_us)
        elif isinstance(message, MasterOrder):
            self._order(message, now_us)

    def _order(self, order: MasterOrder, now_us: int) -> None:
        busy = bool(self.ahead or self.acting)
        if order.order_id == self.order_id:
            base = self.ahead[-1] if self.ahead else None
            end = self.last if base is None else (base.node_id, base.sequence_id)
            first = order.nodes[0]
            if order.order_update_id <= self.update or (first.node_id, first.sequence_id) != end:
                return  # a repetition, or refused
            self.ahead += order.nodes[1:]
        elif busy:
            return  # refused
        else:
            place = order.nodes[0].node_position
            assert place is not None
            if hypot(place.x - self.x_m, place.y - self.y_m) > 1.0:
                return  # refused: it does not begin where the vehicle is
            self.order_id, self.actions = order.order_id, {}
            self.ahead = list(order.nodes)
        self.update = order.order_update_id
        for node in order.nodes:
            for action in node.actions:
                self._status(action, ActionStatus.WAITING)
        self._say_state(now_us)

    def _status(self, action: Action, status: ActionStatus) -> None:
        self.actions[action.action_id] = ActionState(
            action_id=action.action_id, action_type=action.action_type, action_status=status
        )

    def run(self, now_us: int) -> None:
        """One control period."""
        if self.acting is not None:
            action, ends_at_us = self.acting
            if now_us >= ends_at_us:
                self.acting = None
                kind = action.action_type
                able = self.loaded is (kind == "drop")
                self.done[kind] += 1
                self.loaded = kind == "pick" if able else self.loaded
                self._status(action, ActionStatus.FINISHED if able else ActionStatus.FAILED)
                self._say_state(now_us)
        elif self.ahead:
            self._drive(now_us)
        if now_us - self.said_at_us >= STATE_US:
            self._say_state(now_us)
        if now_us - self.shown_at_us >= SHOWN_US:
            self.shown_at_us = now_us
            self._say(Visualization(agv_position=self._position()), now_us)

    def _drive(self, now_us: int) -> None:
        node = self.ahead[0]
        assert node.node_position is not None
        dx_m, dy_m = node.node_position.x - self.x_m, node.node_position.y - self.y_m
        left_m, step_m = hypot(dx_m, dy_m), SPEED_M_S * CONTROL_PERIOD_US / S
        if left_m > step_m:
            self.x_m, self.y_m = (
                self.x_m + dx_m / left_m * step_m,
                self.y_m + dy_m / left_m * step_m,
            )
            return
        self.x_m, self.y_m = self.x_m + dx_m, self.y_m + dy_m
        self.ahead = self.ahead[1:]
        self.last = node.node_id, node.sequence_id
        for action in node.actions:
            self._status(action, ActionStatus.RUNNING)
            self.acting = action, now_us + HANDLE_US
        self._say_state(now_us)

    def _position(self) -> AgvPosition:
        return AgvPosition(
            x=self.x_m, y=self.y_m, theta=0.0, map_id="hall", position_initialized=True
        )

    def _say_state(self, now_us: int) -> None:
        self.said_at_us = now_us
        self._say(
            VehicleState(
                order_id=self.order_id, order_update_id=self.update, driving=bool(self.ahead),
                node_states=[
                    NodeState(node_id=n.node_id, sequence_id=n.sequence_id, released=True)
                    for n in self.ahead
                ],
                agv_position=self._position(), action_states=list(self.actions.values()),
                loads=[Load()] * self.loaded if self.reports_loads else None,
                battery_state=BatteryState(battery_charge=50.0),
            ),
            now_us,
        )  # fmt: skip

    def _say(self, message: MessageHeader, now_us: int) -> None:
        self.numbers += 1
        header = {"header_id": self.numbers, "timestamp": timestamp(now_us / S)}
        self.say(message.model_copy(update=header))


class Story:
    """A parcel is fetched and put down, while something happens to message `number` of both ways."""

    def __init__(
        self, monkeypatch: Any, number: int = -1, what: str = "", reports_loads: bool = True
    ) -> None:
        self.now_us, self.number, self.what, self.count = 10 * S, number, what, 0
        self.kinds: list[str] = []
        self._held: list[tuple[int, Callable[[], None]]] = []
        self.pauses: Spans = []  # the robot's program does nothing between these times
        self.stands: Spans = []  # the robot has to stand between these times
        self.late_us = 0  # each message, and those of places
        self._waiting: list[Callable[[], None]] = []  # messages that it has not read
        motion = HolonomicMotion(0, BodyLimits(0.35, SPEED_M_S, 1.0), np.empty((0, 4)))
        self.safety = peer_in(State.WORKING, None).safety
        self.senses = Senses(self.safety, motion, drives=True)
        monkeypatch.setattr(
            "agent.runtime.bodies.vda5050_body.time.monotonic_ns", lambda: self.now_us * 1000
        )
        self.vehicle = Vehicle(self._to_robot, reports_loads)
        self.boots()

    def boots(self) -> None:
        """The robot's program starts, and knows nothing but what the vehicle says."""
        self.body = Vda5050Body(0, "mqtt://127.0.0.1", "ACME", "7", "hall")
        self.body.link.connected = True
        self.body.link.publish = self._to_vehicle  # type: ignore[method-assign]

    def _to_robot(self, message: MessageHeader) -> None:
        self._carry(
            message, lambda: self._hold(lambda: self._arrives(lambda: self.body._heard(message)))
        )

    def _hold(self, arrives: Callable[[], None]) -> None:
        if self.late_us:
            self._held.append((self.now_us + self.late_us, arrives))
        else:
            arrives()

    def _arrives(self, arrives: Callable[[], None]) -> None:
        if self.is_paused:
            self._waiting.append(arrives)
        else:
            arrives()

    def after(self, periods: int) -> int:
        """So many control periods from now, microseconds."""
        return self.now_us + periods * CONTROL_PERIOD_US

    @property
    def is_paused(self) -> bool:
        return self._is_in(self.pauses)

    def _is_in(self, spans: Spans) -> bool:
        return any(begin_us <= self.now_us < end_us for begin_us, end_us in spans)

    def _to_vehicle(self, message: MessageHeader) -> bool:
        self._carry(message, lambda: self._hold(lambda: self.vehicle.take(message, self.now_us)))
        return True

    def _carry(self, message: MessageHeader, arrives: Callable[[], None]) -> None:
        if isinstance(message, Visualization):
            arrives()
            return
        self.kinds.append(type(message).__name__)
        mine, self.count = self.count == self.number, self.count + 1
        if mine and self.what == "late":
            self._held.append((self.now_us + HELD_US, arrives))
        if mine and self.what in ("lost", "late"):
            return
        arrives()
        if mine and self.what == "twice":
            arrives()
        if mine and self.what == "starts":
            self.vehicle.starts()
        if mine and self.what == "boots":
            self.boots()

    def run(self) -> None:
        """Until the parcel is put down, or the time is over."""
        ends_at_us = self.now_us + ENDS_US
        while self.now_us < ends_at_us and not self.is_over:
            self.now_us += CONTROL_PERIOD_US
            self.vehicle.run(self.now_us)
            due = [arrives for at_us, arrives in self._held if at_us <= self.now_us]
            self._held = [each for each in self._held if each[0] > self.now_us]
            for arrives in due:
                arrives()
            if self.is_paused:
                continue
            waiting, self._waiting = self._waiting, []
            for arrives in waiting:
                arrives()
            here = self.body.sense(self.now_us)
            if here is not None:
                self._control(here)

    def _control(self, here: Observation) -> None:
        """The senses of a robot watch, too: a place that they take for frozen ends the story."""
        self.senses.listens_direct[Sensed](Sensed(here), self.now_us)
        self.senses.look(self.now_us)
        fresh = here.sensed_at_us == self.now_us and not self.is_frozen
        goes = fresh and not self._is_in(self.stands)
        command = self._wanted((here.x_m, here.y_m), here.load) if goes else HALT
        self.senses.drove(command)
        self.body.drive(GatedDrive(command), self.now_us)

    @property
    def is_frozen(self) -> bool:
        return self.safety.holds(StopCause.PLACE_FROZEN)

    @property
    def is_over(self) -> bool:
        return self.body.orders.load < 0 and PARCEL in self.body.orders.dropped

    def _wanted(self, at: tuple[float, float], load: int) -> Drive:
        """What a delivering mission wants."""
        if self.is_over:
            return HALT
        goal = DROPOFF if load == PARCEL else PICKUP
        dx_m, dy_m = goal[0] - at[0], goal[1] - at[1]
        left_m = hypot(dx_m, dy_m)
        if left_m < THERE_M:
            return HALT._replace(parcel_action=PARCEL)
        speed_m_s = min(SPEED_M_S, max(0.1, left_m / 0.5))
        return Drive(dx_m / left_m * speed_m_s, dy_m / left_m * speed_m_s)


def plain() -> Story:
    with pytest.MonkeyPatch.context() as patch:
        story = Story(patch)
        story.run()
    return story


PLAIN = plain()


def test_the_story_without_trouble_takes_orders_states_and_cancellations() -> None:
    assert PLAIN.is_over and PLAIN.vehicle.done == {"pick": 1, "drop": 1}
    assert set(PLAIN.kinds) == {"MasterOrder", "VehicleState", "InstantActions"}


@pytest.mark.parametrize("what", ["lost", "twice", "late", "starts", "boots"])
@given(number=st.integers(0, PLAIN.count - 1), loads=st.booleans())
@settings(max_examples=60)
def test_whatever_happens_to_one_message_the_parcel_is_handled_once(
    what: str, number: int, loads: bool
) -> None:
    """What no message can say is left out: a vehicle that does not report loads, and starts again."""
    loads = loads or what == "starts"
    with pytest.MonkeyPatch.context() as patch:
        story = Story(patch, number, what, loads)
        story.run()
        kind = story.kinds[number]
        assert story.is_over, f"it stands after {what} of message {number}, {kind}"
        assert story.vehicle.done == {"pick": 1, "drop": 1}, f"after {what} of {number}, {kind}"
        assert not story.vehicle.loaded


def busy(seed: int) -> Story:
    """A parcel is fetched and put down on a busy machine: each message is late, the robot's program is
    held up now and then, and the robot has to stand now and then."""
    rng = Random(seed)

    def spans(count: int, periods: int) -> list[tuple[int, int]]:
        begins = [rng.randint(0, 200) for _ in range(count)]
        return [(story.after(k), story.after(k + rng.randint(1, periods))) for k in begins]

    with pytest.MonkeyPatch.context() as patch:
        story = Story(patch)
        story.late_us = rng.randint(0, 300) * MS
        story.pauses, story.stands = spans(4, 16), spans(6, 8)
        story.run()
    return story


@pytest.mark.parametrize("seed", SEEDS)
def test_a_busy_machine_makes_no_place_a_frozen_one(seed: int) -> None:
    """A vehicle stood with its parcel until its trial ended: its robot was told to drive before the next
    order was shown, and took the place for a frozen one."""
    story = busy(seed)
    assert story.is_over, f"frozen: {story.is_frozen}"
    assert story.vehicle.done == {"pick": 1, "drop": 1}
