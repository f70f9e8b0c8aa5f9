"""Item 9: memory that is older than what was said is lost memory, on real sqlite files."""

import json
import os
import sqlite3
import subprocess
import sys
from pathlib import Path
from random import Random
from shutil import copyfile

import pytest

from agent.interface.effects import Persist
from agent.interface.identity import Identity, SilencePolicy
from agent.peer.inputs import Press, Timer
from agent.peer.journal_recovery import LOST
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from agent.runtime.sqlite_journal import CHECK_SIZE, MARK_SUFFIX, SqliteJournal, _checked
from agent.safety.stop_controller import HOLD_KEY, LATCHED
from protocol.frames.safety_frames import Reason
from protocol.name import fleet_name

SEED = 24
TENTHS = range(1, 11)


def boot(recalled: dict[str, bytes], first_boot: bool = False) -> Peer:
    identity = Identity(
        slot=2, members=frozenset(range(3)), name=fleet_name("rolled back", 2), field_hash=1,
        silence=SilencePolicy.STOP, started=True, first_boot=first_boot,
    )  # fmt: skip
    return make_peer(identity, Random(f"{SEED}/{first_boot}"), 0, recalled)


def latched_robot(folder: Path) -> Path:
    """The files of a robot that worked, was stopped, and was killed before it could close them."""
    journal, recalled = SqliteJournal.opened(folder / "living")
    peer = boot(dict(recalled), first_boot=True)
    journal.write([Persist(*peer.records.identity()), Persist(HOLD_KEY, b"\0")])
    for section in range(20):
        for record in peer.records.operation(section + 1, section, 1 << 48):
            journal.write([Persist(*record)])
    pressed = peer.step(Press(Reason.OPERATOR_INTERVENTION), 1_000_000)
    journal.write([effect for effect in pressed if isinstance(effect, Persist)])
    for suffix in ("", "-wal", MARK_SUFFIX):
        copyfile(folder / f"living{suffix}", folder / f"dead{suffix}")
    journal.close()
    return folder / "dead"


def test_item_9_a_killed_robot_stands_latched_with_all_it_knew(tmp_path: Path) -> None:
    journal, recalled = SqliteJournal.opened(latched_robot(tmp_path))
    journal.close()
    assert recalled[HOLD_KEY] == LATCHED and len(recalled) > 20
    peer = boot(dict(recalled))
    assert peer.safety.latched and not peer.safety.unconfirmed


