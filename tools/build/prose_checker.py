"""Sentences of the documents and their words: how long prose is to read."""

import re
from collections.abc import Iterator
from pathlib import Path

MEDIAN_MAX = 16  # words a sentence
LONG = 35  # words; a sentence with more is read twice
LONG_SHARE_MAX = 0.02  # of all sentences
CODE = "Code"  # stands for a piece of code: one word, and the begin of a sentence where it is one
END = re.compile(r"(?<=[.!?])[)\"']*\s+(?=[A-Z(\"'])")


def pages(root: Path) -> list[Path]:
    """README.md and the documents of today, without history. `root`: of the checkout."""
    found = [root / "README.md", *sorted((root / "docs").rglob("*.md"))]
    return [path for path in found if path.parent.name != "history"]


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
