"""A robot that works one field after another, with one journal."""

from pathlib import Path
from random import Random

from agent.interface.effects import Persist
from agent.peer.durable_records import MAP, DurableRecords
from agent.runtime.sqlite_journal import SqliteJournal
from agent.runtime.work_memory import TRANSPORTS, of_work
from agent.safety.stop_controller import HOLD_KEY, LATCHED
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack
from crdt.occupancy import PATCH_BYTES

HOME, FAR = 0x123456, 0x654321  # hashes of two fields
DONE = pack(0, Phase.DONE, 0, 7, 1)


def begun(folder: Path, work: int) -> tuple[SqliteJournal, FieldAllocationCRDT, Progress, int]:
    """The robot is switched on with this work; the last value is how many records were put by."""
    journal, recalled = SqliteJournal.opened(folder / "robot1.sqlite")
    recalled, put_by = of_work(journal, recalled, work)
    allocation, progress = FieldAllocationCRDT(), Progress({0: 40})
    records = DurableRecords(recalled, not recalled, Random(1))
    assert not records.lost
    records.restore(allocation, progress)
    assert (HOLD_KEY in recalled) == bool(recalled), "what keeps it standing is of no field"
    return journal, allocation, progress, put_by


def work_done(journal: SqliteJournal, section: int) -> None:
    records = DurableRecords({}, True, Random(1))
    journal.write([Persist(*records.identity()), Persist(HOLD_KEY, LATCHED)])
    journal.write([Persist(*each) for each in records.operation(1, section, DONE)])
    journal.write([Persist(*records.progress(section, 0, 0b11))])
    journal.write([Persist(f"{MAP}0", bytes(PATCH_BYTES))])
    journal.close()


def test_sections_of_one_field_are_not_taken_for_those_of_another(tmp_path: Path) -> None:
    """The robot said that the new field was done, and drove nowhere."""
    journal, *_ = begun(tmp_path, HOME)
    work_done(journal, 0)
    journal, allocation, progress, put_by = begun(tmp_path, FAR)
    assert len(allocation) == len(progress) == 0 and put_by == 3
    work_done(journal, 5)
    journal, allocation, progress, put_by = begun(tmp_path, FAR)
    assert allocation.sections() == [5] and put_by == 0
    journal.close()
    journal, allocation, progress, put_by = begun(tmp_path, HOME)
    assert allocation.sections() == [0] and put_by == 3, "and it comes back to the first field"
    assert allocation.phase_of(0) is Phase.DONE and progress.bits(0, 0) == 0b11
    journal.close()


def test_a_journal_of_an_earlier_version_is_of_the_field_that_it_is_first_used_with(
    tmp_path: Path,
) -> None:
    journal, _ = SqliteJournal.opened(tmp_path / "robot1.sqlite")
    work_done(journal, 0)
    journal, allocation, _, put_by = begun(tmp_path, HOME)
    assert allocation.sections() == [0] and put_by == 0
    journal.close()
    journal, allocation, _, put_by = begun(tmp_path, TRANSPORTS)
    assert not allocation.sections() and put_by == 3
    journal.close()


def test_a_new_robot_that_loses_power_before_its_first_record_has_lost_nothing(
    tmp_path: Path,
) -> None:
    for _ in range(2):
        journal, *_ = begun(tmp_path, HOME)
        journal.close()
