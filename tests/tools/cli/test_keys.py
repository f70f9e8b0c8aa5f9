"""Key files and the commands that use them: made, shown, rotated, refused in one line, and believed."""

import asyncio
import json
import stat
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from agent.runtime.files.key_file import (
    FLEET,
    OPERATOR,
    KeyFileError,
    counter,
    counter_path,
    fresh,
    read,
    write,
)
from protocol.operator_badges import Role
from tests.tools import launching
from tests.tools.complaint import Complaints
from tests.tools.launching import ENVIRONMENT, WAIT_S


def headland(*words: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", *words], cwd=folder, capture_output=True, text=True,
        check=False, timeout=WAIT_S, env=ENVIRONMENT,
    )  # fmt: skip


def one_line(done: "subprocess.CompletedProcess[str]", *says: str) -> None:
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("headland: ") and all(s in done.stderr for s in says), done.stderr


def test_new_show_and_rotate(tmp_path: Path) -> None:
    made = headland("keys", "new", "k", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    fleet, operator = tmp_path / "k" / "fleet.json", tmp_path / "k" / "operator.json"
    for path in (fleet, operator):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before, device = read(fleet, FLEET), read(operator, OPERATOR)
    assert before.keys.operator == device.keys.operator and device.keys.master is None
    shown = headland("keys", "show", "k", folder=tmp_path)
    assert shown.stdout == made.stdout and before.ids["operator"] in shown.stdout
    for secret in (before.keys.master, before.keys.operator):
        assert secret is not None and secret.hex() not in made.stdout + shown.stdout
    one_line(headland("keys", "new", "k", folder=tmp_path), "is there already")

    assert device.keyring(10).sent == 0 and device.keyring(10).sent == 10
    rotated = headland("keys", "rotate", "k", folder=tmp_path)
    assert rotated.returncode == 0, rotated.stderr
    after = read(fleet, FLEET)
    assert not set(after.ids.values()) & set(before.ids.values())
    assert counter(operator) == 0, "a new key has signed nothing"
    assert read(tmp_path / "k" / f"fleet.json.{before.ids['fleet']}").keys == before.keys


def keys(folder: Path) -> tuple[Path, Path]:
    write(folder / "fleet.json", folder / "operator.json", fresh(), 249)
    return folder / "fleet.json", folder / "operator.json"


def spoil(path: Path, **changes: object) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_wrong_key_files_get_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fleet, _ = keys(tmp_path)

    def wrong(words: str, *says: str) -> None:
        said = Complaints(monkeypatch, capfd).of(words, tmp_path)
        assert said.code == 2 and all(s in said.line for s in says), said

    run = "run small --keys"
    wrong(f"{run} nowhere.json", "fleet.keys", "nowhere.json")
    wrong(f"{run} operator.json", "operator key", "is needed")
    wrong("reset --operator-key fleet.json", "--keys")
    wrong("estop --keys no.json -i virtual", "--keys")
    fleet.chmod(0o640)
    wrong(f"{run} fleet.json", "others may read it", "chmod 600")
    wrong("keys show fleet.json", "chmod 600")
    wrong("keys rotate nowhere", "cannot be read")
    wrong("keys new new --device 3", "--device", "192")
    fleet.chmod(0o600)
    wrong("launch small --no-keys --keys fleet.json", "--no-keys")
    wrong("launch small --segment 1", "--segment", "the same keys")
    wrong("launch small --map --operator-key operator.json", "--operator-key", "--keys")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "not JSON"), ("[]", "not a key file"), ("{}", "not a key file"),
        ('{"kind": "headland fleet keys"}', "missing"),
    ],
)  # fmt: skip
def test_what_is_no_key_file(text: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "k.json"
    path.touch(0o600)
    path.write_text(text)
    with pytest.raises(KeyFileError, match=why):
        read(path)


def test_a_damaged_key_or_counter_is_noticed(tmp_path: Path) -> None:
    fleet, operator = keys(tmp_path)
    key = json.loads(fleet.read_text())["key"]
    spoil(fleet, key=key[:-1] + ("0" if key[-1] != "0" else "1"))
    with pytest.raises(KeyFileError, match="does not fit"):
        read(fleet)
    spoil(fleet, key=17)
    with pytest.raises(KeyFileError, match="hexadecimal"):
        read(fleet)
    counter_path(operator).write_text("many")
    with pytest.raises(KeyFileError, match="rotate"):
        read(operator).keyring()
    spoil(operator, device=7)
    with pytest.raises(KeyFileError, match="device"):
        read(operator)


@pytest.mark.slow
def test_a_fleet_with_keys_is_stopped_and_released_by_those_that_hold_them(tmp_path: Path) -> None:
    call = partial(launching.call, tmp_path)

    async def story() -> None:
        keys(tmp_path)
        launch = await launching.start(tmp_path, "launch", "small", "--keys", "fleet.json")
        try:
            await launching.robots_up(launch, 3)
            code, text = await call("estop", "--json")
            assert code == 1 and not json.loads(text)["signed"], "braked, and nobody latched"
            code, text = await call("estop", "--keys", "fleet.json", "--json")
            assert code == 0 and json.loads(text)["stopped"] == [0, 1, 2], text
            code, text = await call("reset", "--start", "--timeout", "1")
            assert code == 1 and "NOT SIGNED" in text and "NOT RELEASED" in text, text
            for _ in range(2):  # the counter goes on from one session of the device to the next
                code, text = await call(
                    "reset", "--operator-key", "operator.json", "--start", "--json"
                )
                assert code == 0 and json.loads(text)["signed"], text
            assert counter(tmp_path / "operator.json") > 0
        finally:
            launch.terminate()
            async with asyncio.timeout(WAIT_S):
                await launch.wait()
        report = json.loads((tmp_path / "runs" / "launch" / "report.json").read_text())
        assert report["authenticated"]

    asyncio.run(story())


@pytest.mark.slow
def test_a_member_of_a_launch_is_revoked_and_the_others_go_on(tmp_path: Path) -> None:
    call = partial(launching.call, tmp_path)

    async def story() -> None:
        launch = await launching.start(tmp_path, "launch", "small")
        try:
            await launching.robots_up(launch, 3)
            code, text = await call("keys", "rotate", "--running", "--timeout", "15", "--json")
            assert code == 0 and json.loads(text)["switched"] == [0, 1, 2], text
            code, text = await call("keys", "revoke", "2", "--timeout", "15", "--json")
            told = json.loads(text)
            assert code == 0 and told["switched"] == [0, 1] and told["generation"] == 2, text
            assert not (tmp_path / "runs/launch/keys/robot2.json").exists()
            code, text = await call("stop", "--timeout", "10", "--json")
            assert set(json.loads(text)["stopped"]) >= {0, 1}, text
            code, text = await call("release", "--start", "--timeout", "10", "--json")
            assert not json.loads(text)["not_released"], "with the operator's new key: " + text
            assert {s: v for s, v in (await launching.states(tmp_path)).items() if s < 2}
        finally:
            launch.terminate()
            async with asyncio.timeout(WAIT_S):
                await launch.wait()

    asyncio.run(story())


@pytest.mark.slow
def test_a_launch_has_keys_of_its_own_and_the_tools_of_its_user_take_them(tmp_path: Path) -> None:
    call = partial(launching.call, tmp_path)

    async def story() -> None:
        launch = await launching.start(tmp_path, "launch", "small", "--robots", "2")
        try:
            await launching.robots_up(launch, 2)
            code, text = await call("stop", "--json")
            assert code == 0 and json.loads(text)["signed"], text
            code, text = await call("inspect", "--seconds", "1.5", "--json")
            assert json.loads(text)["keyed"] is True
            code, text = await call("release", "--start", "--json")
            assert code == 0 and json.loads(text)["signed"], text
            (tmp_path / "runs/launch/keys").chmod(0o755)  # no longer private: nobody takes them
            code, text = await call("release", "--start", "--timeout", "1", "--json")
            assert not json.loads(text)["signed"], text
        finally:
            launch.terminate()
            async with asyncio.timeout(WAIT_S):
                await launch.wait()
        report = json.loads((tmp_path / "runs" / "launch" / "report.json").read_text())
        assert report["authenticated"]

    asyncio.run(story())


def test_a_key_for_one_person_has_roles_and_an_end(tmp_path: Path) -> None:
    assert headland("keys", "new", "k", folder=tmp_path).returncode == 0
    made = headland(
        "keys", "operator", "Anna", "--roles", "stop,release", "--days", "9", "--folder", "k",
        folder=tmp_path,
    )  # fmt: skip
    assert made.returncode == 0 and "Anna: stop, release, until " in made.stdout, made.stderr
    path = tmp_path / "k" / "operator-192.json"
    file, owner = read(path, OPERATOR), read(tmp_path / "k", OPERATOR)
    assert file.badge is not None and file.root is None and file.keys.master is None
    assert file.keys.operator != owner.keys.operator and file.keys.held is not None
    day = file.badge.expires_day
    assert file.may(Role.RELEASE, day - 1) is None and owner.may(Role.TASK, day) is None
    assert "expired" in (file.may(Role.RELEASE, day) or "")
    assert "it is for stop, release" in (file.may(Role.DIRECT, day - 1) or "")
    wrong = headland("keys", "operator", "Ben", "--roles", "king", "--folder", "k", folder=tmp_path)
    one_line(wrong, "king", "release")
    again = headland("keys", "operator", "Ben", "--device", "192", "--folder", "k", folder=tmp_path)
    one_line(again, "has a file already")

    assert headland("keys", "rotate", "k", folder=tmp_path).returncode == 0
    new = read(path, OPERATOR)
    assert new.badge == file.badge and new.person == "Anna" and new.keys != file.keys


def test_a_key_of_another_role_is_refused_by_the_tools_in_one_line(tmp_path: Path) -> None:
    headland("keys", "new", "k", folder=tmp_path)
    headland("keys", "operator", "WMS", "--roles", "task", "--folder", "k", folder=tmp_path)
    headland("keys", "operator", "Anna", "--folder", "k", folder=tmp_path)
    one_line(
        headland("release", "--keys", "k/operator-192.json", folder=tmp_path), "it is for task"
    )
    one_line(
        headland("task", "add", "1,2", "3,4", "--keys", "k/operator-193.json", folder=tmp_path),
        "it is for stop",
    )


def test_a_key_file_that_others_may_replace_is_refused(tmp_path: Path) -> None:
    fleet, _ = keys(tmp_path)
    tmp_path.chmod(0o777)
    with pytest.raises(KeyFileError, match="others may replace it"):
        read(fleet)
    tmp_path.chmod(0o700)
    assert read(fleet)
