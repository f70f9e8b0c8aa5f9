"""Key files and the commands that use them: made, shown, rotated, refused in one line, and believed."""

import asyncio
import contextlib
import errno
import json
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from agent.interface.lifecycle import State
from agent.runtime.files.key_file import (
    FLEET,
    OPERATOR,
    PANELS,
    KeyFileError,
    counter,
    counter_path,
    create,
    fresh,
    read,
    read_robot,
    write,
)
from agent.runtime.files.key_folder import owned
from protocol.frames.codec import decode, encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.frame import Frame
from protocol.frames.key_frames import KeyPart, KeysHeld
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.name import fleet_name
from protocol.operator_badges import Role
from protocol.rekeying import ALWAYS_S, NOBODY
from sim.fleet.virtual_clock import run_virtual
from tests.tools import launching
from tests.tools.complaint import Complaints
from tests.tools.launching import ENVIRONMENT, WAIT_S
from tools.cli.keys import operator as make_operator
from tools.cli.keys import rotate, show
from tools.common.launch_keys import fleet_keys
from tools.common.panel_keys import PanelKeys
from tools.operate import rekey as rekey_module
from tools.operate.device_keys import DeviceKeys
from tools.operate.estop import NOT_ALL
from tools.operate.operator_device import Operator
from tools.operate.rekey import Rekeyer, _tell


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


def test_the_file_of_a_panel_stops_and_whoever_steals_it_releases_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The file that panels were given, fleet.json, has the operators' secret, too."""
    fleet, operator = keys(tmp_path)
    panel, secret = tmp_path / "panel.json", read(operator, OPERATOR).keys.operator
    assert secret is not None and secret.hex() not in panel.read_text()
    assert read(panel, PANELS).keys == read(fleet, FLEET).keys._replace(operator=None)
    for given in (tmp_path, panel, fleet):  # also one that an older version has made for it
        ring = DeviceKeys(given).keyring
        assert ring is not None and ring.keys == read(panel).keys, given
    said = Complaints(monkeypatch, capfd).of("reset --keys panel.json", tmp_path)
    assert said.code == 2 and "operator key" in said.line, said
    with pytest.raises(KeyFileError, match="robot keys"):
        read_robot(panel, 0)


def test_a_folder_of_an_older_version_has_the_fleets_file_for_panels_until_it_is_rotated(
    tmp_path: Path,
) -> None:
    keys(tmp_path)
    (tmp_path / "panel.json").unlink()
    ring, gateway = DeviceKeys(tmp_path).keyring, PanelKeys(tmp_path)
    assert ring is not None and ring.keys == gateway.keys and ring.keys.operator is None
    rotate(tmp_path, running=False)
    renewed, ring = gateway.renewed(), DeviceKeys(tmp_path).keyring
    assert ring is not None and ring.keys == renewed == read(tmp_path / "panel.json", PANELS).keys


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
            code, text = await call("estop", "--keys", "panel.json", "--json")
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


@pytest.mark.slow
def test_a_launch_elsewhere_says_that_tools_take_its_keys_if_they_are_named(tmp_path: Path) -> None:
    call = partial(launching.call, tmp_path)

    async def story() -> None:
        launch = await launching.start(tmp_path, "launch", "small", "--robots", "2", "--out", "b")
        try:
            await launching.said(launch, "(tools take them with --keys)")
            await launching.robots_up(launch, 2)
            port = str(json.loads((tmp_path / "b" / "bus.json").read_text())["port"])
            code, text = await call("stop", "--port", port, "--json")
            assert code == 1 and not json.loads(text)["signed"], text
            code, text = await call("stop", "--port", port, "--keys", "b/keys", "--json")
            assert code == 0 and json.loads(text)["signed"], text
        finally:
            launch.terminate()
            async with asyncio.timeout(WAIT_S):
                await launch.wait()

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


def test_nobody_is_given_the_owners_own_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file of a person with all roles for ever had the secret of all operators. With it, a person can
    release in the name of each of them."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249)
    every = "stop,release,direct,task"
    with pytest.raises(SystemExit):
        make_operator("Anna", roles=every, days=0, device=0, folder=tmp_path)
    assert "the owner's own key" in capsys.readouterr().err
    make_operator("Anna", roles=every, days=3650, device=0, folder=tmp_path)
    make_operator("Ben", roles="stop,release,direct", days=0, device=0, folder=tmp_path)
    owner = read(tmp_path / "operator.json").keys.operator
    for device in (192, 193):
        assert read(tmp_path / f"operator-{device}.json").keys.operator != owner


