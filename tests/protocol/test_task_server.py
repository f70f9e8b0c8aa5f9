"""Sessions of implements with our task controller, byte by byte as ISO 11783-10 has them."""

from random import Random
from struct import pack

import pytest

from protocol.device_description import TYPE_SECTION, WIDTH, DeviceDescription
from protocol.device_pool import SECTION_WIDTH_MAX_MM, read_pool
from protocol.name import DeviceFields, fleet_name
from protocol.task_server import (
    CLIENTS_MAX,
    ROBOTS_MAX,
    STORED_MAX,
    ClientActivated,
    ClientLost,
    ServerMessage,
    ServerOutput,
    TaskServer,
    ValueTold,
)
from protocol.units import S
from sim.rigs.implements_rig import CONDENSED_MAKER, PLAIN_MAKER, Maker, Sprayer

SOURCE, NAME = 160, 4711
TASK = bytes.fromhex("FFFFFFFF01000000")


def said(outputs: list[ServerOutput]) -> list[bytes]:
    return [each.data for each in outputs if isinstance(each, ServerMessage)]


def tell(server: TaskServer, data: bytes, now_us: int = 0) -> list[ServerOutput]:
    return server.on_message(SOURCE, NAME, data.ljust(8, b"\xff"), now_us)


def logged_in(maker: Maker, server: TaskServer | None = None) -> tuple[TaskServer, bytes]:
    server, pool = server or TaskServer(0), Sprayer(maker, 1).pool()
    assert said(tell(server, TASK)) == []
    assert [data[0] for data in said(tell(server, b"\x00"))] == [0x10, 0x00]
    tell(server, bytes((0x10, maker.version, 0xFF, 0x11, 0, 1, maker.sections, 1)))
    assert said(tell(server, b"\x01")) == [b"\x11" + b"\xff" * 7]
    assert said(tell(server, b"\x21")) == [b"\x31" + b"\xff" * 7]
    assert said(tell(server, b"\x41" + len(pool).to_bytes(4, "little")))[0][:2] == b"\x51\x00"
    assert said(tell(server, b"\x61" + pool))[0][:2] == b"\x71\x00"
    outputs = tell(server, b"\x81\xff")
    assert said(outputs)[0][:2] == b"\x91\x00" and ClientActivated(SOURCE) in outputs
    return server, pool


@pytest.mark.parametrize("maker", [CONDENSED_MAKER, PLAIN_MAKER])
def test_an_implement_logs_in_and_its_description_is_known_again(maker: Maker) -> None:
    server, pool = logged_in(maker)
    found = read_pool(pool, maker.version)
    assert found is not None and found.designator == "SPR"
    assert server.clients[SOURCE].version == maker.version
    assert tell(server, b"\x81\x00")[-1] == ClientLost(SOURCE), "it may deactivate it"
    assert server.forget(SOURCE) == [ClientLost(SOURCE)]
    tell(server, TASK)
    assert said(tell(server, b"\x01"))[0][1:] == found.label, "the description is kept"
    assert ClientActivated(SOURCE) in tell(server, b"\x81\xff")
    assert said(tell(server, b"\xa1"))[0][:2] == b"\xb1\x00"
    assert said(tell(server, b"\x01")) == [b"\x11" + b"\xff" * 7]


def test_places_of_sections_come_from_the_description_or_from_values() -> None:
    fixed = read_pool(Sprayer(CONDENSED_MAKER, 1).pool(), 4)
    assert fixed is not None
    sections = fixed.sections({})
    assert len(sections) == 24 and sections[0][1:] == (-4000, -5750, 500)
    told = read_pool(Sprayer(PLAIN_MAKER, 1).pool(), 3)
    assert told is not None and told.sections({}) == []
    values = {(10, 134): -2500, (10, 135): -5625, (10, 67): 750}
    assert told.sections(values)[0][1:] == (-4000, -5625, 750)


def test_an_implement_that_tells_a_section_of_kilometres_has_none() -> None:
    """Each 5 cm under a section takes memory: `headland tc` ended with a MemoryError."""
    pool = read_pool(Sprayer(PLAIN_MAKER, 1).pool(), 3)
    assert pool is not None
    numbers = sorted(n for n, e in pool.elements.items() if e.kind == TYPE_SECTION)
    usual = dict.fromkeys(((n, WIDTH) for n in numbers), 750)
    assert len(pool.sections(usual)) == len(numbers) and pool.refused_sections(usual) == 0
    wide = usual | {(numbers[1], WIDTH): 1_500_000}
    assert len(pool.sections(wide)) == 0 and pool.refused_sections(wide) == len(numbers)
    wide = usual | {(numbers[1], WIDTH): SECTION_WIDTH_MAX_MM + 1}
    assert len(pool.sections(wide)) == 0 and pool.refused_sections(wide) == 1
    all_wide = dict.fromkeys(usual, SECTION_WIDTH_MAX_MM)
    assert len(pool.sections(all_wide)) == 0 and pool.refused_sections(all_wide) == len(numbers)


