"""Grid coverage: makespan over what no plan can beat, the planner of the brief, deaths, planning time.

Instances come from the folder named by HEADLAND_DATA, else from `../shared/data` beside the project:
`mcpp/instances/*.mcpp` and `fields/grids/*.map`. Where they are absent only random maps are measured.
"""

from collections.abc import Iterator
from pathlib import Path
from statistics import fmean, median
from time import process_time
from typing import NamedTuple

from agent.coverage.team import Team
from sim.files.grid_map import (
    Instance,
    gate_starts,
    random_starts,
    random_walls,
    read_instance,
    read_map,
)
from sim.runs.planned_coverage import Arrival, Death, work
from sim.world.plan_judge import PlanScore, judge, lower_bound
from tools.bench import coverage_fleet
from tools.bench.figure import Figure
from tools.bench.map_kinds import data_folder
from tools.bench.voronoi_coverage import baseline

NAMED = ("floor_medium", "terrain_medium", "ht_chantry", "Shanghai2")
FIELD_ROBOTS = 8
TURN_COST = 0.5  # steps that a quarter turn costs in LS-MCPP
# rows, columns, share of walls, robots, from one corner
RANDOM = (
    (32, 32, 0.2, 20, False), (32, 32, 0.2, 4, False), (64, 64, 0.1, 20, False),
    (64, 64, 0.1, 32, True), (128, 128, 0.15, 40, False), (256, 256, 0.2, 100, False),
)  # fmt: skip
BOUND = "distance-aware lower bound"
SCOPE = "open makespan by the independent judge; unit steps; state shared without delay"


class PlannedRun(NamedTuple):
    """A planned instance with its score and the bound that no plan can beat."""

    instance: Instance
    verdict: PlanScore
    bound: int

    @property
    def ratio(self) -> float:
        """Makespan as a factor of the bound."""
        return self.verdict.makespan / max(1, self.bound)

    @property
    def faults(self) -> int:
        """Collisions, swaps, steps into walls, and cells left: 0 for a plan that counts."""
        v = self.verdict
        return v.collisions + v.swaps + v.wall_entries + v.uncovered


def published(folder: Path) -> list[Instance]:
    """Instances of LS-MCPP in that folder; none if it is missing."""
    return [read_instance(path) for path in sorted(folder.glob("mcpp/instances/*.mcpp"))]


def fields(folder: Path) -> list[Instance]:
    """Grids of real fields in that folder, with robots at one gate."""
    maps = [(path.stem, read_map(path)) for path in sorted(folder.glob("fields/grids/*.map"))]
    return [Instance(name, walls, gate_starts(walls, FIELD_ROBOTS)) for name, walls in maps]


def by_chance(seeds: int) -> list[Instance]:
    """Random maps of several sizes, so many seeds of each but the largest."""
    found = []
    for rows, columns, share, robots, gate in RANDOM:
        for seed in range(seeds if rows < 256 else 1):
            walls = random_walls(rows, columns, share, seed)
            starts = gate_starts(walls, robots) if gate else random_starts(walls, robots, seed)
            place = "gate" if gate else f"{share:.0%}"
            found.append(Instance(f"random {rows}x{columns} {place} k={robots}", walls, starts))
    return found


def run(instance: Instance) -> PlannedRun:
    """Plan an instance, and judge the plan."""
    return PlannedRun(instance, judge(work(instance)), lower_bound(instance.walls, instance.starts))


def _under(name: str, value: float, target: float | None, against: str, scope: str) -> Figure:
    text = "" if target is None else f"<= {target:.2f}"
    return Figure(
        name,
        round(value, 3),
        "ratio",
        text,
        None if target is None else value <= target,
        against,
        scope,
    )


def ratios(
    runs: list[PlannedRun], real: list[PlannedRun], chance: list[PlannedRun]
) -> Iterator[Figure]:
    """Makespan over the bound for each run, and means of the kinds of maps."""
    for one in runs:
        target = 1.45 if one.instance.name in NAMED else None
        name = f"coverage {one.instance.name} k={len(one.instance.starts)}"
        yield _under(name, one.ratio, target, BOUND, SCOPE)
    named = [one.ratio for one in runs if one.instance.name in NAMED]
    if named:
        yield _under("coverage of published maps, mean", fmean(named), 1.35, BOUND, SCOPE)
    if real:
        scope = f"{SCOPE}; {len(real)} real fields as grids, {FIELD_ROBOTS} robots from one gate"
        yield _under("coverage of fields, mean", fmean(r.ratio for r in real), 1.15, BOUND, scope)
        yield _under("coverage of fields, worst", max(r.ratio for r in real), 1.35, BOUND, scope)
    for name in dict.fromkeys(one.instance.name for one in chance):
        same = [one.ratio for one in chance if one.instance.name == name]
        scope = f"{SCOPE}; mean of {len(same)} seeds"
        yield _under(f"coverage {name}", fmean(same), None, BOUND, scope)


