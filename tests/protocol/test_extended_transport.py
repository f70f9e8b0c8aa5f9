"""Long messages between two devices, with lost frames and with any bytes."""

from random import Random

import pytest

from protocol.extended_transport import (
    ExtendedControl,
    ExtendedTransport,
    LongOutgoing,
    LongSendingState,
)
from protocol.frames.network_frames import ExtendedTransportData, ExtendedTransportManagement
from protocol.units import MS, S

PGN = 0xE700
A, B = 128, 38  # addresses


def carried(size: int, lose: float = 0.0, seed: int = 1) -> tuple[bytes, bytes | None, int]:
    """What was sent, what has arrived, and when."""
    rng, data = Random(seed), Random(size).randbytes(size)
    ends, arrived = {A: ExtendedTransport(), B: ExtendedTransport()}, None
    now_us, queue = 0, list[tuple[int, LongOutgoing]]()
    queue += [(A, out) for out in ends[A].send(PGN, data, B, now_us) or ()]
    while now_us < 30 * S:
        while queue:
            sender, out = queue.pop(0)
            if rng.random() < lose:
                continue
            answers, whole = ends[out.destination].on_message(sender, out.message, now_us)
            queue += [(out.destination, each) for each in answers]
            arrived = whole.data if whole is not None else arrived
        if not ends[A].due_at_us and not ends[B].due_at_us:
            break
        now_us += MS
        for address, end in ends.items():
            queue += [(address, out) for out in end.on_tick(now_us)]
    return data, arrived, now_us


@pytest.mark.parametrize("size", [1786, 1792, 4000, 12_345, 65_536])
def test_a_long_message_arrives_whole(size: int) -> None:
    data, arrived, now_us = carried(size)
    assert arrived == data
    assert now_us <= (size // 7 + size // 448 * 12 + 30) * MS


def test_lost_frames_are_asked_for_again() -> None:
    arrived = sum(
        carried(4000, 0.004, seed)[0] == carried(4000, 0.004, seed)[1] for seed in range(20)
    )
    assert arrived >= 18, "of 20 transfers with 2.5 lost frames each"


def test_the_bytes_are_those_of_the_standard() -> None:
    """The first frames of a transfer, written from the tables of ISO 11783-3."""
    one, data = ExtendedTransport(), bytes(2000)
    sent = one.send(PGN, data, B, 0)
    assert sent is not None
    (rts,) = sent
    assert rts.message == ExtendedTransportManagement(20, (2000).to_bytes(4, "little"), PGN)
    grant = ExtendedTransportManagement(21, b"\x10\x01\x00\x00", PGN)
    (dpo,), _ = one.on_message(B, grant, 10)
    assert dpo.message == ExtendedTransportManagement(22, b"\x10\x00\x00\x00", PGN)
    assert len(one.on_tick(10 + MS)) == 0, "packets must not overtake it"
    (first,) = one.on_tick(10 + 10 * MS)
    assert first.message == ExtendedTransportData(1, bytes(7))
    for step in range(15):
        (last,) = one.on_tick((step + 13) * MS)
    assert isinstance(last.message, ExtendedTransportData) and last.message.sequence == 16
    (dpo,), _ = one.on_message(B, ExtendedTransportManagement(21, b"\x05\x11\x00\x00", PGN), 11)
    assert dpo.message == ExtendedTransportManagement(22, b"\x05\x10\x00\x00", PGN)
    for step in range(50, 56):
        one.on_tick(step * MS)
    one.on_message(B, ExtendedTransportManagement(23, (2000).to_bytes(4, "little"), PGN), 12)
    assert one.due_at_us is None and one.counts["delivered"] == 1


def test_a_silent_receiver_ends_the_session() -> None:
    one = ExtendedTransport()
    one.send(PGN, bytes(2000), B, 0)
    assert one.send(PGN, bytes(2000), B, 0) is None
    (abort,) = one.on_tick(2 * S)
    assert isinstance(abort.message, ExtendedTransportManagement)
    assert abort.message.control == ExtendedControl.ABORT and one.due_at_us is None


def test_any_bytes_raise_nothing_and_open_few_sessions() -> None:
    rng, one = Random(5), ExtendedTransport()
    for step in range(20_000):
        now_us, source = step * 5 * MS, rng.randrange(250)
        if step % 50 == 0:
            one.send(PGN, bytes(3000), source, now_us)
        control = rng.choice((*ExtendedControl, rng.randrange(256)))
        pgn = rng.choice((PGN, rng.randrange(1 << 18)))
        message = (
            ExtendedTransportData(rng.randrange(256), rng.randbytes(7))
            if rng.random() < 0.5
            else ExtendedTransportManagement(control, rng.randbytes(4), pgn)
        )
        one.on_message(source, message, now_us)
        one.on_tick(now_us)
    assert len(LongSendingState) == 3


def test_a_sender_that_sends_fewer_packets_than_were_granted_is_not_kept_waiting() -> None:
    """AgIsoStack sends 16 after each DPO. The next grant came after 750 ms, and 10 kB in a minute."""
    one, data, now_us = ExtendedTransport(), Random(2).randbytes(10_000), 0
    rts = ExtendedTransportManagement(20, len(data).to_bytes(4, "little"), PGN)
    answers, whole = one.on_message(B, rts, now_us)
    grants = 0
    while whole is None:
        while not answers:
            now_us += MS
            answers = one.on_tick(now_us)
        cts = answers[0].message
        assert isinstance(cts, ExtendedTransportManagement) and cts.control == 21
        first = int.from_bytes(cts.body[1:4], "little")
        burst = min(16, cts.body[0])
        offset = bytes((burst,)) + (first - 1).to_bytes(3, "little")
        answers, _ = one.on_message(B, ExtendedTransportManagement(22, offset, PGN), now_us)
        grants += 1
        for k in range(burst):
            assert not answers, "a grant before the last packet of the last one"
            body = data[7 * (first - 1 + k) : 7 * (first + k)].ljust(7, b"\xff")
            now_us += MS
            answers, whole = one.on_message(B, ExtendedTransportData(1 + k, body), now_us)
    assert whole.data == data and now_us < 3 * S and one.counts["asked again"] == 0
    assert grants == -(-1429 // 16)


@pytest.mark.parametrize("packets", [False, True])
def test_a_sender_that_repeats_itself_holds_no_session(packets: bool) -> None:
    """Each repetition renewed the time, so that four such senders closed it to all others."""
    one, now_us = ExtendedTransport(), 0
    one.on_message(B, ExtendedTransportManagement(20, (2000).to_bytes(4, "little"), PGN), now_us)
    for step in range(200):
        now_us = step * 100 * MS
        one.on_message(B, ExtendedTransportManagement(22, b"\x10\x00\x00\x00", PGN), now_us)
        if packets:
            one.on_message(B, ExtendedTransportData(3, bytes(7)), now_us)
        one.on_tick(now_us)
    assert one.due_at_us is None and one.counts["timeout"] == 1
