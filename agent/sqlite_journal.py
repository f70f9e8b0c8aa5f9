"""A robot's durable memory on disk: sqlite, write-ahead log, synchronous FULL.

One row a key, with a check sum, because sqlite checks its log but not its pages. `write` returns when
the rows would survive a power cut; sqlite reports what it could not do as an error, which is an
OSError here and the end of moving for this robot.
"""

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from zlib import crc32

from agent.effects import Persist

CHECK_SIZE = 4  # bytes of CRC-32 before each value
FULL = 2  # what sqlite calls synchronous FULL
NOT_TO_BE_HAD = {  # errors about getting at the file; any other is about what is in it
    sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY, sqlite3.SQLITE_INTERRUPT, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PROTOCOL, sqlite3.SQLITE_NOLFS, sqlite3.SQLITE_AUTH,
}  # fmt: skip
PROBLEMS = (sqlite3.Error, UnicodeDecodeError)  # the second where damaged text is decoded


class UnreadableError(OSError):
    """The file is there and what it held is lost. Its robot has lost its memory."""


class SqliteJournal:
    def __init__(self, path: Path) -> None:
        """UnreadableError where the file is no journal (any more), OSError where it is not to be had."""
        self.path = path
        try:
            self._database = sqlite3.connect(path, isolation_level=None, timeout=0.0)
        except PROBLEMS as problem:
            raise self._error(problem) from None
        try:
            # One writer and nobody else: a second process with this journal is refused.
            self._database.execute("PRAGMA locking_mode=EXCLUSIVE")
            (mode,) = self._database.execute("PRAGMA journal_mode=WAL").fetchone()
            self._database.execute("PRAGMA synchronous=FULL")
            (synchronous,) = self._database.execute("PRAGMA synchronous").fetchone()
            if (mode, synchronous) != ("wal", FULL):
                raise OSError(f"{path}: this file system keeps no durable journal ({mode})")
            self._database.execute(
                "CREATE TABLE IF NOT EXISTS record (key TEXT PRIMARY KEY, value BLOB NOT NULL)"
            )
        except PROBLEMS as problem:
            self._database.close()
            raise self._error(problem) from None

    @classmethod
    def opened(cls, path: Path) -> tuple["SqliteJournal", Mapping[str, bytes]]:
        """The journal and what it recalls. An unreadable one is put aside, for whoever wants to
        look into it, and the new one recalls nothing: see `agent/records.py` on lost memory."""
        with suppress(UnreadableError):
            journal = cls(path)
            try:
                return journal, journal.load()
            except UnreadableError:
                journal.close()
        put_aside(path)
        return cls(path), {}

    def load(self) -> Mapping[str, bytes]:
        try:  # the check compares rows with their index, so that a row which is gone is missed
            ((verdict,), *_) = self._database.execute("PRAGMA integrity_check(1)").fetchall()
            rows = self._database.execute("SELECT key, value FROM record").fetchall()
        except PROBLEMS as problem:
            raise self._error(problem) from None
        if verdict != "ok":
            raise UnreadableError(f"{self.path}: {verdict}")
        records: dict[str, bytes] = {}
        for key, row in rows:
            if not isinstance(row, bytes) or row != _checked(key, row[CHECK_SIZE:]):
                raise UnreadableError(f"{self.path}: record {key!r} is damaged")
            records[key] = row[CHECK_SIZE:]
        return records

    def write(self, records: Iterable[Persist]) -> None:
        """All of them or none."""
        rows = [(key, _checked(key, value)) for key, value in records]
        try:
            with self._database:
                self._database.execute("BEGIN")
                self._database.executemany(
                    "INSERT INTO record VALUES (?, ?) "
                    "ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                    rows,
                )
        except PROBLEMS as problem:
            raise self._error(problem) from None

    def close(self) -> None:
        self._database.close()

    def _error(self, problem: Exception) -> OSError:
        code = getattr(problem, "sqlite_errorcode", 0) & 0xFF
        kind = OSError if code in NOT_TO_BE_HAD else UnreadableError
        return kind(f"{self.path}: {problem}")


def _checked(key: str, value: bytes) -> bytes:
    return crc32(value, crc32(key.encode())).to_bytes(CHECK_SIZE, "little") + value


def put_aside(path: Path) -> None:
    """Out of the way of a new journal, with its log. Never deleted: somebody may want to know why."""
    number = 1
    while (aside := path.with_name(f"{path.name}.unreadable{number}")).exists():
        number += 1
    for suffix in ("", "-wal", "-shm"):  # a file without its log could pass for an older state
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(aside.with_name(aside.name + suffix))
