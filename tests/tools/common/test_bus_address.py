"""Where a launch says that its bus is, and whose file is believed."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tools.common import file_owner
from tools.common.bus_address import (
    LAUNCH,
    AttachError,
    address_of_launch,
    folder_of_launch,
    robots_of_launch,
    scenario_of_launch,
)
from tools.common.process_identity import identity
from tools.livemap.command import show_map

HERE = ("127.0.0.1", 29536, "can0")


@pytest.fixture
def launch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a launch that runs: this process."""
    monkeypatch.chdir(tmp_path)
    LAUNCH.parent.mkdir(parents=True)
    host, port, channel = HERE
    where = {"host": host, "port": port, "channel": channel, "robots": [0], "scenario": "small"}
    LAUNCH.write_text(json.dumps({**where, "folder": str(tmp_path), **identity()}))
    LAUNCH.chmod(0o664)  # as a umask of 002 makes it
    return LAUNCH


def given_away(launch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if hasattr(os, "getuid") and os.getuid() == 0:
        os.chown(launch, 12345, 12345)
    else:
        monkeypatch.setattr(file_owner, "USER", file_owner.USER + 1)


def writable(launch: Path, _: pytest.MonkeyPatch) -> None:
    launch.chmod(0o666)


def test_the_launch_of_this_user_is_believed(launch: Path, tmp_path: Path) -> None:
    host, port, _ = HERE
    assert address_of_launch() == HERE
    assert robots_of_launch("socketcand", host, port) == [0]
    assert scenario_of_launch("socketcand", host, port) == "small"
    assert folder_of_launch("socketcand", host, 0) == tmp_path


def test_the_launch_is_found_by_the_other_name_of_its_host(launch: Path, tmp_path: Path) -> None:
    """With `--host localhost` a dead robot was not named, and the stop was not signed."""
    _, port, _ = HERE
    assert robots_of_launch("socketcand", "localhost", port) == [0]
    assert scenario_of_launch("socketcand", "localhost", port) == "small"
    assert folder_of_launch("socketcand", "localhost", port) == tmp_path
    assert robots_of_launch("socketcand", "localhost", port + 1) == []
    assert folder_of_launch("socketcand", "192.0.2.1", port) is None


@pytest.mark.parametrize("change", [given_away, writable])
def test_the_launch_of_another_user_is_refused_and_its_port_named(
    launch: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    change: Callable[[Path, pytest.MonkeyPatch], None],
) -> None:  # fmt: skip
    """A stop went to any bus that the file named."""
    change(launch, monkeypatch)
    host, port, _ = HERE
    with pytest.raises(AttachError, match=r"another user's.* --port 29536$"):
        address_of_launch()
    assert robots_of_launch("socketcand", host, port) == []
    assert scenario_of_launch("socketcand", host, port) is None
    assert folder_of_launch("socketcand", host, 0) is None
    for source in (None, launch.parent):
        code = show_map(source, "socketcand", "can0", 250_000, "", 0, None, None, 0, False)
        told = capsys.readouterr().err
        assert code == 2 and told.count("\n") == 1 and "--port 29536" in told
