"""The codec that a layout writes, against one that reads the same declaration bit by bit."""

import subprocess
import sys
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crdt.claim_register import Phase
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.frame import Frame
from protocol.frames.layout import ROBOT, FrameField, FrameLayout, flag, integer, octets, reserved
from protocol.frames.messages import GROUPS, Message
from protocol.frames.work_frames import PHASES

BY_NAME = pytest.mark.parametrize("layout", GROUPS, ids=lambda layout: layout.name)


def accepted(field: FrameField) -> st.SearchStrategy[int]:
    """Raw values of a field, or of one of its elements."""
    if field.accepted is not None:
        return st.sampled_from(field.accepted)
    return st.integers(0, (1 << field.bits) - 1)


def value_of(field: FrameField, raws: list[int]) -> Any:
    if field.octets:
        return bytes(raws)
    if field.repeat:
        return tuple(raws)
    (raw,) = raws
    if field.boolean:
        return bool(raw)
    if field.parts:
        return raw / field.parts
    if field.scale != 1:
        return raw * field.scale + field.offset
    return field.enumeration(raw) if field.enumeration else raw


@st.composite
def frames(draw: st.DrawFn, layout: FrameLayout[Any]) -> tuple[Message, bytes]:
    """A message and its bytes, put together here bit by bit."""
    word, values = 0, {}
    for field, start in layout.placed():
        if field.reserved is not None:
            word |= field.reserved << start
            continue
        raws = [draw(accepted(field)) for _ in range(field.repeat or 1)]
        for k, raw in enumerate(raws):
            word |= raw << start + k * field.bits
        values[field.name] = value_of(field, raws)
    return layout.kind(**values), word.to_bytes(layout.length, "little")


@BY_NAME
@given(data=st.data(), source=st.integers(0, 255))
def test_there_and_back(layout: FrameLayout[Any], data: st.DataObject, source: int) -> None:
    message, raw = data.draw(frames(layout))
    assert layout.pack(message) == raw
    back = layout.unpack(raw)
    assert back == message and type(back) is type(message)
    assert [type(value) for value in back] == [type(value) for value in message]
    assert decode(encode(message, source)) == (source, message)


@BY_NAME
@given(data=st.data())
def test_a_frame_is_read_if_all_its_values_are_accepted(
    layout: FrameLayout[Any], data: st.DataObject
) -> None:
    raw = data.draw(st.binary(min_size=layout.length, max_size=layout.length))
    word = int.from_bytes(raw, "little")
    valid = all(
        field.accepted is None or word >> start & (1 << field.bits) - 1 in field.accepted
        for field, start in layout.placed()
    )
    _, message = decode(Frame(layout.priority << 26 | layout.pgn << 8 | 0x80, raw))
    assert isinstance(message, Malformed) != valid
    if not isinstance(message, Malformed):
        assert layout.unpack(layout.pack(message)) == message


@BY_NAME
def test_a_value_that_does_not_fit_is_an_error_of_ours(layout: FrameLayout[Any]) -> None:
    """A number must not overflow into the next field."""
    from struct import error as StructError

    good = layout.unpack(bytes((GOOD.get(layout.name, 0),)) + bytes(layout.length - 1))
    for field in layout.fields:
        whole = field.scale == 1 and not field.repeat and not field.boolean
        for value in (1 << field.bits, -1) if whole and field.name else ():
            with pytest.raises((AssertionError, StructError)):
                layout.pack(good._replace(**{field.name: value}))


GOOD = {
    "OPERATOR_BADGE": 192,
    "DM22": 1,
    "FLEET_STOP": 1,
    "FLEET_RESET": 1,
    "GATEWAY_BEAT": 124,
    "SEGMENT_SUMMARY": 1,
}  # byte 0


def test_every_frame_says_what_it_is_for() -> None:
    for layout in GROUPS:
        text = layout.kind.__doc__ or ""
        sentences = " ".join(text.split()).count(". ") + 1
        assert 2 <= sentences <= 5, layout.name
        assert all(len(field.name) > 0 or field.reserved is not None for field in layout.fields)


class Odd(NamedTuple):
    late: int
    early: bool
    tail: bytes


def test_a_declaration_that_cannot_be_is_refused() -> None:
    fields = (flag("early"), reserved(2, checked=True), integer("late", 13), octets("tail", 2))
    odd = FrameLayout(Odd, "ODD", pgn=0xFF70, priority=7, sender=ROBOT, fields=fields)
    assert odd.length == 4 and odd.unpack(odd.pack(Odd(5, True, b"a"))) == (5, True, b"a\xff")
    with pytest.raises(ValueError, match="range"):
        odd.unpack(b"\x02\0\0\0")
    for wrong in (fields[:-1], (*fields, reserved(1)), (*fields, reserved(8), fields[0])):
        with pytest.raises(AssertionError):
            FrameLayout(Odd, "ODD", pgn=0xFF70, priority=7, sender=ROBOT, fields=wrong)


def test_an_early_reference_to_a_codec_stays_valid() -> None:
    """`pack` and `unpack` are compiled when they are first called."""
    fields = (integer("late", 7), flag("early"), octets("tail", 1))
    odd = FrameLayout(Odd, "ODD", pgn=0xFF70, priority=7, sender=ROBOT, fields=fields)
    pack, unpack = odd.pack, odd.unpack
    assert unpack(pack(Odd(1, False, b"x"))) == odd.unpack(odd.pack(Odd(1, False, b"x")))


def test_phases_are_those_of_the_registers() -> None:
    assert tuple((int(phase), phase.name) for phase in Phase) == PHASES


def test_the_codec_needs_no_numerics() -> None:
    """A stop button starts quickly."""
    code = "import sys, protocol.frames.codec; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
