"""The hub of a launch ends without a word, whoever is still connected."""

import asyncio
from typing import Any

from sim.fieldbus import forget, segment
from sim.hub import Hub


def test_a_client_that_is_still_there_is_no_error() -> None:
    complaints: list[dict[str, Any]] = []

    async def main() -> bytes:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: complaints.append(what))
        hub = Hub(segment("hub end"))
        await hub.start()
        reader, writer = await asyncio.open_connection("127.0.0.1", hub.port)
        greeting = await reader.readexactly(6)
        await hub.stop()
        writer.close()
        return greeting

    assert asyncio.run(main()) == b"< hi >"
    assert complaints == []
    forget("hub end")
