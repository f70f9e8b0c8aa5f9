"""Transport sessions between real ends, over a channel that loses, repeats and makes things up."""

from collections.abc import Callable, Iterable
from heapq import heappop, heappush
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.frames.codec import decode, encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.network_frames import TP_CM, TP_DT, TransportData, TransportManagement
from protocol.transport import (
    BAM_GAP_US,
    RECEIVING_MAX,
    SENDING_MAX,
    SENDING_TABLE,
    SIZE_MAX,
    T2_US,
    Abort,
    OutgoingFrame,
    ReceivedMessage,
    SendingEvent,
    SendingState,
    Transport,
    TransportControl,
)
from tests.examples import examples
from tests.state_tables import check_table

PGN = 0xFEEB
DELAY_US = 700
END_US = 60_000_000
Lose = Callable[[int, OutgoingFrame], bool]  # the frame's number, the frame


class Channel:
    """Devices at addresses 0, 1, 2, ...; every frame goes through its bytes."""

    def __init__(self, size: int, lose: Lose = lambda number, out: False) -> None:
        self.ends = [Transport() for _ in range(size)]
        self.arrived: list[tuple[int, ReceivedMessage]] = []
        self.lose, self.frames, self.now_us = lose, 0, 0
        self._flying: list[tuple[int, int, int, int, Frame]] = []

    def put(self, source: int, out: Iterable[OutgoingFrame]) -> None:
        for o in out:
            self.frames += 1
            if not self.lose(self.frames, o):
                frame = encode(o.message, source, o.destination)
                due_at_us = self.now_us + DELAY_US
                heappush(self._flying, (due_at_us, self.frames, source, o.destination, frame))

    def send(self, source: int, data: bytes, destination: int) -> bool:
        out = self.ends[source].send(PGN, data, destination, self.now_us)
        self.put(source, out or ())
        return out is not None

    def run(self, until_us: int = END_US) -> None:
        while True:
            times = [d for e in self.ends if (d := e.due_at_us) is not None]
            times += [self._flying[0][0]] if self._flying else []
            if not times or min(times) > until_us:
                return
            self.now_us = max(self.now_us, min(times))
            while self._flying and self._flying[0][0] <= self.now_us:
                _, _, source, destination, frame = heappop(self._flying)
                self._deliver(source, destination, frame)
            for address, end in enumerate(self.ends):
                if end.due_at_us is not None and end.due_at_us <= self.now_us:
                    self.put(address, end.on_tick(self.now_us))

    def _deliver(self, source: int, destination: int, frame: Frame) -> None:
        _, message = decode(frame)
        assert isinstance(message, TransportManagement | TransportData)
        for address, end in enumerate(self.ends):
            if address != source and destination in (address, GLOBAL_ADDRESS):
                out, arrived = end.on_message(source, destination, message, self.now_us)
                self.put(address, out)
                if arrived is not None:
                    self.arrived.append((address, arrived))


@pytest.mark.parametrize("size", [9, 14, 15, 112, 113, 500, SIZE_MAX])
@pytest.mark.parametrize("destination", [1, GLOBAL_ADDRESS])
def test_a_message_arrives_whole_and_once(size: int, destination: int) -> None:
    data = Random(size).randbytes(size)
    channel = Channel(3)
    assert channel.send(0, data, destination)
    channel.run()
    receivers = [1] if destination == 1 else [1, 2]
    broadcast = destination == GLOBAL_ADDRESS
    assert channel.arrived == [(r, ReceivedMessage(0, PGN, data, broadcast)) for r in receivers]
    assert channel.ends[0].counts["sent"] == 1 and not any(e.sessions for e in channel.ends)
    if broadcast:
        assert channel.now_us >= -(-size // 7) * BAM_GAP_US


def test_everybody_to_everybody_at_once() -> None:
    channel = Channel(4)
    for source in range(4):
        for destination in {0, 1, 2, 3, GLOBAL_ADDRESS} - {source}:
            assert channel.send(source, bytes((source, destination)) * 50, destination)
    channel.run()
    assert len(channel.arrived) == 4 * 3 + 4 * 3
    assert all(a.data == bytes((a.source, 255 if a.broadcast else r)) * 50
               for r, a in channel.arrived)  # fmt: skip


@pytest.mark.parametrize("lost", range(1, 30))
def test_any_one_frame_between_two_may_be_lost(lost: int) -> None:
    data = bytes(range(150))
    channel = Channel(2, lambda number, out: number == lost)
    channel.send(0, data, 1)
    channel.run()
    whole = [a.data for _, a in channel.arrived]
    # Without its RTS a session has never begun, and without its END the sender does not know.
    assert whole == ([] if lost == 1 else [data])
    assert not any(end.sessions for end in channel.ends)


@pytest.mark.slow
@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 2**32), st.floats(0, 0.6))
def test_loss_ends_in_the_whole_message_or_in_none(seed: int, loss: float) -> None:
    rng = Random(seed)
    channel = Channel(3, lambda number, out: rng.random() < loss)
    data = rng.randbytes(rng.randrange(9, 700))
    channel.send(0, data, 1)
    channel.send(1, data, GLOBAL_ADDRESS)
    channel.send(2, data, 0)
    channel.run()
    assert all(arrived.data == data for _, arrived in channel.arrived)
    assert not any(end.sessions for end in channel.ends), "every session ends by itself"


