"""Files are there whole or not at all, whatever ends the command that writes them."""

import errno
import os
from pathlib import Path

import pytest

from sim.files.whole_file import whole_file, write_whole

FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("end", [FULL, KeyboardInterrupt()])
@pytest.mark.parametrize("before", ["what was there", None])
def test_what_ends_half_way_leaves_what_was_there(
    tmp_path: Path, end: BaseException, before: str | None
) -> None:
    path = tmp_path / "work.geojson"
    if before is not None:
        path.write_text(before)
    with pytest.raises(type(end)), whole_file(path) as part:
        part.write_text("half of")
        raise end
    assert [file.read_text() for file in tmp_path.iterdir()] == ([] if before is None else [before])


def test_an_error_names_the_file_that_was_wanted(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with pytest.raises(OSError) as told, whole_file(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert told.value.filename == str(path)
    with pytest.raises(FileNotFoundError) as told:
        write_whole(tmp_path / "none" / "a.csv", "x")
    assert told.value.filename == str(tmp_path / "none" / "a.csv")


def test_an_error_below_a_file_names_the_file_that_was_wanted(tmp_path: Path) -> None:
    """It named a file .headland-fc4364f23c0c that nobody had asked for: that could not be removed."""
    (tmp_path / "file").write_text("x")
    with pytest.raises(NotADirectoryError) as problem:
        write_whole(tmp_path / "file" / "plan.geojson", "x")
    assert problem.value.filename == str(tmp_path / "file" / "plan.geojson")


def test_permissions_links_and_suffixes_stay(tmp_path: Path) -> None:
    path, link = tmp_path / "a.toml", tmp_path / "link.toml"
    path.write_text("old")
    path.chmod(0o600)
    link.symlink_to(path)
    with whole_file(link) as part:
        assert part.suffix == ".toml" and part.parent == tmp_path and part != path
        part.write_text("new")
    assert link.is_symlink() and path.read_text() == "new" and path.stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_devices_and_pipes_are_written_where_they_are(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_whole(pipe, "through")
        assert os.read(reader, 100) == b"through" and pipe.is_fifo()
    finally:
        os.close(reader)
    with pytest.raises(IsADirectoryError):
        write_whole(tmp_path, "x")


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="root may write all")
def test_a_protected_file_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("mine")
    path.chmod(0o400)
    with pytest.raises(PermissionError):
        write_whole(path, "yours")
    assert path.read_text() == "mine"
