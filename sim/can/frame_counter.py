"""Counts the frames on a simulated bus by kind, and writes them to logs."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from protocol.frames.codec import Malformed, decode_once
from protocol.frames.frame import Frame
from sim.files.can_log import LogWriter, open_log


class FrameCounter:
    """Counts the frames of each kind on a bus, and writes every frame to the open logs."""

    def __init__(self) -> None:
        self._kinds: dict[type, int] = {}
        self._logs: list[LogWriter] = []

    def open(self, paths: Sequence[Path]) -> None:
        """From now on, write frames to these files too."""
        self._logs = [open_log(path) for path in paths]

    def tap(self, t_us: int, frame: Frame) -> None:
        """Handle one frame of the wire."""
        _, message = decode_once(frame)
        kind = type(message)
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        for log in self._logs:
            log.write(t_us, frame)

    @property
    def kinds(self) -> Counter[str]:
        """Number of frames of each kind of message."""
        return Counter({kind.__name__: count for kind, count in self._kinds.items()})

    @property
    def malformed(self) -> int:
        """Number of frames of known groups that could not be decoded."""
        return self._kinds.get(Malformed, 0)

    def close(self) -> None:
        """Close the logs. Counts stay."""
        for log in self._logs:
            log.close()
