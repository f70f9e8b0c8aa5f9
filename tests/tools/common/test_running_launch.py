"""What a tool that joins the bus of a launch reads of it, and what it does where the file is damaged."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tools.common.bus_address import LAUNCH, AttachError
from tools.common.process_identity import identity
from tools.common.running_launch import RunningLaunch, running_launch
from tools.livemap.command import show_map
from tools.ros2 import command as ros2

WHERE: dict[str, Any] = {"host": "127.0.0.1", "port": 29536, "channel": "can0"}
OF_A_LAUNCH = ("socketcand", "can0", 250_000, "", 0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    LAUNCH.parent.mkdir(parents=True)
    return tmp_path


def wrote(**where: Any) -> None:
    LAUNCH.write_text(json.dumps({**where, **identity()}))
    LAUNCH.chmod(0o644)


def test_a_launch_says_where_its_bus_and_its_bodies_are(folder: Path) -> None:
    assert running_launch() is None, "there is none"
    keys = folder / "keys"
    keys.mkdir(mode=0o700)
    wrote(**WHERE, folder=str(folder), keys=str(keys), bodies="bodies")
    there = RunningLaunch("127.0.0.1", 29536, "can0", folder, keys, Path("bodies"))
    assert running_launch() == running_launch(folder / LAUNCH) == there
    wrote(**WHERE)
    assert running_launch() == there._replace(folder=Path(), keys=None, bodies=None)


@pytest.mark.parametrize("missing", WHERE)
def test_a_launch_that_does_not_say_where_its_bus_is_is_none(
    missing: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found: the map and the node of ROS 2 ended with a traceback of KeyError."""
    wrote(**{key: value for key, value in WHERE.items() if key != missing})
    assert running_launch() is None
    monkeypatch.setattr(ros2, "_missing", lambda zenoh: "")
    commands: tuple[Callable[[], int], ...] = (
        lambda: show_map(None, *OF_A_LAUNCH, None, None, 0, False),
        lambda: ros2.serve(OF_A_LAUNCH, None, None, None, "", None, 0.1),
    )
    for command in commands:
        code, told = command(), capsys.readouterr().err
        assert code == 2 and told.count("\n") == 1 and "no launch found" in told


def test_the_launch_of_another_user_is_an_error(folder: Path) -> None:
    wrote(**WHERE)
    LAUNCH.chmod(0o666)
    with pytest.raises(AttachError, match="another user's"):
        running_launch()
