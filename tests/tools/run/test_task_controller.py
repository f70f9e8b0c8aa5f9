"""`headland tc` as a process, and an implement with a stack that nobody here wrote: can-j1939."""

import asyncio
import json
import signal
from asyncio.subprocess import Process
from pathlib import Path
from random import Random
from typing import Any, Final

import pytest

from protocol.links.socketcand_link import SocketcandLink
from sim.rigs.implements_rig import CONDENSED_MAKER, SPRAYER, Sprayer
from tests.tools.launching import WAIT_S, call, start

TC_STATUS: Final = 0xFE
j1939 = pytest.importorskip("j1939", reason="can-j1939 is not installed")

FIELD = {
    "type": "Feature", "properties": {"name": "north"},
    "geometry": {"type": "Polygon", "coordinates": [
        [[8.0, 50.0], [8.002, 50.0], [8.002, 50.001], [8.0, 50.001], [8.0, 50.0]]]},
}  # fmt: skip


class Implement:
    """A sprayer on can-j1939: claims, working set, and the transport protocol are that stack's."""

    def __init__(self) -> None:
        self.sprayer = Sprayer(CONDENSED_MAKER._replace(sections=12), 9)
        self.ecu = j1939.ElectronicControlUnit()
        name = j1939.Name(value=int.from_bytes(self.sprayer.name, "little"))
        self.unit = j1939.ControllerApplication(name, SPRAYER)
        self.server = 0
        self.phase, self.told = "wait", list[bytes]()

    def start(self, port: int) -> None:
        self.ecu.connect(interface="socketcand", host="127.0.0.1", port=port, channel="can0",
                         tcp_tune=True)  # fmt: skip
        self.ecu.add_ca(controller_application=self.unit)
        self.unit.subscribe(self._heard)
        self.unit.start()

    def stop(self) -> None:
        self.unit.stop()
        self.ecu.stop()
        self.ecu.disconnect()

    def _say(self, data: bytes) -> None:
        self.unit.send_pgn(0, 0xCB, self.server, 3, list(data.ljust(8, b"\xff")))

    def _heard(self, priority: int, pgn: int, source: int, timestamp: float, body: Any) -> None:
        data = bytes(body)
        if pgn & 0x3FF00 != 0xCB00 or self.unit.state != j1939.ControllerApplication.State.NORMAL:
            return
        self.told.append(data)
        if data[0] == 0xFE:
            self.server = source
            self._say(bytes.fromhex("FFFFFFFF01000000"))
            if self.phase == "wait":
                self.phase = "version"
                self.unit.send_pgn(0, 0xFE, 0x0D, 7, [1] + [255] * 7)
                self._say(b"\x00")
        elif data[0] == 0x10 and self.phase == "version":
            self.phase = "space"
            self._say(b"\x41" + len(self.sprayer.pool()).to_bytes(4, "little"))
        elif data[0] == 0x51 and data[1] == 0 and self.phase == "space":
            self.phase = "pool"
            self._say(b"\x61" + self.sprayer.pool())
        elif data[0] == 0x71 and data[1] == 0 and self.phase == "pool":
            self.phase = "activate"
            self._say(b"\x81\xff")
        elif data[0] == 0x91 and data[1] == 0:
            self.phase = "in"


async def _line(process: Process) -> dict[str, Any]:
    assert process.stdout is not None
    async with asyncio.timeout(WAIT_S):
        found: dict[str, Any] = json.loads(await process.stdout.readline())
    return found


@pytest.mark.slow
def test_an_implement_of_another_stack_logs_in(tmp_path: Path) -> None:
    (tmp_path / "north.geojson").write_text(json.dumps(FIELD))

    async def story() -> None:
        hub = await start(tmp_path, "hub", "--port", "0", "--json")
        implement, controller = Implement(), None
        try:
            port = (await _line(hub))["port"]
            controller = await start(tmp_path, "tc", "north.geojson", "--port", str(port), "--json")
            assert await _line(controller) == {"event": "ready", "address": 247}
            await asyncio.to_thread(implement.start, port)
            said = await _line(controller)
            assert said == {"event": "log-in", "address": SPRAYER, "name": "SPR", "sections": 12}
            assert implement.phase == "in"
            controller.send_signal(signal.SIGINT)
            assert await _line(controller) == {"event": "end", "worked_ha": 0.0}
            assert await controller.wait() == 0
        finally:
            await asyncio.to_thread(implement.stop)
            for process in (controller, hub):
                if process is not None and process.returncode is None:
                    process.kill()
                    await process.wait()

    asyncio.run(story())


@pytest.mark.slow
def test_it_is_attached_again_when_its_bus_comes_back(tmp_path: Path) -> None:
    """It was deaf for good, and shared no map, until a person started it again."""
    (tmp_path / "north.geojson").write_text(json.dumps(FIELD))

    async def story() -> None:
        hub, controller = await start(tmp_path, "hub", "--port", "0", "--json"), None
        try:
            port = str((await _line(hub))["port"])
            controller = await start(tmp_path, "tc", "north.geojson", "--port", port, "--json")
            assert await _line(controller) == {"event": "ready", "address": 247}
            hub.kill()
            await hub.wait()
            hub = await start(tmp_path, "hub", "--port", port, "--json")
            await _line(hub)
            link, heard = SocketcandLink("127.0.0.1", int(port), "can0", Random(1)), asyncio.Event()
            link.subscribe(lambda frame: heard.set() if frame.data[0] == TC_STATUS else None)
            async with asyncio.timeout(WAIT_S):
                await heard.wait()
            link.close()
        finally:
            for process in (controller, hub):
                if process is not None and process.returncode is None:
                    process.kill()
                    await process.wait()

    asyncio.run(story())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("absent.geojson",), "absent.geojson"),
        (("north.geojson", "--slot", "2"), "--slot 2 is not among 1 machines"),
        (("north.geojson", "--port", "1"), "cannot open socketcand at 127.0.0.1:1"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, words: tuple[str, ...], says: str) -> None:
    (tmp_path / "north.geojson").write_text(json.dumps(FIELD))
    code, out = asyncio.run(call(tmp_path, "tc", *words))
    assert code == 2 and says in out and len(out.splitlines()) == 1, out