def test_a_number_whose_file_was_given_away_is_nobody_elses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The next person got the same number, and on one day with the same roles the same secret. The
    release log named the wrong one, and robots took no stop of the one that had counted less far."""
    keys_of, elsewhere = tmp_path / "keys", tmp_path / "anna.json"
    keys_of.mkdir(mode=0o700)
    write(keys_of / "fleet.json", keys_of / "operator.json", fresh(), 249)
    make_operator("Anna", folder=keys_of)
    (keys_of / "operator-192.json").rename(elsewhere)
    make_operator("Ben", folder=keys_of)
    anna, ben = read(elsewhere), read(keys_of / "operator-193.json")
    assert (anna.device, ben.device) == (192, 193) and anna.keys.operator != ben.keys.operator
    capsys.readouterr()
    with pytest.raises(SystemExit):
        make_operator("Cem", device=192, folder=keys_of)
    assert "device 192 has a file elsewhere" in capsys.readouterr().err
    rotate(keys_of, running=False)
    make_operator("Cem", folder=keys_of)
    cem = read(keys_of / "operator-192.json")
    assert cem.person == "Cem" and cem.keys.operator != anna.keys.operator
    owner = owned(keys_of)
    (keys_of / "operator-193.json").unlink()
    owner.finish(owner.begin())
    make_operator("Dora", folder=keys_of)
    assert read(keys_of / "operator-193.json").person == "Dora"


def test_a_persons_damaged_file_is_named_when_keys_are_rotated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was left out without a word, and its person could stop nothing any more."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(2))
    (tmp_path / "operator-201.json").write_text("{")
    rotate(tmp_path, running=False)
    said = capsys.readouterr().err
    assert "operator-201.json" in said and "NO NEW KEYS" in said and said.count("\n") == 1, said


def test_a_file_of_a_robot_that_no_fleet_has_ends_no_rotation(tmp_path: Path) -> None:
    """It was a traceback."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(2))
    text = (tmp_path / "robot0.json").read_text()
    for name in ("robot300.json", "robot128.json", "robot01.json"):
        (tmp_path / name).write_text(text)
    rotate(tmp_path, running=False)
    assert owned(tmp_path).slots == {0, 1}
    assert (tmp_path / "robot300.json").read_text() == text


@pytest.mark.slow
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


class FullDisk:
    """Every write after the first few fails, as on a full disk."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, writes: int) -> None:
        self.left, self._fsync = writes, os.fsync
        monkeypatch.setattr("agent.runtime.files.key_file.os.fsync", self.fsync)

    def fsync(self, handle: int) -> None:
        self.left -= 1
        if self.left < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        self._fsync(handle)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("writes", range(6))
def test_new_keys_on_a_full_disk_leave_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: int
) -> None:
    """An empty fleet.json was left, for which `new` said rotate, and `rotate` said that it is no JSON."""
    with monkeypatch.context() as during:
        FullDisk(during, writes)
        with pytest.raises(OSError, match="No space"):
            write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    assert not contents(tmp_path)
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))


@pytest.mark.parametrize("writes", range(0, 14, 2))
def test_a_rotation_on_a_full_disk_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: int
) -> None:
    """The old files were renamed first, so nobody held a key by which the fleet could be released."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    read(tmp_path, OPERATOR).keyring(10)
    before = contents(tmp_path)
    with monkeypatch.context() as during:
        FullDisk(during, writes)
        with contextlib.suppress(SystemExit):
            rotate(tmp_path, running=False)
    if read(tmp_path, FLEET).keys.generation == 0:
        assert {name: text for name, text in contents(tmp_path).items() if name in before} == before
        assert not [name for name in contents(tmp_path) if name.endswith(".new")]
    else:
        assert writes >= 12, "both files of each of six"
    rotate(tmp_path, running=False)
    assert read(tmp_path, FLEET).keys.operator == read(tmp_path, OPERATOR).keys.operator


@pytest.mark.parametrize("moves", range(1, 7))
def test_a_rotation_that_is_killed_between_two_files_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    left, move = [moves], Path.replace

    def killed(self: Path, target: Path) -> Path:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return move(self, target)

    with monkeypatch.context() as during, contextlib.suppress(KeyboardInterrupt):
        during.setattr(Path, "replace", killed)
        rotate(tmp_path, running=False)
    for kind in (FLEET, OPERATOR):
        read(tmp_path, kind)
    rotate(tmp_path, running=False)
    assert read(tmp_path, FLEET).keys.operator == read(tmp_path, OPERATOR).keys.operator
    numbers = {read(tmp_path / f"robot{slot}.json").keys for slot in range(3)}
    assert {keys.generation for keys in numbers} == {read(tmp_path, FLEET).keys.generation}


