"""A disk that is full in the middle of a file: one line, exit code 75, and no half of a file."""

import errno
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from typer.testing import CliRunner, Result

from agent.runtime.files.key_file import fresh, write
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyStop, Reason
from tests.tools.cli.test_commands import headland
from tools.cli.headland import app
from tools.common.exit_codes import code_of
from tools.livemap import command as map_command
from tools.livemap.server import MapServer
from tools.run import export

PATH_WRITE = Path.write_bytes


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Says at which suffix the disk is full; a part of the file is written before."""

    def at(suffix: str) -> None:
        def write(path: Path, data: Any) -> int:
            if path.suffix != suffix:
                return PATH_WRITE(path, data)
            PATH_WRITE(path, data[:10])
            raise OSError(errno.ENOSPC, "No space left on device", str(path))

        monkeypatch.setattr(Path, "write_bytes", write)

    return at


@pytest.mark.parametrize(
    ("suffix", "words"),
    [
        (".dbc", ["dbc", "all.dbc"]),
        (".toml", ["new", "mine.toml"]),
        (".toml", ["new", "mine.toml", "--like", "warehouse"]),  # with a file beside it
        (".json", ["coverage", "solve", "--H", "4", "--W", "4", "--robots", "1", "-o", "plan.json"]),
        (".map", ["coverage", "solve", "--robots", "1", "--export", "a.map"]),
    ],
)  # fmt: skip
def test_a_full_disk_leaves_no_half_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: Callable[[str], None],
    suffix: str, words: list[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    full(suffix)
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 75 and told.stderr.count("\n") == 1, told.output
    assert "No space left on device" in told.stderr and ".headland-" not in told.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_device_that_is_full_is_told_with_75(tmp_path: Path) -> None:
    told = headland("dbc", "/dev/full", folder=tmp_path)
    assert told.returncode == 75 and told.stderr.count("\n") == 1
    assert "/dev/full: cannot be written: No space left on device" in told.stderr


def test_a_place_that_cannot_be_written_stays_a_wrong_word(tmp_path: Path) -> None:
    told = headland("dbc", str(tmp_path / "none" / "all.dbc"), folder=tmp_path)
    assert told.returncode == 2 and told.stderr.count("\n") == 1
    assert code_of(PermissionError(errno.EACCES, "no")) == code_of(ValueError("no")) == 2
    assert code_of(OSError(errno.EDQUOT, "over quota")) == 75


def key_without_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The key file of an operator on a disk that takes nothing more."""
    key = folder / "operator.json"
    write(folder / "fleet.json", key, fresh(), 249)

    def full_disk(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("agent.runtime.files.key_file.os.fsync", full_disk)
    return key


@pytest.mark.parametrize("words", [["release"], ["order", "0", "start"]])
def test_a_counter_that_cannot_be_reserved_on_a_full_disk_is_told_with_75(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    """Nothing is wrong with the key file, and the same command succeeds as soon as there is room."""
    key = key_without_room(tmp_path, monkeypatch)
    told = CliRunner().invoke(app, [*words, "--keys", str(key)])
    assert told.exit_code == 75 and told.stderr.count("\n") == 1, told.output
    assert "No space left on device" in told.stderr


def overheard(channel: Path, words: list[str]) -> tuple[Result, list[object]]:
    """What a command printed, and the messages that it has sent on a virtual bus."""
    with can.Bus(str(channel), interface="virtual") as ear:
        told = CliRunner().invoke(app, words)
        frames = [
            Frame(message.arbitration_id, bytes(message.data))
            for message in iter(lambda: ear.recv(0.0), None)
        ]
    return told, [decode(frame)[1] for frame in frames]


def test_a_stop_is_said_also_where_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an operator's key nothing was sent, for its counter could not be reserved."""
    key = key_without_room(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    words = ["stop", "-i", "virtual", "-c", str(tmp_path), "--timeout", "0.6", "--keys", str(key)]
    told, heard = overheard(tmp_path, words)
    assert any(isinstance(message, EmergencyStop) for message in heard)
    assert told.exit_code == 1 and "NOT SIGNED" in told.stdout, told.output
    assert "No space left on device; the stop is said unsigned" in told.stderr


def test_a_map_stops_also_where_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an operator's key in --keys no page opened, and nobody could press its red button."""
    key, pressed = key_without_room(tmp_path, monkeypatch), []

    async def serve(server: MapServer, listener: socket.socket) -> None:
        assert server.panel is not None
        server.panel.stopper.stop(server.panel.stopper.new_stop(Reason.OPERATOR_INTERVENTION))
        pressed.append(server.panel.signed)

    monkeypatch.setattr(map_command, "serve", serve)
    monkeypatch.chdir(tmp_path)
    words = ["map", "-i", "virtual", "-c", str(tmp_path), "--page-port", "0", "--keys", str(key)]
    told, heard = overheard(tmp_path, words)
    assert any(isinstance(message, EmergencyStop) for message in heard), told.output
    assert pressed == [False], "the page says that it does not sign"
    assert "No space left on device; the stop is said unsigned" in told.stderr


def test_an_export_names_the_file_that_takes_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device has an error without a name, and `None` was printed for it."""

    def full(record: object, path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(export, "read_work_geojson", lambda path: None)
    monkeypatch.setattr(export, "_check", lambda folder: None)
    monkeypatch.setattr(export, "write_geojson", full)
    told = CliRunner().invoke(app, ["export", str(tmp_path), "--geojson", "/dev/full"])
    assert (told.exit_code, told.stderr) == (75, "headland: /dev/full: No space left on device\n")
