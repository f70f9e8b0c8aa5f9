"""Exploration without sharing: to the nearest frontier, by the robot's own rays alone.

What sharing is measured against. Robots still see and avoid each other; a frontier has another name
for each, so that no claim of one keeps another from it.
"""

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.frontier import Frontier, frontiers, wave_from
from agent.interface.mission import FleetView

PATCH_BITS = 12  # a map of up to 256 x 256 cells; slots above


class LoneExploration(ExplorationMission):
    def patch_of(self, section: int) -> int:
        return section & (1 << PATCH_BITS) - 1

    def _best(self, view: FleetView, current: int | None) -> Frontier | None:
        here = self._way.cell((view.here.x_m, view.here.y_m))
        values = self.chart.values()
        wave = wave_from(self._passable(values, here), here)
        named = (
            f._replace(patch=f.patch | view.slot << PATCH_BITS)
            for f in frontiers(values, wave, self.view_cells)
        )
        found = [f for f in named if self._open(f.patch, view)]
        self.over = not found
        return min(found, key=lambda f: (int(wave[f.station]), f.patch), default=None)

    def _contested(self, view: FleetView) -> bool:
        return False