def against_the_mission(runs: list[PlannedRun]) -> Iterator[Figure]:
    """Makespan against the safe baseline where that ends, and what its stages do by themselves."""
    many, gate, collided, stuck = [], [], 0, 0
    for one in runs:
        plain, _ = baseline(one.instance, strict=False)
        verdict = judge(plain)
        collided += verdict.collisions + verdict.swaps > 0
        _, ended = baseline(one.instance, strict=True)
        stuck += not ended
        # The unsafe schedule is the faster one: it lets robots through each other.
        share = one.verdict.makespan / max(1, verdict.makespan)
        if _from_gate(one.instance):
            gate.append(share)
        elif len(one.instance.starts) >= 30:
            many.append(share)
    against = "mission's planner: Voronoi, DFS with hops, reservation table"
    scope = "makespan share on equal instances; its collisions forgiven"
    if many:
        yield _under("against the mission, k >= 30, worst", max(many), 0.5, against, scope)
    if gate:
        yield _under("against the mission, one gate, worst", max(gate), 0.25, against, scope)
    text = f"of {len(runs)} instances, by the independent judge"
    yield Figure("mission's planner collides", collided, "instances", "", None, against, text)
    yield Figure("mission's planner made safe locks", stuck, "instances", "", None, against, text)


def _from_gate(instance: Instance) -> bool:
    return set(instance.starts) == set(gate_starts(instance.walls, len(instance.starts)))


def deaths(runs: list[PlannedRun], seeds: int) -> Iterator[Figure]:
    """One robot becomes a wreck at half time: how much later the others end."""
    worst, repeats = 0.0, 0
    for one in runs:
        robots = len(one.instance.starts)
        if robots < 8:
            continue
        for seed in range(min(seeds, robots)):
            victim = (seed * 7 + 3) % robots
            verdict = judge(work(one.instance, deaths=[Death(one.verdict.makespan // 2, victim)]))
            assert verdict.ok
            worst = max(worst, verdict.makespan / one.verdict.makespan)
            repeats += 1
    scope = f"worst of {repeats} runs; the wreck blocks its cell; covered cells are not cut again"
    yield _under("a death at half time", worst, 1.2, "the same run without a death", scope)


def joins(runs: list[PlannedRun]) -> Iterator[Figure]:
    """As many again join in a corner at half time: the rest should take half as long."""
    shares = []
    for one in runs:
        robots, half = len(one.instance.starts), one.verdict.makespan // 2
        corner = gate_starts(one.instance.walls, robots)
        verdict = judge(work(one.instance, arrivals=[Arrival(half, cell) for cell in corner]))
        assert verdict.ok
        shares.append((verdict.makespan - half) / (one.verdict.makespan - half))
    scope = f"steps after half time, mean of {len(shares)} runs; the new ones come in one corner"
    against = "the same run without them; half is what cannot be beaten"
    yield _under("twice as many robots from half time on", fmean(shares), None, against, scope)


def turns(runs: list[PlannedRun]) -> Iterator[Figure]:
    """What planning with a cost of turns gains over planning without, on the published maps."""
    for one in runs:
        if one.instance.name in NAMED:
            aware = judge(work(one.instance, turn_cost=TURN_COST)).score(TURN_COST)
            blind = one.verdict.score(TURN_COST)
            name = f"coverage with turns {one.instance.name}"
            scope = f"slowest robot's steps and {TURN_COST} a quarter turn; {SCOPE}"
            yield _under(name, aware / one.bound, None, f"{BOUND} without turns", scope)
            yield _under(
                f"{name}, planned with them", aware / blind, None, "planned without", scope
            )


def planning(instances: list[Instance]) -> Iterator[Figure]:
    """CPU time of what a robot computes, to the end: the slowest instance, the median of three runs."""
    robots, slowest_s = 100, 0.0
    for instance in instances:
        taken_s = []
        for _ in range(3):
            begun_s = process_time()
            team = Team(instance.walls, instance.starts)
            while team.remaining():
                team.advance()
            taken_s.append(process_time() - begun_s)
        slowest_s = max(slowest_s, median(taken_s))
    scope = (
        "walk, cut and all steps, times 100: as if each of 100 robots computed all of it for itself"
    )
    yield Figure(
        "planning of 256x256 with 100 robots", round(slowest_s * robots, 1), "CPU s", "<= 60",
        slowest_s * robots <= 60, "", scope,
    )  # fmt: skip


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Makespans, turns, deaths and times of planning; with `quick` on fewer maps."""
    seeds = 1 if quick else 10
    folder = data_folder()
    work(by_chance(1)[0])  # compiles
    runs, real = [run(i) for i in published(folder)], [run(i) for i in fields(folder)]
    chance = [run(instance) for instance in by_chance(seeds)]
    yield from ratios(runs, real, chance)
    everything = runs + real + chance
    small = [one for one in everything if one.instance.walls.size <= 128 * 128]
    yield from against_the_mission(small if quick else everything)
    yield from deaths(small, seeds)
    smaller = [one for one in everything if one.instance.walls.size < 128 * 128]
    yield from joins(smaller[: 4 if quick else 12])
    yield from turns([one for one in runs if one.instance.walls.size <= 128 * 128 or not quick])
    yield from planning([one.instance for one in everything if len(one.instance.starts) == 100])
    faults = sum(one.faults for one in everything)
    yield Figure(
        "collisions, swaps, wall entries, uncovered", faults, "faults", "0", faults == 0, "",
        f"{len(everything)} runs, by the independent judge",
    )  # fmt: skip
    named = [one.instance for one in runs if one.instance.name in NAMED]
    fenced = [one.instance for one in real]
    yield from coverage_fleet.figures(quick, seed, named, fenced)
