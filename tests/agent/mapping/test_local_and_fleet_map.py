"""The map of an explorer, and the wall round the place."""

from math import ceil

import numpy as np
import pytest

from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from agent.mapping.occupancy_grid import INFLATION_M
from crdt.occupancy import Geometry


@pytest.mark.parametrize("cell_m", [0.05, 0.1, 0.3])
def test_no_path_of_an_explorer_is_nearer_to_the_wall_round_the_place_than_its_body(
    cell_m: float,
) -> None:
    """No echo of that wall is in a cell of the map, so bodies with few rays touched it."""
    side, radius_m = ceil(3.0 / cell_m), 0.15
    grid = LocalAndFleetMap(None, Geometry(side, side, (0.0, 0.0), cell_m), radius_m, 1.5).grid
    k = np.arange(side)
    gap_m = np.minimum(k, side - 1 - k) * cell_m  # from the outer side of a cell to the wall
    near = gap_m < radius_m + INFLATION_M - 1e-9
    assert (grid.tight.blocked == (near[:, None] | near[None, :])).all()
    end_m = side * cell_m
    path = grid.plan((0.2, 0.2), (end_m - 0.2, 0.2))
    assert path is not None and len(path) > 2, "starts and goals beside the wall are left"
