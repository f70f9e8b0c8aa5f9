"""A fleet that cannot be freed or started says why (item 11)."""

import asyncio

import pytest

from agent.interface.config import S
from agent.interface.effects import Send
from agent.interface.lifecycle import State
from agent.peer.peer import Peer
from agent.runtime.engine import FleetCoordinationEngine
from agent.safety.stop_cause import StopCause, about, sentence
from protocol.frames.codec import decode, encode
from protocol.frames.fleet_frames import Member, StandsBy, Standstill
from protocol.frames.frame import Frame
from protocol.frames.network_frames import AddressClaimed
from protocol.links.bus import CanBus
from protocol.name import fleet_name
from sim.can.simulated_bus import FieldBus, forget
from sim.fleet.virtual_clock import elapse, run_virtual
from tests.agent.lone_peer import peer_in
from tools.inspect.inspector import Inspector
from tools.operate.operator_device import Operator
from tools.operate.reset import hear_causes, stands

TOLD = (
    "CONFIG_MISMATCH with address 200: start all with the same release, fleet and field, or switch "
    "that robot off"
)


@pytest.mark.parametrize("cause", list(StopCause), ids=lambda cause: cause.name)
def test_item_11_every_cause_has_a_number_and_says_what_a_person_can_do(cause: StopCause) -> None:
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


def heard_frames(*causes: StopCause) -> tuple[Peer, list[tuple[int, Frame]]]:
    """Robot 0 is held by these causes; all that it says in the following 4 s."""
    peer = peer_in(State.IDLE, None)
    for cause in causes:
        peer.safety.raise_cause(cause, 0, "silent [3, 4]" if cause in SILENCES else "")
    frames = [
        (0, encode(AddressClaimed(fleet_name("total", 0).pack()), 128)),
        (1, encode(Member(0, 0, peer.identity.field_hash), 128)),
    ]
    for beat in range(1, 9):
        for effect in peer.named.voice.heartbeat(peer.context(beat * S // 2)):
            if isinstance(effect, Send):
                frames.append((beat * S // 2, encode(effect.message, 128)))
    return peer, frames


def told_everywhere(frames: list[tuple[int, Frame]]) -> list[list[str]]:
    """What `headland inspect` and `headland release` say of robot 0 in the end."""
    inspector = Inspector()
    operator = Operator(CanBus(FieldBus("told")), None)
    for t_us, frame in frames:
        inspector.hear(t_us / 1e6, frame)
        operator.hear(t_us / 1e6, frame)
    forget("told")
    return [inspector.to_dict()["robots"][0]["stands"], stands(operator, operator.robots[0])]


SILENCES = (StopCause.MEMBER_SILENT, StopCause.CREEP)


@pytest.mark.parametrize("cause", list(StopCause), ids=lambda cause: cause.name)
def test_item_11_every_cause_is_named_with_its_remedy_by_inspect_and_reset(
    cause: StopCause,
) -> None:
    _, frames = heard_frames(cause)
    for lines in told_everywhere(frames):
        (line,) = lines
        assert line.startswith(cause.name) and line.endswith(cause.value.do)
        assert "\n" not in line
        if cause in SILENCES:
            assert "robot 3 and 1 more" in line


def test_item_11_a_cause_is_told_also_between_two_frames_that_name_it() -> None:
    """A heartbeat of a robot that creeps says that it may move."""
    for cause in StopCause:
        _, frames = heard_frames(cause)
        first = next(
            k for k, (_, frame) in enumerate(frames) if isinstance(decode(frame)[1], Standstill)
        )
        for count in range(first + 1, len(frames) + 1):
            assert all(len(lines) == 1 for lines in told_everywhere(frames[:count])), cause


def test_item_11_all_causes_of_one_robot_are_told_worst_first() -> None:
    several = (StopCause.STOP_DOT, StopCause.NOT_STARTED, StopCause.SENSES_OLD, StopCause.UNHEARD)
    _, frames = heard_frames(*several)
    for lines in told_everywhere(frames):
        assert [line.split(":")[0].split(" ")[0] for line in lines] == [
            "STOP_DOT", "SENSES_OLD", "UNHEARD", "NOT_STARTED",
        ]  # fmt: skip
    early = [frame for frame in frames if frame[0] <= 1.2 * S]
    for lines in told_everywhere(early):
        assert lines[-1] == "and for 3 more, which it tells one a second: listen longer"


def test_item_11_a_cause_that_is_gone_is_told_no_longer() -> None:
    peer, frames = heard_frames(StopCause.UNHEARD, StopCause.NOT_STARTED)
    peer.safety.clear_cause(StopCause.UNHEARD, 4 * S)
    for beat in range(9, 13):
        for effect in peer.named.voice.heartbeat(peer.context(beat * S // 2)):
            if isinstance(effect, Send):
                frames.append((beat * S // 2, encode(effect.message, 128)))
    for lines in told_everywhere(frames):
        assert [line.split(":")[0] for line in lines] == ["NOT_STARTED"]


def test_item_11_a_robot_that_can_say_nothing_is_named_as_silent() -> None:
    _, frames = heard_frames(StopCause.NOT_STARTED)
    inspector = Inspector()
    for t_us, frame in frames:
        inspector.hear(t_us / 1e6, frame)
    inspector.hear(30.0, encode(AddressClaimed(fleet_name("total", 1).pack()), 129))
    (robot,) = inspector.to_dict()["robots"]
    assert robot["stands"] == [f"SILENT: {StopCause.MEMBER_SILENT.value.do}"]


def test_item_11_reset_waits_until_a_robot_has_told_all_of_its_causes() -> None:
    channel = "many causes"

    async def main() -> None:
        bus = CanBus(FieldBus(channel))
        engine = FleetCoordinationEngine("tractor_0", bus, members=2)
        operator = Operator(CanBus(ear := FieldBus(channel)), None)
        loop = asyncio.get_running_loop()
        ear.subscribe(lambda frame: operator.hear(loop.time(), frame))
        await engine.start()
        await elapse(1.0)
        held = (StopCause.DISK_ERROR, StopCause.BOOT_UNCONFIRMED, StopCause.NOT_STARTED)
        for cause in held:
            engine._peer.safety.raise_cause(cause, 0)
        await engine.broadcast_emergency_stop("SYSTEM_FAULT")
        await operator.listen(1.0)
        await hear_causes(operator)
        lines = stands(operator, operator.robots[0])
        assert {line.split(":")[0] for line in lines} >= {
            *(cause.name for cause in held), "STOP_DOT (1 stop)",
        }  # fmt: skip
        await engine.stop()
        bus.close()
        forget(channel)

    run_virtual(main())
