"""The fleet of an exploration, and how its robots share maps. It is apart from the run, because
`headland compile` compiles it.
"""

from collections.abc import Mapping, Sequence
from enum import Enum

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_task import ExplorationOrder
from agent.exploration.lone_exploration import LoneExploration
from agent.interface.lifecycle import State
from agent.runtime.mission_parts import MAP_TICK_US, exploration_parts
from agent.runtime.peer_factory import MissionParts
from crdt import Phase
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import OccupancyMap
from crdt.sighting import TIME_MAX
from protocol.sync.map_sync import MapSync, Values
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Cluster, Record, Robot
from sim.scenarios.exploration_scenario import ExplorationSetup


class Sharing(Enum):
    """What robots know of each other's maps."""

    FLEET = "the real wire"
    AT_ONCE = "one map for all, without a wire: what an omniscient coordinator would have"
    NONE = "each for itself, to the nearest frontier"


class InstantMapSync(MapSync):
    """News reach all maps immediately and without a frame."""

    fleet: "list[InstantMapSync]"
    hold_for_us = 0
    now_us = 0

    def see(self, patch: int, values: Values, level: int) -> None:
        time_s = self.clock.read(self.now_us)
        for other in self.fleet:
            other.chart.apply(patch, values, level, time_s, self.slot)

    @property
    def due_at_us(self) -> int:
        return 1 << 62


class ExplorationFleet(Cluster):
    """A cluster of explorers, which share maps over the wire, at once, or not at all."""

    def __init__(
        self, setting: ExplorationSetup, channel: str, record: Record, host: Host,
        sharing: Sharing, orders: Sequence[ExplorationOrder],
    ) -> None:  # fmt: skip
        super().__init__(setting, channel, record, host)
        self.place, self.sharing, self.orders = setting, sharing, orders
        self.missions: dict[int, ExplorationMission] = {}
        self.at_once: list[InstantMapSync] = []

    def parts(self, slot: int, now_us: int, recalled: Mapping[str, bytes]) -> MissionParts:
        place, arena = self.place, self.place.scenario.arena
        kind = LoneExploration if self.sharing is Sharing.NONE else ExplorationMission
        parts = exploration_parts(
            slot, place.scenario.fleet.robots, self._sync(slot, now_us), place.vehicle,
            arena.range_m, self.orders, robots_max=arena.robots_max, kind=kind,
            shares=self.sharing is Sharing.FLEET,
        )  # fmt: skip
        assert isinstance(parts.mission, ExplorationMission)
        self.missions[slot] = parts.mission
        return parts

    def _sync(self, slot: int, now_us: int) -> MapSync:
        chart = OccupancyMap(self.place.geometry, self.place.order)
        clock = HybridClock(now_us, MAP_TICK_US, TIME_MAX)
        if self.sharing is Sharing.FLEET:
            return MapSync(slot, chart, clock, now_us)
        sync = InstantMapSync(slot, chart, clock, now_us)
        sync.fleet = [sync]
        if self.sharing is Sharing.AT_ONCE:
            self.at_once.append(sync)
            sync.fleet = self.at_once
        return sync

    @property
    def finished(self) -> bool:
        """Whether every order is done, and no robot that may drive has a task or sees a frontier that it
        could reach. A robot that is frozen or off the bus has no part in the map."""
        if any(self._is_away(robot) for robot in self.running):
            return False
        running = [robot for robot in self.running if robot.peer.safety.may_move]
        return bool(running) and all(
            robot.peer.mission is not None
            and self.missions[robot.slot].over
            and self.missions[robot.slot].task is None
            and all(
                robot.peer.allocation.phase_of(section) is Phase.DONE
                for section in self.missions[robot.slot].orders
            )
            and robot.peer.state is State.IDLE
            for robot in running
        )

    def _is_away(self, robot: Robot) -> bool:
        hangs = self.acquaintance.is_hung(robot.slot, self.host.now_us())
        return hangs or robot.peer.state is State.DISCONNECTED

    @property
    def maps_equal(self) -> bool:
        """Whether the maps of all running robots are equal bit for bit."""
        charts = {self.missions[robot.slot].chart.fleet.serialize() for robot in self.running}
        return len(charts) <= 1
