"""The keys that a launch makes: private, kept while the fleet goes on, taken only by its user."""

import json
import os
from pathlib import Path

import pytest

from agent.runtime.files.key_file import FLEET, OPERATOR, read
from tools.common import file_owner
from tools.common.file_owner import is_private
from tools.common.launch_keys import KEYS, MADE, fleet_keys, keys_in, own_keys
from tools.common.run_folder import FolderError


def test_a_fleet_that_goes_on_keeps_its_keys_and_a_new_one_gets_others(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        folder = fleet_keys(tmp_path, goes_on=False)
    finally:
        os.umask(old)
    assert is_private(folder) and is_private(folder / "fleet.json")
    first = read(folder, FLEET)
    assert read(folder, OPERATOR).keys.operator == first.keys.operator
    read(folder, OPERATOR).keyring()  # leaves a counter beside the key
    assert read(fleet_keys(tmp_path, goes_on=True), FLEET) == first
    other = read(fleet_keys(tmp_path, goes_on=False), FLEET)
    assert not set(other.ids.values()) & set(first.ids.values())
    made = ["fleet.json", MADE, "operator.json", "panel.json"]
    assert sorted(path.name for path in folder.iterdir()) == made


@pytest.mark.parametrize("kept", ["fleet.json operator.json panel.json", "fleet.json"])
def test_keys_of_machines_are_never_replaced(kept: str, tmp_path: Path) -> None:
    """`headland launch --out .` deleted the keys beside it, by which alone a fleet of machines can be
    released, and wrote others."""
    keys = tmp_path / KEYS
    keys.mkdir(mode=0o755)
    for name in kept.split():
        (keys / name).write_text(name)
    for goes_on in (False, True):
        if goes_on and (keys / "operator.json").exists():
            continue  # the fleet that has them
        with pytest.raises(FolderError, match="keys that no launch has made"):
            fleet_keys(tmp_path, goes_on, 3)
    assert {path.name: path.read_text() for path in keys.iterdir()} == {n: n for n in kept.split()}
    assert keys.stat().st_mode & 0o777 == 0o755


def test_only_the_user_of_a_launch_takes_its_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = fleet_keys(tmp_path, goes_on=False)
    launch = tmp_path / "runs/launch/bus.json"
    launch.parent.mkdir(parents=True)
    where = {"host": "127.0.0.1", "port": 5, KEYS: str(keys)}
    launch.write_text(json.dumps(where))
    launch.chmod(0o644)
    monkeypatch.chdir(tmp_path)
    assert own_keys("socketcand", "127.0.0.1", 0) == keys
    assert own_keys("socketcand", "127.0.0.1", 5) == keys
    assert own_keys("socketcand", "localhost", 5) == keys
    assert own_keys("socketcand", "127.0.0.1", 6) is None, "another bus"
    assert own_keys("socketcan", "127.0.0.1", 0) is None
    keys.chmod(0o750)
    assert keys_in(launch, where) is None, "others can open the folder"
    keys.chmod(0o700)
    launch.chmod(0o666)
    assert keys_in(launch, where) is None, "others could have named the folder"
    launch.chmod(0o644)
    monkeypatch.setattr(file_owner, "USER", 12345)
    assert keys_in(launch, where) is None, "another user's launch"


@pytest.mark.parametrize("named", [None, 7, "/nowhere"])
def test_a_launch_without_keys_names_none(named: object, tmp_path: Path) -> None:
    launch = tmp_path / "bus.json"
    launch.touch(0o600)
    assert keys_in(launch, {KEYS: named}) is None
