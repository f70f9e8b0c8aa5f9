"""Logs of other programs, as python-can writes them: what no robot reads spoils nothing."""

from itertools import count
from pathlib import Path

import can
import pytest

from sim.record.recording import Recording
from tools.inspect.log_frames import SourceError, columns_of, frames_of


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv"])
def test_frames_of_can_fd_leave_the_frames_behind_them_as_they_are(
    tmp_path: Path, suffix: str
) -> None:
    """The .csv of python-can does not say that a frame is of CAN FD. Its 64 bytes were kept as
    those of eight frames: `inspect` gave every frame behind it the data of others, and `map` and
    `report` ended with "zip() argument 3 is longer"."""
    path = tmp_path / f"mixed{suffix}"
    writer = can.Logger(path)
    for number in range(6):
        data = bytes([number]) * (64 if number % 3 == 2 else 8)
        writer(can.Message(number, 0xCFF1080, True, is_fd=len(data) > 8, data=data, channel=0))
    writer.stop()
    others, recording = count(), Recording()
    for columns in columns_of(path, lambda: next(others)):
        recording.extend(columns)
    assert [frame.data for _, frame in recording.rows()] == [bytes([k]) * 8 for k in (0, 1, 3, 4)]
    assert next(others) == 2


@pytest.mark.parametrize("time", ["1e300", "-1e300", "inf", "nan"])
def test_a_time_that_cannot_be_is_one_line(tmp_path: Path, time: str) -> None:
    path = tmp_path / "odd.csv"
    path.write_text(
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
        f"{time},0xcff1080,1,0,0,8,AAAAAAAAAAA=\n"
    )
    with pytest.raises(SourceError, match=r"not a CAN log: a time of .* s$"):
        list(frames_of(path))
