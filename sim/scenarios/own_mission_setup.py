"""A field in which robots do a mission that its user wrote: `hl.Fleet("small", mission=SoilSamples)`."""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import NamedTuple

from agent.interface.mission import Mission
from agent.interface.vehicle import Vehicle
from agent.paths.route import Route
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from crdt.allocation import FieldAllocationCRDT
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Scenario, ScenarioError


class Site(NamedTuple):
    """What a mission is made with: its robot, and the field around it. Metres east and north."""

    slot: int  # of the robot
    outline: tuple[tuple[float, float], ...]  # of the field
    route: Route  # `route.path(here, goal)`: paths inside of the field and round its holes
    vehicle: Vehicle  # size and limits of the robot


MissionMaker = Callable[[Site], Mission]


class OwnMissionSetup(FieldSetup):
    """The field of a scenario; its swaths are not worked."""

    def __init__(self, scenario: Scenario, make: MissionMaker) -> None:
        """`make`: called for each robot at each of its boots. Raises ScenarioError."""
        super().__init__(scenario)
        self.make = make
        if not self.section_units:
            raise ScenarioError(f"{scenario.name}: mission: its section_units are empty: no work")

    @cached_property
    def section_units(self) -> Mapping[int, int]:
        """Number of units of each section, as a robot's mission says it."""
        return dict(self._mission(0).section_units)

    @property
    def config_hash(self) -> int:
        work = sorted(self.section_units.items())
        return FieldAllocationCRDT.hash_of(f"{super().config_hash} {work}")

    @property
    def section_count(self) -> int:
        return len(self.section_units)

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """The parts of a field's robot, with the mission of the user."""
        return super().parts(slot, now_us, recalled)._replace(mission=self._mission(slot))

    def _mission(self, slot: int) -> Mission:
        outline = tuple((float(x_m), float(y_m)) for x_m, y_m in self.field.exterior)
        mission = self.make(Site(slot, outline, self.plan.route, self.vehicle))
        if not isinstance(mission, Mission):
            raise ScenarioError(
                f"{self.scenario.name}: mission: it made a {type(mission).__name__}, not a Mission"
            )
        return mission
