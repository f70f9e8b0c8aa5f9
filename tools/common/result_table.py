"""The table of what came of a run: a fact a row, its name before it."""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from rich.markup import escape
from rich.table import Table

from tools.common.counted import counted
from tools.common.run_flaws import flaws

NO_KEYS = "[bold red]NONE: any device on the bus can stop and release this fleet[/bold red]"
Fact = tuple[str, str]  # name and text; the text may have rich's markup


class RunOutcome(Protocol):
    """What outcomes of all kinds of runs tell."""

    @property
    def scenario(self) -> str:
        """Name of the scenario."""

    @property
    def robots(self) -> int:
        """Number of robots that took part."""

    @property
    def seed(self) -> int:
        """Of the random numbers of the run."""

    @property
    def success(self) -> bool:
        """Whether the exit code is 0."""

    def to_dict(self) -> dict[str, Any]:
        """The figures of its report."""

    @property
    def frames(self) -> Mapping[str, int]:
        """Number of frames of each kind on the bus."""

    @property
    def trace_hash(self) -> str:
        """Hash over everything that the robots did."""

    @property
    def wall_s(self) -> float:
        """Real time that the run took."""


def fact_table(title: str, facts: Iterable[Fact]) -> Table:
    """A table with two columns, names in bold, ready to be printed. The title is no markup."""
    table = Table(title=escape(title), show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, fact in facts:
        table.add_row(name, fact)
    return table


def run_table(ran: RunOutcome, facts: Iterable[Fact]) -> Table:
    """The table of a scenario's run: whether it was without a flaw, `facts`, how to know it again."""
    why = escape("; ".join(flaws(ran.to_dict())))
    return fact_table(
        f"{ran.scenario}: {counted(ran.robots, '{} robot{s}')}, seed {ran.seed}",
        [
            ("without a flaw", "[green]yes[/green]" if ran.success else f"[red]no: {why}[/red]"),
            *facts,
            ("frames", ", ".join(f"{n} {kind}" for kind, n in ran.frames.items())),
            ("trace hash", ran.trace_hash),
            ("computed in", f"{ran.wall_s:.1f} s"),
        ],
    )
