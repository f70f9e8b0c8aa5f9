"""The numbers of transports that a fleet has used: a tool learns them before it orders one."""

import asyncio

from agent.delivery.task_registry import HIGHEST_ASKED
from tools.operate.tool_address import DeviceAddress

LISTEN_S = 3.0  # robots tell which tasks they know, a bucket a second each
ASKED = 6  # times in it, as frames may be lost, for the highest number that is used


async def learn_numbers(device: DeviceAddress) -> None:
    """Ask for the highest number, while whoever listens on this bus hears which tasks robots know."""
    for _ in range(ASKED):
        device.send(HIGHEST_ASKED)
        await asyncio.sleep(LISTEN_S / ASKED)
