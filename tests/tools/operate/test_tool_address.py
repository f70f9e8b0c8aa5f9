"""Operator tools as devices of ISO 11783-5: they claim before they speak (item 6, finding A3)."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from protocol.address import FIRST, LAST
from protocol.frames.codec import decode, encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.network_frames import (
    Acknowledgment,
    AcknowledgmentControl,
    AddressClaimed,
    Request,
)
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Command,
    EmergencyStop,
    OperatorCommand,
    Reason,
    Switch,
)
from protocol.links.bus import CanBus
from protocol.name import AGRICULTURE, MANUFACTURER, TOOL_FUNCTION, Name, fleet_name, tool_name
from sim.can.simulated_bus import FieldBus, Segment, forget, segment
from sim.can.socketcand_server import Hub
from sim.fleet.virtual_clock import elapse, run_virtual
from tests.tools.launching import call
from tools.livemap.stop_panel import Panel, PanelError
from tools.operate.estop import press
from tools.operate.operator_device import Operator
from tools.operate.pgn_client import PgnClient
from tools.operate.tool_address import CLAIM_PGN, CROWDED_OUT, PREFERRED, DeviceAddress

HOLDERS = {
    "a lower NAME": Name(5, manufacturer=100, function=129, device_class=0, industry_group=0),
    "a higher NAME": Name(5, manufacturer=100, device_class=127, device_class_instance=15),
}


class Heard:
    """All frames of a segment, in order, with their messages."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self.segment: Segment = segment(channel)
        self.frames: list[Frame] = []
        self.segment.taps.append(lambda t_us, frame: self.frames.append(frame))
        self.crowded = False

    def operator(self) -> Operator:
        bus, loop = CanBus(FieldBus(self.channel)), asyncio.get_running_loop()
        operator = Operator(bus, None)
        bus.subscribe(lambda frame: operator.hear(loop.time(), frame))
        return operator

    def holder(self, name: Name) -> None:
        """A device that holds 249, says so when it is asked, and never moves."""
        bus, loop = CanBus(FieldBus(self.channel)), asyncio.get_running_loop()
        claimed = encode(AddressClaimed(name.pack()), PREFERRED)

        def hear(frame: Frame) -> None:
            _, message = decode(frame)
            if isinstance(message, Request) and message.pgn == CLAIM_PGN:
                loop.call_later(0.153, bus.send, claimed)

        bus.subscribe(hear)
        bus.send(claimed)

    def crowd(self) -> None:
        """A device that holds every address while `crowded`, and says so when it is asked."""
        self.crowded = True
        bus = CanBus(FieldBus(self.channel))

        def hear(frame: Frame) -> None:
            _, message = decode(frame)
            if self.crowded and isinstance(message, Request) and message.pgn == CLAIM_PGN:
                for address in (*range(FIRST, LAST + 1), PREFERRED):
                    bus.send(encode(AddressClaimed(0), address))

        bus.subscribe(hear)

    def of(self, kind: type) -> list[tuple[int, Any]]:
        return [(s, m) for s, m in map(decode, self.frames) if isinstance(m, kind)]


def on_a_wire(story: Callable[[Heard], object], name: str) -> None:
    async def main() -> None:
        heard = Heard(f"device address {name}")
        try:
            result = story(heard)
            if asyncio.iscoroutine(result):
                await result
        finally:
            forget(heard.channel)

    run_virtual(main())


def test_a3_the_name_of_a_tool_is_ours_and_loses_against_every_robot() -> None:
    name = tool_name(0)
    assert (name.manufacturer, name.industry_group) == (MANUFACTURER, AGRICULTURE)
    assert name.function == TOOL_FUNCTION and name.arbitrary_address == 1
    assert name.pack() > max(fleet_name("fleet", slot).pack() for slot in range(108))


