"""CAN logs in candump format, as can-utils writes them and python-can reads them."""

import re
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TextIO

from protocol.frames.frame import Frame

LINE_BYTES_MAX = 512  # a CAN FD frame has 180 bytes
# Time; channel; identifier and data (a classic frame), or an unsupported kind: remote (R), FD (##).
LINE = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\)\s+\S+\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:((?:[0-9A-Fa-f]{2}){0,8})|R\d?|#[0-9A-Fa-f]+)(?:\s+[RT])?"
)
# The same of a line as `CandumpWriter` and `candump -L` write it: most lines of most logs.
PLAIN = re.compile(
    rb"^\((\d{1,12})\.(\d{6})\) \S{1,32} ([0-9A-F]{8})#((?:[0-9A-F]{2}){0,8})\n", re.MULTILINE
)
BLOCK_BYTES = 1 << 18  # some six thousand lines
EXTENDED_MAX = 0x1FFFFFFF


class FrameColumns(NamedTuple):
    """Frames in the order in which they were heard, as `sim.record.recording` keeps them."""

    t_us: Sequence[int]
    identifiers: Sequence[int]
    lengths: bytes
    data: bytes  # eight bytes of each frame, filled up with zeros

    def rows(self) -> Iterator[tuple[int, Frame]]:
        """(microseconds, frame)."""
        at, data = 0, self.data
        for t_us, identifier, length in zip(self.t_us, self.identifiers, self.lengths, strict=True):
            yield t_us, Frame(identifier, data[at : at + length])
            at += 8


class CandumpWriter:
    """One line a frame: `(1.234567) can0 0CFF1080#0011223344556677`."""

    def __init__(self, path: Path, channel: str = "can0") -> None:
        self.channel = channel
        self.frames = 0
        self.size = 0  # bytes; what is in a buffer included
        self._file: TextIO = path.open("w", encoding="ascii")

    def write(self, t_us: int, frame: Frame) -> None:
        """Append one line. `t_us` is written as seconds with six decimals."""
        self.frames += 1
        self.size += self._file.write(
            f"({t_us // 1_000_000}.{t_us % 1_000_000:06d}) {self.channel} "
            f"{frame.identifier:08X}#{frame.data.hex().upper()}\n"
        )

    def close(self) -> None:
        """Write what is buffered and close the file."""
        self._file.close()


def read_candump(
    path: Path,
    damaged: Callable[[], object] = lambda: None,
    other: Callable[[], object] = lambda: None,
) -> Iterator[tuple[int, Frame]]:
    """(microseconds, frame) of every data frame with a 29-bit identifier.

    Frames with 11-bit identifiers, remote and error frames are skipped, and `other` is called for
    each; `damaged` is called for each line that is not in candump format. OSError.
    """
    for columns in read_columns(path, damaged, other):
        yield from columns.rows()


def read_columns(
    path: Path,
    damaged: Callable[[], object] = lambda: None,
    other: Callable[[], object] = lambda: None,
) -> Iterator[FrameColumns]:
    """The frames of `read_candump`, some thousand at a time. OSError."""
    with path.open("rb") as file:
        block = b""
        while more := file.read(BLOCK_BYTES):
            block += more
            # A line without an end is read in pieces.
            end = block.rfind(b"\n") + 1 or len(block) // LINE_BYTES_MAX * LINE_BYTES_MAX
            yield _columns(block[:end], damaged, other)
            block = block[end:]
        yield _columns(block, damaged, other)


def _columns(
    block: bytes, damaged: Callable[[], object], other: Callable[[], object]
) -> FrameColumns:
    """Of a block that ends where a line does."""
    found = PLAIN.findall(block)
    identifiers = [int(identifier, 16) for _, _, identifier, _ in found]
    whole = len(found) == block.count(b"\n") and block[-1:] in (b"", b"\n")
    if not whole or max(identifiers, default=0) > EXTENDED_MAX:
        return _by_lines(block, damaged, other)
    return FrameColumns(
        [int(seconds + micros) for seconds, micros, _, _ in found],
        identifiers,
        bytes([len(data) >> 1 for *_, data in found]),
        bytes.fromhex(b"".join([data.ljust(16, b"0") for *_, data in found]).decode()),
    )


def _by_lines(
    block: bytes, damaged: Callable[[], object], other: Callable[[], object]
) -> FrameColumns:
    file, t_us, identifiers, lengths, data = BytesIO(block), [], [], bytearray(), bytearray()
    while line := file.readline(LINE_BYTES_MAX):
        if not (text := line.decode("ascii", errors="replace").strip()):
            continue
        if (found := LINE.fullmatch(text)) is None:
            damaged()
            continue
        seconds, micros, identifier, hexadecimal = found.groups()
        if len(identifier) != 8 or hexadecimal is None or int(identifier, 16) > EXTENDED_MAX:
            other()
            continue
        t_us.append(int(seconds) * 1_000_000 + int(micros[:6].ljust(6, "0")))
        identifiers.append(int(identifier, 16))
        lengths.append(len(hexadecimal) >> 1)
        data += bytes.fromhex(hexadecimal).ljust(8, b"\0")
    return FrameColumns(t_us, identifiers, bytes(lengths), bytes(data))
