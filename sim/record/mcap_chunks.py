"""The messages of an MCAP file, chunk by chunk, of some of its topics.

The `mcap` package reads the records of a file, takes chunks apart and checks their sums. Its readers
make an object of each message of each topic, and of each entry of each index. Here a chunk stays bytes,
and only what is wanted is cut out of it, which takes a tenth of the time.
"""

from collections.abc import Callable, Iterator
from struct import Struct
from typing import IO, Any

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream

RECORD = Struct("<BQ")  # opcode, bytes that follow
MESSAGE = Struct("<HIQQ")  # channel, number, written at and sent at in nanoseconds; then the data
Found = tuple[int, str, bytes]


class ChunkReader(StreamReader):
    """Skips the index of messages behind each chunk: a reader of the whole file does not need it."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(file, emit_chunks=True, validate_crcs=True)

    def _read_record(self, opcode: int, length: int) -> Any:
        if opcode != Opcode.MESSAGE_INDEX:
            return super()._read_record(opcode, length)
        self._stream.read(length)
        return None


def messages_of(file: IO[bytes], wanted: Callable[[str], bool]) -> Iterator[Found]:
    """(nanoseconds, topic, data) of each message, in the order of writing.

    `wanted`: is asked once for each channel. Raises what the reader and its decompressors raise, and
    ValueError or struct.error for a damaged chunk without a sum.
    """
    topics: dict[int, str | None] = {}  # by channel; None: not wanted
    for record in ChunkReader(file).records:
        if isinstance(record, Chunk):
            yield from _of_chunk(record, topics, wanted)
        elif isinstance(record, Channel):
            topics[record.id] = record.topic if wanted(record.topic) else None
        elif isinstance(record, Message) and (topic := _topic(topics, record.channel_id)):
            yield record.log_time, topic, record.data


def _of_chunk(
    chunk: Chunk, topics: dict[int, str | None], wanted: Callable[[str], bool]
) -> Iterator[Found]:
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data: bytes = stream.read(size)
    at, read_record, read_message = 0, RECORD.unpack_from, MESSAGE.unpack_from
    message, head, own_head = int(Opcode.MESSAGE), RECORD.size, MESSAGE.size
    while at < size:
        opcode, length = read_record(data, at)
        at += head
        end = at + length
        if end > size:
            raise ValueError("a record of a chunk ends outside of it")
        if opcode == message:
            channel, _, written_at_ns, _ = read_message(data, at)
            topic = topics[channel] if channel in topics else _topic(topics, channel)
            if topic is not None:
                yield written_at_ns, topic, data[at + own_head : end]
        elif opcode == Opcode.CHANNEL:
            for each in breakup_chunk(_alone(chunk, data[at - head : end])):
                assert isinstance(each, Channel)
                topics[each.id] = each.topic if wanted(each.topic) else None
        at = end


def _topic(topics: dict[int, str | None], channel: int) -> str | None:
    if channel not in topics:
        raise ValueError(f"no channel record found with id {channel}")
    return topics[channel]


def _alone(chunk: Chunk, record: bytes) -> Chunk:
    """A chunk of one record, for the reader of the package."""
    return Chunk(
        compression="", data=record, message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time, uncompressed_crc=0, uncompressed_size=len(record),
    )  # fmt: skip
