"""`FleetCoordinationEngine`: the API of the protocol document, on real python-can bus objects."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from itertools import count
from math import inf
from typing import Any

import can
import pytest

from agent.interface.identity import SilencePolicy
from agent.peer.inputs import Hold
from agent.runtime.engine import FleetCoordinationEngine
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import CREEP_M_S
from protocol.authentication import Keyring, Keys
from protocol.links.bus import CanBus
from sim.can.simulated_bus import forget, segment
from sim.fleet.virtual_clock import elapse, run_virtual

numbers = count()
Story = Callable[[list[FleetCoordinationEngine]], Awaitable[None]]


@asynccontextmanager
async def fleet(
    size: int, keys: Keys | None = None
) -> AsyncIterator[list[FleetCoordinationEngine]]:
    channel = f"engines {next(numbers)}"
    engines = []
    for slot in range(size):
        bus = CanBus(can.Bus(interface="fieldbus", channel=channel))
        engine = FleetCoordinationEngine(
            f"tractor_{slot:03d}", bus, members=size, silence=SilencePolicy.CONTINUE, keys=keys
        )
        engines.append(engine)
    await asyncio.gather(*(engine.start() for engine in engines))
    await elapse(2.0)
    yield engines
    for engine in engines:
        await engine.stop()
        engine.bus.close()
    forget(channel)


def play(size: int, story: Story, keys: Keys | None = None) -> None:
    async def main() -> None:
        async with fleet(size, keys) as engines:
            await story(engines)

    run_virtual(main())


def test_joining_makes_everybody_idle_and_known() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        assert {e.get_current_state() for e in engines} == {"IDLE"}
        status = engines[0].get_fleet_status()
        assert sorted(status) == ["tractor_000", "tractor_001", "tractor_002"]
        assert status["tractor_001"]["status"] == "IDLE"

    play(3, story)


def test_of_two_claims_at_once_one_wins_and_both_know() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        won = await asyncio.gather(*(e.claim_section("S7") for e in engines))
        assert sorted(won) == [False, False, True]
        winner = won.index(True)
        assert engines[winner].get_current_state() == "WORKING"
        owners = {e.get_field_allocation_state().owner_of(7) for e in engines}
        assert owners == {winner}

    play(3, story)


def test_a_released_section_is_finished_for_everybody() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        assert await engines[0].claim_section("north-west corner")
        await engines[0].release_section("north-west corner")
        await elapse(1.0)
        assert engines[0].get_current_state() == "IDLE"
        assert all(e.get_field_allocation_state().done_count() == 1 for e in engines)
        assert not await engines[1].claim_section("north-west corner")

    play(2, story)


def test_i25_who_has_finished_a_section_cannot_claim_it_again() -> None:
    """It was told that it had won the section, and worked it twice."""

    async def story(engines: list[FleetCoordinationEngine]) -> None:
        assert await engines[0].claim_section("S7")
        await engines[0].release_section("S7")
        assert not await engines[0].claim_section("S7")
        assert engines[0].refusal == "another machine has it, or it is done"
        assert await engines[0].claim_section("S8")
        assert not await engines[0].claim_section("S7"), "beside other work"

    play(2, story)


def test_a_stop_stops_all_and_is_left_only_by_reset() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        heard: list[dict[str, Any]] = []
        engines[1].on_emergency(heard.append)
        await engines[0].claim_section("S1")
        await engines[2].broadcast_emergency_stop("OBSTACLE_DETECTED")
        await elapse(0.05)
        assert {e.get_current_state() for e in engines} == {"EMERGENCY_STOP"}
        assert heard and "stop" in heard[0]["why"]
        assert not await engines[0].manual_reset(), "nobody has cleared the stop"
        assert not await engines[0].claim_section("S2")

    play(3, story)


def test_callbacks_may_be_plain_or_async_and_may_fail() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        seen: list[str] = []

        def broken(state: str) -> None:
            raise RuntimeError("mine")

        async def later(state: str) -> None:
            await elapse(0)
            seen.append(state)

        async def broken_later(state: str) -> None:
            raise RuntimeError("mine, later")

        for callback in (broken, later, broken_later):
            engines[0].on_state_change(callback)
        assert await engines[0].claim_section("S3")
        await elapse(0.1)
        assert seen == ["WORKING"]
        assert engines[0].get_current_state() == "WORKING"

    play(2, story)


def test_a_leader_is_elected_and_replaced() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        def leaders(of: list[FleetCoordinationEngine]) -> set[Any]:
            return {e._peer.named.votes.election.leader for e in of}

        (leader,) = leaders(engines)
        await engines[leader.slot].stop()
        await elapse(2.0)
        (follower,) = leaders([e for e in engines if e.slot != leader.slot])
        assert follower.slot != leader.slot and follower.term > leader.term

    play(3, story)


def test_all_six_messages_are_really_sent() -> None:
    channel = f"engines {next(numbers)}"

    async def main() -> None:
        kinds: set[int] = set()
        wire = segment(channel)
        wire.taps.append(lambda t_us, frame: kinds.add(frame.identifier >> 8 & 0x3FFFF))
        engines = []
        for slot in range(3):
            bus = CanBus(can.Bus(interface="fieldbus", channel=channel))
            engines.append(
                FleetCoordinationEngine(f"r{slot}", bus, members=3, silence=SilencePolicy.CONTINUE)
            )
        await engines[0].start()
        await elapse(1.5)
        assert await engines[0].claim_section("S1")
        await engines[1].start()  # late: it must ask, and be told
        await engines[2].start()
        await elapse(5.0)
        assert engines[2].get_field_allocation_state().owner_of(1) == 0
        await engines[2].broadcast_emergency_stop("SYSTEM_FAULT")
        await elapse(0.2)
        assert {0xFF00, 0xFF04, 0xFF08, 0xFF11, 0xFF0C, 0xFF0D} <= kinds
        for engine in engines:
            await engine.stop()
            engine.bus.close()

    run_virtual(main())
    forget(channel)


def test_bad_arguments_say_what_to_do() -> None:
    bus = CanBus(can.Bus(interface="fieldbus", channel=f"engines {next(numbers)}"))
    with pytest.raises(ValueError, match="must end in a slot number"):
        FleetCoordinationEngine("tractor", bus)
    engine = FleetCoordinationEngine("tractor_1", bus)
    with pytest.raises(RuntimeError, match=r"start\(\) first"):
        engine.get_fleet_status()
    assert engine.get_current_state() == "DISCONNECTED"
    bus.close()


def test_m18_every_stop_is_told_with_its_reason_and_place() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        heard: list[dict[str, Any]] = []
        engines[1].on_emergency(heard.append)
        for _ in range(20):
            for slot, engine in enumerate(engines):
                engine.update(10.0 * slot, 5.0, 0.0, 1.0, health=0.5)
            await elapse(0.05)
        assert engines[0].get_fleet_status()["tractor_002"]["position"] == {
            "x_m": pytest.approx(20.0, abs=0.05), "y_m": pytest.approx(5.0, abs=0.05),
        }  # fmt: skip
        for presser, reason in ((2, "PERSON_IN_FIELD"), (0, "OBSTACLE_DETECTED")):
            await engines[presser].broadcast_emergency_stop(reason)
            await elapse(0.05)
        told = [(h["slot"], h["reason"], h["position"]["x_m"]) for h in heard[:2]]
        assert told[0][:2] == (2, "PERSON_IN_FIELD") and told[1][:2] == (0, "OBSTACLE_DETECTED")
        assert told[0][2] == pytest.approx(20.0, abs=0.05)
        assert told[1][2] == pytest.approx(0.0, abs=0.05)

    play(3, story)


def test_m18_a_claim_of_a_machine_that_may_not_move_is_false_with_the_reason() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        engines[0]._operate(Hold())
        assert not await engines[0].claim_section("S7")
        assert "NOT_STARTED" in engines[0].refusal
        await elapse(0.1)
        assert engines[1].get_field_allocation_state().owner_of(7) is None

    play(2, story)


def test_m18_a_plain_can_bus_is_wrapped_and_anything_else_refused() -> None:
    async def main() -> None:
        with can.Bus(interface="fieldbus", channel="plain") as bus:
            assert isinstance(FleetCoordinationEngine("tractor_001", bus).bus, CanBus)
        with pytest.raises(TypeError, match=r"can\.Bus"):
            FleetCoordinationEngine("tractor_001", "can0")  # type: ignore[arg-type]
        forget("plain")

    run_virtual(main())


KEYS = Keys(b"m" * 16, b"o" * 16)
OPERATOR = 200


def operator_key(secret: bytes = b"o" * 16) -> Keyring:
    """Of a person: it holds no secret of robots."""
    return Keyring(Keys(None, secret), OPERATOR, b"operator", sent=1000)


async def released(engines: list[FleetCoordinationEngine]) -> None:
    """Each machine is reset, and then permitted to move; all of them work again."""
    assert all([await engine.manual_reset() for engine in engines])
    await elapse(3.0)
    assert {e.get_current_state() for e in engines} == {"IDLE"}
    assert [e.speed_limit_m_s for e in engines] == [0.0] * len(engines), "reset is not start"
    assert all([await engine.permit() for engine in engines])
    await elapse(1.0)
    assert [e.speed_limit_m_s for e in engines] == [inf] * len(engines)
    assert await engines[1].claim_section("S5")


def test_m18_a_fleet_without_keys_is_released_by_the_engine_that_says_so() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        await engines[2].broadcast_emergency_stop("OBSTACLE_DETECTED")
        await elapse(0.3)
        for wrong in (
            {},
            {"operator": operator_key()},
            {"operator": operator_key(), "keyless": True},
        ):
            with pytest.raises(ValueError, match="has no keys"):
                await engines[0].clear_stops(**wrong)
        assert not await engines[0].manual_reset()
        assert not await engines[0].permit(), "a latched machine takes no start"
        cleared = await engines[0].clear_stops(keyless=True)
        assert cleared.complete and len(cleared.stops) == 1 and cleared.stops[0].startswith("2.")
        assert {e.get_current_state() for e in engines} == {"EMERGENCY_STOP"}, "until each is reset"
        await released(engines)

    play(3, story)


def test_m18_a_fleet_with_keys_is_released_by_an_operators_key_alone() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        await engines[1].broadcast_emergency_stop("PERSON_IN_FIELD")
        await elapse(0.3)
        assert all(e._peer.safety.stops.latched for e in engines)
        for wrong in ({}, {"keyless": True}, {"operator": operator_key(), "keyless": True}):
            with pytest.raises(ValueError, match="has keys"):
                await engines[0].clear_stops(**wrong)
        with pytest.raises(ValueError, match="no operator"):
            await engines[0].clear_stops(Keyring(KEYS, 140, b"panel"))
        forged = await engines[0].clear_stops(operator_key(b"x" * 16), timeout_s=2.0)
        assert forged.holding == ("tractor_000", "tractor_001", "tractor_002")
        assert all(e._peer.safety.stops.latched for e in engines)
        await elapse(11.0)  # the lock-out of a sender with bad tags
        cleared = await engines[0].clear_stops(operator_key())
        assert cleared.complete, cleared
        assert not any(e._peer.safety.stops.latched for e in engines)
        await released(engines)

    play(3, story, KEYS)


def test_m18_a_stop_that_is_pressed_during_a_release_stays() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        await engines[1].broadcast_emergency_stop("PERSON_IN_FIELD")
        await elapse(0.3)
        release = asyncio.ensure_future(engines[0].clear_stops(keyless=True, timeout_s=1.0))
        await elapse(0.01)
        await engines[2].broadcast_emergency_stop("SYSTEM_FAULT")
        cleared = await release
        assert cleared.holding == ("tractor_000", "tractor_001", "tractor_002")
        assert len(cleared.stops) == 1
        for engine in engines:
            assert [dot.slot for dot in engine._peer.safety.stops.active] == [2]

    play(3, story)


def test_m18_a_release_names_the_members_that_nobody_hears() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        await engines[1].broadcast_emergency_stop("PERSON_IN_FIELD")
        await elapse(0.3)
        await engines[2]._cancel()  # its computer dies
        engines[2].bus.close()
        await elapse(1.0)
        cleared = await engines[0].clear_stops(keyless=True)
        assert not cleared.holding and cleared.silent == ("tractor_002",) and not cleared.complete

    play(3, story)


def test_m18_the_pose_and_health_of_a_machine_are_in_its_status_and_with_the_others() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        for step in range(40):
            for slot, engine in enumerate(engines):
                engine.update(10.0 * slot + 0.1 * step, 5.0, 0.0, 2.0, health=0.5 + 0.5 * slot)
            await elapse(0.05)
        for engine in engines:
            status = engine.get_fleet_status()
            for slot in range(2):
                row = status[f"tractor_00{slot}"]
                assert row["position"]["x_m"] == pytest.approx(10.0 * slot + 3.9, abs=0.25)
                assert row["speed_m_s"] == pytest.approx(2.0, abs=0.05)
                assert row["health"] == pytest.approx(0.5 + 0.5 * slot, abs=0.01)
        assert engines[0].get_fleet_status()["tractor_000"]["health_why"] == ["says of itself 50%"]

    play(2, story)


def test_m18_a_machine_whose_receiver_falls_silent_stands_and_says_so() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        assert engines[0].speed_limit_m_s == inf
        for _ in range(20):
            for engine in engines:
                engine.update(3.0, 4.0, 0.0, 2.0)
            await elapse(0.05)
        assert engines[0].speed_limit_m_s == inf
        for _ in range(60):
            engines[1].update(3.0, 4.0, 0.0, 0.0)
            await elapse(0.05)
        assert engines[0].speed_limit_m_s == 0.0 and engines[1].speed_limit_m_s == inf
        assert [why.split(":")[0] for why in engines[0].stands] == ["SENSES_OLD"]
        seen = engines[1].get_fleet_status()["tractor_000"]
        assert seen["health"] == 0.0 and seen["stands"][0].startswith("SENSES_OLD")
        assert not await engines[0].claim_section("S7")
        assert engines[0].refusal.startswith("SENSES_OLD")
        for _ in range(40):
            engines[0].update(3.0, 4.0, 0.0, 0.0)
            engines[1].update(3.0, 4.0, 0.0, 0.0)
            await elapse(0.05)
        assert engines[0].speed_limit_m_s == inf

    play(2, story)


def test_m18_the_speed_limit_of_a_machine_says_creep_and_stand() -> None:
    async def story(engines: list[FleetCoordinationEngine]) -> None:
        engine = engines[0]
        engine._peer.safety.raise_cause(StopCause.CREEP, 0, "silent [1]")
        assert engine.speed_limit_m_s == CREEP_M_S
        await engines[1].broadcast_emergency_stop("SYSTEM_FAULT")
        await elapse(0.05)
        assert engine.speed_limit_m_s == 0.0
        await engine.stop()
        assert engine.speed_limit_m_s == 0.0

    play(2, story)


def test_an_engine_that_has_failed_lets_no_machine_drive() -> None:
    """A driver that raises ends the peer. The program has to notice that, and to stop the machine."""

    async def story(engines: list[FleetCoordinationEngine]) -> None:
        engine, told = engines[0], list[dict[str, Any]]()
        assert engine.speed_limit_m_s == inf and not engine.failure
        engine.on_emergency(told.append)
        runner = engine._runner
        assert runner is not None

        def unplugged() -> None:
            raise RuntimeError("the adapter is gone")

        runner.on_tick = unplugged  # type: ignore[method-assign]
        await elapse(1.0)
        assert engine.speed_limit_m_s == 0.0
        assert "the adapter is gone" in engine.failure
        assert "the adapter is gone" in engine.stands[0]
        assert "the adapter is gone" in told[-1]["why"]

        async def gone() -> None:
            raise RuntimeError("the adapter is gone")

        runner.leave = gone  # type: ignore[method-assign]
        await engine.stop()
        assert not engine.failure and engine.speed_limit_m_s == 0.0

    play(2, story)


def test_a_start_that_was_cancelled_leaves_nothing_running() -> None:
    """The program gave up after a tenth of a second. The next start has to join, too."""

    async def story(engines: list[FleetCoordinationEngine]) -> None:
        await engines[1].stop()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await engines[1].start()
        assert (
            engines[1].speed_limit_m_s == 0.0 and engines[1].get_current_state() == "DISCONNECTED"
        )
        await engines[1].start()
        assert engines[1].get_current_state() != "DISCONNECTED"

    play(2, story)


def test_an_engine_is_stopped_and_started_on_a_bus_that_a_thread_reads() -> None:
    """As those of python-can are that have no file to wait for; here in real time."""

    async def main() -> str:
        with can.Bus(interface="virtual", channel=f"engines {next(numbers)}") as bus:
            engine = FleetCoordinationEngine("tractor_000", CanBus(bus), members=2)
            for _ in range(2):
                await engine.start()
                state = engine.get_current_state()
                await engine.stop()
            engine.bus.close()
            return state

    assert asyncio.run(main()) == "IDLE"
