"""Vehicles of an independent implementation as bodies of peers, without a master."""

import asyncio
import subprocess  # noqa: F401 - processes are started by the trial
from pathlib import Path

import pytest

from tests.tools.vda5050.absence import node_of
from tools.bench.vda5050.own_vehicles import RADIUS_M, trial


@pytest.mark.slow
@pytest.mark.parametrize("vehicles", [4])  # 20: headland bench systems
def test_vehicles_without_a_master_deliver_every_task_once(tmp_path: Path, vehicles: int) -> None:
    folder = tmp_path / "fleet"
    folder.mkdir()
    told = asyncio.run(trial(folder, node_of(tmp_path), vehicles))
    assert (told.ordered, told.delivered_once) == (vehicles, vehicles), told
    assert told.flaws == {} and told.messages["order"] > vehicles
    assert told.closest_m > 2 * RADIUS_M
