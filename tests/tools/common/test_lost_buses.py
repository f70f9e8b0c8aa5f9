"""Programs that run until they are ended, and whose interface is gone for good."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol.controller_health import Health
from protocol.frames.frame import Frame
from tools.cli import bridge
from tools.common import bus_attach
from tools.inspect.inspection import inspect
from tools.livemap import command as livemap

WHY = "the interface is gone: no such device"
GIVEN_UP_S = 5.0  # then a program goes on


class GoneBus:
    """An adapter that was unplugged."""

    health, lost, sent, connections = Health.ACTIVE, WHY, None, 1

    def send(self, frame: Frame) -> bool:
        return False

    def subscribe(self, hear: object) -> None:
        """Nothing comes."""

    def close(self) -> None:
        """Nothing is held."""


def bridged(tmp_path: Path) -> int:
    pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")
    return bridge.bridge(
        1, "socketcan", "can0", 250_000, "", 0, "fleet", [], ["tcp/127.0.0.1:0"], "peer", None, None,
        GIVEN_UP_S, True,
    )  # fmt: skip


def as_vehicles(tmp_path: Path) -> int:
    pytest.importorskip("aiomqtt", reason="the extra `vda5050` is not installed")
    from tools.vda5050.command import serve

    return serve(
        "mqtt://127.0.0.1:1", "warehouse", tmp_path / "book.jsonl", ("socketcan", "can0", 250_000, "", 0),
        None, "uagv", "Headland", "2.0.0", GIVEN_UP_S,
    )  # fmt: skip


def mapped(tmp_path: Path) -> int:
    return livemap.show_map(None, "socketcan", "can0", 250_000, "", 0, None, None, 0, True)


def watched(tmp_path: Path) -> int:
    return inspect(
        None, "socketcan", "can0", 250_000, "", 0, GIVEN_UP_S, False, None, True, watch=True
    )


@pytest.mark.parametrize("program", [bridged, as_vehicles, mapped, watched])
def test_a_program_whose_interface_is_gone_ends_and_says_why(
    program: Callable[[Path], int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Each went on, deaf, and said nothing: a gateway that carried no stop, and a map whose STOP reached
    nobody when the adapter was back."""
    monkeypatch.setattr(bus_attach, "CanBus", GoneBus)

    async def served(*given: object) -> None:
        await asyncio.wait_for(asyncio.Event().wait(), GIVEN_UP_S)

    def attached(*where: object) -> GoneBus:
        return GoneBus()

    for module in (bus_attach, bridge):
        monkeypatch.setattr(module, "attach", attached)
    monkeypatch.setattr(livemap, "serve", served)
    assert program(tmp_path) == 2
    assert capfd.readouterr().err.endswith(f"headland: {WHY}\n")


def test_what_is_done_is_not_lost_with_its_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_attach, "CanBus", GoneBus)

    async def work() -> int:
        return 5

    assert asyncio.run(bus_attach.while_attached(work(), GoneBus())) == 5
