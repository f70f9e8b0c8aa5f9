"""What a check found, one finding a line: as text for people, or as JSON."""

from collections.abc import Sequence
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape

MARKS = {True: "[green]ok  [/green]", None: "[dim]note[/dim]", False: "[red]BAD [/red]"}


class Finding(NamedTuple):
    """One thing that was looked at. `ok` None: nothing is wrong, but it is worth knowing."""

    what: str
    ok: bool | None
    found: str


def print_findings(console: Console, findings: Sequence[Finding]) -> None:
    """A line each."""
    width = max(len(finding.what) for finding in findings)
    for finding in findings:
        text = f"{MARKS[finding.ok]} {escape(f'{finding.what:<{width}}')}  {escape(finding.found)}"
        console.print(text, soft_wrap=True)
