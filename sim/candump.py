"""CAN logs in candump format, as can-utils writes them and python-can reads them."""

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from protocol.frame import Frame


class CandumpWriter:
    """One line a frame: `(1.234567) can0 0CFF1080#0011223344556677`."""

    def __init__(self, path: Path, channel: str = "can0") -> None:
        self.channel = channel
        self.frames = 0
        self._file: TextIO = path.open("w", encoding="ascii")

    def write(self, t_us: int, frame: Frame) -> None:
        self.frames += 1
        self._file.write(
            f"({t_us // 1_000_000}.{t_us % 1_000_000:06d}) {self.channel} "
            f"{frame.identifier:08X}#{frame.data.hex().upper()}\n"
        )

    def close(self) -> None:
        self._file.close()


def read_candump(path: Path) -> Iterator[tuple[int, Frame]]:
    """(microseconds, frame) of every data frame with a 29-bit identifier; other lines are passed over."""
    with path.open(encoding="ascii", errors="replace") as lines:
        for line in lines:
            parts = line.split()
            if len(parts) < 3 or "#" not in parts[2]:
                continue
            try:
                seconds, micros = parts[0].strip("()").split(".")
                identifier, data = parts[2].split("#")[:2]
                if len(identifier) != 8:
                    continue
                t_us = int(seconds) * 1_000_000 + int(micros[:6].ljust(6, "0"))
                yield t_us, Frame(int(identifier, 16) & 0x1FFFFFFF, bytes.fromhex(data)[:8])
            except ValueError:
                continue
