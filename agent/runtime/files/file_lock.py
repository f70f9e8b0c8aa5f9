"""A lock on an open file that the system frees when its owner dies, on POSIX and on Windows."""

from importlib import import_module
from typing import IO, Any


def lock(file: IO[str], wait: bool = True) -> bool:
    """Take the lock until the file is closed. False where another process holds it and `wait` is False.

    Raises OSError where the file system has no locks.
    """
    try:
        import fcntl
    except ImportError:
        return _lock_windows(file, wait)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True


def _lock_windows(file: IO[str], wait: bool) -> bool:
    """The first byte of the file. `msvcrt` waits ten seconds at most; then it is asked again."""
    try:
        msvcrt: Any = import_module("msvcrt")
    except ImportError:  # a system with neither: nobody else is kept out
        return True
    while True:
        file.seek(0)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
        except OSError:
            if not wait:
                return False
        else:
            return True
