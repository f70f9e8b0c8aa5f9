"""The one line that a wrong command ends with, in this process: what a start imports is imported once."""

import shlex
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tools.cli import headland


class Complaint(NamedTuple):
    code: int
    line: str


class Complaints:
    """Called with words behind `headland`; asserts that the end is one line of ours."""

    def __init__(self, patch: pytest.MonkeyPatch, captured: pytest.CaptureFixture[str]) -> None:
        self.patch, self.captured = patch, captured

    def of(self, words: str, folder: Path) -> Complaint:
        self.patch.chdir(folder)
        self.patch.setattr(sys, "argv", ["headland", *shlex.split(words)])
        with pytest.raises(SystemExit) as ended:
            headland.main()
        said = self.captured.readouterr().err
        assert said.startswith("headland: ") and said.count("\n") == 1, said
        assert isinstance(ended.value.code, int)
        return Complaint(ended.value.code, said)
