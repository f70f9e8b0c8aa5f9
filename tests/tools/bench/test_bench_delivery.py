"""What a comparison of deliveries says where there is nothing to compare with."""

from math import isnan

import pytest

from agent.delivery.cost_matrix import CostMatrix
from agent.mapping.building import Floor
from agent.paths.nav_mesh import Mesh
from sim.scenarios.building_generator import warehouse
from tools.bench import delivery


def test_an_opponent_that_finds_no_plan_is_no_match(monkeypatch: pytest.MonkeyPatch) -> None:
    """Our own plan stood in for the missing one, so that the target held by 1.0."""
    monkeypatch.setattr(delivery, "MOVES", 10)
    monkeypatch.setattr("tools.bench.routing_opponents._pyvrp", lambda *_: None)
    monkeypatch.setattr(delivery, "ortools_plan", lambda *_, **__: None)
    floor = Floor.drawn(warehouse(3, 4, 5, 2, 2, 1), 1.0, 0.3)
    costs = CostMatrix(Mesh(floor.inflated, floor.origin, floor.fine_m))
    _, makespan, travel = delivery.plans(costs, 2, 4, 9.0, range(1, 3), 0.1)
    for figure in (makespan, travel):
        assert isnan(figure.value) and figure.holds is None, figure
        assert "found no plan for 2 of them" in figure.scope
