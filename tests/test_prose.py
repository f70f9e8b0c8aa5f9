"""Sentences of the documents are short: their median and the share of long ones have floors."""

from pathlib import Path
from statistics import median

import pytest

from tools.build.prose_checker import LONG, LONG_SHARE_MAX, MEDIAN_MAX, pages, sentences

ROOT = Path(__file__).parents[1]
PAGE_SHARE_MAX = 0.11  # of a page with enough sentences to have a share
ENOUGH = 20
TODAY = pages(ROOT)


def test_sentences_are_counted_as_a_reader_does() -> None:
    text = (
        "# A heading is none\n\nThe robot stops. `stop` tells it so, and it says why.\n\n"
        "| a | table |\n|---|---|\n* One fact [with a link](x.md)\n  over two lines.\n\n"
        "   ```\n   code has no sentences\n   ```\n"
    )
    assert [words for words, _ in sentences(text)] == [3, 8, 8]


def test_the_documents_are_read_once() -> None:
    counts = [words for path in TODAY for words, _ in sentences(path.read_text(encoding="utf-8"))]
    share = sum(words > LONG for words in counts) / len(counts)
    print(f"{len(counts)} sentences, median {median(counts)}, {share:.1%} over {LONG} words")
    assert median(counts) <= MEDIAN_MAX
    assert share <= LONG_SHARE_MAX, "python -m pytest tests/test_prose.py names the pages"


@pytest.mark.parametrize("path", TODAY, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_page_is_much_worse_than_the_others(path: Path) -> None:
    found = sentences(path.read_text(encoding="utf-8"))
    if len(found) < ENOUGH:
        return
    long = [sentence for words, sentence in found if words > LONG]
    assert len(long) <= PAGE_SHARE_MAX * len(found), long
    assert median(words for words, _ in found) <= MEDIAN_MAX + 3
