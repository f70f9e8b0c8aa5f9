"""A robot's durable memory on disk: sqlite, write-ahead log, synchronous FULL.

Each key has one row, with a checksum, because sqlite checks its log but not its pages. `write`
returns when the rows would survive a power cut. A failure of sqlite becomes an OSError here, after
which this robot does not move any more.

Sqlite rolls back a log that was cut short without an error: what is left is whole and valid, but
old. So each write has a number, which is kept in two places. The journal's own number is part of
the transaction. The mark is a small file beside it, written and synced after the commit and before
`write` returns. Nothing of a write is revealed before both are durable. After a crash between the
two the journal is one ahead of the mark, which is sound. A journal behind its mark has lost data
that were revealed. If it is further ahead, its mark cannot be trusted. In both cases the memory is
lost. A journal and a mark that are both replaced by older copies of themselves cannot be told from
sound ones.

What a full disk does not take is gone at the next start, and the newest state that it took may be from
before a stop. So a failed write is noted in the mark, in place, where it needs no more room. The robot
then starts latched, with all that the disk took.

An open file that is deleted, or moved away with its folder, can still be written, and nothing of that is
there after a restart. So each write looks whether the paths still lead to the files that are open.

After `headland keys rotate --running` the journal holds the fleet's secrets. So all its files are for
their user alone from the first byte on, and those of an earlier version become so. SQLite gives its log
and its index the mode of the database.
"""

import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from struct import Struct
from zlib import crc32

from agent.interface.effects import Persist
from agent.peer.journal_recovery import LOST, senseless
from agent.runtime.files.private_file import OWNER, Narrowed, make_private, narrow
from agent.safety.stop_controller import HOLD_KEY, LATCHED

CHECK_SIZE = 4  # bytes of CRC-32 before each value
NEWEST = "journal/newest"  # the record with the number of the newest write
NUMBER = Struct("<Q")
MARK = Struct("<QI")  # the same number in the mark, and its CRC-32
MARK_PLACES, MARK_SPACING = 2, 4096  # numbers alternate between two places, a page of a disk apart
FAILED_AT = MARK_PLACES * MARK_SPACING  # of the third place: whether a write has failed
FAILED = b"a write has failed"
MARK_BYTES = FAILED_AT + MARK_SPACING
MARK_SUFFIX = "-mark"
SUFFIXES = ("", "-wal", "-shm", MARK_SUFFIX)  # of the files of a journal
LAG_MAX = 1  # writes that the mark may be behind: a crash between the commit and the mark
FULL = 2  # the value of sqlite's PRAGMA synchronous for FULL
NOT_TO_BE_HAD = {  # errors of access to the file; any other is about its contents
    sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY, sqlite3.SQLITE_INTERRUPT, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PROTOCOL, sqlite3.SQLITE_NOLFS, sqlite3.SQLITE_AUTH,
}  # fmt: skip
# Offset and largest known value in the header of a database (sqlite.org/fileformat.html).
WRITE_VERSION_AT, WRITE_VERSION_MAX = 18, 2
PROBLEMS = (sqlite3.Error, UnicodeDecodeError)  # the second one for damaged text


class UnreadableError(OSError):
    """The file exists and its contents are lost: its robot has lost its memory."""


class InUseError(OSError):
    """Another process has the journal open."""


