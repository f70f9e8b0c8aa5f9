"""11-bit and remote frames: their place in arbitration, their length, and who gets them."""

from random import Random

import pytest

from protocol.frames.frame import Frame
from sim.can.can_wire import Wire
from sim.can.frame_timing import frame_bits
from sim.can.other_frame import OtherFrame
from sim.can.simulated_bus import FieldBus, forget, segment


def test_a_long_frame_has_the_bits_of_ours() -> None:
    rng = Random(11)
    for _ in range(300):
        number, data = rng.getrandbits(29), rng.randbytes(rng.randrange(9))
        assert OtherFrame.of(number, data, extended=True).bits == frame_bits(number, data)


def test_a_short_frame_has_the_bits_of_the_standard() -> None:
    """Without stuffing: 44 + 8 n, and 3 of the interframe space (ISO 11898-1)."""
    rng = Random(12)
    for _ in range(300):
        data = rng.randbytes(rng.randrange(9))
        plain = 47 + 8 * len(data)
        bits = OtherFrame.of(rng.getrandbits(11), data).bits
        assert plain <= bits <= plain + (34 + 8 * len(data) - 1) // 4
    assert 47 <= OtherFrame.of(0x555, b"", remote=8).bits <= 55  # no data on the wire


def test_it_arbitrates_with_its_identifier() -> None:
    wire = Wire(0)
    ours, theirs = wire.attach("ours"), wire.attach("theirs")
    stop = Frame(0x00FF0080, b"")
    wire.submit(theirs, OtherFrame.of(0x7FF, b""), 0)
    wire.submit(theirs, OtherFrame.of(0x002, b""), 0)
    wire.submit(ours, stop, 0)
    order = [delivery.frame.identifier >> 18 for delivery in wire.advance(10_000)]
    assert order == [0x002, stop.identifier >> 18, 0x7FF]
    assert wire.others == 2 and sum(wire.by_group.values()) == 1


@pytest.mark.parametrize(
    ("number", "extended", "length"),
    [(1 << 11, False, 0), (1 << 29, True, 0), (-1, True, 0), (1, True, 9)],
)
def test_what_can_has_not_is_refused(number: int, extended: bool, length: int) -> None:
    with pytest.raises(ValueError, match="no classic CAN frame"):
        OtherFrame.of(number, bytes(length), extended)


def test_no_robot_and_no_recorder_gets_it() -> None:
    name = "others"
    bus, other = FieldBus(name), FieldBus(name)
    heard: list[Frame] = []
    taps: list[Frame] = []
    bus.subscribe(heard.append)
    segment(name).taps.append(lambda _, frame: taps.append(frame))
    told: list[OtherFrame] = []
    segment(name).other_ears[bus.node] = told.append
    other.submit(OtherFrame.of(0x123, b"12"))
    while not told:
        segment(name).pump()
    assert heard == [] and taps == [] and told[0].number == 0x123
    bus.shutdown()
    other.shutdown()
    assert not segment(name).other_ears
    forget(name)
