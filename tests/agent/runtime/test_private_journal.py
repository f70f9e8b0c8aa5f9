"""Journals of robots, which may hold the fleet's secrets, are for their user alone."""

import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.interface.effects import Persist
from agent.peer.journal_recovery import LOST
from agent.runtime.files import private_file
from agent.runtime.sqlite_journal import SqliteJournal

SECRET = [Persist("keys", bytes(34))]


@pytest.fixture(autouse=True)
def open_to_all() -> Iterator[None]:
    """The user's programs make files that all may read and write, if they do not care."""
    old = os.umask(0)
    yield
    os.umask(old)


def widened(folder: Path) -> list[Path]:
    found = sorted(path for path in folder.iterdir() if not path.is_symlink())
    return [path for path in found if path.stat().st_mode & 0o077]


def left_by_an_earlier_version(path: Path) -> None:
    """A journal that all may read, with its log, as after a crash."""
    journal = SqliteJournal(path)
    journal.write(SECRET)
    image = {file: file.read_bytes() for file in path.parent.iterdir()}
    journal.close()
    for file, content in image.items():
        file.unlink(missing_ok=True)
        file.write_bytes(content)
        file.chmod(0o666)
    assert len(widened(path.parent)) == 3, "the database, its log and the mark"


def test_a_journal_is_for_its_user_alone_from_the_first_byte_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, connect = tmp_path / "robot0.sqlite", sqlite3.connect
    seen: list[int] = []

    def connected(*args: object, **options: object) -> sqlite3.Connection:
        seen.append(path.stat().st_mode & 0o777)
        return connect(*args, **options)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(sqlite3, "connect", connected)
    journal, recalled = SqliteJournal.opened(path)
    assert seen == [0o600] and not recalled and not str(journal.narrowed)
    journal.write(SECRET)
    assert len(list(tmp_path.iterdir())) == 3 and not widened(tmp_path)
    journal.close()
    assert SqliteJournal.opened(path)[1] == {"keys": bytes(34)}


def test_a_journal_that_others_could_read_becomes_private_and_it_is_said(tmp_path: Path) -> None:
    path = tmp_path / "robot0.sqlite"
    left_by_an_earlier_version(path)
    journal, recalled = SqliteJournal.opened(path)
    assert recalled == {"keys": bytes(34)} and not widened(tmp_path)
    assert "others could read it" in str(journal.narrowed) and "2 more" in str(journal.narrowed)
    journal.close()


def test_a_journal_that_is_put_aside_and_the_new_one_are_private(tmp_path: Path) -> None:
    path = tmp_path / "robot0.sqlite"
    left_by_an_earlier_version(path)
    (tmp_path / "robot0.sqlite-wal").unlink()
    path.write_bytes(b"no journal at all, but long enough to be looked at" * 100)
    journal, recalled = SqliteJournal.opened(path)
    assert [*recalled] == [LOST] and (tmp_path / "robot0.sqlite.unreadable1").exists()
    journal.write(SECRET)
    assert not widened(tmp_path)
    assert str(journal.narrowed)
    journal.close()


def test_a_link_that_leads_nowhere_makes_a_private_journal(tmp_path: Path) -> None:
    path, disk = tmp_path / "robot0.sqlite", tmp_path / "disk"
    disk.mkdir(0o700)
    path.symlink_to(disk / "journal")
    journal, _ = SqliteJournal.opened(path)
    journal.write(SECRET)
    assert (disk / "journal").exists() and not widened(disk)
    journal.close()


def test_what_a_link_leads_to_that_is_no_journal_keeps_its_rights(tmp_path: Path) -> None:
    path, letter = tmp_path / "robot0.sqlite", tmp_path / "letter"
    letter.write_text("Dear Sir or Madam, " * 100)
    letter.chmod(0o644)
    path.symlink_to(letter)
    journal, _ = SqliteJournal.opened(path)
    journal.close()
    assert letter.stat().st_mode & 0o777 == 0o644 and letter.read_text().startswith("Dear")


def test_a_journal_of_another_user_that_others_may_read_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot0.sqlite"
    left_by_an_earlier_version(path)
    monkeypatch.setattr(Path, "chmod", forbidden)
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    with pytest.raises(OSError, match=r"another user's: chmod 600 .*robot0\.sqlite"):
        SqliteJournal.opened(path)
    monkeypatch.undo()
    SqliteJournal.opened(path)[0].close()  # it was let go, and nothing was put aside


def test_a_file_system_without_modes_keeps_a_journal_and_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot0.sqlite"
    left_by_an_earlier_version(path)
    monkeypatch.setattr(Path, "chmod", forbidden)
    journal, recalled = SqliteJournal.opened(path)
    assert recalled and "this file system keeps no modes" in str(journal.narrowed)
    journal.close()
    monkeypatch.setattr(private_file, "MODES", False)  # as on Windows
    journal, recalled = SqliteJournal.opened(path)
    assert recalled and not str(journal.narrowed)
    journal.close()


def forbidden(path: Path, mode: int) -> None:
    """FAT says so, and every file system does for the file of another user."""
    raise PermissionError(1, "Operation not permitted", str(path))
