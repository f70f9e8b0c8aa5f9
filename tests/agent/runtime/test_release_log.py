"""The signed log of releases: what was changed, added, moved or taken out is found."""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Effect, Trace
from agent.runtime.files.key_file import OPERATOR, fresh, read, read_robot, write
from agent.runtime.files.release_log import (
    ReadLog,
    ReleaseLog,
    key_of,
    lacking,
    own_log_key,
    path_of,
    read_log,
)
from protocol.authentication import Keyring, Keys
from protocol.frames.codec import decode
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import Challenge, Command, OperatorCommand
from protocol.name import tool_name
from protocol.rekeying import own_key
from sim.rigs.keyed_rig import KeyedRig
from tools.cli.keys import log_command, rotate
from tools.common.release_records import release_records

ROBOT, OPERATOR_DEVICE = 1, 249
Lines = list[str]


def cleared(detail: str) -> Trace:
    return Trace("safety", "", "CLEARED", "", detail)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    keys = tmp_path / "keys"
    keys.mkdir(mode=0o700)
    write(keys / "fleet.json", keys / "operator.json", fresh(), 249, range(3))
    return tmp_path


def written(folder: Path, robot: int = ROBOT, releases: int = 4) -> Path:
    key = key_of(read_robot(folder / "keys", robot).keys, robot)
    log = ReleaseLog(path_of(folder, robot), robot, key)
    log.keep(0, HALT)
    for number in range(releases):
        log.keep(number, cleared(f"dot 7.1.{number} by 249"))
    return log.path


def checked(folder: Path, path: Path) -> ReadLog:
    root = read(folder / "keys", OPERATOR).root
    assert root is not None
    return read_log(path, own_log_key(own_key(root, ROBOT), ROBOT))


def test_a_log_is_whole_and_goes_on_after_a_restart(folder: Path) -> None:
    path = written(folder)
    written(folder)
    log = checked(folder, path)
    assert not log.broken and log.signed and [r.number for r in log.releases] == list(range(1, 9))
    assert log.releases[0].what == "dot 7.1.0" and log.releases[0].device == 249
    assert path.stat().st_mode & 0o077 == 0


def changed(lines: Lines) -> Lines:
    return [lines[0], lines[1].replace("249", "201"), *lines[2:]]


def rewritten(lines: Lines) -> Lines:
    """Somebody without the key computes all hashes again."""
    line = json.loads(lines[3])
    return [*lines[:3], json.dumps(line | {"what": "dot 0.0.0"}, sort_keys=True)]


CHANGES: tuple[Callable[[Lines], Lines], ...] = (
    changed,
    rewritten,
    lambda lines: lines[1:],
    lambda lines: [lines[0], *lines[2:]],
    lambda lines: [lines[1], lines[0], *lines[2:]],
    lambda lines: [*lines, lines[-1]],
    lambda lines: [*lines, "no JSON"],
    lambda lines: [lines[0], "{}", *lines[2:]],
)


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_found(folder: Path, change: Callable[[Lines], Lines]) -> None:
    path = written(folder)
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    assert checked(folder, path).broken


def test_a_log_that_another_robot_wrote_is_found(folder: Path) -> None:
    written(folder, robot=2).rename(path_of(folder, ROBOT))
    assert checked(folder, path_of(folder, ROBOT)).broken


def test_an_end_that_was_cut_off_shows_in_the_logs_of_the_others(folder: Path) -> None:
    for robot in range(3):
        written(folder, robot)
    path = path_of(folder, ROBOT)
    path.write_text("\n".join(path.read_text().splitlines()[:2]) + "\n")
    records = release_records(folder)
    assert records.root and not records.broken
    assert lacking(records.logs) == {ROBOT: {"dot 7.1.2", "dot 7.1.3"}}


