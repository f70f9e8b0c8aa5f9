"""The wire against the rules of CAN: order, timing, faults, and bounds."""

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.frames.frame import Frame
from sim.can.can_wire import QUEUE_MAX, RECOVERY_US, Delivery, Wire
from sim.can.frame_timing import CRC_BITS, HEAD_BITS, TAIL_BITS, frame_bits, worst_bits


def slow_bits(identifier: int, data: bytes) -> int:
    """The frame written out bit by bit, as ISO 11898-1 draws it."""
    text = "0" + f"{identifier >> 18:011b}" + "11" + f"{identifier & 0x3FFFF:018b}" + "000"
    text += f"{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in text:
        top = crc >> 14 & 1
        crc = crc << 1 & 0x7FFF
        if top ^ int(bit):
            crc ^= 0x4599
    text += f"{crc:015b}"
    stuffed, run, last = 0, 0, ""
    for bit in text:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed, last, run = stuffed + 1, "1" if bit == "0" else "0", 1
    return len(text) + stuffed + TAIL_BITS


@given(st.integers(0, (1 << 29) - 1), st.binary(max_size=8))
@settings(deadline=None)
def test_bits_are_counted_as_they_are_sent(identifier: int, data: bytes) -> None:
    bits = frame_bits(identifier, data)
    assert bits == slow_bits(identifier, data)
    assert HEAD_BITS + CRC_BITS + 8 * len(data) + TAIL_BITS <= bits <= worst_bits(len(data))


def drain(wire: Wire, until_us: int = 10_000_000) -> list[Delivery]:
    return wire.advance(until_us)


def frame(identifier: int, byte: int = 0) -> Frame:
    return Frame(identifier, bytes([byte] * 8))


@given(st.lists(st.integers(0, (1 << 29) - 1), unique=True, min_size=1, max_size=30), st.integers())
def test_the_lowest_identifier_goes_first_whoever_submits_first(ids: list[int], seed: int) -> None:
    wire = Wire()
    nodes = [wire.attach() for _ in ids]
    wire.attach("listener")
    order = list(zip(nodes, ids, strict=True))
    Random(seed).shuffle(order)
    for node, identifier in order:
        wire.submit(node, frame(identifier), 1000)
    assert [d.frame.identifier for d in drain(wire)] == sorted(ids)


def test_a_frame_under_way_is_not_interrupted_and_delays_by_no_more_than_itself() -> None:
    wire = Wire()
    low, high = wire.attach(), wire.attach()
    wire.submit(low, frame(0x1FFFFFFF), 0)
    wire.submit(low, frame(0x1FFFFFFE), 0)
    wire.advance(100)
    wire.submit(high, frame(0), 100)
    deliveries = drain(wire)
    assert [d.frame.identifier for d in deliveries] == [0x1FFFFFFE, 0, 0x1FFFFFFF]
    assert deliveries[1].t_us - 100 <= 2 * 640


def test_a_node_is_not_its_own_audience_and_an_idle_wire_schedules_nothing() -> None:
    wire = Wire()
    a, b = wire.attach(), wire.attach()
    assert wire.next_at_us is None
    wire.submit(a, frame(1), 5)
    (delivery,) = drain(wire)
    assert delivery.receivers == (b,) and wire.next_at_us is None


def test_islands_do_not_hear_each_other_and_have_a_bus_each() -> None:
    wire = Wire()
    a, b, c, d = (wire.attach() for _ in range(4))
    wire.partition({a, b}, {c, d})
    wire.submit(a, frame(1), 0)
    wire.submit(c, frame(2), 0)
    first, second = drain(wire)
    assert {first.receivers, second.receivers} == {(b,), (d,)}
    assert first.t_us < 700 and second.t_us < 700, "they do not wait for each other"
    wire.heal()
    wire.submit(a, frame(1), 20_000_000)
    (whole,) = drain(wire, 30_000_000)
    assert whole.receivers == (b, c, d)


