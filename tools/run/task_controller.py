"""`headland tc`: a task controller for implements of any maker on a bus (ISO 11783-10).

It takes places from the receiver on that bus, knows the ground that has been worked, and switches
sections off over it. Several of them, one on each tractor, share the map as the progress of one fleet.
"""

import asyncio
import secrets
from collections.abc import Callable
from pathlib import Path
from random import Random

from agent.implements.as_applied_map import AsAppliedMap, by_row
from agent.implements.task_controller import TaskController, controller_name
from agent.interface.config import MS
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.ports import Bus
from agent.peer.inputs import Cover
from agent.runtime.bodies.bus_fixes import BusFixes
from agent.runtime.bodies.nmea_body import LATENCY_MS, in_field
from agent.runtime.bodies.position_fixes import ReceiverClock
from agent.runtime.end_signals import on_end
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import Boundary, read_boundary
from agent.runtime.files.key_file import FLEET, KeyFileError
from agent.runtime.files.key_file import read as read_keys
from agent.runtime.option_values import ANTENNA_MAX_M
from agent.runtime.peer_factory import clock_zero_at_s, keyring_of, make_peer, release
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.sqlite_journal import SqliteJournal
from crdt import FieldAllocationCRDT
from protocol.authentication import Keys
from protocol.controller_health import Health
from protocol.frames.frame import Frame
from protocol.name import fleet_name
from tools.common.bus_address import CHANNEL, AttachError
from tools.common.bus_attach import LOST_LOOK_S, lost_of, stay_attached
from tools.common.counted import counted
from tools.common.event_lines import EventLines
from tools.common.exit_codes import wrong

TICK_S = 0.005
GOODBYE_S = 0.2
SQUARE_M: float = 10_000.0  # in a hectare


class SharedBus:
    """One interface for two devices of this process: each gets all frames of the others on the bus."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self._heard: list[Callable[[Frame], None]] = []
        bus.subscribe(self._hear)

    def send(self, frame: Frame) -> bool:
        """Queue a frame; False if the bus does not take it."""
        return self.bus.send(frame)

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Call back for every received frame."""
        self._heard.append(callback)

    @property
    def health(self) -> Health:
        """The state of the CAN controller."""
        return self.bus.health

    def close(self) -> None:
        """Release the interface."""
        self.bus.close()

    def _hear(self, frame: Frame) -> None:
        for callback in self._heard:
            callback(frame)


