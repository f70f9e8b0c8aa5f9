"""`headland bench NAME`: every figure that a document of ours claims, measured again."""

import inspect
import json
import sys
from collections.abc import Callable, Iterator
from importlib import import_module

from rich.console import Console
from rich.table import Table

from tools.bench.figure import Figure

BENCHES = {
    "wire": "bus load, deliveries, response times against their bounds, decoding",
    "sync": "heals, joins, merging against pycrdt and loro",
    "stop": "presses, silence and real processes, to the last zero command",
    "durability": "SIGKILLs and power cuts of the journal",
    "forgery": "forged, replayed and stale orders",
    "coverage": "plans against the lower bound and the mission's planner",
    "delivery": "plans against PyVRP and OR-Tools, streams, batteries, trouble",
    "exploration": "speed-up, overlap, maps on the bus, equal maps",
    "theta": "paths against plain Theta* and the optimum",
    "orca": "avoidance against RVO2",
    "corridor": "swaps in passages, dead ends, and a hundred robots in rooms",
    "motion": "the thesis experiment: way driven against way planned",
    "lidar": "range sensing against pymunk, world steps",
}
MISSED, WRONG = 1, 2


def bench(name: str, quick: bool, seed: int, as_json: bool) -> int:
    """0 when every figure holds its target."""
    if name != "all" and name not in BENCHES:
        known = ", ".join((*BENCHES, "all"))
        print(f"headland: no bench {name}: choose one of {known}", file=sys.stderr)
        return WRONG
    found: list[Figure] = []
    console = Console(stderr=as_json)
    for each in BENCHES if name == "all" else (name,):
        with console.status(f"{each}: {BENCHES[each]}"):
            for figure in _figures(each, quick, seed):
                found.append(figure)
                if as_json:
                    print(
                        json.dumps({"bench": each, **figure._asdict()}, ensure_ascii=False),
                        flush=True,
                    )
                else:
                    console.print(_line(figure), highlight=False)
    missed = [figure for figure in found if figure.holds is False]
    if not as_json:
        targets = sum(figure.holds is not None for figure in found)
        console.print(f"{len(found)} figures, {targets} with a target, {len(missed)} missed")
    return MISSED if missed else 0


def _figures(name: str, quick: bool, seed: int) -> Iterator[Figure]:
    figures: Callable[..., Iterator[Figure]] = import_module(f"tools.bench.{name}").figures
    seeded = "seed" in inspect.signature(figures).parameters
    yield from figures(quick, seed) if seeded else figures(quick)


def _line(figure: Figure) -> Table:
    table = Table.grid(padding=(0, 1))
    for width in (6, 60, 14, 10, 24):
        table.add_column(width=width, overflow="fold")
    mark = {True: "[green]holds[/]", False: "[red]MISSED[/]", None: ""}[figure.holds]
    value = f"{figure.value:,.4g}" if figure.value < 1e4 else f"{figure.value:,.0f}"
    table.add_row(mark, figure.figure, value, figure.unit, figure.target)
    return table
