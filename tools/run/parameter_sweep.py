"""The same scenario with other robots and other seeds: a table with a row for each run."""

from collections.abc import Iterable
from itertools import product
from typing import Any

from rich.progress import track

from tools.run.notebook import play

SHOWN = (
    "coverage",
    "makespan_s",
    "distance_m",
    "contacts",
    "finished",
)  # first, where a run has them


def sweep(
    scenario: str = "small",
    robots: Iterable[int | None] = (4,),
    seeds: Iterable[int] = (1,),
    *,
    progress: bool = True,
    **changes: Any,
) -> Any:
    """Every number of robots with every seed: a pandas DataFrame with the figures of each run.

    `changes` are passed to `play`: `faults`, `time_limit_s`, `drive`, `mission`. `progress`: show how far
    it is. `robots`: None: as many as the scenario has.
    Raises ScenarioError, and ImportError without pandas.
    """
    import pandas

    pairs = list(product(robots, seeds))
    rows = []
    for count, seed in track(pairs, description=scenario, disable=not progress, transient=True):
        run = play(scenario, robots=count, seed=seed, progress=False, **changes)
        plain = {k: v for k, v in run.figures.items() if isinstance(v, (bool, int, float, str))}
        rows.append({"robots": len(run.tracks), "seed": seed} | plain)
    frame = pandas.DataFrame(rows)
    first = ["robots", "seed", *(name for name in SHOWN if name in frame)]
    return frame[[*first, *(name for name in frame if name not in first)]]
