"""A VDA 5050 vehicle as the body of a robot: the robot is its master control.

    [body]
    plugin = "vda5050"
    options = { broker = "mqtt://10.0.0.9", manufacturer = "ACME", serial = "7", map = "hall" }

The vehicle has to say where it is ten times a second, in its state or its visualization. Between two
messages the body adds the way that the vehicle has driven since. Without any for `stale_for_ms` it has no
place, and the robot stands. The vehicle's map is the robot's: metres, x east. On a map of another name
it has no place either.

A broker that was away delivers what has waited at once, and some deliver a message twice or late. So the
velocity is taken from the times at which the vehicle said its places, and a message that is older than
the one before it is not taken. A clock that jumps back makes the vehicle late for `LATE_US` only.

A vehicle that a person has taken over, by its operating mode, gets no orders, and its robot says that the
body is sick.

A vehicle does not see parcels. What lies within reach is what the fleet's registers say, and what this
vehicle has put down itself.

An order may be refused, lost or late, and so may a place. A place that does not follow is a frozen one,
and only a person ends that. So it has to follow only while the vehicle says that it drives by our order,
and says new places.

A place that jumps stops a robot. Vehicles that turn on the spot between two messages would look like
that, so the heading that the robot gets follows the vehicle's at `TURN_RAD_S`.
"""

import asyncio
import time
from math import hypot, inf, isfinite, pi, remainder
from secrets import token_hex
from typing import Any, Final, NamedTuple

from agent.delivery.delivery_mission import REACH_M, DeliveryMission
from agent.interface.config import MS, S
from agent.interface.effects import HALT, GatedDrive
from agent.interface.observation import Observation, VisibleParcel
from agent.peer.peer import Peer
from agent.runtime.option_values import name_or_number, number, text
from agent.runtime.robot_body import DeclaredMachine, RobotBody
from agent.runtime.vda5050.broker_link import (
    Broker,
    BrokerError,
    BrokerLink,
    VehicleAddress,
    is_level,
)
from agent.runtime.vda5050.messages import (
    VERSION,
    AgvPosition,
    ErrorLevel,
    EStop,
    MessageHeader,
    OperatingMode,
    Topic,
    VehicleState,
    Visualization,
    told_at_us,
)
from agent.runtime.vda5050.vehicle_orders import OrderPhase, VehicleOrders
from crdt import Phase

FIRST_S: Final = 10.0  # for the broker and the first place of the vehicle
LOOK_S: Final = 0.02
WATCH_S: Final = 0.1  # between two looks at the registers
BETWEEN_US: Final = 300 * MS  # two places further apart say nothing of the velocity between them
# Two that are nearer say too much: a vehicle that computes its place every 40 ms may say one just before
# it does, and the next just after.
OVER_US: Final = 80 * MS
# Standard deviation of a place that is added up from two: at 1 m/s and 100 ms, with 20 % of slip.
ACCURACY_M: Final = 0.02
# A place is brought forward by this at most: a vehicle that has turned since is elsewhere, and from
# 0.3 m on the next place would have jumped.
FORWARD_US: Final = 100 * MS
# Without a new place for this long the place is brought forward no more, and seems to stand.
RENEWED_US: Final = 3 * FORWARD_US // 2
LATE_US: Final = 2 * S  # after this a message with an earlier time is from a clock that jumped
OURS: Final = (OperatingMode.AUTOMATIC, OperatingMode.SEMIAUTOMATIC)  # else a person drives it
TURN_RAD_S: Final = 2.0
TURN_STEP_US: Final = 100 * MS  # also after a pause: 11 degrees, and 20 would be a jump


class _Place(NamedTuple):
    """A place that a vehicle said."""

    at: AgvPosition
    heard_at_us: int
    said_at_us: int | None  # on the clock of the vehicle

    def since_for_us(self, before: "_Place") -> int:
        """How long after another one it was true: messages that have waited arrive at once."""
        passed_for_us = self.heard_at_us - before.heard_at_us
        if self.said_at_us is None or before.said_at_us is None:
            return passed_for_us
        return max(passed_for_us, self.said_at_us - before.said_at_us)


