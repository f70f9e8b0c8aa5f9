"""Damaged files: the bench that says what it takes to refuse them, and what it found."""

from pathlib import Path

import pytest

from agent.runtime.sqlite_journal import SqliteJournal
from sim.chaos.fuzz_targets import FILES, TARGETS, seeds, sqlite_journal
from tools.bench import files


@pytest.mark.slow
def test_f_the_bench_of_files_prints_three_figures_for_each_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(files, "FILES", [TARGETS["candump"], TARGETS["sqlite_journal"]])
    monkeypatch.setattr(files, "QUICK", 40)
    *found, total = list(files.figures(True))
    assert [figure.figure.split(":")[0] for figure in found[::3]] == ["candump", "sqlite_journal"]
    assert all(figure.holds for figure in found), found
    assert all("40 mutations" in figure.scope for figure in found)
    assert total.holds is None and total.unit == "min"


def test_f_journals_of_sqlite_are_a_kind_of_file() -> None:
    assert sqlite_journal in FILES
    killed, ended = seeds("sqlite_journal")
    assert len(killed) > len(ended), "the log of a robot that was killed is there"
    for data in (killed, ended, b"", killed[:-8192], killed[:8] + bytes(len(killed) - 8)):
        sqlite_journal(data)


def test_f_the_fuzzer_of_journals_finds_one_that_comes_back_old(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A journal that does not look at its mark, as on commit 24747e2."""
    killed, _ = seeds("sqlite_journal")
    main, log = int.from_bytes(killed[:4], "little"), int.from_bytes(killed[4:8], "little")
    short = log - 4120  # one page and its header: the last write is rolled back
    end = 8 + main
    cut = killed[:4] + short.to_bytes(4, "little") + killed[8 : end + short] + killed[end + log :]
    sqlite_journal(cut)
    monkeypatch.setattr("agent.runtime.sqlite_journal.LAG_MAX", 99)
    monkeypatch.setattr(SqliteJournal, "_numbered", lambda self, raw: self.mark.number)
    with pytest.raises(AssertionError):
        sqlite_journal(cut)
