"""The key file by which a program verifies what robots say, read again when the owner has replaced it."""

from pathlib import Path

from agent.runtime.files.key_file import FLEET, NAMES, KeyFileError, panel_path, read_panel
from protocol.authentication import Keys
from tools.common.bus_address import AttachError


class PanelKeys:
    """The file of panels and gateways, or the fleet's, without the operators' secret."""

    def __init__(self, path: Path) -> None:
        """`path`: the file, or the folder that has it. Raises AttachError."""
        self.path = panel_path(path) if panel_path(path).exists() else path
        if self.path.is_dir():
            self.path = path / NAMES[FLEET]  # of a folder of an older version
        self._read_version = self._version()
        self.keys = self._read()

    def renewed(self) -> Keys | None:
        """Other keys than the last, if the file has changed. A file that is wrong, or half written, is
        read at the next look."""
        version = self._version()
        if version == self._read_version:
            return None
        try:
            keys = self._read()
        except AttachError:
            return None
        self._read_version = version
        if keys == self.keys:
            return None
        self.keys = keys
        return keys

    def _version(self) -> tuple[int, int, int]:
        """Inode, size and time of the file: two writes within a tick of the clock have one time."""
        try:
            found = self.path.stat()
        except OSError:
            return (0, 0, 0)
        return (found.st_ino, found.st_size, found.st_mtime_ns)

    def _read(self) -> Keys:
        try:
            return read_panel(self.path).keys
        except KeyFileError as problem:
            raise AttachError(f"--keys {problem}") from None
