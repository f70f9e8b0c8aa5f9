"""What is on a simulated bus: frames counted by kind, and written to logs."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from protocol.codec import Malformed, decode_once
from protocol.frame import Frame
from sim.can_log import LogWriter, open_log


class BusTally:
    def __init__(self) -> None:
        self.kinds: Counter[str] = Counter()
        self.malformed = 0
        self._logs: list[LogWriter] = []

    def open(self, paths: Sequence[Path]) -> None:
        """From now on frames are written there, too."""
        self._logs = [open_log(path) for path in paths]

    def tap(self, t_us: int, frame: Frame) -> None:
        """One frame of the wire."""
        _, message = decode_once(frame)
        self.kinds[type(message).__name__] += 1
        self.malformed += isinstance(message, Malformed)
        for log in self._logs:
            log.write(t_us, frame)

    def close(self) -> None:
        for log in self._logs:
            log.close()
