"""A log in parts: a new file starts at a size limit, and only the newest files are kept.

`can.log` is the part that is written; `can.1.log`, `can.2.log` and so on are those before it, in their
order. Each part is a whole log by itself.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from protocol.frames.frame import Frame
from sim.files.recording_end import say

MIB = 1 << 20


class Limit(NamedTuple):
    """How much of a log in parts is kept on disk."""

    part_bytes: int
    parts: int  # two or more; includes the one being written

    @property
    def text(self) -> str:
        """The limit as text for a message."""
        size = self.part_bytes * self.parts
        return f"{size >> 20} MiB" if size >= MIB else f"{size} bytes"


# For each log of a launch: about a day of ten robots. A launch keeps the index of the MCAP part
# that it writes in memory, a quarter of a megabyte; writing the index takes milliseconds.
LAUNCH_LIMIT = Limit(part_bytes=8 * MIB, parts=128)


class Writer(Protocol):
    """A log file that `PartedLog` can measure and close."""

    @property
    def size(self) -> int:
        """Bytes written so far."""
        ...

    def close(self) -> None:
        """Write what is buffered and close the file."""


W = TypeVar("W", bound=Writer)


class PartedLog(Generic[W]):
    """Calls go to the writer `part`, which starts a new part if the last is full."""

    def __init__(
        self, path: Path, begin: Callable[[Path, int], W], begin_at_us: int,
        limit: Limit = LAUNCH_LIMIT, told: Callable[[str], None] = say,
    ) -> None:  # fmt: skip
        """`begin`: opens a part, for a time in microseconds. `told`: gets one line for the user
        when the first part is deleted. Raises what `begin` raises."""
        self.path, self.limit, self.told = path, limit, told
        self.deleted = 0  # parts
        self._begin = begin
        self._writer = begin(path, begin_at_us)
        # In addition to what a part begins with.
        self._full_bytes = self._writer.size + limit.part_bytes

    def part(self, t_us: int) -> W:
        """The writer for the next data. Raises OSError."""
        if self._writer.size >= self._full_bytes:
            self._writer.close()
            self._put_back()
            self._writer = self._begin(self.path, t_us)
            self._full_bytes = self._writer.size + self.limit.part_bytes
        return self._writer

    def write(self, t_us: int, frame: Frame) -> None:
        """Write to a log of frames. Raises OSError."""
        writer: Any = self.part(t_us)
        writer.write(t_us, frame)

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Write to a log that accepts intents. Raises OSError."""
        writer: Any = self.part(t_us)
        writer.tell(t_us, intent)

    def add(self, topic: str, t_us: int, text: str) -> None:
        """Write to a log that has topics. Raises OSError."""
        writer: Any = self.part(t_us)
        writer.add(topic, t_us, text)

    def close(self) -> None:
        """Close the part that is being written. Full parts stay."""
        self._writer.close()

    def _put_back(self) -> None:
        """Give the full part a number; delete the oldest part if there are too many."""
        older = _older(self.path)
        number = max((number for number, _ in older), default=0) + 1
        self.path.rename(part_path(self.path, number))
        for _, part in older[: max(len(older) + 2 - self.limit.parts, 0)]:
            part.unlink()
            if not self.deleted:
                self.told(f"{self.path.name}: its newest {self.limit.text} are kept; what is older is "
                          "deleted from now on")  # fmt: skip
            self.deleted += 1


def part_path(path: Path, number: int) -> Path:
    """Where a full part lies: the number stands before the suffix, as in `can.3.log`."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}")


def parts_of(path: Path) -> list[Path]:
    """All existing parts of a log, oldest first; the log itself is the last."""
    return [*(part for _, part in _older(path)), path]


def _older(path: Path) -> list[tuple[int, Path]]:
    """Number and path of each full part, oldest first."""
    pattern = re.compile(re.escape(path.stem) + r"\.([1-9]\d{0,8})" + re.escape(path.suffix))
    try:
        beside = list(path.parent.iterdir())
    except OSError:
        return []
    found = ((pattern.fullmatch(part.name), part) for part in beside)
    return sorted((int(match[1]), part) for match, part in found if match and part.is_file())
