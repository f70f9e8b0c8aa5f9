"""Reduce a failing scenario: fewer faults and robots, as long as it breaks the same rule."""

from collections.abc import Callable, Iterator

from sim.chaos.fault_profiles import span_of, with_faults
from sim.scenarios.scenario import Crash, Fault, Restart, Scenario

RUNS_MAX = 80  # tries; a run takes a few seconds


def shrink(scenario: Scenario, fails: Callable[[Scenario], bool]) -> tuple[Scenario, int]:
    """The smallest failing scenario found, and the number of runs. `fails` runs a scenario; ddmin
    (Zeller 1999) on faults.

    A crash does not lose its restart: a fleet that waits for a dead robot would fail for another reason.
    """
    runs = 0

    def tried(candidate: Scenario) -> bool:
        nonlocal runs
        runs += 1
        return runs <= RUNS_MAX and fails(candidate)

    faults = [fault for fault in scenario.fault if fault.at_s <= span_of(scenario).calm_at_s]
    pieces = 2
    while faults:
        for fewer in _without(faults, pieces):
            if _dead(fewer) <= _dead(faults) and tried(with_faults(scenario, fewer)):
                faults, pieces = fewer, max(2, pieces - 1)
                break
        else:
            if pieces >= len(faults):
                break
            pieces = min(2 * pieces, len(faults))
    best = with_faults(scenario, faults)
    least = 1 + max((robot for fault in faults for robot in _robots(fault)), default=0)
    for robots in range(least, scenario.fleet.robots):
        fleet = best.fleet.model_copy(update={"robots": robots})
        candidate = best.model_copy(update={"fleet": fleet})
        if tried(candidate):
            return candidate, runs
    return best, runs


def _without(faults: list[Fault], pieces: int) -> Iterator[list[Fault]]:
    """The list without each of its pieces in turn."""
    size = -(-len(faults) // pieces)
    for begin in range(0, len(faults), size):
        yield faults[:begin] + faults[begin + size :]


def _dead(faults: list[Fault]) -> set[int]:
    """The robots that crash and are not started again."""
    dead: set[int] = set()
    for fault in sorted(faults, key=lambda fault: fault.at_s):
        if isinstance(fault, Crash):
            dead.add(fault.robot)
        elif isinstance(fault, Restart):
            dead.discard(fault.robot)
    return dead


def _robots(fault: Fault) -> list[int]:
    named = [getattr(fault, key, 0) for key in ("robot", "sender", "receiver")]
    return named + [slot for island in getattr(fault, "islands", []) for slot in island]