class Vda5050Body(RobotBody):
    """Sensors and actuators of one robot, by a broker."""

    def __init__(
        self,
        slot: int,
        broker: str,
        manufacturer: str,
        serial: str,
        map: str,
        interface: str = "uagv",
        version: str = VERSION,
        stale_for_ms: float = 300.0,
        parameters: dict[str, Any] | None = None,
    ) -> None:
        """`map`: its mapId. `interface`: the first level of its topics. `parameters`: that it wants
        with pick and drop. Raises ValueError, one line: an option of another type, or a BrokerError, a
        name that cannot be used."""
        serial = name_or_number("serial", serial, "the serial number of the vehicle")
        text("manufacturer", manufacturer, "the manufacturer of the vehicle")
        text("interface", interface, "the first level of its topics")
        text("version", version, "a version of VDA 5050")
        text("map", map, "the mapId of its map")
        text("broker", broker, "mqtt://HOST:PORT or mqtts://HOST:PORT")
        if not isinstance(parameters, dict | None):
            raise ValueError(f"options.parameters: {parameters!r} is not a table of key = value")
        address = VehicleAddress(interface, manufacturer, serial, version)
        if not (is_level(interface, deeper=True) and is_level(manufacturer) and is_level(serial)):
            raise BrokerError(
                "interface, manufacturer and serial are levels of a topic, without + and #"
            )
        self.slot = slot
        self.stale_for_us = round(number("stale_for_ms", stale_for_ms, 0.0) * MS)
        self.orders = VehicleOrders(token_hex(3), map, parameters or {})
        self.link = BrokerLink(
            Broker.read(broker), address, self._heard, lambda: None, is_vehicle=False
        )
        self.state: VehicleState | None = None
        self.lying: dict[int, tuple[float, float]] = {}  # parcels, as the registers say
        # The newest place and when it arrived; and the one that its velocity is measured from.
        self._place: _Place | None = None
        self._from: _Place | None = None
        self._speed_max_m_s = inf  # of the vehicle, as it was declared
        # By kind of message: when the newest was said, on the clock of the vehicle, and when it arrived.
        self._newest: dict[type[MessageHeader], tuple[int, int]] = {}
        self._elsewhere = ""  # the map that it is on, if that is another one
        self._velocity = (0.0, 0.0)  # metres a second on the map
        self._heading: tuple[float, int] | None = None  # radians, and when
        self._running: asyncio.Task[None] | None = None

    def declare(self, machine: DeclaredMachine) -> None:
        """Take the speed that the vehicle can have, and how it brakes."""
        self._speed_max_m_s = machine.vehicle.speed_m_s
        self.orders.vehicle = machine.vehicle

    async def open(self) -> None:
        """Reach the broker, and wait for the first place. Raises OSError."""
        topics = [Topic.STATE, Topic.VISUALIZATION]
        self._running = asyncio.create_task(self.link.run(topics))
        loop = asyncio.get_running_loop()
        ends_at_s = loop.time() + FIRST_S
        while self._place is None or self.state is None:
            if loop.time() > ends_at_s:
                problem = self.link.problem or self._placeless()
                self.close()
                raise OSError(f"{self.link.broker} {self.link.identity.serial}: {problem}")
            await asyncio.sleep(LOOK_S)

    # ---------------------------------------------------------------- what the vehicle says

    def _placeless(self) -> str:
        if self._elsewhere:
            return f"the vehicle is on the map {self._elsewhere!r}, not {self.orders.map_id!r}"
        return "the vehicle says no place"

    def _heard(self, message: MessageHeader) -> None:
        now_us = time.monotonic_ns() // 1000
        said_at_us = told_at_us(message.timestamp)
        if self._is_late(type(message), said_at_us, now_us):
            return
        if isinstance(message, VehicleState):
            self.state = message
            self.orders.on_state(message, now_us)
            self._placed(message.agv_position, now_us, said_at_us)
        elif isinstance(message, Visualization):
            self._placed(message.agv_position, now_us, said_at_us)

    def _is_late(
        self, kind: type[MessageHeader], said_at_us: int | None, now_us: int
    ) -> bool:  # fmt: skip
        if said_at_us is None:
            return False
        newest = self._newest.get(kind)
        if newest is not None and said_at_us < newest[0] and now_us - newest[1] < LATE_US:
            return True
        self._newest[kind] = said_at_us, now_us
        return False

    def _placed(self, at: AgvPosition | None, now_us: int, said_at_us: int | None) -> None:
        self._elsewhere = "" if at is None or at.map_id == self.orders.map_id else at.map_id
        if at is None or not at.position_initialized or self._elsewhere:
            self._place = self._from = None
            return
        before = self._from
        self._place = place = _Place(at, now_us, said_at_us)
        passed_for_us = BETWEEN_US + 1 if before is None else place.since_for_us(before)
        if passed_for_us < OVER_US:
            return
        self._from = place
        if before is None or passed_for_us > BETWEEN_US:
            self._velocity = (0.0, 0.0)
            return
        for_s = passed_for_us / 1e6
        vx_m_s, vy_m_s = (at.x - before.at.x) / for_s, (at.y - before.at.y) / for_s
        speed_m_s = hypot(vx_m_s, vy_m_s)
        if not isfinite(speed_m_s):  # of places that no map has
            vx_m_s = vy_m_s = speed_m_s = 0.0
        share = min(1.0, self._speed_max_m_s / max(speed_m_s, 1e-9))
        self._velocity = share * vx_m_s, share * vy_m_s

    def sense(self, now_us: int) -> Observation | None:
        """The newest place, brought forward to now."""
        place, state = self._place, self.state
        if place is None or state is None:
            return None
        at, heard_at_us, _ = place
        age_us = now_us - heard_at_us
        fresh = self.link.connected and age_us <= self.stale_for_us
        drives = state.driving
        vx_m_s, vy_m_s = self._velocity if drives else (0.0, 0.0)
        since_for_s = min(age_us, FORWARD_US) / 1e6
        x_m, y_m = at.x + vx_m_s * since_for_s, at.y + vy_m_s * since_for_s
        sick = (
            state.safety_state.e_stop is not EStop.NONE
            or state.operating_mode not in OURS
            or any(error.error_level is ErrorLevel.FATAL for error in state.errors)
        )
        return Observation(
            x_m, y_m, self._turned(at.theta, now_us), vx_m_s, vy_m_s,
            battery=min(max(state.battery_state.battery_charge / 100.0, 0.0), 1.0),
            load=self.orders.load, parcels=self._within_reach((x_m, y_m)),
            sensed_at_us=now_us if fresh else heard_at_us, health=0.0 if sick else 1.0,
            position_accuracy_m=ACCURACY_M,
            under_way=drives and self.orders.phase is OrderPhase.ACTIVE and age_us <= RENEWED_US,
        )  # fmt: skip

    def _turned(self, theta_rad: float, now_us: int) -> float:
        if self._heading is not None:
            before_rad, at_us = self._heading
            most_rad = TURN_RAD_S * min(now_us - at_us, TURN_STEP_US) / 1e6
            off_rad = remainder(theta_rad - before_rad, 2 * pi)
            theta_rad = before_rad + max(-most_rad, min(off_rad, most_rad))
        self._heading = theta_rad, now_us
        return theta_rad

    def _within_reach(self, at: tuple[float, float]) -> dict[int, VisibleParcel]:
        lying = self.lying | self.orders.dropped
        return {
            task: VisibleParcel(*place, False)
            for task, place in lying.items()
            if task != self.orders.load and hypot(place[0] - at[0], place[1] - at[1]) < REACH_M
        }

    async def watch(self, peer: Peer) -> None:
        """Learn from the fleet's registers where parcels lie."""
        mission = peer.mission
        if not isinstance(mission, DeliveryMission):
            return
        house = mission.house
        while True:
            lying = {}
            for task, order in mission.dispatch.book.tasks.items():
                if not house.known(order):
                    continue
                trip = house.trip(order)
                if peer.allocation.phase_of(task) is Phase.DONE:
                    lying[task] = trip.dropoff
                elif not peer.progress.bits(task, 0):
                    lying[task] = trip.pickup
            self.lying = lying
            await asyncio.sleep(WATCH_S)

    # ---------------------------------------------------------------- what the robot wants

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Send an order, or a cancellation, if the command needs one."""
        if self._place is None or (self.state and self.state.operating_mode not in OURS):
            return
        at = self._place.at
        message = self.orders.want(command, (at.x, at.y), now_us)
        if message is not None:
            self.link.publish(message)

    def close(self) -> None:
        """Let the vehicle stand at the end of its step, and leave the broker."""
        self.drive(HALT, time.monotonic_ns() // 1000)
        if self._running is not None:
            self._running.cancel()
            self._running = None
