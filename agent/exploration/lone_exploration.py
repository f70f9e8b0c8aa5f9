"""Exploration without sharing: each robot goes to the nearest frontier by its own rays alone.

It is the baseline against which sharing is measured. Robots still see and avoid each other. A
frontier has another name for each robot, so no claim keeps another robot from it.
"""

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.frontier import Frontier, frontiers, wave_from
from agent.interface.mission import FleetView

PATCH_BITS = 12  # a map of up to 256 x 256 cells; slots above


class LoneExploration(ExplorationMission):
    """The exploration mission of a robot that shares no map."""

    def patch_of(self, section: int) -> int:
        """The patch of a section: its lower `PATCH_BITS` bits."""
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