def test_a3_a_tool_claims_249_before_it_says_anything_else() -> None:
    async def story(heard: Heard) -> None:
        operator = heard.operator()
        operator.ask_work()
        operator.command(Command.START)
        assert await operator.device.held()
        await elapse(0.1)
        sources = [(source, type(message)) for source, message in map(decode, heard.frames)]
        assert sources[:2] == [(NULL_ADDRESS, Request), (PREFERRED, AddressClaimed)]
        assert len(sources) == 4 and {source for source, _ in sources[2:]} == {PREFERRED}

    on_a_wire(story, "first")


def test_a3_two_tools_at_once_have_two_addresses() -> None:
    async def story(heard: Heard) -> None:
        tools = [heard.operator() for _ in range(3)]
        await elapse(2.0)
        addresses = [tool.device.address for tool in tools]
        assert set(addresses) == {PREFERRED, LAST, LAST - 1}
        late = heard.operator()
        assert await late.device.held()
        assert late.device.address == LAST - 2, "who comes later disturbs nobody"
        assert [tool.device.address for tool in tools] == addresses

    on_a_wire(story, "two")


@pytest.mark.parametrize("name", HOLDERS.values(), ids=HOLDERS)
def test_a3_a_device_that_holds_249_keeps_it(name: Name) -> None:
    async def story(heard: Heard) -> None:
        heard.holder(name)
        await elapse(1.0)
        operator = heard.operator()
        await press(operator, Reason.OPERATOR_INTERVENTION, 1.0)
        operator.command(Command.WAIT)
        letters = PgnClient(operator.bus, operator.device)
        await letters.ask(65242, 130, 0.3)
        spoken = {type(m) for s, m in map(decode, heard.frames) if s == PREFERRED}
        assert spoken == {AddressClaimed}, "the holder's own claims"
        assert operator.device.address == LAST

    on_a_wire(story, f"held {name.industry_group}")


def test_a3_a_stop_is_said_at_once_and_as_the_standard_frame_again_once_claimed() -> None:
    async def story(heard: Heard) -> None:
        begun_s = asyncio.get_running_loop().time()
        first_s: list[float] = []

        def tap(t_us: int, frame: Frame) -> None:
            if isinstance(decode(frame)[1], EmergencyStop | AllImplementsStop):
                first_s.append(t_us / 1e6 - begun_s)

        heard.segment.taps.append(tap)
        operator = heard.operator()
        await press(operator, Reason.OPERATOR_INTERVENTION, 1.0)
        assert first_s[0] < 0.005 and first_s[1] < 0.005, "both frames, before any claim"
        standard = [s for s, m in heard.of(AllImplementsStop) if m[1] == Switch.STOP]
        assert standard[0] == NULL_ADDRESS and PREFERRED in standard
        stops = [source for source, _ in heard.of(EmergencyStop)]
        assert stops[0] == NULL_ADDRESS and PREFERRED in stops
        after = stops[stops.index(PREFERRED) :]
        assert set(after) == {PREFERRED}, "from the address as soon as it is ours"

    on_a_wire(story, "stop")


def test_a3_a_tool_without_a_loop_claims_by_what_it_hears() -> None:
    sent: list[Frame] = []

    class Wire:
        def send(self, frame: Frame) -> bool:
            sent.append(frame)
            return True

    device = DeviceAddress(Wire())
    device.send(Request(0xFF14))
    for tick in range(10):
        device.hear(tick * 0.05, encode(Request(0xFF14), 128))
    assert device.address == PREFERRED
    assert [decode(frame)[0] for frame in sent] == [NULL_ADDRESS, NULL_ADDRESS, PREFERRED]