class LoggedRig(KeyedRig):
    """A fleet whose robots write logs, and its operator."""

    def __init__(self, folder: Path, keyed: bool = True) -> None:
        self.logs = {slot: ReleaseLog(path_of(folder, slot), slot, None) for slot in range(3)}
        super().__init__(3, keyed=keyed)
        self.operator: Keyring | None = None
        if self.keys is not None:
            self.operator = Keyring(Keys(None, self.keys.operator), OPERATOR_DEVICE, b"day")
        self.forge(AddressClaimed(tool_name(OPERATOR_DEVICE).pack()), OPERATOR_DEVICE)

    def send(self, slot: int, effects: Sequence[Effect]) -> None:
        for effect in effects:
            self.logs[slot].keep(self.now_us, effect)
        super().send(slot, effects)

    def order(self, command: Command, target: int = 255, argument: int = 0) -> None:
        """What it says, as often as a tool says it, with answers to robots that ask for its counter."""
        said = OperatorCommand(command, target, OPERATOR_DEVICE, argument)
        for _ in range(6):
            self.recorded.clear()
            for _ in range(2):  # robots act on two frames that agree
                signed = said if self.operator is None else self.operator.sign(said)
                self.forge(signed, OPERATOR_DEVICE)
            self.run_for(MS * 100)
            for source, message in map(decode, list(self.recorded)):
                if self.operator is not None and isinstance(message, Challenge):
                    proof = self.operator.answer(message, self.now_us)
                    if proof is not None:
                        self.forge(proof, OPERATOR_DEVICE, source)

    def written(self, slot: int) -> list[tuple[str, int | None]]:
        """What a robot has in its log."""
        path = self.logs[slot].path
        return [(r.what, r.device) for r in read_log(path, None).releases] if path.exists() else []


def test_the_log_has_who_started_a_robot_and_who_let_it_go_on_without_another(
    tmp_path: Path,
) -> None:
    """It had the stops that were cleared, and neither of the two orders by which robots drive on."""
    rig = LoggedRig(tmp_path)
    rig.order(Command.START)
    assert [rig.written(slot) for slot in rig.peers] == [[]] * 3, "they were started"
    rig.order(Command.HOLD)
    rig.order(Command.START)
    assert [rig.written(slot) for slot in rig.peers] == [[("start", OPERATOR_DEVICE)]] * 3, "once"
    rig.order(Command.HOLD, 1)
    rig.order(Command.START, 1)
    assert rig.written(1)[1:] == [("start of this robot", OPERATOR_DEVICE)]
    rig.cut.add(2)
    rig.run_for(5 * S)
    rig.order(Command.WAIVE, argument=2)
    for slot in (0, 1):
        assert rig.written(slot)[-1] == ("go on without robot 2", OPERATOR_DEVICE)
    logs = [read_log(rig.logs[slot].path, None) for slot in rig.peers]
    assert not lacking(logs), "no stop was cleared, so no line is missed"


def test_a_fleet_without_keys_does_not_log_what_nobody_has_proven(tmp_path: Path) -> None:
    rig = LoggedRig(tmp_path, keyed=False)
    rig.order(Command.HOLD)
    rig.order(Command.START)
    assert all(peer.safety.started for peer in rig.peers.values())
    assert [rig.written(slot) for slot in rig.peers] == [[]] * 3


def test_a_log_whose_end_is_damaged_goes_on_and_says_so(folder: Path) -> None:
    path = written(folder)
    path.write_bytes(path.read_bytes()[:-20])
    written(folder)
    assert checked(folder, path).broken


def headland(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "keys", "log", *words],
        cwd=folder, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


def test_the_command_names_people_and_fails_where_a_log_was_changed(folder: Path) -> None:
    made = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", "keys", "operator", "Anna", "--device", "201",
         "--roles", "release", "--folder", "keys"],
        cwd=folder, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    key = key_of(read_robot(folder / "keys", ROBOT).keys, ROBOT)
    log = ReleaseLog(path_of(folder, ROBOT), ROBOT, key)
    log.keep(0, cleared("dot 7.1.1 by 201"))
    whole = headland(folder, ".", "--verify")
    assert whole.returncode == 0 and "dot 7.1.1  by Anna (201)" in whole.stdout, whole
    assert json.loads(headland(folder, ".", "--json").stdout)["signed"]
    log.path.write_text(log.path.read_text().replace("201", "202"))
    spoilt = headland(folder, ".", "--verify")
    assert spoilt.returncode == 1 and "robot 1: CHANGED" in spoilt.stdout


def test_a_folder_without_logs_proves_nothing(folder: Path) -> None:
    """Where all logs were deleted, `--verify` had exit code 0."""
    with pytest.raises(SystemExit) as ended:
        log_command(folder, folder / "keys", verify=True, json=True)
    assert ended.value.code == 1


