"""A robot's durable memory on disk: sqlite, write-ahead log, synchronous FULL.

One row a key. `write` returns when the rows would survive a power cut; sqlite reports what it could
not do as an error, which is an OSError here and the end of moving for this robot.
"""

import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path

from agent.effects import Persist


class SqliteJournal:
    def __init__(self, path: Path) -> None:
        """OSError where the file cannot be opened or is not a journal."""
        self.path = path
        try:
            self._database = sqlite3.connect(path, isolation_level=None)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=FULL")
            self._database.execute(
                "CREATE TABLE IF NOT EXISTS record (key TEXT PRIMARY KEY, value BLOB NOT NULL)"
            )
        except sqlite3.Error as problem:
            raise OSError(f"{path}: {problem}") from None

    def load(self) -> Mapping[str, bytes]:
        try:
            return dict(self._database.execute("SELECT key, value FROM record"))
        except sqlite3.Error as problem:
            raise OSError(f"{self.path}: {problem}") from None

    def write(self, records: Iterable[Persist]) -> None:
        """All of them or none."""
        try:
            with self._database:
                self._database.execute("BEGIN")
                self._database.executemany(
                    "INSERT INTO record VALUES (?, ?) "
                    "ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                    records,
                )
        except sqlite3.Error as problem:
            raise OSError(f"{self.path}: {problem}") from None

    def close(self) -> None:
        self._database.close()
