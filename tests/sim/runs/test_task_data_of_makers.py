"""Task data of several makers is worked, written again, and read by programs that we did not write."""

from pathlib import Path

import pytest

from tools.bench.task_data import QUICK_LIMIT_S, ReaderAbsent, exported, kinds, warnings_of

pytestmark = [pytest.mark.slow, pytest.mark.process]


def test_what_we_write_is_valid_and_read_without_a_warning(tmp_path: Path) -> None:
    given = list(kinds(tmp_path / "given"))
    assert len(given) >= 3  # those that need no data beside the checkout
    zips = []
    for number, kind in enumerate(given):
        place = tmp_path / f"{number}"
        place.mkdir()
        written = exported(kind, place, QUICK_LIMIT_S)
        assert not written.schema_errors, kind.name
        zips.append(written.zipped)
    try:
        read = warnings_of(zips, tmp_path)
    except ReaderAbsent as problem:
        pytest.skip(str(problem))
    for kind, said in zip(given, read, strict=True):
        assert said["warnings"] == [] and said["fields"] == 1 and said["records"] > 0, kind.name
