"""M25: what the elected leader is for, and that nothing depends on it."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from itertools import count

from agent.interface.identity import SilencePolicy
from agent.peer import fleet_summary as bulletin
from agent.peer.fleet_summary import FLEET_SUMMARY_PGN
from agent.runtime.engine import FleetCoordinationEngine
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.fleet.virtual_clock import elapse, run_virtual
from tools.inspect.inspector import Inspector
from tools.operate.pgn_client import PgnClient

SIZE = 4
numbers = count()
Engines = list[FleetCoordinationEngine]


class Fleet:
    """Engines on a simulated wire, and an operator's device that asks."""

    def __init__(self, engines: Engines, channel: str) -> None:
        self.engines, self.wire = engines, segment(channel).wire
        bus = FieldBus(channel)
        self.device, self.letters, self.inspector = bus, PgnClient(CanBus(bus)), Inspector()
        loop = asyncio.get_running_loop()

        def heard(frame) -> None:  # type: ignore[no-untyped-def]
            self.letters.hear(loop.time(), frame)
            self.inspector.hear(loop.time(), frame)

        bus.subscribe(heard)

    async def ask(self) -> list[int]:
        """Ask everybody for the state of the fleet; who answered, within 2 s."""
        self.letters.arrived.clear()
        await self.letters.ask(FLEET_SUMMARY_PGN, GLOBAL_ADDRESS, 1.0)
        await elapse(1.0)
        told = [
            bulletin.read(a.data.decode())
            for a in self.letters.arrived
            if a.pgn == FLEET_SUMMARY_PGN
        ]
        return [t.by for t in told if t is not None]

    def leaders(self) -> list[str | None]:
        return [engine.leader() for engine in self.engines if engine._runner is not None]


@asynccontextmanager
async def fleet() -> AsyncIterator[Fleet]:
    channel = f"leaders {next(numbers)}"
    engines = []
    for slot in range(SIZE):
        bus = CanBus(FieldBus(channel))
        engines.append(
            FleetCoordinationEngine(
                f"tractor_{slot:03d}", bus, members=SIZE, silence=SilencePolicy.CONTINUE
            )
        )
    made = Fleet(engines, channel)
    await asyncio.gather(*(engine.start() for engine in engines))
    await elapse(4.0)
    yield made
    for engine in engines:
        await engine.stop()
        engine.bus.close()
    forget(channel)


def play(story: Callable[[Fleet], Awaitable[None]]) -> None:
    async def main() -> None:
        async with fleet() as made:
            await story(made)

    run_virtual(main())


async def die(engine: FleetCoordinationEngine) -> None:
    """Its computer fails: it says nothing more, and no farewell."""
    await engine._cancel()
    engine.bus.close()


def test_m25_the_leader_alone_answers_a_question_to_everybody() -> None:
    async def story(made: Fleet) -> None:
        assert made.leaders() == ["tractor_000"] * SIZE
        assert [engine.is_leader for engine in made.engines] == [True, False, False, False]
        assert await made.ask() == [0]
        assert made.inspector.leader == 0

    play(story)


def test_m25_another_leads_and_answers_when_the_leader_dies() -> None:
    async def story(made: Fleet) -> None:
        seen: list[str | None] = []
        made.engines[2].on_leader_change(seen.append)
        assert await made.engines[0].claim_section("S3")
        await die(made.engines[0])
        assert await made.engines[1].claim_section("S1"), "nobody waits for a leader"
        await elapse(4.0)
        assert made.leaders() == ["tractor_001"] * 3
        assert await made.ask() == [1]
        assert seen == ["tractor_001"]
        for expected in (2, 3):
            await die(made.engines[expected - 1])
            await elapse(4.0)
            assert await made.ask() == [expected]

    play(story)


def test_m25_without_a_leader_any_other_peer_still_answers() -> None:
    async def story(made: Fleet) -> None:
        for engine in made.engines:
            engine._peer.named.votes.election.leader = None
            engine._peer.named.votes.election.votes.clear()
            engine._peer.named.votes.election._patience = 100  # nobody votes for now
        assert await made.ask() == []
        address = made.engines[2]._peer.address
        assert address is not None
        text = await made.letters.ask(FLEET_SUMMARY_PGN, address, 1.0)
        assert text is not None and bulletin.read(text) is not None
        assert await made.engines[3].claim_section("S9"), "work needs no leader"
        await made.engines[1].broadcast_emergency_stop("SYSTEM_FAULT")
        await elapse(0.1)
        assert {engine.get_current_state() for engine in made.engines} == {"EMERGENCY_STOP"}

    play(story)


def test_m25_two_leaders_of_a_cut_do_no_harm_and_one_remains() -> None:
    async def story(made: Fleet) -> None:
        nodes = [engine.bus.bus.node for engine in made.engines]  # type: ignore[attr-defined]
        made.wire.partition({nodes[0], nodes[1]}, {nodes[2], nodes[3], made.device.node})
        await elapse(5.0)
        assert made.leaders() == ["tractor_000"] * 2 + ["tractor_002"] * 2
        assert await made.ask() == [2], "each side has one that answers"
        won = [await made.engines[k].claim_section(f"S{k}") for k in (0, 3)]
        assert won == [True, True]
        made.wire.heal()
        await elapse(12.0)
        (leader,) = set(made.leaders())
        answers = await made.ask()
        assert [f"tractor_{slot:03d}" for slot in answers] == [leader]
        digests = {engine._peer.allocation.digest for engine in made.engines}
        assert len(digests) == 1, "what both sides did is known to all"

    play(story)


def test_m25_health_elects_nobody() -> None:
    async def story(made: Fleet) -> None:
        for _ in range(80):
            for slot, engine in enumerate(made.engines):
                engine.update(10.0 * slot, 0.0, 0.0, 0.0, health=0.0 if slot == 0 else 1.0)
            await elapse(0.05)
        assert made.engines[1].get_fleet_status()["tractor_000"]["health"] == 0.0
        assert made.leaders() == ["tractor_000"] * SIZE

    play(story)
