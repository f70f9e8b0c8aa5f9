"""Everything a run is made of, from its scenario: field, grid, world, safety policy, keys.

Read once, shared by the peers of one process: the field and its grid are immutable, so sharing them
gives nobody knowledge that it would not have computed alike.
"""

from functools import cached_property

from agent.field import Field, rasterise
from agent.route import Route
from agent.safety import SilencePolicy
from protocol.authentication import Keyring
from sim.scenario import Scenario
from sim.world import World

ROUTE_CELL_M = 0.5  # a cell of the path grid; a fifth of the narrowest gap the default robots may use
CLEARANCE_M = 0.2  # paths keep this much more than the radius from fences and holes


class Setting:
    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.field: Field = scenario.make_field()
        self.silence = SilencePolicy[scenario.fleet.silence.upper()]

    @cached_property
    def _grid(self) -> tuple[object, float, float, float]:
        return rasterise(self.field, ROUTE_CELL_M, self.scenario.fleet.radius_m + CLEARANCE_M)

    def route(self) -> Route:
        return Route(*self._grid)  # type: ignore[arg-type]

    def world(self) -> World:
        raise NotImplementedError

    def keyring(self, slot: int) -> Keyring | None:
        return None
