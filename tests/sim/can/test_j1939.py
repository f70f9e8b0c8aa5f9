"""A stack that nobody here wrote on one bus with our peers: can-j1939, through python-can's socketcand.

Real time, real sockets, its threads and our loop. Waiting is for frames, never for a time.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator
from random import Random
from typing import Any

import pytest

from agent.interface.identity import Identity
from agent.peer.diagnostics import COMPONENT_PGN, fault_of
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from agent.runtime.peer_runner import PeerRunner
from agent.safety.stop_cause import StopCause
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.network_frames import Acknowledgment, AcknowledgmentControl
from protocol.links.bus import CanBus
from protocol.name import Name, fleet_name
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_server import Hub

j1939 = pytest.importorskip("j1939", reason="can-j1939 is not installed")

LIMIT_S = 30.0


class Bus:
    """One segment with a hub; `until` looks again whenever a frame has passed."""

    def __init__(self, channel: str) -> None:
        self.segment = segment(channel)
        self.hub = Hub(self.segment)
        self.peers: list[Peer] = []
        self.frames: list[Frame] = []
        self._passed = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._units: list[Any] = []
        self.segment.taps.append(self._tap)

    def _tap(self, t_us: int, frame: Frame) -> None:
        self.frames.append(frame)
        self._passed.set()

    def add_peer(self, slot: int) -> Peer:
        identity = Identity(
            slot,
            frozenset({slot}),
            fleet_name("interop", slot),
            1,
            release="1.2.3",
            diagnostics=True,
        )
        peer = make_peer(identity, Random(slot), PeerRunner.now_us(), {})
        runner = PeerRunner(peer, CanBus(FieldBus(self.segment.channel)), None, None)
        self._tasks.append(asyncio.create_task(runner.run()))
        self.peers.append(peer)
        return peer

    async def add_unit(self, name: int, address: int) -> "Unit":
        unit = Unit(name, address)
        await asyncio.to_thread(unit.start, self.hub.port)
        self._units.append(unit)
        return unit

    async def until(self, holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(LIMIT_S):
            while not holds():
                self._passed.clear()
                await self._passed.wait()

    async def close(self) -> None:
        for unit in self._units:
            await asyncio.to_thread(unit.stop)
        for task in self._tasks:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
        await self.hub.stop()
        forget(self.segment.channel)


class Unit:
    """A can-j1939 control unit with one application."""

    def __init__(self, name: int, address: int) -> None:
        self.heard: list[tuple[int, int, bytes]] = []  # (group, source, data)
        self.ecu = j1939.ElectronicControlUnit()
        self.application = j1939.ControllerApplication(j1939.Name(value=name), address)

    def start(self, port: int) -> None:
        self.ecu.connect(interface="socketcand", host="127.0.0.1", port=port, channel="can0",
                         tcp_tune=True)  # fmt: skip
        self.ecu.add_ca(controller_application=self.application)
        self.application.subscribe(self._on_message)
        self.application.start()

    def _on_message(
        self, priority: int, pgn: int, source: int, timestamp: float, data: Any
    ) -> None:
        self.heard.append((pgn, source, bytes(data)))

    @property
    def address(self) -> int | None:
        return self.application.device_address if self.ready else None

    @property
    def ready(self) -> bool:
        return bool(self.application.state == j1939.ControllerApplication.State.NORMAL)

    def stop(self) -> None:
        self.application.stop()
        self.ecu.stop()
        self.ecu.disconnect()


@contextlib.asynccontextmanager
async def opened(channel: str) -> AsyncIterator[Bus]:
    bus = Bus(channel)
    await bus.hub.start()
    try:
        yield bus
    finally:
        await bus.close()


def names() -> Iterator[tuple[int, bool]]:
    """(a NAME, whether it beats the one of slot 0): one lower, one higher than ours."""
    ours = fleet_name("interop", 0).pack()
    other = Name(identity=5, manufacturer=100)
    yield other._replace(function_instance=0).pack(), other.pack() < ours
    higher = Name(identity=5, manufacturer=2000)
    yield higher.pack(), higher.pack() < ours


@pytest.mark.asyncio
@pytest.mark.parametrize(("name", "wins"), list(names()))
async def test_one_address_two_stacks(name: int, wins: bool) -> None:
    """The lower NAME keeps the address, the other moves on, and each knows the other's claim."""
    async with opened(f"j1939 contention {wins}") as bus:
        peer = bus.add_peer(0)
        await bus.until(lambda: peer.address == 128)
        unit = await bus.add_unit(name, 128)
        await bus.until(
            lambda: unit.ready and peer.address is not None and peer.address != unit.address
        )
        assert (unit.address == 128) is wins and (peer.address == 128) is not wins
        assert unit.address is not None
        assert peer.joining.machine.names[unit.address] == name


