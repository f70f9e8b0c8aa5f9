"""`headland tc` whose interface is gone for good."""

import asyncio
import json
from pathlib import Path

import pytest

from agent.runtime.files.field_file import read_boundary
from protocol.controller_health import Health
from protocol.frames.frame import Frame
from sim.fleet.virtual_clock import run_virtual
from tools.common import bus_attach
from tools.common.bus_address import AttachError
from tools.common.event_lines import EventLines
from tools.run import task_controller

GONE_AT_S = 5.0
RING = [[8.0, 50.0], [8.002, 50.0], [8.002, 50.001], [8.0, 50.001], [8.0, 50.0]]


class GoneBus:
    """Its interface is unplugged after a while."""

    health = Health.ACTIVE

    @property
    def lost(self) -> str | None:
        gone = asyncio.get_running_loop().time() > GONE_AT_S
        return "the interface is gone: no such device" if gone else None

    def send(self, frame: Frame) -> bool:
        return True

    def subscribe(self, hear: object) -> None:
        """Nothing comes."""

    def close(self) -> None:
        """Nothing is held."""


def test_a_task_controller_without_its_interface_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found: it went on for good after its interface was gone, deaf, and said nothing."""
    monkeypatch.setattr(bus_attach, "CanBus", GoneBus)
    outline = {"type": "Feature", "properties": {"name": "north"},
               "geometry": {"type": "Polygon", "coordinates": [RING]}}  # fmt: skip
    (tmp_path / "north.geojson").write_text(json.dumps(outline))
    boundary = read_boundary(tmp_path / "north.geojson")

    async def story() -> None:
        serving = task_controller._serve(
            boundary,
            None,
            (GoneBus(), None),
            (0, 1),
            0.0,
            1.0,
            tmp_path / "memory",
            EventLines(True),
        )
        async with asyncio.timeout(2 * GONE_AT_S):
            await serving

    with pytest.raises(AttachError, match="interface is gone"):
        run_virtual(story())
