"""A launch that is one segment of a fleet: a stop of another segment stops its robots."""

import asyncio
import json
from pathlib import Path
from socket import socket

import pytest

from sim.rigs.bridged_processes import BridgedSegments
from tests.tools.launching import WAIT_S, robots_up, start, states


@pytest.mark.slow
def test_a_stop_of_another_segment_stops_a_launch(tmp_path: Path) -> None:
    pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    others = BridgedSegments(2)

    async def story() -> None:
        launch = await start(
            tmp_path, "launch", "small", "--robots", "2", "--segment", "1", "--no-keys"
        )
        try:
            await robots_up(launch, 2)
            bus = json.loads((tmp_path / "runs/launch/bus.json").read_text())
            others.ports[1] = bus["port"]  # its hub instead of that of our own segment 1
            others.start_gateway(1, "--listen", endpoint)
            others.start_gateway(2, "--zenoh", endpoint)
            others.wait("they meet", lambda: bool(others.state(2)["reached"] == 1), WAIT_S)
            others.hosts[2].ask({"do": "press", "slot": 0})
            async with asyncio.timeout(WAIT_S):
                while set((await states(tmp_path)).values()) != {"EMERGENCY_STOP"}:
                    pass
        finally:
            launch.terminate()
            await launch.wait()

    try:
        others.start_hosts()
        asyncio.run(story())
    finally:
        others.close()
