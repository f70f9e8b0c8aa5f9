"""Sentences of the documents are short: their median and the share of long ones have floors."""

import re
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import pytest

ROOT = Path(__file__).parents[1]
MEDIAN_MAX = 16  # words a sentence
LONG = 35  # words; a sentence with more is read twice
LONG_SHARE_MAX = 0.02  # of all sentences
PAGE_SHARE_MAX = 0.11  # of a page with enough sentences to have a share
ENOUGH = 20
CODE = "Code"  # stands for a piece of code: one word, and the begin of a sentence where it is one
END = re.compile(r"(?<=[.!?])[)\"']*\s+(?=[A-Z(\"'])")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TODAY = [path for path in PAGES if path.parent.name != "history"]


def prose(text: str) -> Iterator[str]:
    """Paragraphs and items of lists, without code, tables, headings and pictures."""
    text = re.sub(r"^( *)```.*?^\1```", "\n", text, flags=re.S | re.M)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    lines = []
    for line in text.splitlines():
        plain = line.strip()
        if plain.startswith(("|", "#", "![", "<")):
            lines.append("")
        else:
            lines.append(re.sub(r"^\s*(?:[-*]|\d+\.)\s+", "\n\n", line))
    joined = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    joined = re.sub(r"`[^`]*`", CODE, joined)
    for paragraph in re.split(r"\n\s*\n", joined):
        yield " ".join(paragraph.split()).replace("*", "")


def sentences(text: str) -> list[tuple[int, str]]:
    """The words of each sentence, and the sentence."""
    found = []
    for paragraph in prose(text):
        for sentence in END.split(paragraph):
            words = sum(any(c.isalnum() for c in word) for word in sentence.split())
            if words > 2:
                found.append((words, sentence))
    return found


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
