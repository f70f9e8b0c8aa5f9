"""Asking a robot for its traces over the bus, in virtual time."""

import asyncio

from agent.peer.diagnostics import COMPONENT_PGN
from agent.peer.pgn_responder import LOG_PGN
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus
from sim.fleet.virtual_clock import run_virtual
from tools.bench.drill import ProtocolFleet
from tools.operate.pgn_client import PgnClient


def test_a_robot_tells_its_name_and_its_newest_traces() -> None:
    async def main() -> tuple[str | None, str | None, str | None]:
        squad = ProtocolFleet(3, 1)
        bus = CanBus(FieldBus(squad.channel))
        asker, loop = PgnClient(bus), asyncio.get_running_loop()
        bus.subscribe(lambda frame: asker.hear(loop.time(), frame))
        try:
            await squad.until_working()
            address = squad.shells[1].peer.address
            assert address is not None
            name = await asker.ask(COMPONENT_PGN, address, 5.0)
            traces = await asker.ask(LOG_PGN, address, 5.0)
            nobody = await asker.ask(LOG_PGN, 77, 5.0)
            return name, traces, nobody
        finally:
            bus.close()
            await squad.close()

    name, traces, nobody = run_virtual(main())
    assert name is not None and name.startswith("Headland*peer*") and "robot 1" in name
    assert traces is not None and "WORKING" in traces and "FLEET_JOINED" in traces
    assert nobody is None
