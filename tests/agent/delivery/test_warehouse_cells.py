"""Which cell of a floor a place is in."""

from math import inf, nan

import pytest

from agent.delivery.cost_matrix import Carrier
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.mapping.building import Floor


@pytest.mark.parametrize("value", [1.7e308, -1.7e308, inf, -inf, nan, 1e30])
def test_a_place_that_no_integer_counts_is_in_no_cell(value: float) -> None:
    """Found: OverflowError for a place of 1e308 m."""
    house = Warehouse(Floor.drawn("............\n" * 6, 0.5, 0.2), Carrier(1.0, 0.0))
    assert house.cell((1.0, 0.6)) == 14
    assert house.cell((value, 0.6)) is None and house.cell((1.0, value)) is None


def test_an_order_that_was_taken_back_goes_from_its_dropoff_to_its_dropoff() -> None:
    """Its parcel may be on a robot that died. Found: nobody bid for such an order."""
    house = Warehouse(Floor.drawn("............\n" * 6, 0.5, 0.2), Carrier(1.0, 0.0))
    back = TransportTask(14, 20).taken_back
    assert house.known(back) and house.trip(back) == (house.place(20), house.place(20))
    assert not house.known(TransportTask(14, 72).taken_back), "no cell of this floor"
