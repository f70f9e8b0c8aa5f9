"""The setup of a delivery scenario: building, starts of the robots, tasks, and true parcels."""

from collections.abc import Mapping
from functools import cached_property
from random import Random

import numpy as np

from agent.delivery.cost_matrix import Carrier
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.mapping.building import Floor, FloorError
from agent.runtime.files.given_file import DRAWING_BYTES_MAX, GivenFileError, read_text
from agent.runtime.mission_parts import carrier_of, delivery_parts
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from protocol.frames.delivery_frames import TASK_NUMBERS
from sim.scenarios.delivery_scenario import DeliveryScenario, TaskRow, random_tasks, read_tasks
from sim.scenarios.navigation_setup import NavigationSetup, scattered
from sim.scenarios.scenario import Box, ScenarioError
from sim.world.parcel_truth import Parcels

APART_M = 1.5  # minimum distance of robots at the start
BOX_M = 0.5


class DeliverySetup(NavigationSetup):
    """A building with robots in it, the transports that are known from the start, and those that
    come later."""

    scenario: DeliveryScenario

    def __init__(self, scenario: DeliveryScenario) -> None:
        """Raises ScenarioError if the warehouse cannot be used."""
        name, table, fleet = scenario.name, scenario.warehouse, scenario.fleet
        floor = floor_of(scenario)
        rng = Random(f"{scenario.run.seed}/warehouse")
        try:
            starts = scattered(floor, fleet.robots, rng, APART_M)
        except ValueError as problem:
            raise ScenarioError(f"{name}: fleet.robots: {problem}") from None
        super().__init__(scenario, floor, starts, [()] * fleet.robots)
        self.carrier = carrier_of(table, fleet, scenario.battery)
        plain = Warehouse(floor, self.carrier)
        for number, bay in enumerate(table.bays):
            if plain.cell(bay) is None:
                raise ScenarioError(f"{name}: warehouse.bays.{number}: {bay} is not on free floor")
        self.rows = self._rows(plain, rng)
        self.house = Warehouse(floor, self.carrier, table.bays, self._known(plain), table.t_max)

    def _rows(self, house: Warehouse, rng: Random) -> list[TaskRow]:
        """The tasks of the file, then random ones."""
        scenario, table = self.scenario, self.scenario.warehouse
        rows = []
        if table.tasks is not None:
            rows = read_tasks(scenario.folder / table.tasks)
        rows += random_tasks(self.cells, table.random_tasks, table.random_over_s, rng)
        if len(rows) > TASK_NUMBERS:
            raise ScenarioError(
                f"{scenario.name}: {len(rows)} tasks; a fleet can number {TASK_NUMBERS} of them"
            )
        for number, row in enumerate(rows):
            for key, at in (("pickup", row.pickup), ("dropoff", row.dropoff)):
                if house.cell(at) is None:
                    raise ScenarioError(
                        f"{scenario.name}: task {number}: {key}: {at} is not on free floor"
                    )
        return rows

    def _known(self, house: Warehouse) -> dict[int, TransportTask]:
        """Tasks that robots know at the start; the others are sent on the bus when they appear."""
        return {
            number: self.order(house, row) for number, row in enumerate(self.rows) if not row.at_s
        }

    @staticmethod
    def order(house: Warehouse, row: TaskRow) -> TransportTask:
        """A row of the file as the frame has it: cells instead of metres."""
        pickup, dropoff = house.cell(row.pickup), house.cell(row.dropoff)
        assert pickup is not None and dropoff is not None
        return TransportTask(pickup, dropoff)

    @cached_property
    def cells(self) -> list[tuple[float, float]]:
        """Centres of cells where a robot can stand, all on one floor."""
        floor = self.floor
        lattice = floor.lattice
        home = int(np.argmax(np.bincount(lattice.component)))
        house = Warehouse(floor, Carrier(1.0, 0.0))
        found = set()
        for node in np.flatnonzero(lattice.component == home).tolist():
            cell = house.cell(lattice.point(node))
            if cell is not None:
                found.add(house.place(cell))
        return sorted(found)

    @property
    def config_hash(self) -> int:
        return self.house.check

    @property
    def section_count(self) -> int:
        return len(self.rows)

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        fleet = self.scenario.fleet
        return delivery_parts(
            slot, fleet.robots, self.house, self.starts[slot], self.vehicle,
            self.search_seed(slot), now_us, recalled, asks=fleet.asks,
        )  # fmt: skip

    def search_seed(self, slot: int) -> int:
        """The seed of one robot's search for plans."""
        return self.scenario.run.seed * 1000 + slot

    def parcels(self) -> Parcels:
        """The truth about parcels at the start: those of all known transports lie at their pickups."""
        truth = Parcels(self.carrier, self.house.bays)
        for number, order in self.house.tasks.items():
            trip = self.house.trip(order)
            truth.appear(number, trip.pickup, trip.dropoff, 0)
        return truth

    def boxes(self) -> list[Box]:
        """Random temporary obstacles of the scenario, by its seed; never at a robot's start."""
        table, rng = self.scenario.warehouse, Random(f"{self.scenario.run.seed}/boxes")
        found: list[Box] = []
        t_s = 0.0
        while table.boxes_a_minute:
            t_s += rng.expovariate(table.boxes_a_minute / 60.0)
            if t_s > table.boxes_until_s:
                break
            x_m, y_m = rng.choice(self.cells)
            found.append(
                Box(at_s=t_s, kind="box", x_m=x_m, y_m=y_m, size_m=BOX_M, for_s=table.box_s)
            )
        return found


def floor_of(scenario: DeliveryScenario) -> Floor:
    """The building of a scenario, from its file or its drawing. Raises ScenarioError if it cannot
    be read."""
    table = scenario.warehouse
    drawn = "\n" in table.map  # the map itself
    # An absolute path stays as it is.
    path = scenario.folder if drawn else scenario.folder / table.map
    try:
        text = table.map if drawn else read_text(path, DRAWING_BYTES_MAX)
        return Floor.drawn(text, table.cell_m, scenario.fleet.radius_m)
    except GivenFileError as problem:
        raise ScenarioError(f"{scenario.name}: warehouse.map: {path}: {problem}") from None
    except FloorError as problem:
        raise ScenarioError(f"{scenario.name}: warehouse.map: {problem}") from None