def test_a_robot_with_the_fleets_file_is_not_said_to_have_a_changed_log(folder: Path) -> None:
    """A robot without a key file of its own writes under the fleet's secret, also before a rotation."""
    for number in range(2):
        key = key_of(read_robot(folder / "keys" / "fleet.json", ROBOT).keys, ROBOT)
        ReleaseLog(path_of(folder, ROBOT), ROBOT, key).keep(0, cleared(f"dot 7.1.{number} by 249"))
        rotate(folder / "keys", running=False)
    written(folder, 2)
    found = release_records(folder)
    assert not found.broken and found.shared == [ROBOT]
    told = headland(folder, ".", "--verify")
    assert told.returncode == 1 and f"robot {ROBOT}: NOT PROVEN" in told.stdout, told
    path = path_of(folder, ROBOT)
    path.write_text(path.read_text().replace("249", "201"))
    assert ROBOT in release_records(folder).broken


@pytest.mark.parametrize("taken", ["nothing", "a part", "all"])
def test_a_disk_that_fails_once_spoils_no_later_line(
    folder: Path, taken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next line was appended to a half one, and it could not be read. A disk that had taken nothing,
    or all of the line and said that it failed, made an honest log a changed one."""
    key = key_of(read_robot(folder / "keys", ROBOT).keys, ROBOT)
    log = ReleaseLog(path_of(folder, ROBOT), ROBOT, key)
    log.keep(0, cleared("dot 7.1.0 by 249"))
    whole = log.path.read_bytes()

    def fails(handle: int) -> None:
        written = len(log.path.read_bytes()) - len(whole)
        share = {"nothing": 0, "a part": written // 2, "all": written}[taken]
        os.truncate(log.path, len(whole) + share)
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as during:
        during.setattr("agent.runtime.files.release_log.os.fsync", fails)
        log.keep(0, cleared("dot 7.1.1 by 249"))
    log.keep(0, cleared("dot 7.1.2 by 249"))
    found = checked(folder, log.path)
    dots = ["7.1.0", "7.1.2"] if taken != "all" else ["7.1.0", "7.1.1", "7.1.2"]
    assert [release.what.split()[1] for release in found.releases] == dots
    assert found.broken == ("line 2 cannot be read" if taken == "a part" else "")


HOSTILE = (
    '{"number": Infinity}', "[" * 4_000, "[]", "null", '"x"', "{}", "\x00", '{"number": 1e999}',
)  # fmt: skip


def lines_with(**changes: object) -> str:
    plain = {
        "number": 1, "released_at_s": 1.0, "robot": ROBOT, "what": "dot", "device": 249,
        "before": "0" * 64, "tag": "",
    }  # fmt: skip
    return json.dumps(plain | changes)


@pytest.mark.parametrize(
    "line",
    [
        *HOSTILE,
        lines_with(released_at_s=None),
        lines_with(released_at_s=1e20),
        lines_with(released_at_s="yesterday"),
        lines_with(what=["dot"]),
        lines_with(what="dot \x1b[2J"),
        lines_with(what="\ud800"),
        lines_with(device=[249]),
        lines_with(number=True),
        lines_with(robot=1.5),
    ],
    ids=lambda line: line[:24],
)
def test_a_thief_who_writes_anything_into_its_log_does_not_break_the_owners_tool(
    folder: Path, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stolen robot's log made `headland keys log` end in a traceback, or command the terminal."""
    good = written(folder, 2)
    path_of(folder, ROBOT).write_text(line + "\n", encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        log_command(folder, folder / "keys", verify=True, json=False)
    said = capsys.readouterr().out
    assert ended.value.code == 1 and f"robot {ROBOT}: CHANGED: line 1 cannot be read" in said
    assert "\x1b" not in said and said.count("robot 2  dot 7.1") == 4, (
        "the other robot's lines are shown"
    )
    assert good.read_bytes()
    written(folder)  # and a robot that finds such a log starts and writes


def test_a_pipe_or_a_folder_at_the_place_of_the_log_holds_no_robot(folder: Path) -> None:
    path = path_of(folder, ROBOT)
    os.mkfifo(path)
    written(folder)
    path.unlink()
    path.mkdir()
    written(folder)


def test_a_log_that_is_cut_at_any_byte_goes_on(folder: Path) -> None:
    whole = written(folder, releases=2).read_bytes()
    first = whole.index(b"\n")
    for length in range(len(whole)):
        path_of(folder, ROBOT).write_bytes(whole[:length])
        log = checked(folder, written(folder, releases=1))
        assert [r.what for r in log.releases][-1:] == ["dot 7.1.0"], length
        expected = "" if length in (0, first, first + 1, len(whole) - 1) else "line"
        assert log.broken.startswith(expected) and bool(log.broken) == bool(expected), length
