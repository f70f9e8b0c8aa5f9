"""Records sqlite's writes, truncations and syncs in order, so that a power cut can be simulated
exactly.

A ctypes shim over sqlite's default VFS. The original opens the files, and three of their methods
are replaced by ones that record their arguments and pass them on. It works if Python's sqlite3 is
linked with a shared libsqlite3 (Linux distributions; see `available()`). It records one connection
with `locking_mode=EXCLUSIVE`, which keeps the index of the write-ahead log in memory.
"""

import ctypes
import sqlite3
from collections.abc import Callable
from ctypes import CFUNCTYPE, POINTER, Structure, c_char_p, c_int, c_int64, c_void_p
from pathlib import Path
from typing import Any, NamedTuple

NAME = b"recording"
POINTERS = 18  # members of sqlite3_io_methods after the version, version 3
Write = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int, c_int64)
Truncate = CFUNCTYPE(c_int, c_void_p, c_int64)
Sync = CFUNCTYPE(c_int, c_void_p, c_int)
Open = CFUNCTYPE(c_int, c_void_p, c_void_p, c_void_p, c_int, c_void_p)
Delete = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int)
WRITE, TRUNCATE, SYNC = 2, 3, 4  # places in sqlite3_io_methods


class _Methods(Structure):
    _fields_ = (("version", c_int), ("calls", c_void_p * POINTERS))


class _Vfs(Structure):
    _fields_ = (
        ("version", c_int), ("file_size", c_int), ("path_max", c_int), ("next", c_void_p),
        ("name", c_char_p), ("data", c_void_p), ("open", c_void_p), ("delete", c_void_p),
        ("others", c_void_p * 14),
    )  # fmt: skip


class VfsCall(NamedTuple):
    """One call of sqlite on one file."""

    file: str  # name without folder
    kind: str  # write, truncate, delete, sync, ack
    # Offset of a write, size after a truncation, 1 for a durable deletion, number of an ack.
    at: int = 0
    data: bytes = b""


def available() -> bool:
    """Whether Python's sqlite3 can be recorded: the same shared library is loaded by name."""
    try:
        return bool(_library().sqlite3_libversion().decode() == sqlite3.sqlite_version)
    except (OSError, AttributeError):
        return False


def _library() -> Any:
    library = ctypes.CDLL("libsqlite3.so.0")
    library.sqlite3_libversion.restype = c_char_p
    library.sqlite3_vfs_find.argtypes = [c_char_p]
    library.sqlite3_vfs_find.restype = POINTER(_Vfs)
    library.sqlite3_vfs_register.argtypes = [POINTER(_Vfs), c_int]
    library.sqlite3_vfs_unregister.argtypes = [POINTER(_Vfs)]
    return library


class VfsRecording:
    """While entered, every sqlite file opened in this process is recorded."""

    def __init__(self) -> None:
        self.steps: list[VfsCall] = []
        self._library = _library()
        self._names: dict[int, str] = {}
        self._tables: dict[int, _Methods] = {}  # by file; sqlite keeps pointers into them
        self._calls: list[Any] = []  # ctypes callbacks must outlive their use
        self._original = self._library.sqlite3_vfs_find(None)
        self._vfs = _Vfs.from_buffer_copy(self._original.contents)
        self._vfs.name = NAME
        self._open = Open(self._original.contents.open)
        self._vfs.open = self._keep(Open, self._opened)
        self._delete = Delete(self._original.contents.delete)
        self._vfs.delete = self._keep(Delete, self._deleted)

    def __enter__(self) -> "VfsRecording":
        self._library.sqlite3_vfs_register(ctypes.byref(self._vfs), 1)
        return self

    def __exit__(self, *_: object) -> None:
        self._library.sqlite3_vfs_unregister(ctypes.byref(self._vfs))
        self._library.sqlite3_vfs_register(self._original, 1)

    def acknowledge(self, number: int) -> None:
        """The journal has just returned from write `number`."""
        self.steps.append(VfsCall("", "ack", number))

    def _keep(self, kind: Callable[[Any], Any], call: Callable[..., int]) -> int:
        wrapped = kind(call)
        self._calls.append(wrapped)
        return ctypes.cast(wrapped, c_void_p).value or 0

    def _opened(self, vfs: int, name: int, file: int, flags: int, out: int) -> int:
        code = self._open(ctypes.addressof(self._original.contents), name, file, flags, out)
        methods = ctypes.cast(file, POINTER(POINTER(_Methods))).contents
        if code == 0 and methods and name:
            self._names[file] = Path(ctypes.string_at(name).decode()).name
            table = self._tables[file] = self._watched(methods.contents)
            ctypes.cast(file, POINTER(c_void_p))[0] = ctypes.addressof(table)
        return int(code)

    def _deleted(self, vfs: int, name: int, durably: int) -> int:
        self.steps.append(VfsCall(Path(ctypes.string_at(name).decode()).name, "delete", durably))
        return int(self._delete(ctypes.addressof(self._original.contents), name, durably))

    def _watched(self, original: _Methods) -> _Methods:
        table = _Methods.from_buffer_copy(original)
        write, truncate = Write(table.calls[WRITE]), Truncate(table.calls[TRUNCATE])
        sync = Sync(table.calls[SYNC])

        def on_write(file: int, data: int, size: int, at: int) -> int:
            self._note(file, "write", at, ctypes.string_at(data, size))
            return int(write(file, data, size, at))

        def on_truncate(file: int, size: int) -> int:
            self._note(file, "truncate", size)
            return int(truncate(file, size))

        def on_sync(file: int, flags: int) -> int:
            self._note(file, "sync")
            return int(sync(file, flags))

        table.calls[WRITE] = self._keep(Write, on_write)
        table.calls[TRUNCATE] = self._keep(Truncate, on_truncate)
        table.calls[SYNC] = self._keep(Sync, on_sync)
        return table

    def _note(self, file: int, kind: str, at: int = 0, data: bytes = b"") -> None:
        self.steps.append(VfsCall(self._names[file], kind, at, data))