def test_values_are_set_only_where_the_description_allows_it() -> None:
    server, _ = logged_in(CONDENSED_MAKER)
    client = server.clients[SOURCE]
    assert said(server.set_value(client, (2, 290), -3)) == [bytes.fromhex("2A002201FDFFFFFF")]
    assert server.set_value(client, (2, 161), 1) == []
    plain, _ = logged_in(PLAIN_MAKER)
    client = plain.clients[SOURCE]
    assert said(plain.set_value(client, (12, 289), 1)) == [bytes.fromhex("C300210101000000")]
    assert said(plain.measure(client, (12, 141), 1000)) == [
        bytes.fromhex("C4008D00E8030000"), bytes.fromhex("C8008D0001000000"),
    ]  # fmt: skip
    told = plain.on_message(SOURCE, NAME, bytes.fromhex("C3008D0001000000"), 0)
    assert told == [ValueTold(SOURCE, (12, 141), 1)]


def test_an_implement_that_has_begun_anew_is_told_everything_again() -> None:
    """It was off for less than 6 s: its sections stayed manual, and what they did was not told."""
    server, _ = logged_in(CONDENSED_MAKER)
    tell(server, b"\x00", S)
    outputs = tell(server, b"\x81\xff", S)
    assert said(outputs)[0][:2] == b"\x91\x00"
    assert outputs[1:] == [ClientLost(SOURCE), ClientActivated(SOURCE)]


@pytest.mark.parametrize("taken", [True, False])
def test_an_implement_that_has_moved_to_another_address_goes_on(taken: bool) -> None:
    """It was served by none, as it did not log in again. `taken`: another device has its address."""
    server, _ = logged_in(CONDENSED_MAKER)
    if taken:
        assert server.forget(SOURCE) == [ClientLost(SOURCE)]
    outputs = server.on_message(SOURCE + 1, NAME, TASK, S)
    assert outputs == [ClientLost(SOURCE)] * (not taken) + [ClientActivated(SOURCE + 1)]
    assert list(server.clients) == [SOURCE + 1] and server.clients[SOURCE + 1].active
    assert server.on_message(SOURCE + 1, NAME, TASK, 2 * S) == []


def test_an_implement_that_comes_back_later_logs_in() -> None:
    server, _ = logged_in(CONDENSED_MAKER)
    assert ClientLost(SOURCE) in server.on_timer(6 * S)
    assert tell(server, TASK, 7 * S) == [] and not server.clients[SOURCE].active


def test_its_status_each_two_seconds_and_a_silent_client_is_forgotten() -> None:
    server, _ = logged_in(CONDENSED_MAKER)
    statuses = 0
    for second in range(6):
        assert SOURCE in server.clients
        statuses += sum(data[0] == 0xFE for data in said(server.on_timer(second * S)))
    assert statuses == 3
    assert ClientLost(SOURCE) in server.on_timer(6 * S) and not server.clients


@pytest.mark.sampled(1)
@pytest.mark.parametrize("maker", [CONDENSED_MAKER, PLAIN_MAKER])
def test_no_part_of_a_description_is_believed(maker: Maker) -> None:
    pool, rng = Sprayer(maker, 1).pool(), Random(3)
    for length in range(0, len(pool), 7):
        read_pool(pool[:length], maker.version)
    for _ in range(2000):
        changed = bytearray(pool)
        for _ in range(3):
            changed[rng.randrange(len(pool))] = rng.randrange(256)
        found = read_pool(bytes(changed), maker.version)
        if found is not None:
            found.sections({})
    server = TaskServer(0)
    tell(server, TASK)
    assert said(tell(server, b"\x61" + pool[:100]))[0][:2] == b"\x71\x01"
    assert said(tell(server, b"\x81\xff"))[0][1] == 1, "nothing can be activated"


@pytest.mark.parametrize("size", [7, 8, 100, 250])
@pytest.mark.parametrize("maker", [CONDENSED_MAKER, PLAIN_MAKER])
def test_a_description_may_come_in_parts(maker: Maker, size: int) -> None:
    """Each part but a whole description was refused, and such an implement never logged in."""
    server, pool = logged_in(maker)
    whole = server.clients[SOURCE].pool
    assert said(tell(server, b"\xa1"))[0][:2] == b"\xb1\x00"
    assert said(tell(server, b"\x41" + len(pool).to_bytes(4, "little")))[0][:2] == b"\x51\x00"
    parts = [pool[at : at + size] for at in range(0, len(pool), size)]
    for number, part in enumerate(parts):
        assert said(tell(server, b"\x61" + part))[0][:2] == b"\x71\x00"
        if read_pool(pool[: size * (number + 1)], maker.version) is None:
            assert said(tell(server, b"\x81\xff"))[0][1] == 1, "it is not whole yet"
    assert server.clients[SOURCE].pool == whole
    assert ClientActivated(SOURCE) in tell(server, b"\x81\xff")
    assert said(tell(server, b"\x61" + pool))[0][:2] == b"\x71\x00", "a new one is no further part"
    assert server.clients[SOURCE].pool == whole
    assert len(server.clients[SOURCE].upload.received) == len(pool)