class Service:
    """The task controller and its member of the fleet, on their buses."""

    def __init__(
        self, controller: TaskController, bus: SharedBus, runner: PeerRunner, sayer: EventLines
    ) -> None:
        self.controller, self.bus, self.runner, self.sayer = controller, bus, runner, sayer
        self._known: dict[int, str] = {}
        self._address: int | None = None
        bus.subscribe(self._hear)

    async def serve(self) -> None:
        """Until it is cancelled."""
        while True:
            now_us = PeerRunner.now_us()
            if now_us >= self.controller.due_at_us:
                self._send(self.controller.on_timer(now_us))
            self._tell()
            await asyncio.sleep(TICK_S)

    def _hear(self, frame: Frame) -> None:
        self._send(self.controller.on_frame(frame, PeerRunner.now_us()))

    def _send(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.bus.send(frame)
        calls = [Cover(*row) for row in by_row(self.controller.take_cells()).items()]
        if calls:
            self.runner.operate(*calls)

    def _tell(self) -> None:
        address = self.controller.claim.address
        if address != self._address and address is not None:
            self._address = address
            self.sayer.say("ready", f"task controller at address {address}; Ctrl-C ends it",
                           address=address)  # fmt: skip
        implements = self.controller.implements
        for source in implements.keys() - self._known.keys():
            implement = implements[source]
            name, sections = implement.pool.designator, len(implement.sections)
            self._known[source] = name
            said = (
                f"{name!r} at address {source} has logged in: {counted(sections, '{} section{s}')}"
            )
            self.sayer.say("log-in", said, address=source, name=name, sections=sections)
            if implement.refused:
                said = f"{name!r} is not switched: sections that are too wide: {implement.refused}"
                self.sayer.say("refused", said, address=source, refused=implement.refused)
        for source in self._known.keys() - implements.keys():
            name = self._known.pop(source)
            self.sayer.say(
                "lost", f"{name!r} at address {source} has gone", address=source, name=name
            )


def _identity(boundary: Boundary, slot: int, machines: int, first_boot: bool) -> Identity:
    """Of the member that shares the map of this field; equal fields make one fleet."""
    return Identity(
        slot, frozenset(range(machines)), fleet_name(f"task controllers of {boundary.name}", slot),
        FieldAllocationCRDT.hash_of(f"as applied {boundary.origin} {boundary.polygon.wkt}"),
        SilencePolicy.CONTINUE, started=True, first_boot=first_boot, release=release(),
    )  # fmt: skip


async def _serve(
    boundary: Boundary, keys: Keys | None, buses: tuple[Bus, Bus | None], machine: tuple[int, int],
    hitch_m: float, accuracy_m: float, memory: Path, sayer: EventLines,
) -> None:  # fmt: skip
    slot, machines = machine
    first_boot = not memory.exists()
    journal, recalled = SqliteJournal.opened(memory)
    if said := str(journal.narrowed):
        sayer.note(said)
    try:
        bus = SharedBus(buses[0])
        fleet_bus: Bus = bus if buses[1] is None else buses[1]
        now_us, lot = PeerRunner.now_us(), secrets.token_bytes(16)
        peer = make_peer(
            _identity(boundary, slot, machines, first_boot), Random(lot), now_us, recalled,
            keyring=keyring_of(keys, slot, lot.hex().encode(), clock_zero_at_s(now_us)),
        )  # fmt: skip
        runner = PeerRunner(peer, fleet_bus, None, journal)
        clock = ReceiverClock(round(LATENCY_MS * MS))
        fixes = BusFixes(
            in_field(boundary.origin), (0.0, 0.0), clock.sensed_at_us, clock.latency_us, accuracy_m
        )
        ground = AsAppliedMap(boundary.polygon, peer.progress)
        controller = TaskController(
            controller_name(secrets.randbits(21)), ground, fixes, hitch_m, Random(lot), now_us
        )
        running = asyncio.create_task(runner.run())
        serving = asyncio.create_task(Service(controller, bus, runner, sayer).serve())
        ending = asyncio.create_task(_told_to_end())
        losing = asyncio.create_task(_until_lost(buses))
        done, _ = await asyncio.wait(
            {running, serving, ending, losing}, return_when=asyncio.FIRST_COMPLETED
        )
        if ending in done:
            await runner.leave()
            await asyncio.sleep(GOODBYE_S)
        for task in (running, serving, ending, losing):
            task.cancel()
        failures = await asyncio.gather(running, serving, return_exceptions=True)
        for failure in failures:
            if isinstance(failure, Exception):
                raise failure
        if losing in done:
            raise AttachError(losing.result())
        area_ha = ground.area_m2() / SQUARE_M
        sayer.say("end", f"{area_ha:.2f} ha worked, by all", worked_ha=round(area_ha, 4))
    finally:
        journal.close()


async def _until_lost(buses: tuple[Bus, Bus | None]) -> str:
    """Why one of the interfaces does not come back by itself."""
    while (why := lost_of(*buses)) is None:
        await asyncio.sleep(LOST_LOOK_S)
    return why


async def _told_to_end() -> None:
    end, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end(loop, end.set)
    await end.wait()


def task_controller(
    field: Path, feature: str | None, bus: tuple[str, str, int, str, int], fleet: tuple[str, int],
    machine: tuple[int, int], hitch_m: float, accuracy_m: float, keys: Path | None, memory: Path,
    as_json: bool,
) -> int:  # fmt: skip
    """Serve until Ctrl-C. `bus`: interface, channel, bit rate, host and port of the tractor's bus.
    `fleet`: host and port of the bus on which the map is shared; port 0: the tractor's. `machine`:
    slot and number of slots. The exit code is 2 for what a person has to mend, which one
    line on stderr says (AttachError)."""

    async def serve() -> None:
        own = await stay_attached(*bus, "tc")
        other: Bus | None = None
        try:
            if fleet[1]:
                channel = bus[1] if bus[0] == "socketcand" else CHANNEL
                other = await stay_attached("socketcand", channel, bus[2], *fleet, "tc's map")
            try:
                await _serve(
                    boundary, fleet_keys, (own, other), machine, hitch_m, accuracy_m, memory,
                    EventLines(as_json),
                )  # fmt: skip
            finally:
                if other is not None:
                    other.close()
        finally:
            own.close()

    try:
        if not 0 <= machine[0] < machine[1]:
            raise AttachError(f"--slot {machine[0]} is not among {machine[1]} machines (from 0)")
        if not abs(hitch_m) <= ANTENNA_MAX_M:
            raise AttachError(
                f"--hitch {hitch_m:g}: it is {-ANTENNA_MAX_M:g} to {ANTENNA_MAX_M:g} metres"
            )
        if not 0 <= accuracy_m <= ANTENNA_MAX_M:
            raise AttachError(f"--accuracy {accuracy_m:g}: it is 0 to {ANTENNA_MAX_M:g} metres")
        boundary = read_boundary(field, feature)
        fleet_keys = None if keys is None else read_keys(keys, FLEET).keys
        memory.parent.mkdir(parents=True, exist_ok=True)
        asyncio.run(serve())
    except (AttachError, FieldFileError, KeyFileError) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"{memory}: {problem}")
    return 0
