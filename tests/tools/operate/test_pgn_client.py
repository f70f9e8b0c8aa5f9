"""Asking a robot for its traces over the bus, in virtual time."""

import asyncio

from agent.peer.diagnostics import COMPONENT_PGN
from agent.peer.pgn_responder import LOG_PGN
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.links.bus import CanBus
from protocol.transport import Transport
from sim.can.simulated_bus import FieldBus
from sim.fleet.virtual_clock import run_virtual
from tools.bench.drill import ProtocolFleet
from tools.operate.pgn_client import ARRIVED_MAX, PgnClient


def test_a_robot_tells_its_name_and_its_newest_traces() -> None:
    async def main() -> tuple[str | None, str | None, str | None]:
        fleet = ProtocolFleet(3, 1)
        bus = CanBus(FieldBus(fleet.channel))
        asker, loop = PgnClient(bus), asyncio.get_running_loop()
        bus.subscribe(lambda frame: asker.hear(loop.time(), frame))
        try:
            await fleet.until_working()
            address = fleet.runners[1].peer.address
            assert address is not None
            name = await asker.ask(COMPONENT_PGN, address, 5.0)
            traces = await asker.ask(LOG_PGN, address, 5.0)
            nobody = await asker.ask(LOG_PGN, 77, 5.0)
            return name, traces, nobody
        finally:
            bus.close()
            await fleet.close()

    name, traces, nobody = run_virtual(main())
    assert name is not None and name.startswith("Headland*peer*") and "robot 1" in name
    assert traces is not None and "WORKING" in traces and "FLEET_JOINED" in traces
    assert nobody is None


def test_a_text_that_anybody_sends_commands_no_terminal_and_takes_little_memory() -> None:
    """A device on the bus could colour, clear or fill the screen of who asks a robot for its traces."""
    robot, noise = Transport(), Transport()
    told = b"WORKING\x1b[2J\x1b]0;x\x07\x9b31m \xfc\nnext line"

    async def main() -> str | None:
        loop = asyncio.get_running_loop()
        asker = PgnClient(Nobody())  # type: ignore[arg-type]

        async def answer() -> None:
            for number in range(1_000):
                out = list(noise.send(0xFE00, bytes(20), GLOBAL_ADDRESS, 0) or ())
                out += [each for k in range(1, 4) for each in noise.on_tick(k * 10**6)]
                for each in out:
                    asker.hear(number * 0.001, encode(each.message, 99, each.destination))
            out = list(robot.send(LOG_PGN, told, GLOBAL_ADDRESS, 0) or ())
            out += [each for k in range(1, 9) for each in robot.on_tick(k * 10**6)]
            for each in out:
                asker.hear(2.0, encode(each.message, 129, each.destination))

        asking = asyncio.create_task(asker.ask(LOG_PGN, 129, 5.0))
        loop.call_later(3.0, lambda: asyncio.ensure_future(answer()))
        text = await asking
        assert len(asker.arrived) == ARRIVED_MAX
        return text

    assert run_virtual(main()) == "WORKING [2J ]0;x  31m \xfc\nnext line"


class Nobody:
    def send(self, frame: Frame) -> bool:
        return True

    def subscribe(self, callback: object) -> None:
        """Nothing comes."""
