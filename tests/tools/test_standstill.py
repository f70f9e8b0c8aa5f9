"""A fleet that cannot be freed or started says why (item 11)."""

import asyncio

import pytest

from agent.cause import Cause, about, sentence
from agent.engine import FleetCoordinationEngine
from protocol.bus import CanBus
from protocol.codec import encode
from protocol.fleet_frames import Member, StandsBy
from protocol.name import fleet_name
from protocol.network_frames import AddressClaimed
from sim.clock import elapse, run_virtual
from sim.fieldbus import FieldBus, forget
from tools.inspector import Inspector
from tools.operator_device import Operator
from tools.reset import stands

TOLD = "CONFIG_MISMATCH with address 200: start that robot with the field of this fleet, or switch it off"


@pytest.mark.parametrize("cause", list(Cause), ids=lambda cause: cause.name)
def test_item_11_every_cause_has_a_number_and_says_what_a_person_can_do(cause: Cause) -> None:
    assert cause.number is not StandsBy.OTHER and cause.value.do
    assert sentence(cause.number, about(cause, "")).startswith(cause.name)


def test_item_11_what_holds_a_fleet_is_told_to_inspect_reset_and_the_engine() -> None:
    channel = "standstill"

    async def main() -> None:
        engines = []
        for slot in range(2):
            bus = CanBus(FieldBus(channel))
            engines.append(FleetCoordinationEngine(f"tractor_{slot}", bus, members=3))
        inspector, operator = Inspector(), Operator(CanBus(ear := FieldBus(channel)), None)
        loop = asyncio.get_running_loop()

        def heard(frame) -> None:  # type: ignore[no-untyped-def]
            inspector.hear(loop.time(), frame)
            operator.hear(loop.time(), frame)

        ear.subscribe(heard)
        await asyncio.gather(*(engine.start() for engine in engines))
        await elapse(1.0)
        operator.ask_who()
        await elapse(2.0)
        stranger = FieldBus(channel)
        stranger.subscribe(lambda frame: None)
        stranger.submit(encode(AddressClaimed(fleet_name("headland", 2).pack()), 200))
        await elapse(0.1)
        for _ in range(4):
            stranger.submit(encode(Member(2, 1, 0x123456), 200))
            await elapse(1.0)
        for slot in range(2):
            assert TOLD in inspector.to_dict()["robots"][slot]["stands"], slot
            assert TOLD in stands(operator, operator.robots[slot]), slot
            status = engines[0].get_fleet_status()
            assert TOLD in status[f"tractor_{slot}"]["stands"], slot
        await elapse(10.0)
        for slot in range(2):
            assert TOLD not in inspector.to_dict()["robots"][slot]["stands"], "it is gone"
            assert TOLD not in engines[0].get_fleet_status()[f"tractor_{slot}"]["stands"]
        for engine in engines:
            await engine.stop()
            engine.bus.close()
        forget(channel)

    run_virtual(main())