def test_a_description_that_is_shorter_than_announced_is_used() -> None:
    server, pool = logged_in(CONDENSED_MAKER)
    whole = server.clients[SOURCE].pool
    tell(server, b"\xa1")
    tell(server, b"\x41" + (len(pool) + 50).to_bytes(4, "little"))
    assert said(tell(server, b"\x61" + pool))[0][:2] == b"\x71\x00"
    assert server.clients[SOURCE].pool == whole
    assert ClientActivated(SOURCE) in tell(server, b"\x81\xff")


def test_parts_that_make_no_description_are_refused_at_the_last_one() -> None:
    server, pool = logged_in(CONDENSED_MAKER)
    tell(server, b"\x41" + (300).to_bytes(4, "little"))
    assert said(tell(server, b"\x61" + bytes(200)))[0][:2] == b"\x71\x00"
    assert said(tell(server, b"\x61" + bytes(200)))[0][:2] == b"\x71\x01"
    tell(server, b"\x41" + len(pool).to_bytes(4, "little"))
    tell(server, b"\x61" + pool[:100])
    tell(server, b"\x41" + len(pool).to_bytes(4, "little"))
    assert said(tell(server, b"\x61" + pool))[0][:2] == b"\x71\x00", "it began again"
    assert ClientActivated(SOURCE) in tell(server, b"\x81\xff")
    tell(server, b"\x41" + len(pool).to_bytes(4, "little"))
    tell(server, b"\x61" + pool[:100])
    tell(server, b"\xa1")
    assert said(tell(server, b"\x61" + pool[100:]))[0][:2] == b"\x71\x01", "the rest of none"


def test_any_bytes_raise_nothing() -> None:
    server, _ = logged_in(CONDENSED_MAKER)
    rng = Random(4)
    for step in range(20_000):
        source = rng.choice((SOURCE, rng.randrange(254)))
        server.on_message(source, rng.choice((NAME, None, source)), rng.randbytes(8), step * 1000)
        if step % 100 == 0:
            server.on_timer(step * 1000)
    assert len(server.clients) <= CLIENTS_MAX


@pytest.mark.parametrize("manufacturer", [1407, 555])
def test_robots_that_log_in_take_no_place_of_an_implement(manufacturer: int) -> None:
    """Sixteen robots on the bus kept every implement out for good, and nothing was said."""
    server = TaskServer(0)
    for slot in range(40):
        name = fleet_name("north", slot, DeviceFields(manufacturer))
        description = DeviceDescription(name, f"robot {slot}", "1", 3000)
        for data in (TASK, b"\x61" + description.pool(4), b"\x81".ljust(8, b"\xff")):
            server.on_message(1 + slot, name.pack(), data, 0)
    assert len(server.clients) == 40
    logged_in(CONDENSED_MAKER, server)
    assert server.clients[SOURCE].active and not server.clients[SOURCE].robot


def test_devices_are_refused_when_there_is_no_place_for_them() -> None:
    server = TaskServer(0)
    for number in range(2 * CLIENTS_MAX):
        server.on_message(1 + number, number, TASK, 0)
    assert len(server.clients) == CLIENTS_MAX
    for number in range(200):
        name = fleet_name(str(number), number % 128).pack()
        server.on_message(40 + number, name, TASK, 0)
    assert len(server.clients) == CLIENTS_MAX + ROBOTS_MAX


def test_values_that_are_not_described_are_told_and_not_kept() -> None:
    server, _ = logged_in(CONDENSED_MAKER)
    client = server.clients[SOURCE]
    assert client.pool is not None
    key = next(iter(client.pool.properties))
    for element, ddi in [key, *((4000, ddi) for ddi in range(2000))]:
        data = pack("<BBHi", 0x3 | (element & 0xF) << 4, element >> 4, ddi, 5)
        assert tell(server, data) == [ValueTold(SOURCE, (element, ddi), 5)]
    assert client.values == {key: 5}
    assert server.counts["value that is not described"] == 2000


def test_descriptions_of_few_devices_are_kept() -> None:
    server, pool = TaskServer(0), Sprayer(CONDENSED_MAKER, 1).pool()
    for name in range(3 * STORED_MAX):
        server.on_message(SOURCE, name, TASK, 0)
        server.on_message(SOURCE, name, b"\x61" + pool, 0)
    assert list(server.stored) == list(range(2 * STORED_MAX, 3 * STORED_MAX))
