"""The CAN frames of a log or of a run folder. What reads a format is imported where a file needs it."""

import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

from agent.runtime.files.given_file import check_regular
from protocol.frames.frame import Frame
from sim.files.candump import read_candump
from sim.files.log_parts import parts_of


class SourceError(Exception):
    """One line for the person."""


def frames_of(
    source: Path, other: Callable[[], object] = lambda: None
) -> Iterator[tuple[int, Frame]]:
    """Frames of a run folder, a candump log, an MCAP, or any log python-can reads (.asc .blf .csv
    .trc). `other` is called for each frame with an 11-bit identifier, and for each remote or error
    frame. SourceError, also where there is no frame in it."""
    empty = True
    for row in _frames_of(source, other):
        empty = False
        yield row
    if empty:
        raise SourceError(f"{source}: no CAN frame is in it: not a log, or nothing was said")


def _frames_of(source: Path, other: Callable[[], object]) -> Iterator[tuple[int, Frame]]:
    path = source / "can.log" if source.is_dir() else source
    if source.is_dir() and not path.is_file():
        path = source / "run.mcap"
    if not path.is_file():
        raise SourceError(f"{source}: no such log, and no run folder with a can.log in it")
    if path.suffix == ".log":
        damaged = count()
        try:
            frames = False
            for part in parts_of(path):
                for row in read_candump(part, lambda: next(damaged), other):
                    frames = True
                    yield row
        except OSError as problem:
            raise SourceError(f"{path}: cannot be read: {problem.strerror}") from None
        if (lines := next(damaged)) and frames:
            print(f"headland: {path}: {lines} damaged lines are left out", file=sys.stderr)
        return
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
            if message.is_extended_id and not (message.is_error_frame or message.is_remote_frame):
                yield (
                    round(message.timestamp * 1e6),
                    Frame(message.arbitration_id, bytes(message.data)),
                )
            else:
                other()
    except Exception as problem:  # log readers raise any exception on files of another kind
        raise SourceError(f"{path}: not a CAN log: {_first_line(problem)}") from None


def _first_line(problem: Exception) -> str:
    lines = str(problem).splitlines()
    return lines[0] if lines else type(problem).__name__
