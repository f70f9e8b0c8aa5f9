"""The proofs of transport orders, from an operator's key file."""

from pathlib import Path
from secrets import token_bytes

from agent.runtime.files.key_file import DEVICE, OPERATOR, read
from protocol.authentication import KEY_SIZE, Keys
from protocol.frame_proofs import ToolProofs


def proofs_with(keys: Keys, device: int = DEVICE) -> ToolProofs:
    """The proofs of a device, 192 to 254, with the operator's secret."""
    return ToolProofs(keys, device, token_bytes(KEY_SIZE))


def proofs_of(file: Path | None) -> ToolProofs | None:
    """The proofs of the device that a key file names; None without a file. Raises KeyFileError."""
    if file is None:
        return None
    found = read(file, OPERATOR)
    assert found.device is not None, "an operator's file names its device"
    return proofs_with(found.keys, found.device)
