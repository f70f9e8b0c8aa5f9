"""A progress bar leaves nothing where it is not seen."""

from io import StringIO
from unittest.mock import Mock

from rich.console import Console

from tools.run.run_mission import ProgressBar


def test_a_bar_that_nobody_sees_leaves_no_empty_line() -> None:
    """`headland run --json` wrote an empty line to stderr, and the text of a run began with one."""
    console = Console(file=StringIO())
    with ProgressBar(console, "small", Mock(), "sections"):
        pass
    assert isinstance(console.file, StringIO) and console.file.getvalue() == ""
