"""The real journal on a real file: kills, power cuts, damage, full disks and second owners."""

import shutil
import sqlite3
from pathlib import Path
from random import Random

import can
import pytest

from agent.interface.effects import Persist
from agent.interface.lifecycle import State
from agent.peer.journal_recovery import LOST
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.sqlite_journal import Mark, SqliteJournal, UnreadableError
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import HOLD_KEY, LATCHED
from protocol.links.bus import CanBus
from sim.chaos import power_cuts
from sim.chaos.durability_rules import Tape, record
from sim.chaos.sqlite_vfs_recorder import available
from tests.agent.lone_peer import peer_in

SEED = 11
watched = pytest.mark.skipif(
    not available(), reason="Python's sqlite3 is not a shared library here"
)


@pytest.fixture(scope="module")
def tape() -> Tape:
    return record(SEED)[0]


def filled(path: Path) -> None:
    journal = SqliteJournal(path)
    for number in range(50):
        journal.write([Persist(f"key {number}", number.to_bytes(2, "little") * 40)])
    journal.close()


def test_the_newest_value_of_each_key_is_there_again(tmp_path: Path) -> None:
    journal = SqliteJournal(tmp_path / "j")
    journal.write([Persist("a", b"1"), Persist("b", b"")])
    journal.write([Persist("a", b"2")])
    journal.close()
    journal, recalled = SqliteJournal.opened(tmp_path / "j")
    assert recalled == {"a": b"2", "b": b""}
    journal.close()


class KilledMark(Mark):
    """A mark whose process is killed before it writes a number above `last`."""

    def __init__(self, path: Path, last: int) -> None:
        super().__init__(path)
        self.last = last

    def set(self, number: int) -> None:
        if number > self.last:
            raise InterruptedError("killed here")
        super().set(number)

    def fail(self, failed: bool = True) -> None:
        raise InterruptedError("killed before")


def test_two_crashes_in_a_row_between_commit_and_mark_lose_nothing(tmp_path: Path) -> None:
    """SIGKILL found it once in 600: the mark was two writes behind, and the memory passed for lost."""
    journal = SqliteJournal(tmp_path / "j")
    journal.write([Persist("a", b"0")])
    for number in range(1, 4):
        journal.mark = KilledMark(journal.mark.path, number)
        with pytest.raises(InterruptedError):
            journal.write([Persist("a", str(number).encode())])
        journal.close()
        journal, recalled = SqliteJournal.opened(tmp_path / "j")
        assert recalled == {"a": str(number).encode()}
    journal.close()


def test_kill_nine_loses_nothing_that_was_acknowledged(tape: Tape) -> None:
    assert list(power_cuts.kills(tape, 20, Random(SEED))) == [], f"seed {SEED}"


@pytest.mark.slow
@watched
def test_a_power_cut_loses_nothing_that_was_acknowledged(tape: Tape) -> None:
    steps = power_cuts.record_sqlite(tape)
    assert {s.file for s in steps if s.kind == "sync"} >= {"journal", "journal-wal"}, "checkpoints"
    assert list(power_cuts.sqlite_states(tape, steps, 2_000, Random(SEED))) == [], f"seed {SEED}"


@watched
def test_the_campaign_finds_a_journal_that_does_not_sync(tape: Tape) -> None:
    steps = power_cuts.record_sqlite(tape, "NORMAL")
    assert list(power_cuts.sqlite_states(tape, steps, 100, Random(SEED)))


@pytest.mark.parametrize("seed", range(60))
def test_damage_is_noticed_or_harmless(seed: int, tmp_path: Path) -> None:
    path, rng = tmp_path / "j", Random(f"{SEED}/{seed}")
    filled(path)
    whole = {f"key {number}": number.to_bytes(2, "little") * 40 for number in range(50)}
    image = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 3, 400))):
        image[rng.randrange(len(image))] ^= 1 << rng.randrange(8)
    path.write_bytes(image)
    journal, recalled = SqliteJournal.opened(path)
    assert [*recalled] == [LOST] or recalled == whole
    journal.write([Persist("after", b"x")])
    journal.close()


