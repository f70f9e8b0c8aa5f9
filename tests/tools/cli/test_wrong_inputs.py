"""Wrong files, numbers, folders, ports and names, over all commands: one line, a code, no traceback."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.bench.wrong_inputs import CASES, ending, make_place, taken_port


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("place")
    make_place(folder)
    return folder


@pytest.fixture(scope="module")
def taken() -> Iterator[str]:
    with taken_port() as port:
        yield port


def test_there_are_forty_beyond_those_of_scenarios() -> None:
    assert len({words for words, _ in CASES}) == len(CASES) >= 40


@pytest.mark.parametrize(("words", "word"), CASES, ids=[words for words, _ in CASES])
def test_a_wrong_input_is_one_line_that_names_it(
    words: str, word: str, place: Path, taken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    told = ending(words, word, taken)
    assert told.good, told
