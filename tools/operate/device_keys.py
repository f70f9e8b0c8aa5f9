"""The keys of a device that stops or orders robots for hours: an open map, a conversation, a held stop.

Meanwhile the owner may give the fleet other keys, another tool may count on with the same file, and the
frames that were reserved may be used up. Robots believe nothing that is signed with old keys, or under a
counter that is not above all they have heard.
"""

from pathlib import Path

from agent.runtime.files.key_file import (
    OPERATOR,
    RESERVE,
    KeyFile,
    KeyFileError,
    counter,
    read,
    read_panel,
)
from protocol.authentication import Keyring


class DeviceKeys:
    """The keyring of a device, which follows its key file."""

    def __init__(self, path: Path, kind: str | None = None) -> None:
        """`path`: a file, or the folder that has it. `kind`: OPERATOR, or None for a stop panel, which
        cannot release whatever file it has, or an operator's device if the file is an operator's.

        Raises KeyFileError, also if an operator's counter cannot be reserved."""
        self._path, self._kind = path, kind
        self._file = self._read()
        self._seen = file_stamp(self._file.path)
        self.keyring: Keyring | None = self._file.keyring()
        self._end = self.keyring.sent + RESERVE  # of the frames that are reserved

    def begin(self) -> Keyring | None:
        """The keyring for a press or a phrase: of the newest file, and above what other tools with this
        file have signed. None where an operator's counter cannot be reserved now."""
        self._follow()
        last = self.keyring is not None and self._counted() == self._end  # to have signed with it
        if self._file.kind == OPERATOR and not last:
            self._reserve()
        return self.keyring

    def newest(self) -> Keyring | None:
        """The keyring for the next frame, in the midst of a press or a phrase."""
        self._follow()
        used_up = self.keyring is not None and self.keyring.sent >= self._end
        if self._file.kind == OPERATOR and used_up:
            self._reserve()  # one that fails is tried again at the next press: it may wait for a disk
        return self.keyring

    def _read(self) -> KeyFile:
        if self._kind is None and (self._path.is_dir() or read(self._path).kind != OPERATOR):
            return read_panel(self._path)
        return read(self._path, OPERATOR)

    def _follow(self) -> None:
        """Take the keys of a file that was replaced. One that is gone or damaged changes nothing."""
        stamp = file_stamp(self._file.path)
        if stamp == self._seen:
            return
        try:
            found = self._read()
        except KeyFileError:
            return
        self._file, self._seen = found, stamp
        if found.kind == OPERATOR:
            self._reserve()
        elif self.keyring is not None:
            self.keyring.rekey(found.keys)  # robots know the counter of a panel over a rotation

    def _counted(self) -> int:
        try:
            return counter(self._file.path)
        except KeyFileError:
            return -1

    def _reserve(self) -> None:
        """A keyring that counts on after all that was reserved with this file."""
        try:
            self.keyring = self._file.keyring()
        except KeyFileError:
            self.keyring = None  # what follows is said unsigned: robots brake for such a stop, too
            return
        self._end = self.keyring.sent + RESERVE


def file_stamp(path: Path) -> tuple[int, int]:
    """Changes when the file is replaced or written; (0, 0) where it is gone."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_ino, found.st_mtime_ns