@pytest.mark.slow
@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.tuples(
    st.integers(0, 253), st.booleans(), st.booleans(), st.binary(min_size=8, max_size=8),
    st.sampled_from([*TransportControl, 0, 200]), st.integers(0, 2_000_000)), max_size=80))  # fmt: skip
def test_made_up_frames_are_counted_and_bounded(
    frames: list[tuple[int, bool, bool, bytes, int, int]],
) -> None:
    end, now_us = Transport(), 0
    end.send(PGN, bytes(100), 7, 0)
    for source, broadcast, is_data, raw, control, pause_us in frames:
        now_us += pause_us
        message: TransportManagement | TransportData
        if is_data:
            message = TP_DT.unpack(raw)
        else:
            message = TP_CM.unpack(bytes((control,)) + raw[1:])
        out, _ = end.on_message(source, GLOBAL_ADDRESS if broadcast else 130, message, now_us)
        assert len(list(out)) <= 1, "one frame costs one frame at most"
        assert len(list(end.on_tick(now_us))) <= RECEIVING_MAX + SENDING_MAX
        assert end.sessions <= RECEIVING_MAX + SENDING_MAX
    for _ in range(1000):
        now_us += T2_US
        list(end.on_tick(now_us))
    assert end.sessions == 0


def test_a_second_message_from_one_sender_is_refused_and_the_first_arrives() -> None:
    end = Transport()
    rts = TransportManagement(TransportControl.RTS, bytes((20, 0, 3, 255)), PGN)
    list(end.on_message(5, 130, rts, 0))
    out, _ = end.on_message(5, 130, rts._replace(pgn=0xEF00), 1)
    (answer,) = out
    assert isinstance(answer.message, TransportManagement)
    assert (answer.message.control, answer.message.body[0]) == (TransportControl.ABORT, Abort.BUSY)
    for k in (1, 2, 3):
        _, arrived = end.on_message(5, 130, TransportData(k, bytes(7)), 2)
    assert arrived == ReceivedMessage(5, PGN, bytes(20), False)


def test_a_receiver_that_asks_for_ever_is_given_up() -> None:
    end = Transport()
    end.send(PGN, bytes(20), 5, 0)
    cts = TransportManagement(TransportControl.CTS, bytes((1, 1, 255, 255)), PGN)
    for k in range(1000):
        list(end.on_message(5, 130, cts, k * 1000))
        list(end.on_tick(k * 1000))
    assert end.sessions == 0 and end.counts["given up"] == 1


def test_every_state_and_event_of_a_session_of_ours() -> None:
    waits, sends, closed = SendingState
    granted, on_hold, grant_sent, delivered, timed_out, given_up, aborted = SendingEvent
    check_table(SENDING_TABLE, waits, {
        (waits, granted, sends), (sends, on_hold, waits), (sends, grant_sent, waits),
        (waits, delivered, closed), (sends, delivered, closed),
        (waits, timed_out, closed),  # packets of a grant are sent, however late
        (waits, given_up, closed), (sends, given_up, closed),
        (waits, aborted, closed), (sends, aborted, closed),
    })  # fmt: skip


@pytest.mark.parametrize("source", [254, 255])
@pytest.mark.parametrize(
    "control", [TransportControl.CTS, TransportControl.END, TransportControl.ABORT]
)
def test_a_frame_from_no_address_ends_no_broadcast_of_ours(
    source: int, control: TransportControl
) -> None:
    """Sent from address 255, it was taken for the answer of the receiver of our broadcast."""
    ours = Transport()
    assert ours.send(PGN, b"x" * 30, GLOBAL_ADDRESS, 0)
    for hold in (0, 1):
        answer = TransportManagement(control, bytes((hold, 1, 255, 255)), PGN)
        assert ours.on_message(source, 7, answer, 1) == ((), None)
    sent = [out for now_us in range(0, 2_000_000, 10_000) for out in ours.on_tick(now_us)]
    assert [o.message for o in sent if isinstance(o.message, TransportData)] == [
        TransportData(k, (b"x" * 30)[7 * k - 7 : 7 * k].ljust(7, b"\xff")) for k in range(1, 6)
    ]
    assert ours.counts["malformed"] == 2 and not ours.sessions


def test_the_packets_of_two_broadcasts_are_not_joined_to_one() -> None:
    """The end of the first and the BAM of the second were lost. A message came out that nobody sent."""
    lost = {3, 4}  # frames: BAM, packet 1, packet 2, then the same of the second message
    channel = Channel(2, lambda number, out: number in lost)
    channel.send(0, b"first message!", GLOBAL_ADDRESS)
    channel.run(3 * BAM_GAP_US)
    channel.send(0, b"other contents", GLOBAL_ADDRESS)
    channel.run()
    assert channel.frames == 6 and channel.arrived == []
    assert channel.ends[1].counts["lost"] == 1 and not channel.ends[1].sessions
