"""The key file of a gateway: it is read again when the owner has replaced it."""

import os
from pathlib import Path

import pytest

from agent.runtime.files.key_file import FLEET, NAMES, OPERATOR, fresh, write
from tools.cli.bridge import GatewayKeys
from tools.common.bus_address import AttachError


def keys_in(folder: Path) -> Path:
    folder.mkdir(mode=0o700)
    write(folder / NAMES[FLEET], folder / NAMES[OPERATOR], fresh(), 249)
    return folder


def test_a_gateway_reads_its_file_again_when_the_owner_has_replaced_it(tmp_path: Path) -> None:
    first, second = keys_in(tmp_path / "first"), keys_in(tmp_path / "second")
    keys = GatewayKeys(first)
    before = keys.keys
    assert before.master is not None and before.operator is None, "it needs no more than this"
    assert keys.renewed() is None
    file = first / NAMES[FLEET]
    os.truncate(file, 10)  # half written
    os.utime(file, ns=(1, 1))
    assert keys.renewed() is None and keys.keys == before
    (second / NAMES[FLEET]).replace(file)
    renewed = keys.renewed()
    assert renewed is not None and renewed != before
    assert keys.renewed() is None


def test_a_gateways_file_that_others_may_read_is_refused(tmp_path: Path) -> None:
    folder = keys_in(tmp_path / "keys")
    (folder / NAMES[FLEET]).chmod(0o644)
    with pytest.raises(AttachError, match="others may read it"):
        GatewayKeys(folder)
    with pytest.raises(AttachError, match="is needed"):
        GatewayKeys(folder / NAMES[OPERATOR])