def test_a_change_that_is_finished_lets_the_operators_counter_begin_anew(tmp_path: Path) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    read(tmp_path, OPERATOR).keyring(10)
    assert counter(tmp_path / "operator.json") == 10
    owned(tmp_path).finish(owned(tmp_path).begin())
    assert counter(tmp_path / "operator.json") == 0, "a new key has signed nothing"


def test_finishing_a_change_twice_does_not_set_the_operators_counter_back(tmp_path: Path) -> None:
    """A tool that was killed after the files were replaced: the next call took the counter away that the
    new key had used by then, and robots refused the owner's orders as old."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    begun = owned(tmp_path).begin()
    owned(tmp_path).finish(begun)
    read(tmp_path, OPERATOR).keyring(10)
    create(tmp_path / "next.json", json.dumps(begun._asdict() | {"secret": begun.secret.hex()}))
    again = owned(tmp_path).begin()
    assert again == begun
    owned(tmp_path).finish(again)
    assert counter(tmp_path / "operator.json") == 10


def test_what_a_revocation_makes_void_is_not_changed_in_silence(tmp_path: Path) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    owned(tmp_path).begin(2, 60)
    with pytest.raises(KeyFileError, match="revoke 2 --since 60' was begun"):
        owned(tmp_path).begin(2)
    with pytest.raises(SystemExit):
        rotate(tmp_path, running=False)
    assert owned(tmp_path).begin(2, 60).void_for_s == 60


def test_a_rotation_without_a_bus_is_above_one_that_was_begun(tmp_path: Path) -> None:
    """Both had one generation and two secrets, so that robots could not be given the later one."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    begun = owned(tmp_path).begin()
    rotate(tmp_path, running=False)
    assert read(tmp_path, FLEET).keys.generation > begun.generation
    assert owned(tmp_path).begun is None and owned(tmp_path).begin().secret != begun.secret


@pytest.mark.parametrize(
    "changes",
    [
        {"generation": 70_000}, {"generation": 0}, {"generation": 1e999}, {"secret": "00"},
        {"revoked": 200}, {"revoked": -1}, {"void_for_s": -1}, {"void_for_s": 1 << 40},
        {"secret": None},
    ],
    ids=str,
)  # fmt: skip
def test_a_damaged_change_is_one_line(tmp_path: Path, changes: dict[str, object]) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    begun = owned(tmp_path).begin()
    spoil(tmp_path / "next.json", **(begun._asdict() | {"secret": begun.secret.hex()} | changes))
    with pytest.raises(KeyFileError, match="damaged: delete it"):
        owned(tmp_path).begin()