class Mark:
    """The number of the newest write, and whether one has failed, in a file of its own."""

    def __init__(self, path: Path) -> None:
        """Reads the file if it exists. Raises OSError if it cannot be read."""
        self.path = path
        self._file: int | None = None
        self.number = 0  # the newest that can be read; 0: none
        self.failed = False  # a write failed, and nobody has accounted for it
        with suppress(FileNotFoundError):
            image = path.read_bytes()[:MARK_BYTES]
            self.failed = image[FAILED_AT:].startswith(FAILED)
            for place in range(MARK_PLACES):
                raw = image[place * MARK_SPACING :][: MARK.size]
                if len(raw) == MARK.size:
                    number, check = MARK.unpack(raw)
                    if check == crc32(raw[: NUMBER.size]) and number % MARK_PLACES == place:
                        self.number = max(self.number, number)

    def set(self, number: int) -> None:
        """Write the number; it is durable when this returns. Raises OSError."""
        raw = NUMBER.pack(number)
        self._put(number % MARK_PLACES * MARK_SPACING, MARK.pack(number, crc32(raw)))
        self._sync()
        self.number = number

    def fail(self, failed: bool = True) -> None:
        """Note that a write has failed, or that this was accounted for; durable when this returns. Raises
        OSError.
        """
        self._put(FAILED_AT, FAILED if failed else bytes(len(FAILED)))
        self._sync()
        self.failed = failed

    def close(self) -> None:
        """Close the file; `set` opens it again."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _put(self, at: int, data: bytes) -> None:
        if self._file is None:
            self._file = self._opened()
        os.pwrite(self._file, data, at)

    def _sync(self) -> None:
        assert self._file is not None
        os.fdatasync(self._file)

    def _opened(self) -> int:
        """Open the file. It gets the room for all places first, so that a full disk does no harm
        later.
        """
        file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, OWNER)
        size = os.fstat(file).st_size
        if size < MARK_BYTES:
            os.pwrite(file, bytes(MARK_BYTES - size), size)
            os.fsync(file)
            folder = os.open(self.path.parent, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        return file


class SqliteJournal:
    """The durable memory of one robot in one file, which only one process can open."""

    def __init__(self, path: Path) -> None:
        """Open the file or create it.

        Raises UnreadableError if the file is no journal (any more), and OSError if it cannot be
        accessed, or if others may read it and it is another user's.
        """
        self.path = path
        self.mark = Mark(path.with_name(path.name + MARK_SUFFIX))
        self._number: int | None = None  # of the newest write; None: not read yet
        self._opened: dict[Path, tuple[int, int]] = {}  # device and inode of each file that is open
        make_private(path)
        try:
            self._database = sqlite3.connect(path, isolation_level=None, timeout=0.0)
        except PROBLEMS as problem:
            raise self._error(problem) from None
        try:
            # Exclusive access: a second process with this journal is refused.
            self._database.execute("PRAGMA locking_mode=EXCLUSIVE")
            (mode,) = self._database.execute("PRAGMA journal_mode=WAL").fetchone()
            self._database.execute("PRAGMA synchronous=FULL")
            (synchronous,) = self._database.execute("PRAGMA synchronous").fetchone()
            if (mode, synchronous) != ("wal", FULL):
                raise OSError(f"{path}: this file system keeps no durable journal ({mode})")
            self._database.execute(
                "CREATE TABLE IF NOT EXISTS record (key TEXT PRIMARY KEY, value BLOB NOT NULL)"
            )
            # A journal that can be read and not written cannot keep a stop.
            self._database.execute("BEGIN")
            self._database.execute("INSERT OR REPLACE INTO record VALUES ('', x'')")
            self._database.execute("ROLLBACK")
        except PROBLEMS as problem:
            self._database.close()
            # Only now, because a header that a power cut has torn is whole in the log.
            if _header_forbids_writing(path):
                raise UnreadableError(f"{path}: its header forbids writing") from None
            raise self._error(problem) from None
        try:  # only now, because what a link leads to may be no journal
            self.narrowed: Narrowed = narrow(_parts_of(path))
            self._note(path)
            real = path.resolve()  # SQLite puts its log beside the file that a link leads to
            self._log = real.with_name(real.name + "-wal")
        except OSError:
            self._database.close()
            raise

    @classmethod
    def opened(cls, path: Path) -> tuple["SqliteJournal", Mapping[str, bytes]]:
        """Open a journal and load it: the journal, and its records by key.

        An unreadable one is put aside for people to inspect. The new one then has one
        record, `LOST`, with the reason. After a write that failed its robot is latched. Raises OSError.
        """
        try:
            journal = cls(path)
            try:
                recalled = journal.load()
            except UnreadableError:
                journal.close()
                raise
        except UnreadableError as problem:
            put_aside(path)
            return cls._without_memory(cls(path), str(problem))
        if not recalled and _aside(path, 1).exists():  # a crash while it was put aside
            return cls._without_memory(journal, "an earlier journal was put aside")
        if journal.mark.failed:
            journal.write([Persist(HOLD_KEY, LATCHED)])
            journal.mark.fail(False)
            return journal, journal.load()
        return journal, recalled

    @staticmethod
    def _without_memory(
        journal: "SqliteJournal", why: str
    ) -> tuple["SqliteJournal", Mapping[str, bytes]]:
        journal.write([Persist(LOST, why.encode())])
        return journal, journal.load()

    def load(self) -> Mapping[str, bytes]:
        """The newest value of each key.

        Raises UnreadableError if records are missing, damaged or contradict each other.
        """
        records = self._rows()
        number = self._numbered(records.pop(NEWEST, None))
        if not 0 <= number - self.mark.number <= LAG_MAX:
            raise UnreadableError(
                f"{self.path}: its newest write has number {number}, and {self.mark.path.name} "
                f"says {self.mark.number}: it was rolled back"
            )
        if why := senseless(records):
            raise UnreadableError(f"{self.path}: {why}")
        self._number = number
        return records

    def write(self, records: Iterable[Persist]) -> None:
        """Write all of the records or none; they are durable when this returns.

        Raises OSError, also if a file of the journal was deleted or replaced while it was open."""
        self.exchange((), records)

    def exchange(self, gone: Iterable[str], records: Iterable[Persist]) -> None:
        """As `write`, and the records with the keys `gone` are removed before. Raises OSError."""
        try:
            self._write(gone, records)
        except OSError:
            with suppress(OSError):
                self.mark.fail()
            raise

    def _write(self, gone: Iterable[str], records: Iterable[Persist]) -> None:
        if self._number is None:
            self.load()
        assert self._number is not None
        if self.mark.number < self._number:  # after a crash between a commit and its mark
            self.mark.set(self._number)  # a second such crash must not leave the mark two behind
        number = self._number + 1
        rows = [(key, _checked(key, value)) for key, value in records]
        rows.append((NEWEST, _checked(NEWEST, NUMBER.pack(number))))
        try:
            with self._database:
                self._database.execute("BEGIN")
                self._database.executemany(
                    "DELETE FROM record WHERE key = ?", [(key,) for key in gone]
                )
                self._database.executemany(
                    "INSERT INTO record VALUES (?, ?) "
                    "ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                    rows,
                )
        except PROBLEMS as problem:
            raise self._error(problem) from None
        self._number = number
        self.mark.set(number)
        for part in (self.path, self._log, self.mark.path):
            self._note(part)

    def _note(self, part: Path) -> None:
        """Note which file this is; raises OSError if it is another one than before, or none. An inode is
        not used again while its file is open."""
        try:
            found = part.stat()
        except FileNotFoundError:
            raise OSError(f"{part}: it was deleted while it was open") from None
        file = found.st_dev, found.st_ino
        if self._opened.setdefault(part, file) != file:
            raise OSError(f"{part}: it was replaced while it was open")

    def _rows(self) -> dict[str, bytes]:
        try:  # the check compares rows with their index, so it notices a missing row
            ((verdict,), *_) = self._database.execute("PRAGMA integrity_check(1)").fetchall()
            rows = self._database.execute("SELECT key, value FROM record").fetchall()
        except PROBLEMS as problem:
            raise self._error(problem) from None
        if verdict != "ok":
            raise UnreadableError(f"{self.path}: {verdict}")
        records: dict[str, bytes] = {}
        for key, row in rows:
            text = isinstance(key, str) and isinstance(row, bytes)
            if not text or row != _checked(key, row[CHECK_SIZE:]):
                raise UnreadableError(f"{self.path}: record {key!r} is damaged")
            records[key] = row[CHECK_SIZE:]
        return records

    def _numbered(self, raw: bytes | None) -> int:
        """The number in a record; 0 for a journal from before there were numbers."""
        if raw is not None and len(raw) != NUMBER.size:
            raise UnreadableError(f"{self.path}: record {NEWEST!r} makes no sense")
        return 0 if raw is None else int(NUMBER.unpack(raw)[0])

    def close(self) -> None:
        """Close the database and the mark."""
        self._database.close()
        self.mark.close()

    def _error(self, problem: Exception) -> OSError:
        code = getattr(problem, "sqlite_errorcode", 0) & 0xFF
        if code == sqlite3.SQLITE_BUSY:  # "database is locked", by its exclusive owner
            return InUseError(
                f"{self.path}: another process has it open; this robot may already run"
            )
        kind = OSError if code in NOT_TO_BE_HAD else UnreadableError
        return kind(f"{self.path}: {problem}")


def _header_forbids_writing(path: Path) -> bool:
    """Whether sqlite would open this file read-only, because of a later write version."""
    with suppress(OSError), path.open("rb") as file:
        header = file.read(WRITE_VERSION_AT + 1)
        return len(header) > WRITE_VERSION_AT and header[WRITE_VERSION_AT] > WRITE_VERSION_MAX
    return False


def _checked(key: str, value: bytes) -> bytes:
    return crc32(value, crc32(key.encode())).to_bytes(CHECK_SIZE, "little") + value


def put_aside(path: Path) -> None:
    """Rename a journal with its log and mark. It is never deleted, because people may want to
    inspect it.
    """
    number = 1
    while (aside := _aside(path, number)).exists():
        number += 1
    # A file without its log could pass for an older state, and one without its mark for a journal
    # from before there were marks.
    for suffix in SUFFIXES:
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(aside.with_name(aside.name + suffix))


def _parts_of(path: Path) -> Iterator[Path]:
    """The files of a journal, and of those that were put aside before it."""
    journals, number = [path], 1
    while (aside := _aside(path, number)).exists():
        journals.append(aside)
        number += 1
    for journal in journals:
        if journal is path or not journal.is_symlink():
            # Behind a link may be a file of something else.
            yield from (journal.with_name(journal.name + suffix) for suffix in SUFFIXES)


def _aside(path: Path, number: int) -> Path:
    return path.with_name(f"{path.name}.unreadable{number}")
