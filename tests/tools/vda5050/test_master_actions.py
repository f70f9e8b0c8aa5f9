"""An independent master control pauses vehicles, lets them go on, and takes orders back."""

import asyncio
import subprocess  # noqa: F401 - processes are started by the trial
from pathlib import Path

import pytest

from tests.tools.vda5050.absence import node_of
from tools.bench.vda5050.masters_actions import DELIVERED, WANTED, trial


@pytest.mark.slow
@pytest.mark.parametrize("keyed", [False, True])
def test_a_master_pauses_and_cancels_and_a_parcel_aboard_is_delivered(
    tmp_path: Path, keyed: bool
) -> None:
    folder = tmp_path / "fleet"
    folder.mkdir()
    told = asyncio.run(trial(folder, node_of(tmp_path), keyed))
    assert told.steps == list(WANTED)
    assert told.delivered == DELIVERED and told.flaws == {}