def test_one_way() -> None:
    wire = Wire()
    a, b = wire.attach(), wire.attach()
    wire.faults.deaf.add((a, b))
    wire.submit(a, frame(1), 0)
    wire.submit(b, frame(2), 0)
    assert [d.receivers for d in drain(wire)] == [(), (a,)]


def test_a_full_queue_refuses_and_counts() -> None:
    wire = Wire()
    node = wire.attach()
    taken = [wire.submit(node, frame(i), 0) for i in range(QUEUE_MAX + 3)]
    assert taken.count(False) == 3 and wire.nodes[node].refused == 3


def test_errors_delay_then_silence_a_node_and_it_recovers() -> None:
    wire = Wire()
    node = wire.attach()
    wire.faults.error = 1.0
    wire.submit(node, frame(1), 0)
    while wire.nodes[node].off_ends_at_us is None:
        assert wire.next_at_us is not None
        wire.advance(wire.next_at_us)
    assert wire.errors == 32, "a transmit error costs 8 of 256"
    assert not wire.submit(node, frame(2), 1_000_000)
    off_ends_at_us = wire.nodes[node].off_ends_at_us
    assert off_ends_at_us is not None
    wire.faults.error = 0.0
    wire.advance(off_ends_at_us + RECOVERY_US)
    assert wire.submit(node, frame(2), off_ends_at_us + RECOVERY_US)


@pytest.mark.parametrize("kind", ["loss", "omission"])
def test_a_rate_is_a_rate(kind: str) -> None:
    wire = Wire(seed=7)
    sender = wire.attach()
    receivers = [wire.attach() for _ in range(10)]
    setattr(wire.faults, kind, 0.2)
    heard = 0
    for k in range(500):
        wire.submit(sender, frame(1), k * 2000)
        heard += sum(len(d.receivers) for d in wire.advance(k * 2000 + 1999))
    assert 0.75 < heard / (500 * len(receivers)) < 0.85


def test_duplicates_repeat_a_frame() -> None:
    wire = Wire(seed=3)
    a = wire.attach()
    wire.attach()
    wire.faults.duplicate = 0.5
    for k in range(200):
        wire.submit(a, frame(k), k * 2000)
    assert 250 < len(drain(wire)) < 600


def test_the_same_seed_gives_the_same_wire() -> None:
    def play(seed: int) -> list[Delivery]:
        wire = Wire(seed)
        nodes = [wire.attach() for _ in range(5)]
        wire.faults.loss, wire.faults.error, wire.faults.duplicate = 0.1, 0.1, 0.1
        rng, result = Random(9), []
        for t_us in range(0, 500_000, 900):
            wire.submit(rng.choice(nodes), frame(rng.randrange(1 << 29)), t_us)
            result += wire.advance(t_us + 899)
        return result

    assert play(1) == play(1)
    assert play(1) != play(2)


@pytest.mark.parametrize("seed", range(20))
def test_who_speaks_into_silence_is_not_waited_for_and_nothing_else_changes(seed: int) -> None:
    """Arbitration ahead of its bit against one in its time, which a chance of errors asks for."""
    rng, ahead, in_time = Random(seed), Wire(), Wire()
    in_time.faults.error = 1e-300
    now_us, told = 0, {id(ahead): list[Delivery](), id(in_time): list[Delivery]()}
    for wire in (ahead, in_time):
        for _ in range(4):
            wire.attach()
    for _ in range(300):
        now_us += rng.choice((0, 0, 1, 2, 3, 4, 5, 200, 900))
        node, sent = rng.randrange(4), frame(rng.randrange(1 << 29), rng.randrange(256))
        for wire in (ahead, in_time):
            told[id(wire)] += wire.advance(now_us)
            wire.submit(node, sent, now_us)
    for wire in (ahead, in_time):
        told[id(wire)] += drain(wire)
    assert told[id(ahead)] == told[id(in_time)], f"seed {seed}"
    counts = [(w.frames, w.busy_for_us, w.worst_for_us, w.by_group) for w in (ahead, in_time)]
    assert counts[0] == counts[1], f"seed {seed}"
