"""An independent master control orders from a launched fleet, while broker, robots and gateway die."""

import asyncio
import subprocess  # noqa: F401 - processes are started by the trial
from pathlib import Path

import pytest

from tests.tools.vda5050.absence import node_of
from tools.bench.vda5050.masters_orders import trial

ORDERS = 50


@pytest.mark.slow
def test_50_orders_of_an_independent_master_are_delivered_once(tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    folder.mkdir()
    told = asyncio.run(trial(folder, node_of(tmp_path), ORDERS))
    report = told.report
    assert (report["tasks"], told.delivered_once) == (ORDERS, ORDERS)
    assert report["contacts"] == 0 and report["robots_ended"] == [1, 2]
    assert told.done == list(range(ORDERS))
    assert told.flaws == {} and told.messages["state"] > ORDERS
    assert told.dropped == []
