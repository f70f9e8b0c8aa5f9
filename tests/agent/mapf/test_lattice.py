"""The lattice: what fits, what is joined, and places as frames tell them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.mapf.lattice import FINE, Lattice
from agent.mapping.building import Floor
from sim.scenarios.building_generator import CORRIDOR, office

FLOOR = Floor.drawn(CORRIDOR, 1.0, 0.35)


def test_a_node_a_cell() -> None:
    lattice = FLOOR.lattice
    assert len(lattice) == int((~FLOOR.walls).sum())
    assert lattice.pitch_m == 1.0 and lattice.component.max() == 0
    middle = lattice.nearest((7.5, 2.5))
    assert lattice.narrow[middle] and lattice.near[middle].tolist().count(-1) == 2


def test_edges_go_both_ways_and_are_straight() -> None:
    lattice = FLOOR.lattice
    for node, row in enumerate(lattice.near.tolist()):
        for k, other in enumerate(row):
            if other >= 0:
                assert lattice.near[other, (k + 2) % 4] == node
                step = lattice.points[other] - lattice.points[node]
                expected = ((1, 0), (0, 1), (-1, 0), (0, -1))[k]
                assert np.allclose(step, np.array(expected) * lattice.pitch_m)


def test_a_wall_between_nodes_parts_them() -> None:
    blocked = np.zeros((3, 9), dtype=bool)
    blocked[:, 4] = True
    lattice = Lattice(blocked, (0.0, 0.0), 0.2, 3)
    assert set(lattice.component.tolist()) == {0, 1}


@given(st.floats(0.5, 14.5), st.floats(0.5, 3.5))
def test_a_place_is_told_to_a_sixteenth(x_m: float, y_m: float) -> None:
    lattice = FLOOR.lattice
    node, detail = lattice.encode((x_m, y_m))
    if lattice.distance_m(node, (x_m, y_m)) < 0.45:
        told = lattice.decode(node, detail)
        assert (
            abs(told[0] - x_m) <= lattice.pitch_m / FINE
            and abs(told[1] - y_m) <= lattice.pitch_m / FINE
        )


@pytest.mark.parametrize("inflation_m", [0.05, 0.1, 0.2])
def test_lines_go_through_all_doors_of_an_office(inflation_m: float) -> None:
    """Doors that fit a body exactly, in walls that are not on the lattice's lines by chance."""
    floor = Floor.drawn(office(), 0.2, 0.35, inflation_m)
    assert floor.lattice.component.max() == 0
    gaps = np.hypot(*(floor.lattice.points[:, None] - floor.lattice.points[None]).T)
    np.fill_diagonal(gaps, np.inf)
    assert gaps.min() >= floor.lattice.pitch_m - 1e-9
