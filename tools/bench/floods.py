"""Floods of frames of every priority, with presses: which robots still move, and how soon all recover.

`python -m tools.bench.floods SEED` plays one trial again and prints it.
"""

import sys
from collections.abc import Iterator
from os import cpu_count
from time import process_time

from sim.chaos.flood_trial import RECOVER_US, Flood, FloodResult, Trial, draw
from tools.bench.figure import Figure, percentile
from tools.chaos.campaign import workers

TRIALS, QUICK_TRIALS = 2_000, 100
LONGEST_S, QUICK_LONGEST_S = 120.0, 20.0
NEVER_S = 3_600.0  # what did not come back while it was watched: JSON has no infinity
SAID_EVERY = 100  # trials, on standard error


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Robots that moved after the bound of a press in a flood, and how soon wire and fleet recover."""
    count, longest_for_s = (QUICK_TRIALS, QUICK_LONGEST_S) if quick else (TRIALS, LONGEST_S)
    floods = [draw(seed * TRIALS + k, longest_for_s=longest_for_s) for k in range(count)]
    results: list[FloodResult] = []
    cpu_s = 0.0
    with workers(cpu_count() or 1) as pool:
        for future in [pool.submit(_trial, flood) for flood in floods]:
            result, used_s = future.result()
            results.append(result)
            cpu_s += used_s
            if result.broken:
                print(f"broken: {_told(result)}", file=sys.stderr, flush=True)
            if len(results) % SAID_EVERY == 0:
                broken = sum(r.broken for r in results)
                print(f"{len(results)} of {count} trials, {broken} broken, {cpu_s:.0f} CPU s",
                      file=sys.stderr, flush=True)  # fmt: skip
    yield from _summed_up(
        results, f"floods of 1 to {longest_for_s:g} s, N = 3, 6, 20, all policies", cpu_s
    )


def _summed_up(results: list[FloodResult], scope: str, cpu_s: float) -> Iterator[Figure]:
    count, limit_s = len(results), RECOVER_US / 1e6
    presses = sum(len(result.flood.presses) for result in results)
    flood_s = sum(result.flood.for_s for result in results)
    late = sum(result.late for result in results)
    scope = f"{scope}; {count} trials, {presses} presses, {flood_s / 3600:.1f} h of floods"
    yield Figure("robots that move 120 ms and the silence limit after a press", late, "robots", "0",
                 late == 0, "true commands and positions of the bodies", scope)  # fmt: skip
    for name, times in (
        (
            "wire carries every robot's frames after a flood",
            [min(r.wire_for_s, NEVER_S) for r in results],
        ),
        (
            "fleet works after a flood, or its reset and start",
            [min(r.fleet_for_s, NEVER_S) for r in results],
        ),
    ):
        yield Figure(f"{name}, p99", percentile(times, 0.99), "s", "", None, "", scope)
        yield Figure(f"{name}, longest", max(times), "s", f"<= {limit_s:g}",
                     max(times) <= limit_s, "", scope)  # fmt: skip
    broken = sum(result.broken for result in results)
    yield Figure("trials broken", broken, "trials", "0", broken == 0, "", scope)
    yield Figure("processor time", cpu_s / count, "CPU s a trial", "", None, "", scope)


def _trial(flood: Flood) -> tuple[FloodResult, float]:
    begun_s = process_time()
    return Trial(flood).run(), process_time() - begun_s


def _told(result: FloodResult) -> str:
    again = f"python -m tools.bench.floods {result.flood.seed} {result.flood.longest_for_s:g}"
    return f"{result}\n    again: {again}"


if __name__ == "__main__":
    longest_for_s = float(sys.argv[2]) if len(sys.argv) > 2 else LONGEST_S
    print(Trial(draw(int(sys.argv[1]), longest_for_s=longest_for_s)).run())