def test_a_tool_refuses_a_group_that_it_alone_is_asked_for() -> None:
    """ISO 11783-3: a device that gets no answer to a request of one device asks again and again."""

    async def story(heard: Heard) -> None:
        operator = heard.operator()
        assert await operator.device.held()
        asker = CanBus(FieldBus(heard.channel))
        for destination in (PREFERRED, GLOBAL_ADDRESS, LAST):
            asker.send(encode(Request(0xFEDA), 38, destination))
        asker.send(encode(Request(0xFEDA), NULL_ADDRESS, PREFERRED))
        asker.send(encode(Request(CLAIM_PGN), 38, PREFERRED))
        await elapse(1.0)
        refusal = Acknowledgment(AcknowledgmentControl.NACK, 0xFF, 38, 0xFEDA)
        assert heard.of(Acknowledgment) == [(PREFERRED, refusal)]
        assert len(heard.of(AddressClaimed)) == 2

    on_a_wire(story, "asked")


def test_a_tool_without_an_address_tries_again_and_sends_nothing_old() -> None:
    """The page of a map stayed without an address until it was restarted."""

    async def story(heard: Heard) -> None:
        heard.crowd()
        operator = heard.operator()
        operator.command(Command.START)
        await elapse(1.0)
        assert operator.device.crowded_out
        operator.command(Command.START)
        await elapse(10.0)
        assert operator.device.crowded_out, "said all the time, also while it tries again"
        heard.crowded = False
        await elapse(6.0)
        assert operator.device.address == PREFERRED and not operator.device.crowded_out
        assert not heard.of(OperatorCommand), "a start of a quarter of a minute ago moves no robot"
        operator.command(Command.START)
        await elapse(0.1)
        assert len(heard.of(OperatorCommand)) == 1

    on_a_wire(story, "again")


COMMANDS = {
    "estop": ("estop", "--timeout", "0.6"),
    "reset": ("reset", "--timeout", "0.6"),
    "order": ("order", "0", "wait", "--timeout", "0.5"),
    "inspect": ("inspect", "--plain", "--seconds", "0.6"),
    "task": ("task", "add", "9.5,2.5", "1.5,8.5"),
    "say": ("say", "where is robot 0"),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a3_every_command_speaks_from_an_address_that_it_claimed(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    async def main() -> list[Frame]:
        heard = Heard(f"command {words[0]}")
        hub = Hub(heard.segment)
        await hub.start()
        try:
            code, out = await call(tmp_path, *words, "--port", str(hub.port))
            print(code, out)
            return heard.frames
        finally:
            await hub.stop()
            forget(heard.channel)

    claimed: dict[int, Name] = {}
    for frame in asyncio.run(main()):
        source, message = decode(frame)
        if isinstance(message, AddressClaimed):
            claimed[source] = Name.unpack(message.name)
        elif source == NULL_ADDRESS:
            assert isinstance(message, Request | EmergencyStop | AllImplementsStop)
        else:
            assert claimed[source].function == TOOL_FUNCTION
    assert list(claimed) == [PREFERRED], words


@pytest.mark.sampled(1)
@pytest.mark.parametrize("words", [COMMANDS[name] for name in ("reset", "order", "task")])
def test_t2_a_command_without_an_address_says_so(words: tuple[str, ...], tmp_path: Path) -> None:
    """A release said that stops were cleared, though nothing of it had left."""

    async def main() -> tuple[int, str]:
        heard = Heard(f"crowd {words[0]}")
        hub = Hub(heard.segment)
        await hub.start()
        heard.crowd()
        try:
            return await call(tmp_path, *words, "--port", str(hub.port))
        finally:
            await hub.stop()
            forget(heard.channel)

    code, out = asyncio.run(main())
    assert code == 2 and CROWDED_OUT in out


def test_t2_the_page_says_that_there_is_no_address(tmp_path: Path) -> None:
    async def story(heard: Heard) -> None:
        heard.crowd()
        bus, loop = CanBus(FieldBus(heard.channel)), asyncio.get_running_loop()
        panel = Panel(bus, None)
        bus.subscribe(lambda frame: panel.hear(loop.time(), frame))
        with pytest.raises(PanelError, match="every address"):
            await panel.release(keyless=True, reset=True, start=True)

    on_a_wire(story, "page")
