"""The simulated disk and the journal on it: what a power cut, a fault, and a forgotten sync do."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.effects import Persist
from sim.chaos import power_cuts
from sim.chaos.durability_rules import Tape, record
from sim.fleet.simulated_disk import SECTOR, Disk, LogJournal, PowerCut

SEED = 7


@pytest.fixture(scope="module")
def tapes() -> dict[int, Tape]:
    return record(SEED)


def test_what_is_synced_stays_and_what_is_not_may_go() -> None:
    disk = Disk()
    disk.write(0, b"a" * SECTOR)
    disk.sync()
    disk.write(0, b"b" * SECTOR)
    disk.write(SECTOR, b"c" * 2 * SECTOR)
    assert disk.read() == b"b" * SECTOR + b"c" * 2 * SECTOR
    left = {disk.after_cut(Random(n)).read() for n in range(200)}
    assert b"a" * SECTOR in left and disk.read() in left
    assert any(image[:SECTOR] not in (b"a" * SECTOR, b"b" * SECTOR) for image in left), "torn"


@pytest.mark.parametrize("fault", ["cut", "fail"])
@pytest.mark.parametrize("step", range(1, 7))
def test_a_fault_between_any_two_steps(fault: str, step: int) -> None:
    disk = Disk()
    if fault == "cut":
        disk.cut_at = step
    else:
        disk.fail_at = step
    journal, acknowledged = LogJournal(disk), 0
    with pytest.raises(PowerCut if fault == "cut" else OSError):
        for number in range(3):
            journal.write([Persist("n", bytes((number,))), Persist("same", bytes((number,)))])
            acknowledged += 1
    assert acknowledged == (step - 1) // 2
    for seed in range(50):
        recalled = LogJournal(disk.after_cut(Random(seed))).load()
        assert recalled.get("n") == recalled.get("same"), "all of a batch or nothing"
        number = recalled["n"][0] + 1 if "n" in recalled else 0
        assert acknowledged <= number <= acknowledged + 1


@given(st.binary(max_size=300), st.binary(max_size=40))
def test_any_bytes_are_some_journal_and_can_be_written_on(image: bytes, value: bytes) -> None:
    disk = Disk(image)
    journal = LogJournal(disk)
    known = dict(journal.load())
    journal.write([Persist("key", value)])
    assert LogJournal(Disk(disk.read())).load() == {**known, "key": value}


@pytest.mark.slow
def test_no_acknowledged_record_is_lost_to_a_power_cut(tapes: dict[int, Tape]) -> None:
    for slot, tape in tapes.items():
        rng = Random(f"{SEED}/{slot}")
        assert list(power_cuts.log_states(tape, 1_000, rng)) == [], f"seed {SEED}"


@pytest.mark.slow
def test_the_campaign_finds_a_journal_that_does_not_sync(tapes: dict[int, Tape]) -> None:
    assert list(power_cuts.log_states(tapes[0], 100, Random(SEED), synced=False))


def test_the_campaign_finds_what_is_said_before_it_is_written(tapes: dict[int, Tape]) -> None:
    """The judge is told of claims, units, votes and stops that no batch before them holds."""
    tape = tapes[0]
    late: Tape = [e for e in tape if type(e) is not tuple]
    late += [e for e in tape if type(e) is tuple]
    found = {problem.split()[0] for problem in power_cuts.log_states(late, 300, Random(SEED))}
    assert found, f"seed {SEED}"


def test_a_batch_behind_a_damaged_one_stays_lost() -> None:
    """Found by the fuzz target `journal`: a new batch as long as the damaged one made it fit again."""
    disk = Disk()
    journal = LogJournal(disk)
    journal.write([Persist("key", b"first")])
    journal.write([Persist("old", b"value")])
    image = bytearray(disk.read())
    image[20] ^= 0xFF
    again = LogJournal(Disk(bytes(image)))
    assert again.load() == {}
    again.write([Persist("key", b"other")])
    assert LogJournal(Disk(again.disk.read())).load() == {"key": b"other"}
