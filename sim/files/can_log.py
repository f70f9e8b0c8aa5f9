"""CAN logs by suffix: we write candump text, python-can writes all others."""

from pathlib import Path
from typing import Protocol

import can

from protocol.frames.frame import Frame
from sim.files.candump import CandumpWriter

SUFFIXES = (".log", ".asc", ".blf", ".csv", ".trc")  # not .db: it loses frames when it is closed


class LogWriter(Protocol):
    """What every log of frames offers, whatever its format."""

    def write(self, t_us: int, frame: Frame) -> None:
        """Append one frame; `t_us` counts from the beginning of the log, in microseconds."""

    def close(self) -> None:
        """Write what is buffered and close the file. Nothing may be written after it."""


class PythonCanWriter:
    """A log in a format that python-can writes, chosen by the suffix of the path."""

    def __init__(self, path: Path) -> None:
        self._writer = can.Logger(path)

    def write(self, t_us: int, frame: Frame) -> None:
        """Append one frame as received on channel 0, with its time in microseconds."""
        self._writer(
            can.Message(t_us / 1e6, frame.identifier, is_extended_id=True, data=frame.data,
                        channel=0, is_rx=True, check=False)
        )  # fmt: skip

    def close(self) -> None:
        """Write what is buffered and close the file."""
        self._writer.stop()


def open_log(path: Path) -> LogWriter:
    """Open a log. OSError if it cannot be written; ValueError for a suffix not in `SUFFIXES`."""
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: a log ends in {', '.join(SUFFIXES)}")
    return CandumpWriter(path) if path.suffix == ".log" else PythonCanWriter(path)
