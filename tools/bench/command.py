"""`headland bench NAME`: every figure that a document of ours claims, measured again."""

import inspect
from collections.abc import Callable, Collection, Iterator
from importlib import import_module

from rich.console import Console
from rich.table import Table

from sim.files.strict_json import dumps
from tools.bench.figure import Figure
from tools.chaos.campaign import ClusterError, workers
from tools.common.exit_codes import wrong

BENCHES = {
    "wire": "bus load, deliveries, response times against their bounds, decoding",
    "sync": "heals, joins, merging against pycrdt and loro",
    "stop": "presses, silence and real processes, to the last zero command",
    "floods": "a bus full of frames that outrank a stop, with presses, by true positions",
    "durability": "SIGKILLs and power cuts of the journal",
    "forgery": "forged, replayed and stale orders",
    "trust": "fleets with keys: forged frames, stolen keys, attackers in campaigns, bus load, CPU",
    "field": "work in fields against a plan of the whole fleet by OR-Tools",
    "coverage": "plans against the lower bound and the mission's planner",
    "delivery": "plans against PyVRP and OR-Tools, streams, batteries, trouble",
    "exploration": "speed-up, overlap, maps on the bus, equal maps",
    "theta": "paths against plain Theta* and the optimum",
    "orca": "avoidance against RVO2",
    "corridor": "swaps in passages, dead ends, and a hundred robots in rooms",
    "motion": "the thesis experiment: way driven against way planned",
    "robot": "robots as processes on machines: lost places over TCP, start, memory",
    "scale": "many segments: stops across them, bus share, heals, memory, campaigns on a cluster",
    "operator": "the map in a browser, and stops with its page open",
    "lidar": "range sensing against pymunk, world steps",
    "phrases": "plain language, misspellings, why, the inspector's screen",
    "files": "damaged files of every kind that is read: time and memory to refuse them",
    "isobus": "devices of other makers: what a robot answers them, what their tools read of it",
    "systems": "interfaces to other systems, each against a counterpart of others",
    "people": "the first hour: start, install, typing errors, a round of an operator, prose",
    "leaks": "memory of ten robots with the map, 24 h from 30 min",
    "house": "what can be counted of the sources: cycles, names, ignored types, docstrings, lines",
    "chaos": "the speed of simulated trouble, campaigns, planted bugs, decoders",
}
MISSED = 1


def bench(
    name: str,
    quick: bool,
    seed: int,
    as_json: bool,
    cluster: str = "",
    seconds: float | None = None,
) -> int:
    """0 when every figure holds its target. `name`: one of BENCHES, all, or empty for their list.

    `cluster`: benches run on the workers of a scheduler.

    `seconds`: how long, where a bench runs by the clock; none: as its target asks for.
    """
    if not name:
        return _listed(as_json)
    if name != "all" and name not in BENCHES:
        known = ", ".join((*BENCHES, "all"))
        return wrong(f"no bench {name}: choose one of {known}")
    if seconds is not None and name != "all" and "seconds" not in _taken(name):
        return wrong(
            f"--seconds: does nothing here: {name} does not run by the clock; leave it out"
        )
    found: list[Figure] = []
    console = Console(stderr=as_json)
    names = tuple(BENCHES) if name == "all" else (name,)
    try:
        for each, figure in _measured(names, quick, seed, cluster, console, seconds):
            found.append(figure)
            if as_json:
                told = {"bench": each, **figure._asdict()}
                print(dumps(told, ensure_ascii=False), flush=True)
            else:
                console.print(_line(figure), highlight=False)
    except ClusterError as problem:
        return wrong(problem)
    missed = [figure for figure in found if figure.holds is False]
    if not as_json:
        targets = sum(figure.holds is not None for figure in found)
        console.print(f"{len(found)} figures, {targets} with a target, {len(missed)} missed")
    return MISSED if missed else 0


def _listed(as_json: bool) -> int:
    if as_json:
        print(dumps(BENCHES))
        return 0
    width = max(map(len, BENCHES))
    for name, what in BENCHES.items():
        print(f"{name:{width}}  {what}")
    print(f"{'all':{width}}  all of them: hours; with --quick less than a minute each")
    return 0


def _measured(
    names: tuple[str, ...], quick: bool, seed: int, cluster: str, console: Console,
    seconds: float | None,
) -> Iterator[tuple[str, Figure]]:  # fmt: skip
    if not cluster:
        for each in names:
            with console.status(f"{each}: {BENCHES[each]}"):
                for figure in _figures(each, quick, seed, seconds):
                    yield each, figure
        return
    with workers(cluster=cluster) as pool, console.status(f"{len(names)} benches at {cluster}"):
        runs = {each: pool.submit(_all_figures, each, quick, seed, seconds) for each in names}
        for each, run in runs.items():
            for figure in run.result():
                yield each, figure


def _all_figures(name: str, quick: bool, seed: int, seconds: float | None) -> list[Figure]:
    return list(_figures(name, quick, seed, seconds))


def _figures(name: str, quick: bool, seed: int, seconds: float | None) -> Iterator[Figure]:
    figures: Callable[..., Iterator[Figure]] = import_module(f"{__package__}.{name}").figures
    taken = _taken(name)
    given = {"seed": seed, "seconds": seconds}
    yield from figures(quick, **{key: value for key, value in given.items() if key in taken})


def _taken(name: str) -> Collection[str]:
    """What a bench can be told, by the names of its parameters."""
    return inspect.signature(import_module(f"{__package__}.{name}").figures).parameters


def _line(figure: Figure) -> Table:
    table = Table.grid(padding=(0, 1))
    for width in (6, 60, 14, 10, 24):
        table.add_column(width=width, overflow="fold")
    mark = {True: "[green]holds[/]", False: "[red]MISSED[/]", None: ""}[figure.holds]
    value = f"{figure.value:,.4g}" if figure.value < 1e4 else f"{figure.value:,.0f}"
    table.add_row(mark, figure.figure, value, figure.unit, figure.target)
    return table