@pytest.mark.parametrize("person", ["\ud800", "Anna\x1b[2J", "\n" * 99])
def test_a_persons_name_commands_no_terminal(
    tmp_path: Path, person: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    with pytest.raises(SystemExit):
        make_operator(person, roles="stop", days=1, device=0, folder=tmp_path)
    assert not list(tmp_path.glob("operator-*"))
    make_operator("Anna", roles="stop", days=1, device=0, folder=tmp_path)
    spoil(tmp_path / "operator-192.json", person=person)
    capsys.readouterr()
    with contextlib.suppress(SystemExit):
        show(tmp_path)
    said = capsys.readouterr()
    assert "\x1b" not in said.out + said.err and len(said.out.splitlines()) <= 4


def test_a_forged_confirmation_takes_none_back(tmp_path: Path) -> None:
    """One bad KEYS_HELD in each robot's name, and the owner's files stayed old while the fleet used the
    new keys: nobody could release it."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(2))
    begun = owned(tmp_path).begin()
    rekeyer = Rekeyer(Operator(Nobody(), None), owned(tmp_path), begun)  # type: ignore[arg-type]
    for slot in range(2):
        for switched in (False, True):
            rekeyer.hear(encode(begun.held(slot, switched), 128 + slot))
            rekeyer.hear(encode(KeysHeld(slot, begun.generation, switched, 99), 128 + slot))
    rekeyer.hear(encode(KeysHeld(7, begun.generation, True, 99), 135))
    assert rekeyer.done(True) == rekeyer.done(False) == {0, 1}


def test_a_robot_that_was_there_and_is_not_heard_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Robot 1 was off: exit code 0 and no word of it, and it stood when it came back."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(3))
    begun = owned(tmp_path).begin(2)
    tool = Operator(Nobody(), None)  # type: ignore[arg-type]
    tool.expect((0, 1, 2, 9))
    rekeyer = Rekeyer(tool, owned(tmp_path), begun)
    assert rekeyer.unheard == {0, 1}, "2 is revoked, and 9 has no file"
    assert _tell(begun, {0}, set(), {1}, False) == NOT_ALL
    assert "robot 1: NOT HEARD" in capsys.readouterr().out
    assert _tell(begun, {0, 1}, set(), set(), True) == 0


class RobotsWithoutOwnKeys:
    """A bus with two robots that were given the file of the fleet."""

    def __init__(self) -> None:
        self.tell: Callable[[Frame], None] = lambda frame: None

    def send(self, frame: Frame) -> bool:
        _, message = decode(frame)
        if isinstance(message, Request | KeyPart):
            for slot in (0, 1):
                beat = Heartbeat(1, State.WORKING, False, False, True, False, 1.0, 0, 0)
                for said in (
                    AddressClaimed(fleet_name("f", slot).pack()),
                    Member(slot, 1, 7),
                    beat,
                ):
                    asyncio.get_running_loop().call_soon(self.tell, encode(said, 128 + slot))
        return True

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        self.tell = callback

    def close(self) -> None:
        """Nothing is open."""


@pytest.mark.parametrize("heard", [True, False])
def test_a_revocation_that_no_robot_takes_is_said_and_holds_up_no_other(
    tmp_path: Path, heard: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Robots with the fleet's own file take no new keys. The command said that robot 1 was revoked.
    Then, as after one on a bus without robots, no other change could be made."""
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(2))
    bus = RobotsWithoutOwnKeys() if heard else Nobody()
    monkeypatch.setattr(rekey_module, "attach", lambda *words: bus)
    monkeypatch.setattr(asyncio, "run", run_virtual)
    where = ("virtual", "field", 250_000, "", 0)
    assert rekey_module.rekey(1, ALWAYS_S, tmp_path, where, 2.0, False) == NOT_ALL
    said = capsys.readouterr().out
    if heard:
        assert "robot 1 is NOT REVOKED" in said and "robot 0: HAS NOT TAKEN" in said, said
    assert "stands" not in said and owned(tmp_path).begun is None
    assert owned(tmp_path).begin(0).generation == 2, "a robot may hold the first"
    (tmp_path / "next.json").unlink()
    assert rekey_module.rekey(1, ALWAYS_S, tmp_path, where, 2.0, False) == NOT_ALL
    rotate(tmp_path, running=False)
    assert owned(tmp_path).generation == 2 and not (tmp_path / "next.json").exists()


def test_a_change_that_robots_may_use_already_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "fleet.json", tmp_path / "operator.json", fresh(), 249, range(2))
    begun = owned(tmp_path).begin()
    monkeypatch.setattr(rekey_module, "attach", lambda *words: RobotsWithoutOwnKeys())
    monkeypatch.setattr(asyncio, "run", run_virtual)
    where = ("virtual", "field", 250_000, "", 0)
    assert rekey_module.rekey(NOBODY, ALWAYS_S, tmp_path, where, 2.0, False) == NOT_ALL
    assert owned(tmp_path).begun == begun


def test_a_name_that_is_no_text_is_printed(tmp_path: Path) -> None:
    """It ended in a traceback after the keys were made, where a terminal wants UTF-8."""
    words: list[str | bytes] = [
        sys.executable, "-m", "tools.cli.headland", "keys", "new", b"k\xff",
    ]  # fmt: skip
    done = subprocess.run(
        words, cwd=tmp_path, capture_output=True, check=False, timeout=WAIT_S,
        env={**ENVIRONMENT, "PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    assert done.returncode == 0 and b"k\\udcff/operator.json: " in done.stdout, done


def test_a_launch_empties_no_folder_that_its_keys_are_linked_to(tmp_path: Path) -> None:
    """In a folder that others can write, somebody put a link at the place of `keys`: all files behind it
    were deleted."""
    home, run = tmp_path / "home", tmp_path / "run"
    for folder in (home, run):
        folder.mkdir()
    (home / "letter").write_text("dear")
    (run / "keys").symlink_to(home)
    for goes_on in (False, True):
        with pytest.raises(OSError, match="is a link"):
            fleet_keys(run, goes_on, 3)
    assert [path.name for path in home.iterdir()] == ["letter"]


class Nobody:
    def send(self, frame: Frame) -> bool:
        return True

    def subscribe(self, callback: object) -> None:
        """Nothing comes."""

    def close(self) -> None:
        """Nothing is open."""
