"""`headland launch --foxglove`: the feed of a launch, and the stop panel behind its services.

The panel is a device of its own on the bus of the launch, as that of `headland map` is.
"""

import asyncio
import secrets
from pathlib import Path
from random import Random

from protocol.frames.frame import Frame
from protocol.links.socketcand_link import SocketcandLink
from sim.record.scene import Scene
from tools.common.bus_address import CHANNEL
from tools.livemap.foxglove_live import start_feed
from tools.livemap.foxglove_services import services_of
from tools.livemap.stop_panel import Panel
from tools.operate.estop import stop_keys

KEY_BYTES = 16  # of the key of the services: 128 random bits


class LaunchViewers:
    """Viewers of a launch: what they see, and what they may call with `key`."""

    def __init__(
        self, scene: Scene, port: int, bus: tuple[str, int], keys: Path | None,
        operator_key: Path | None,
    ) -> None:  # fmt: skip
        """`port`: of the viewers. `bus`: its host and port. `keys`, `operator_key`:
        files or folders with which the panel stops and releases; None: the fleet has no keys.

        Raises PortTaken and AttachError. Needs the running loop.
        """
        loop = asyncio.get_running_loop()
        stopping = stop_keys(keys)
        # The hub answers in this same loop, so a client that waits for its greeting would wait for ever.
        self._bus = SocketcandLink(*bus, CHANNEL, Random(f"viewers at {port}"))
        panel = Panel(self._bus, stopping, operator_key)

        def hear(frame: Frame) -> None:
            panel.hear(loop.time(), frame)

        self._bus.subscribe(hear)
        self.key = secrets.token_urlsafe(KEY_BYTES)
        self.feed = start_feed(scene, port, services_of(panel, self.key))
        self._asking = loop.create_task(panel.keep_asking())

    def close(self) -> None:
        """Tell viewers nothing more, and leave the bus."""
        self._asking.cancel()
        self.feed.close()
        self._bus.close()
