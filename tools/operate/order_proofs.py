"""The proofs of transport orders, from an operator's key file.

A desk runs for days: the launch of a warehouse, or the VDA 5050 gateway. Meanwhile the owner may give the
fleet other keys, and the key of a person ends. So `FileProofs` looks at its file before each order. It
takes the new keys, and after the end it proves nothing and says so in one line.
"""

import time
from collections.abc import Callable
from pathlib import Path
from secrets import token_bytes
from typing import Any

from agent.runtime.files.key_file import DEVICE, OPERATOR, KeyFile, KeyFileError, read
from protocol.authentication import KEY_SIZE
from protocol.frame_proofs import ToolProofs
from protocol.frames.trust_frames import OperatorBadge, Proof, TimeQuestion
from protocol.operator_badges import DAY_S, Role
from tools.operate.device_keys import file_stamp


class FileProofs(ToolProofs):
    """The proofs of a desk, which follow its key file."""

    def __init__(
        self,
        path: Path,
        kind: str = OPERATOR,
        told: Callable[[str], None] = lambda line: None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """`path`: a file of this kind, or the folder that has it. `told`: takes a line when orders can no
        longer be proven, and when they can again. `clock`: seconds since 1970-01-01.

        Raises KeyFileError, also if the file does not allow transport orders."""
        self.path, self.kind, self._told, self._clock = path, kind, told, clock
        self.file = read(path, kind)
        self._seen = file_stamp(self.file.path)
        self.refusal = self._why()  # why no order is proven now; None: they are
        if self.refusal is not None:
            raise KeyFileError(self.refusal)
        device = DEVICE if self.file.device is None else self.file.device
        super().__init__(self.file.keys, device, token_bytes(KEY_SIZE), self.file.badge)

    def after(
        self, message: Any, address: int, now_us: int
    ) -> list[OperatorBadge | Proof | TimeQuestion]:
        """As of every tool; nothing while the file allows no orders."""
        self._follow()
        return [] if self.refusal is not None else super().after(message, address, now_us)

    def _follow(self) -> None:
        """Read the file again if it was replaced, and look whether its key has ended."""
        before, refusal = self.refusal, None
        stamp = file_stamp(self.file.path)
        if stamp != self._seen:
            try:
                found: KeyFile | None = read(self.file.path, self.kind)
            except KeyFileError as problem:
                found, refusal = None, str(problem)
            if found is not None:
                self.file, self._seen = found, stamp
                self.renew(found.keys, found.badge)
        self.refusal = refusal or self._why()
        if self.refusal != before:
            self._told(
                f"transport orders are proven again: {self.file.path}" if self.refusal is None
                else f"no transport order is proven: {self.refusal}"
            )  # fmt: skip

    def _why(self) -> str | None:
        return self.file.may(Role.TASK, int(self._clock()) // DAY_S)


def proofs_of(
    file: Path | None, told: Callable[[str], None] = lambda line: None
) -> ToolProofs | None:
    """The proofs of the device that a key file names; None without a file. Raises KeyFileError, also if
    the file does not allow transport orders."""
    return None if file is None else FileProofs(file, told=told)
