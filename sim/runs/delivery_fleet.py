"""The fleet of a delivery run. It is apart from the run, because `headland compile` compiles it."""

from collections.abc import Mapping

from agent.delivery.delivery_mission import DeliveryMission
from agent.runtime.peer_factory import MissionParts
from crdt import Phase
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Cluster, Record, Robot
from sim.fleet.warehouse_floor import WarehouseFloor, beyond_battery
from sim.scenarios.delivery_setup import DeliverySetup
from sim.world.parcel_truth import CarrierBody


class DeliveryFleet(Cluster):
    """A cluster in a warehouse, with its floor and the device that orders transports."""

    def __init__(
        self, setting: DeliverySetup, channel: str, record: Record | None, host: Host
    ) -> None:
        super().__init__(setting, channel, record, host)
        self.place = setting
        self.floor = WarehouseFloor(setting, self.world, host.now_us, self.is_up, self.propose)
        self.truth, self.desk = self.floor.truth, self.floor.desk
        self.missions: dict[int, DeliveryMission] = {}
        self.segment.taps.append(self.floor.hear)

    def parts(self, slot: int, now_us: int, recalled: Mapping[str, bytes]) -> MissionParts:
        parts = super().parts(slot, now_us, recalled)
        assert isinstance(parts.mission, DeliveryMission)
        self.missions[slot] = parts.mission
        return parts

    def boot(self, slot: int) -> Robot:
        robot = super().boot(slot)
        assert robot.runner.body is not None
        robot.runner.body = CarrierBody(robot.runner.body, slot, self.truth, self.host.now_us)
        return robot

    def replica_of(self, robot: Robot) -> tuple[bytes, ...]:
        """Registers and progress, and the orders that the robot knows."""
        orders = sorted(self.missions[robot.slot].dispatch.book.tasks.items())
        return *super().replica_of(robot), repr(orders).encode()

    @property
    def finished(self) -> bool:
        return self.floor.delivered and all(
            robot.peer.allocation.phase_of(task) is Phase.DONE
            for robot in self.running
            for task in self.truth.dropoff
        )

    @property
    def unreachable(self) -> frozenset[int]:
        """Tasks that are not done and cannot be, as the running robots report. Either the robot
        with the parcel aboard cannot reach its dropoff, or no robot can reach both places."""
        cut = {robot.slot: self.missions[robot.slot].cut_off.sections for robot in self.running}
        found = set()
        for task in self.truth.dropoff.keys() - self.truth.delivered_at_us.keys():
            aboard = [
                cut[slot] for slot, t in self.truth.aboard.items() if t == task and slot in cut
            ]
            asked = aboard or list(cut.values())
            if asked and all(task in own for own in asked):
                found.add(task)
        return frozenset(found)

    @property
    def beyond_battery(self) -> frozenset[int]:
        """Tasks that nobody has picked up, and that a battery that is full at any bay does not last for:
        from there to both places, and to a bay again. No robot takes them once it has left its start."""
        left = self.truth.dropoff.keys() - self.truth.delivered_at_us.keys()
        left -= {*self.truth.aboard.values()} | self.unreachable
        trips = {
            task: self.place.house.trip(order)
            for robot in self.running
            for task, order in self.missions[robot.slot].dispatch.book.tasks.items()
            if task in left
        }
        return beyond_battery(self.place.house, trips)