@pytest.mark.parametrize("tenth", TENTHS)
def test_item_9_a_log_cut_by_tenths_leaves_the_robot_standing(tenth: int, tmp_path: Path) -> None:
    path = latched_robot(tmp_path)
    log = path.with_name(path.name + "-wal")
    os.truncate(log, log.stat().st_size * (10 - tenth) // 10)
    journal, recalled = SqliteJournal.opened(path)
    journal.close()
    peer = boot(dict(recalled))
    assert peer.safety.latched and peer.safety.unconfirmed, f"{tenth} tenths of the log are gone"
    assert (tmp_path / "dead.unreadable1").exists()
    assert boot(dict(recalled), first_boot=True).safety.unconfirmed, "whatever its starter believes"


def test_item_9_it_still_stands_after_another_restart(tmp_path: Path) -> None:
    path = latched_robot(tmp_path)
    path.with_name(path.name + "-wal").unlink()
    for _ in range(3):
        journal, recalled = SqliteJournal.opened(path)
        peer = boot(dict(recalled))
        assert peer.safety.latched
        journal.write([e for e in peer.step(Timer(), peer.due_at_us) if isinstance(e, Persist)])
        journal.close()
    assert len(list(tmp_path.glob("dead.unreadable?"))) == 1


@pytest.mark.parametrize("lost", ["", MARK_SUFFIX])
def test_item_9_either_of_the_two_files_alone_is_no_memory(lost: str, tmp_path: Path) -> None:
    path = latched_robot(tmp_path)
    path.with_name(path.name + lost).unlink()
    journal, recalled = SqliteJournal.opened(path)
    journal.close()
    assert [*recalled] == [LOST]


def test_item_9_a_crash_between_the_commit_and_the_mark_is_no_false_alarm(tmp_path: Path) -> None:
    journal = SqliteJournal(tmp_path / "j")
    for number in range(4):
        journal.write([Persist("a", bytes((number,)))])
        copyfile(tmp_path / f"j{MARK_SUFFIX}", tmp_path / "before")
    journal.write([Persist("a", b"newest")])
    journal.close()
    copyfile(tmp_path / "before", tmp_path / f"j{MARK_SUFFIX}")
    for _ in range(3):
        journal, recalled = SqliteJournal.opened(tmp_path / "j")
        assert recalled["a"] == b"newest"
        journal.close()
    image = bytearray((tmp_path / "before").read_bytes())
    image[:64] = Random(SEED).randbytes(64)  # the write of the mark was under way
    (tmp_path / f"j{MARK_SUFFIX}").write_bytes(image)
    journal, recalled = SqliteJournal.opened(tmp_path / "j")
    journal.close()
    assert [*recalled] == [LOST], "number 4 was in this place: the other says 3"


def test_item_9_a_torn_mark_leaves_the_other_place(tmp_path: Path) -> None:
    journal = SqliteJournal(tmp_path / "j")
    for number in range(4):
        journal.write([Persist("a", bytes((number,)))])
    journal.close()
    mark = tmp_path / f"j{MARK_SUFFIX}"
    image = bytearray(mark.read_bytes())
    image[4 % 2 * 4096] ^= 1  # the newest: 4 was committed, and its mark torn
    mark.write_bytes(image)
    journal, recalled = SqliteJournal.opened(tmp_path / "j")
    journal.close()
    assert recalled["a"] == b"\3"


@pytest.mark.parametrize(
    "key, value",
    [("register/x", bytes(8)), ("progress/1/2/3", bytes(8)), ("map/-1", bytes(48)),
     ("register/99999", bytes(8)), ("hold", b"\7"), ("stop_counter", bytes(9)),
     ("stops", b"\xff\xff"), ("incarnation", b"")],
)  # fmt: skip
def test_item_9_a_checked_record_without_sense_is_put_aside(
    key: str, value: bytes, tmp_path: Path
) -> None:
    path = latched_robot(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("INSERT OR REPLACE INTO record VALUES (?, ?)", (key, _checked(key, value)))
    database.close()
    journal, recalled = SqliteJournal.opened(path)
    journal.close()
    assert "makes no sense" in recalled[LOST].decode()
    assert boot(dict(recalled)).safety.unconfirmed
    assert boot({"incarnation": b"\1\0", key: value}).safety.unconfirmed, "any other journal, too"
    assert CHECK_SIZE == 4


@pytest.mark.slow
def test_item_9_a_journal_that_is_not_to_be_had_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir()
    owner = SqliteJournal(tmp_path / "locked/robot1.sqlite")
    owner.write([Persist("a", b"1")])
    (tmp_path / "folder/robot1.sqlite").mkdir(parents=True)
    for name in ("locked", "folder", "nowhere"):
        robot = {
            "name": "rolled back", "robot": {"slot": 1, "journal": str(tmp_path / name)},
            "fleet": {"robots": 2},
        }  # fmt: skip
        order = {"robot": robot, "first_boot": False}
        ended = subprocess.run(
            [sys.executable, "-m", "tools.run.robot"], input=json.dumps(order).encode() + b"\n",
            capture_output=True, timeout=60, check=False,
        )  # fmt: skip
        said = ended.stderr.decode()
        assert ended.returncode == 2 and len(said.splitlines()) == 1, said
        assert said.startswith("robot 1: its journal"), said
    owner.close()


def test_item_9_a_stop_that_a_full_disk_did_not_take_stands_after_a_restart(tmp_path: Path) -> None:
    """On one machine all disks are full at once, so no other robot told the stop again."""
    path = tmp_path / "j"
    journal, recalled = SqliteJournal.opened(path)
    peer = boot(dict(recalled), first_boot=True)
    journal.write([Persist(*peer.records.identity()), Persist(HOLD_KEY, b"\0")])
    journal._database.execute("PRAGMA max_page_count=1")
    pressed = peer.step(Press(Reason.OPERATOR_INTERVENTION), 1_000_000)
    with pytest.raises(OSError, match="full"):
        journal.write([Persist("a", bytes(99_999))])
    with pytest.raises(OSError, match="full"):
        journal.write(
            [*[e for e in pressed if isinstance(e, Persist)], Persist("a", bytes(99_999))]
        )
    journal.close()
    for _ in range(2):
        journal, recalled = SqliteJournal.opened(path)
        again = boot(dict(recalled))
        assert again.safety.latched and not again.safety.unconfirmed
        assert again.records.incarnation == peer.records.incarnation, "it keeps what the disk took"
        assert not journal.mark.failed
        journal.close()
    journal, recalled = SqliteJournal.opened(path)
    journal.write([Persist(HOLD_KEY, b"\0")])  # a person has released it
    journal.close()
    journal, recalled = SqliteJournal.opened(path)
    assert recalled[HOLD_KEY] == b"\0" and not boot(dict(recalled)).safety.latched
    journal.close()


def test_item_9_a_mark_of_an_earlier_version_gets_its_third_place(tmp_path: Path) -> None:
    journal, _ = SqliteJournal.opened(tmp_path / "j")
    journal.write([Persist("a", b"1")])
    journal.close()
    os.truncate(tmp_path / f"j{MARK_SUFFIX}", 2 * 4096)
    journal, _ = SqliteJournal.opened(tmp_path / "j")
    journal.write([Persist("a", b"2")])
    journal.close()
    assert (tmp_path / f"j{MARK_SUFFIX}").stat().st_size == 3 * 4096 and not journal.mark.failed
