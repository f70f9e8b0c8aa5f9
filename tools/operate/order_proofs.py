"""The proofs of transport orders, from an operator's key file."""

import time
from pathlib import Path
from secrets import token_bytes

from agent.runtime.files.key_file import DEVICE, OPERATOR, KeyFileError, read
from protocol.authentication import KEY_SIZE, Keys
from protocol.frame_proofs import ToolProofs
from protocol.operator_badges import DAY_S, Badge, Role


def proofs_with(keys: Keys, device: int = DEVICE, badge: Badge | None = None) -> ToolProofs:
    """The proofs of a device, 192 to 254, with the operator's secret, or with that of its badge."""
    return ToolProofs(keys, device, token_bytes(KEY_SIZE), badge)


def proofs_of(file: Path | None) -> ToolProofs | None:
    """The proofs of the device that a key file names; None without a file. Raises KeyFileError, also if
    the file does not allow transport orders."""
    if file is None:
        return None
    found = read(file, OPERATOR)
    assert found.device is not None, "an operator's file names its device"
    why = found.may(Role.TASK, int(time.time()) // DAY_S)
    if why is not None:
        raise KeyFileError(why)
    return proofs_with(found.keys, found.device, found.badge)
