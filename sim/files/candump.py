"""CAN logs in candump format, as can-utils writes them and python-can reads them."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

from protocol.frames.frame import Frame

LINE_BYTES_MAX = 512  # a CAN FD frame has 180 bytes
# Time; channel; identifier and data (a classic frame), or an unsupported kind: remote (R), FD (##).
LINE = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\)\s+\S+\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:((?:[0-9A-Fa-f]{2}){0,8})|R\d?|#[0-9A-Fa-f]+)(?:\s+[RT])?"
)


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
    with path.open("rb") as file:
        while line := file.readline(LINE_BYTES_MAX):
            if not (text := line.decode("ascii", errors="replace").strip()):
                continue
            if (found := LINE.fullmatch(text)) is None:
                damaged()
                continue
            seconds, micros, identifier, data = found.groups()
            if len(identifier) != 8 or data is None or int(identifier, 16) > 0x1FFFFFFF:
                other()
                continue
            t_us = int(seconds) * 1_000_000 + int(micros[:6].ljust(6, "0"))
            yield t_us, Frame(int(identifier, 16), bytes.fromhex(data))
