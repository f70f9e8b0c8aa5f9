"""Messages between gateways: there and back; any bytes at all without an exception."""

from hypothesis import given
from hypothesis import strategies as st

from protocol import backbone_messages as backbone
from protocol.backbone_messages import Entry, Header, Kind, Message, Summary
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
    Kind.STOPS: st.lists(stops, max_size=64).map(tuple),
    Kind.RESETS: st.lists(resets, max_size=64).map(tuple),
    Kind.SUMMARY: summaries,
    Kind.MAP: st.lists(entries, max_size=4).map(tuple),
    Kind.WORK: st.lists(entries, max_size=backbone.ENTRIES_MAX).map(tuple),
}


@given(st.sampled_from(list(Kind)), st.data(), segment, u16, u8, u32, u32)
def test_there_and_back(
    kind: Kind, data: st.DataObject, number: int, term: int, who: int, boot: int, sequence: int
) -> None:
    header, body = Header(kind, number, term, who, boot, sequence), data.draw(bodies[kind])
    packed = backbone.pack(header, body)  # type: ignore[arg-type]
    assert backbone.unpack(packed) == Message(header, body)  # type: ignore[arg-type]


@given(st.binary(max_size=300), st.sampled_from(list(Kind)), st.booleans())
def test_any_bytes_are_a_message_or_nothing(noise: bytes, kind: Kind, headed: bool) -> None:
    head = backbone.HEADER.pack(backbone.VERSION, kind, 1, 0, 124, 0, 0) if headed else b""
    message = backbone.unpack(head + noise)
    assert message is None or isinstance(message, Message)