@pytest.mark.asyncio
async def test_long_messages_both_ways() -> None:
    async with opened("j1939 transport") as bus:
        peer = bus.add_peer(0)
        unit = await bus.add_unit(next(names())[0], 200)
        await bus.until(lambda: unit.ready and peer.joining.joined)
        assert peer.address is not None

        # Asked alone, our peer answers by RTS and CTS.
        await asyncio.to_thread(unit.application.send_request, 0, COMPONENT_PGN, peer.address)
        text = peer.identity.component.encode()
        expected = (COMPONENT_PGN, peer.address, text)
        await bus.until(lambda: expected in unit.heard)
        # All were asked: it answers to all, by BAM.
        unit.heard.clear()
        await asyncio.to_thread(unit.application.send_request, 0, COMPONENT_PGN, 255)
        await bus.until(lambda: expected in unit.heard)

        # And the other way: to one ...
        data = bytes(range(200))
        await asyncio.to_thread(unit.application.send_pgn, 0, 0xEF, peer.address, 6, list(data))
        await bus.until(lambda: any(a.data == data and not a.broadcast
                                    for a in peer.letters.inbox))  # fmt: skip
        # ... and to all.
        theirs = b"Somebody*else*0815*baler*"
        await asyncio.to_thread(unit.application.send_pgn, 0, 0xFE, 0xEB, 6, list(theirs))
        await bus.until(lambda: peer.letters.names.get(200) == theirs.decode())


@pytest.mark.asyncio
async def test_an_unknown_group_is_refused_to_who_asked_alone() -> None:
    async with opened("j1939 refusal") as bus:
        peer = bus.add_peer(0)
        unit = await bus.add_unit(next(names())[0], 200)
        await bus.until(lambda: unit.ready and peer.joining.joined)
        refusal = encode(
            Acknowledgment(AcknowledgmentControl.NACK, 0xFF, 200, 65217), peer.address or 0
        )
        await asyncio.to_thread(unit.application.send_request, 0, 65217, peer.address)
        await bus.until(lambda: refusal in bus.frames)


@pytest.mark.asyncio
async def test_a13_can_j1939_reads_our_faults_and_is_refused_to_clear_them() -> None:
    """Its reader of DM1 has the faults of a robot that stands; its DM22 is answered."""
    async with opened("diagnosis") as bus:
        peer = bus.add_peer(0)
        unit = await bus.add_unit(next(names())[0], 200)
        heard: list[tuple[int, list[dict[str, int]]]] = []
        reader = j1939.Dm1(unit.application)
        reader.subscribe(lambda source, _, faults, __: heard.append((source, faults)))
        await bus.until(lambda: unit.ready and peer.joining.joined)
        await bus.until(lambda: len(heard) >= 2)  # nobody has asked
        listens = StopCause.UNHEARD  # it has just booted
        await bus.until(lambda: not peer.safety.holds(listens) and len(heard[-1][1]) == 1)
        causes = [cause for cause, _ in peer.safety.causes]
        assert causes == [
            StopCause.BOOT_UNCONFIRMED,
            StopCause.NOT_STARTED,
        ]  # it follows from the first
        expected = [fault_of(StopCause.BOOT_UNCONFIRMED)]
        source, faults = heard[-1]
        assert source == peer.address
        assert [(fault["spn"], fault["fmi"]) for fault in faults] == expected
        clear = j1939.Dm22(unit.application)
        await asyncio.to_thread(clear.request_clear_act_dtc, peer.address, 110, 3)
        refused = clear.DTC_CLR_CTRL.ACT_NACK, clear.DTC_CLR_CTRL_SPECIFIC.DTC_UNKNOWN
        await bus.until(
            lambda: any(p == 0xC300 and tuple(data[:2]) == refused for p, _, data in unit.heard)
        )


@pytest.mark.asyncio
@pytest.mark.parametrize(
    ("pgn", "text"),
    [
        (64965, "*robot 0*peer*Headland**"),
        (65242, "\x01Headland 1.2.3*"),
        (64653, "peer*Headland*"),
    ],
)
async def test_a13_can_j1939_gets_what_a_robot_is(pgn: int, text: str) -> None:
    async with opened(f"identity {pgn}") as bus:
        peer = bus.add_peer(0)
        unit = await bus.add_unit(next(names())[0], 200)
        await bus.until(lambda: unit.ready and peer.joining.joined)
        await asyncio.to_thread(unit.application.send_request, 0, pgn, peer.address)
        await bus.until(
            lambda: any(text in d.decode("latin-1") for p, _, d in unit.heard if p == pgn)
        )
