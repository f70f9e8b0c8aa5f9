"""What is cut out of the chunks of an MCAP file is what the package's own reader finds."""

from io import BytesIO
from pathlib import Path
from random import Random

import pytest

pytest.importorskip("mcap", reason="the extra `operator` is not installed")

from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from protocol.frames.frame import Frame
from sim.record.mcap_chunks import messages_of
from sim.record.mcap_log import McapLog, read_frames, read_recording
from tools.livemap.command import recorded

SEED = 31


def written(compression: CompressionType, chunking: bool) -> bytes:
    """Two thousand messages of four topics, one of which begins late."""
    file, rng = BytesIO(), Random(SEED)
    writer = Writer(file, chunk_size=4096, compression=compression, use_chunking=chunking)
    writer.start()
    schema = writer.register_schema("A", "jsonschema", b"{}")
    channels = [writer.register_channel(f"/robots/{k}", "json", schema) for k in range(3)]
    for k in range(2000):
        if k == 1000:
            channels.append(writer.register_channel("/late", "json", 0))
        writer.add_message(rng.choice(channels), k, rng.randbytes(rng.randrange(60)), k)
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [True, False])
def test_messages_are_those_of_the_packages_reader(
    compression: CompressionType, chunking: bool
) -> None:
    data = written(compression, chunking)
    theirs = [
        (message.log_time, channel.topic, message.data)
        for _, channel, message in NonSeekingReader(BytesIO(data), validate_crcs=True).iter_messages(
            log_time_order=False
        )
    ]  # fmt: skip
    assert list(messages_of(BytesIO(data), lambda topic: True)) == theirs, f"seed {SEED}"
    for topic in ("/robots/1", "/late", "/none"):
        own = [row for row in theirs if row[1] == topic]
        assert list(messages_of(BytesIO(data), topic.__eq__)) == own, f"seed {SEED}"


def test_a_damaged_chunk_is_refused(tmp_path: Path) -> None:
    data = bytearray(written(CompressionType.NONE, True))
    data[len(data) // 3] ^= 1
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="crc"):
        read_recording(path)


def test_a_file_that_was_cut_off_anywhere_at_its_begin_has_no_message_yet(tmp_path: Path) -> None:
    """A run of a small field that was killed in its first seconds left an empty run.mcap. For it
    `headland report` and `headland map` refused the folder, whose can.log was whole."""
    log = McapLog(tmp_path / "run.mcap", {"name": "small"})
    log.write(0, Frame(0xCFF1080, bytes(8)))
    log.close()
    whole, cut = (tmp_path / "run.mcap").read_bytes(), tmp_path / "cut.mcap"
    for size in range(300):
        cut.write_bytes(whole[:size])
        assert list(read_frames(cut)) == []
        assert read_recording(cut).count == 0
    (tmp_path / "can.log").write_text("(0.000000) can0 0CFF1080#0011223344556677\n")
    (tmp_path / "run.mcap").write_bytes(b"")
    assert recorded(tmp_path, None).count == 1
    cut.write_bytes(b"\x89MCAP1\r\n")
    with pytest.raises(ValueError, match="not an MCAP file"):
        list(read_frames(cut))
