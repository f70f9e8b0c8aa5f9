"""Exploration: how much faster many robots are, what it costs on the bus, and whether maps agree."""

from collections.abc import Iterator, Sequence
from math import isfinite, nan
from random import Random

import numpy as np

from crdt.occupancy import Geometry, OccupancyMap
from crdt.sighting import OBSTACLE, UNKNOWN, MergeOrder
from sim.runs.exploration_fleet import Sharing
from sim.runs.exploration_run import ExplorationOutcome, ExplorationRun
from sim.scenarios.exploration_scenario import load_arena
from sim.scenarios.scenario import Crash, Loss
from tools.bench.figure import Figure

SCOPE = "simulated time from power-up; real peers, wire, physics and rays on both sides"
AGAINST = "the same code with one map for all at once and without a wire"
LARGE = ["hall", "offices", "ring", "warehouse"]
ORDERS = 100_000  # random orders of merging


def play(
    arena: str, robots: int, seed: int, sharing: Sharing = Sharing.FLEET, until: float = 2.0,
    faults: Sequence[Loss | Crash] = (),
) -> ExplorationOutcome:  # fmt: skip
    """One exploration of a shipped arena. `until` is the share of the ground after which it ends;
    above 1: not before all is seen."""
    scenario = load_arena(arena).changed(robots, seed)
    return ExplorationRun(
        scenario.model_copy(update={"fault": list(faults)}), sharing, until=until
    ).run()


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Speed-up, overlap, load of the bus and equality of maps, over arenas and seeds."""
    arenas = ["arena"] if quick else LARGE
    sizes = [1, 2, 4] if quick else [1, 2, 4, 8]
    seeds = range(seed, seed + (2 if quick else 3))
    runs = {
        (size, sharing): [play(a, size, s, sharing) for a in arenas for s in seeds]
        for size in sizes
        for sharing in (Sharing.FLEET, Sharing.AT_ONCE)
    }
    where = f"{', '.join(arenas)}; seeds {seeds[0]} to {seeds[-1]}"
    yield from speed(runs, sizes, where)
    fleet = [run for size in sizes for run in runs[size, Sharing.FLEET]]
    yield from costs(runs[sizes[-1], Sharing.FLEET], sizes[-1], where)
    if not quick:  # without sharing a large arena takes a minute
        yield from overlaps(arenas, 4, list(seeds))
    yield from overlaps(["arena"], 4, list(seeds))
    equal = sum(run.maps_equal for run in fleet) / len(fleet)
    yield Figure("runs with identical maps on all replicas after 2 s of quiet", equal, "share",
                 "= 1", equal == 1.0, "-", f"{len(fleet)} runs; bit for bit; {where}")  # fmt: skip
    yield trouble(3 if quick else 50, seed)
    yield merge_orders(ORDERS // 10 if quick else ORDERS, seed)


def speed(
    runs: dict[tuple[int, Sharing], list[ExplorationOutcome]], sizes: list[int], where: str
) -> Iterator[Figure]:
    """Times to 95 % and speed-ups, of all arenas and seeds together."""
    total = {key: sum(run.time_95_s for run in found) for key, found in runs.items()}
    for size in sizes:
        mean_s = total[size, Sharing.FLEET] / len(runs[size, Sharing.FLEET])
        yield Figure(
            f"time to 95 %, {size} robots", mean_s, "s", "", None, "-", f"{SCOPE}; {where}"
        )
    for size in sizes[1:]:
        ours, theirs = (
            total[1, sharing] / total[size, sharing] for sharing in (Sharing.FLEET, Sharing.AT_ONCE)
        )
        share = ours / theirs if theirs else nan  # a fleet that has not seen 95 % took for ever
        holds = isfinite(share) and share >= 0.90
        yield Figure(f"speed-up of {size} robots over one", ours, "x", "", None, "-", where)
        yield Figure(f"speed-up of {size} robots, share of the omniscient one's", share, "x",
                     ">= 0.90", holds, AGAINST, f"{SCOPE}; {where}")  # fmt: skip


def costs(found: list[ExplorationOutcome], robots: int, where: str) -> Iterator[Figure]:
    """Load of the bus and bytes a square metre that maps took in these runs."""
    load = max(run.map_load for run in found)
    scope = f"map frames at worst-case stuffing, 250 kbit/s, power-up to end; worst run; {where}"
    yield Figure(f"bus load by maps, {robots} robots", load, "share", "<= 0.15", load <= 0.15,
                 "-", scope)  # fmt: skip
    bytes_m2 = float(np.mean([run.map_bytes_per_m2 for run in found]))
    yield Figure(f"bytes on the wire a square metre, {robots} robots", bytes_m2, "bytes/m2", "", None,
                 "-", f"data bytes of map frames, digests included; cells of 0.1 m; {where}")  # fmt: skip


def overlaps(arenas: list[str], robots: int, seeds: list[int]) -> Iterator[Figure]:
    """Area seen again by another until 95 % has been seen by somebody: of each arena, and in all.

    In the small arena four robots stand side by side and see a third of it together before they move,
    on both sides of the comparison: that figure has no target.
    """
    seen = {
        (arena, sharing): sum(play(arena, robots, s, sharing, 0.95).overlap for s in seeds)
        for arena in arenas
        for sharing in (Sharing.FLEET, Sharing.NONE)
    }
    for some in [[arena] for arena in arenas] + ([arenas] if len(arenas) > 1 else []):
        ours, theirs = (
            sum(seen[arena, sharing] for arena in some) for sharing in (Sharing.FLEET, Sharing.NONE)
        )
        judged = some != ["arena"]
        yield Figure(
            f"overlap of {robots} robots against no sharing, {', '.join(some)}",
            ours / theirs, "x", "<= 0.50" if judged else "", ours / theirs <= 0.5 if judged else None,
            "each for itself to its nearest frontier",
            f"cells seen by a robot after another had, until 95 % has been seen by somebody; "
            f"{len(seeds)} seeds",
        )  # fmt: skip


def trouble(runs: int, seed: int) -> Figure:
    """Complete and untouched, although a fifth of all frames is lost and a robot dies."""
    good = 0
    for k in range(runs):
        rng = Random(f"{seed + k}/trouble")
        faults = (
            Loss(at_s=0.2, kind="loss", rate=0.2),
            Crash(at_s=rng.uniform(3.0, 9.0), kind="crash", robot=rng.randrange(3)),
        )
        run = play("arena", 3, seed + k, faults=faults)
        # What the dead robot's body stands on, and what it hides, cannot be seen.
        good += run.finished and run.contacts == 0 and run.maps_equal and run.explored >= 0.95
    return Figure("explorations complete without a contact, 20 % of frames lost, one robot killed",
                  good / runs, "share", "= 1", good == runs, "-",
                  f"{runs} seeds, arena, 3 robots; maps equal after 2 s")  # fmt: skip


def merge_orders(orders: int, seed: int) -> Figure:
    """Maps of five robots that contradict each other, joined in random orders."""
    rng = np.random.default_rng(seed)
    geometry = Geometry(8, 8, (0.0, 0.0), 0.1)
    found: set[int] = set()
    maps = []
    for slot in range(5):
        chart = OccupancyMap(geometry, MergeOrder.DECAYED)
        for _ in range(12):
            values = rng.integers(UNKNOWN, OBSTACLE + 1, 16)
            patch, level, time = (int(rng.integers(n)) for n in (4, 16, 30))
            chart.apply(patch, values, level, time, slot)
        maps.append(chart)
    for _ in range(orders):
        joined = OccupancyMap(geometry, MergeOrder.DECAYED)
        for slot in rng.permutation(5).tolist():
            joined.join_map(maps[slot])
        found.add(joined.digest)
    return Figure("different maps from random orders of merging", len(found), "maps", "= 1",
                  len(found) == 1, "the mission's rule gives several", f"{orders} orders")  # fmt: skip