def test_an_unreadable_file_is_put_aside_not_deleted(tmp_path: Path) -> None:
    path = tmp_path / "j"
    for number in (1, 2):
        path.write_bytes(b"no journal at all, but long enough to be looked at" * 100)
        with pytest.raises(UnreadableError):
            SqliteJournal(path)
        journal, recalled = SqliteJournal.opened(path)
        assert [*recalled] == [LOST], "its robot stands until a person has looked"
        journal.close()
        assert (tmp_path / f"j.unreadable{number}").read_bytes().startswith(b"no journal")


@pytest.mark.parametrize("version", [3, 0x12, 0xFF])
def test_f_a_journal_whose_header_says_read_only_is_put_aside(version: int, tmp_path: Path) -> None:
    """Found by mutations: its robot could not start until a person had removed the file."""
    path = tmp_path / "j"
    filled(path)
    image = bytearray(path.read_bytes())
    image[18] = version
    path.write_bytes(image)
    journal, recalled = SqliteJournal.opened(path)
    assert [*recalled] == [LOST]
    journal.write([Persist("after", b"x")])
    journal.close()


def test_a_second_owner_is_refused_and_nothing_is_put_aside(tmp_path: Path) -> None:
    journal = SqliteJournal(tmp_path / "j")
    journal.write([Persist("a", b"1")])
    with pytest.raises(OSError, match="this robot may already run") as refused:
        SqliteJournal.opened(tmp_path / "j")
    assert not isinstance(refused.value, UnreadableError)
    assert not list(tmp_path.glob("*unreadable*"))
    journal.close()


def test_a_full_disk_is_an_error_and_keeps_what_was_there(tmp_path: Path) -> None:
    journal = SqliteJournal(tmp_path / "j")
    journal.write([Persist("a", b"1")])
    journal._database.execute("PRAGMA max_page_count=4")
    with pytest.raises(OSError, match="full"):
        journal.write([Persist("a", b"2"), Persist("big", bytes(100_000))])
    journal.close()
    journal, recalled = SqliteJournal.opened(tmp_path / "j")
    assert recalled == {"a": b"1", HOLD_KEY: LATCHED}
    journal.close()


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="unable to open"):
        SqliteJournal.opened(tmp_path / "nowhere" / "j")


def test_sqlite_is_told_to_be_durable(tmp_path: Path) -> None:
    database = SqliteJournal(tmp_path / "j")._database
    assert isinstance(database, sqlite3.Connection)
    assert database.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert database.execute("PRAGMA synchronous").fetchone() == (2,)


@pytest.mark.parametrize("suffix", ["", "-wal", "-mark"])
@pytest.mark.parametrize("replaced", [False, True])
def test_a_file_that_is_deleted_or_replaced_while_it_is_open_is_a_failed_write(
    suffix: str, replaced: bool, tmp_path: Path
) -> None:
    """Writes went on into a file without a name, and a restart had lost them."""
    journal, _ = SqliteJournal.opened(tmp_path / "j")
    journal.write([Persist("a", b"1")])
    journal.write([Persist("a", b"2")])
    part = tmp_path / f"j{suffix}"
    image = part.read_bytes()
    part.unlink()
    if replaced:
        part.write_bytes(image)
    with pytest.raises(OSError, match="replaced" if replaced else "deleted"):
        journal.write([Persist("a", b"3")])
    journal.close()


def test_a_robot_whose_folder_is_deleted_while_it_runs_stops_as_with_a_failed_disk(
    tmp_path: Path,
) -> None:
    peer, folder = peer_in(State.WORKING, None), tmp_path / "state"
    folder.mkdir()
    journal, _ = SqliteJournal.opened(folder / "j")
    with can.Bus("deleted-folder", interface="virtual") as ours:
        runner = PeerRunner(peer, CanBus(ours), None, journal, clock=lambda: 0)
        runner.perform([Persist("unit", b"1")])
        assert StopCause.DISK_ERROR not in dict(peer.safety.causes)
        shutil.rmtree(folder)
        runner.perform([Persist("unit", b"2")])
        assert StopCause.DISK_ERROR in dict(peer.safety.causes)
    journal.close()
