"""The CAN frames of a log or of a run folder. What reads a format is imported where a file needs it."""

import sys
from collections.abc import Callable, Iterator
from itertools import count, islice
from pathlib import Path

from agent.runtime.files.given_file import check_regular
from protocol.frames.frame import Frame
from sim.files.candump import FrameColumns, read_columns
from sim.files.log_parts import parts_of

ROWS = 4096  # of a log that is read frame by frame
BYTES_MAX = 8  # of a classic frame
SILENCE_S = 10.0  # a longer gap of a log, as of a clock that was set, is played as one of this
SECONDS_MAX = 1e12  # of a time in a log, as candump logs have it: 30,000 years


NO_LOG = "no such log, and no run folder with a can.log or run.mcap in it"


class SourceError(Exception):
    """One line for the person."""


def frames_of(
    source: Path, other: Callable[[], object] = lambda: None
) -> Iterator[tuple[int, Frame]]:
    """Frames of a run folder, a candump log, an MCAP, or any log python-can reads (.asc .blf .csv
    .trc). `other` is called for each frame with an 11-bit identifier, and for each remote, error or
    CAN FD frame. SourceError, also where there is no frame in it."""
    for columns in columns_of(source, other):
        yield from columns.rows()


def columns_of(source: Path, other: Callable[[], object] = lambda: None) -> Iterator[FrameColumns]:
    """The frames of `frames_of`, some thousand at a time. SourceError."""
    path = source / "can.log" if source.is_dir() else source
    if source.is_dir() and not path.is_file():
        path = source / "run.mcap"
    if not path.is_file():
        raise SourceError(f"{source}: {NO_LOG}")
    empty = True
    for columns in _of_candump(path, other) if path.suffix == ".log" else _of_rows(path, other):
        empty = empty and not columns.t_us
        yield columns
    if empty:
        raise SourceError(f"{source}: no CAN frame is in it: not a log, or nothing was said")


def _of_candump(path: Path, other: Callable[[], object]) -> Iterator[FrameColumns]:
    damaged, frames = count(), False
    try:
        for part in parts_of(path):
            for columns in read_columns(part, lambda: next(damaged), other):
                frames = frames or bool(columns.t_us)
                yield columns
    except OSError as problem:
        raise SourceError(f"{path}: cannot be read: {problem.strerror}") from None
    if (lines := next(damaged)) and frames:
        print(f"headland: {path}: {lines} damaged lines are left out", file=sys.stderr)


def _of_rows(path: Path, other: Callable[[], object]) -> Iterator[FrameColumns]:
    rows = _frames_of(path, other)
    while some := list(islice(rows, ROWS)):
        yield FrameColumns(
            [t_us for t_us, _ in some],
            [frame.identifier for _, frame in some],
            bytes([len(frame.data) for _, frame in some]),
            b"".join([frame.data.ljust(8, b"\0") for _, frame in some]),
        )


def _frames_of(path: Path, other: Callable[[], object]) -> Iterator[tuple[int, Frame]]:
    if path.suffix == ".mcap":
        from sim.record.mcap_log import McapMissing, read_frames

        try:
            for part in parts_of(path):
                yield from read_frames(part)
        except (McapMissing, ValueError) as problem:
            raise SourceError(f"{path}: {problem}") from None
        except OSError as problem:
            raise SourceError(f"{path}: cannot be read: {problem.strerror}") from None
        return
    import can  # every reader that it has

    try:
        check_regular(path)
        for message in can.LogReader(path):
            beyond = message.is_error_frame or message.is_remote_frame or message.is_fd
            # The .csv of python-can does not say which frames are of CAN FD: their length does.
            beyond = beyond or len(message.data) > BYTES_MAX
            if not abs(message.timestamp) < SECONDS_MAX:
                raise ValueError(f"a time of {message.timestamp:g} s")
            if message.is_extended_id and not beyond:
                yield (
                    round(message.timestamp * 1e6),
                    Frame(message.arbitration_id, bytes(message.data)),
                )
            else:
                other()
    except UnicodeDecodeError:
        raise SourceError(f"{path}: not a CAN log: it is no text, as {path.suffix} is") from None
    except Exception as problem:  # log readers raise any exception on files of another kind
        raise SourceError(f"{path}: not a CAN log: {_first_line(problem)}") from None


def _first_line(problem: Exception) -> str:
    lines = str(problem).splitlines()
    return lines[0] if lines else type(problem).__name__
