"""Messages between gateways: there and back; any bytes at all without an exception."""

import tracemalloc
from random import Random
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import backbone_messages as backbone
from protocol.backbone_messages import BackboneHeader, BackboneKind, Entry, Message, Summary
from protocol.frames.segment_frames import FleetReset, FleetStop

u8, u16, u24, u32 = (st.integers(0, (1 << bits) - 1) for bits in (8, 16, 24, 32))
segment = st.integers(1, 0x7FFF)
stops = st.builds(FleetStop, segment, u8, u8, u8, u24, st.booleans())
resets = st.builds(FleetReset, segment, st.integers(0, 1), u8, u8, u8, u24)
entries = st.builds(Entry, u8, u16, u16, u16, u8, st.binary(min_size=8, max_size=8))
summaries = st.builds(
    Summary, u8, u8, u8, u16, u16, u32, u32, u32,
    st.dictionaries(u16, u32, max_size=16), st.dictionaries(u16, u16, max_size=100),
)  # fmt: skip
bodies = {
    BackboneKind.STOPS: st.lists(stops, max_size=64).map(tuple),
    BackboneKind.RESETS: st.lists(resets, max_size=64).map(tuple),
    BackboneKind.SUMMARY: summaries,
    BackboneKind.MAP: st.lists(entries, max_size=4).map(tuple),
    BackboneKind.WORK: st.lists(entries, max_size=backbone.ENTRIES_MAX).map(tuple),
}


@given(st.sampled_from(list(BackboneKind)), st.data(), segment, u16, u8, u32, u32)
def test_there_and_back(
    kind: BackboneKind,
    data: st.DataObject,
    number: int,
    term: int,
    who: int,
    boot: int,
    sequence: int,
) -> None:
    header, body = BackboneHeader(kind, number, term, who, boot, sequence), data.draw(bodies[kind])
    packed = backbone.pack(header, body)  # type: ignore[arg-type]
    assert backbone.unpack(packed) == Message(header, body)  # type: ignore[arg-type]


@given(st.binary(max_size=300), st.sampled_from(list(BackboneKind)), st.booleans())
def test_any_bytes_are_a_message_or_nothing(noise: bytes, kind: BackboneKind, headed: bool) -> None:
    head = b"\x98" + b"".join(map(msgpack.packb, (backbone.VERSION, kind, 1, 0, 124, 0, 0)))
    message = backbone.unpack(head + noise if headed else noise)
    assert message is None or isinstance(message, Message)


values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers(-(1 << 40), 1 << 40) | st.floats() | st.binary(max_size=9)
    | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=12) | st.dictionaries(st.integers(0, 99), inner, max_size=4),
    max_leaves=12,
)  # fmt: skip


@given(st.sampled_from(list(BackboneKind)), values)
def test_a_body_of_other_types_is_no_message(kind: BackboneKind, body: Any) -> None:
    message = backbone.unpack(msgpack.packb((backbone.VERSION, kind, 1, 0, 124, 0, 0, body)))
    assert message is None or backbone.pack(*message)


@pytest.mark.parametrize(
    "header",
    [
        (1, 1, 1, 0, 124, 0, 0),  # version
        (2, 6, 1, 0, 124, 0, 0),  # kind
        (2, True, 1, 0, 124, 0, 0),
        (2, 1, 0, 0, 124, 0, 0),  # segment
        (2, 1, 0x8000, 0, 124, 0, 0),
        (2, 1, 1, 1 << 16, 124, 0, 0),
        (2, 1, 1, 0, -1, 0, 0),
        (2, 1, 1, 0, 124.0, 0, 0),
        (2, 1, 1, 0, 124, "0", 0),
    ],
)
def test_a_wrong_header_is_no_message(header: tuple[Any, ...]) -> None:
    assert backbone.unpack(msgpack.packb((*header, []))) is None
    assert backbone.unpack(msgpack.packb((2, 1, 1, 0, 124, 0, 0, []))) is not None


def test_what_follows_or_lacks_makes_it_no_message() -> None:
    whole = backbone.pack(
        BackboneHeader(BackboneKind.STOPS, 1, 0, 124, 0, 0), (FleetStop(1, 2, 3, 4),)
    )
    assert backbone.unpack(whole) is not None
    assert backbone.unpack(whole + b"\0") is None
    assert all(backbone.unpack(whole[:n]) is None for n in range(len(whole)))
    assert backbone.unpack(whole + bytes(backbone.MESSAGE_MAX)) is None


def test_a_number_that_does_not_fit_is_not_sent() -> None:
    with pytest.raises(ValueError, match="range"):
        backbone.pack(BackboneHeader(BackboneKind.STOPS, 1, 1 << 16, 124, 0, 0), ())


@pytest.mark.slow
def test_hostile_bytes_neither_raise_nor_fill_memory() -> None:
    """100,000 mutations of valid messages, and headers that announce far more than follows."""
    rng = Random(11)
    header = BackboneHeader(BackboneKind.STOPS, 1, 2, 124, 3, 4)
    summary = Summary(1, 2, 3, 4, 5, 6, 7, 8, {2: 9}, {3: 1, 4: 2})
    entry = Entry(1, 2, 3, 4, 5, b"12345678")
    seeds = [
        backbone.pack(header, (FleetStop(1, 2, 3, 4), FleetStop(1, 2, 3, 5))),
        backbone.pack(header._replace(kind=BackboneKind.RESETS), (FleetReset(1, 0, 2, 3, 4, 5),)),
        backbone.pack(header._replace(kind=BackboneKind.SUMMARY), summary),
        backbone.pack(header._replace(kind=BackboneKind.WORK), (entry, entry)),
    ]
    huge = (b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xdc\xff\xff",
            b"\xc9\xff\xff\xff\xff\0", b"\x9a" * 3000, b"\x8f" * 3000)  # fmt: skip
    tracemalloc.start()
    read = 0
    for n in range(100_000):
        data = bytearray(seeds[n % len(seeds)])
        for _ in range(rng.randrange(1, 4)):
            at = rng.randrange(len(data))
            match rng.randrange(4):
                case 0:
                    data[at] = rng.randrange(256)
                case 1:
                    del data[at]
                case 2:
                    data[at:at] = rng.randbytes(rng.randrange(1, 4))
                case 3 if n % 50 == 0:
                    data[at:at] = rng.choice(huge)
            if not data:
                break
        message = backbone.unpack(bytes(data))
        read += message is not None
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0 < read < 100_000
    assert peak < 4 << 20
