"""Grid coverage by whole peers on the simulated bus: against the bound, and against instant sharing.

One peer a robot with all that it does on a real bus of 250 kbit/s; the makespan is what the world saw,
from power-up on, with address claims, agreement on the plan and everything else that takes time.
"""

from collections.abc import Iterator, Sequence
from statistics import fmean
from typing import NamedTuple

from sim.files.grid_map import (
    Instance,
    gate_starts,
    rack_walls,
    random_starts,
    random_walls,
    room_walls,
)
from sim.runs.coverage_run import CoverageOutcome, CoverageRun
from sim.runs.planned_coverage import work
from sim.scenarios.coverage_setup import STEP_S, CoverageSetup
from sim.scenarios.scenario import Crash, Fault, Heal, Join, Loss, Partition
from sim.world.plan_judge import judge
from tools.bench.figure import Figure

BOUND = "distance-aware lower bound"
INSTANT = "the same planner with state shared at once"
SCOPE = (
    f"whole peers on a wire of 250 kbit/s, cells of {STEP_S:.1f} s; from power-up to the last cell"
)
SPLIT_S = 60.0
ROBOTS = 8


class FleetRun(NamedTuple):
    """One run of whole peers over an instance."""

    instance: Instance
    outcome: CoverageOutcome

    @property
    def shared_at_once(self) -> float:
        """Makespan over that of instant sharing."""
        steps = judge(work(self.instance)).makespan
        return self.outcome.makespan_s / (max(1, steps) * STEP_S)


def drive(
    instance: Instance, seed: int = 1, faults: Sequence[Fault] = (), loss: float = 0.0
) -> FleetRun:
    """Let whole peers cover an instance. `loss` is a share of all frames from 0 to 1."""
    cells = int((~instance.walls).sum())
    limit_s = 300.0 + 3.0 * cells * STEP_S / len(instance.starts)
    setting = CoverageSetup.made(
        instance, seed=seed, faults=faults, loss=loss, time_limit_s=limit_s
    )  # fmt: skip
    return FleetRun(instance, CoverageRun(setting).run())


def scattered(side: int, robots: int, seed: int) -> Instance:
    """A random map of `side` by `side` cells with a tenth of walls, and robots anywhere."""
    walls = random_walls(side, side, 0.1, seed)
    return Instance(
        f"random {side}x{side} k={robots}", walls, random_starts(walls, robots, seed)
    )  # fmt: skip


def troubled(seed: int) -> list[Instance]:
    """Maps for trouble: open ones, rooms with doors, a warehouse whose aisles hold one robot."""
    rooms, racks = room_walls(31, 31, 7, seed), rack_walls(32, 32)
    return [
        scattered(32, ROBOTS, seed),
        scattered(32, 12, seed + 1),
        Instance(f"rooms 31x31 k={ROBOTS}", rooms, random_starts(rooms, ROBOTS, seed)),
        Instance(f"warehouse 32x32 k={ROBOTS}", racks, gate_starts(racks, ROBOTS)),
    ]


def _ratio(name: str, value: float, target: float | None, against: str, scope: str) -> Figure:
    text = "" if target is None else f"<= {target:.2f}"
    holds = None if target is None else value <= target
    return Figure(name, round(value, 3), "ratio", text, holds, against, scope)


def on_maps(instances: Sequence[Instance], seed: int, done: list[FleetRun]) -> Iterator[Figure]:
    """For each map the makespan over the bound and over instant sharing. Drives are appended to
    `done`."""
    ratios = []
    for instance in instances:
        one = drive(instance, seed)
        done.append(one)
        ratios.append(one.outcome.ratio)
        name = f"whole peers {instance.name} k={len(instance.starts)}"
        yield _ratio(name, ratios[-1], 1.45, BOUND, SCOPE)
        yield _ratio(f"{name}, on the wire", one.shared_at_once, None, INSTANT, SCOPE)
        load = one.outcome.bus_load_worst_case
        yield Figure(
            f"{name}, bus load", round(load, 3), "share", "<= 0.60", load <= 0.6, "", SCOPE
        )
    if ratios:
        yield _ratio("whole peers on published maps, mean", fmean(ratios), 1.35, BOUND, SCOPE)


def on_fields(instances: Sequence[Instance], seed: int, done: list[FleetRun]) -> Iterator[Figure]:
    """The same as one figure for real fields; none if there are no fields. Drives are appended to
    `done`."""
    if not instances:
        return
    drives = [drive(instance, seed) for instance in instances]
    done += drives
    ratios = [one.outcome.ratio for one in drives]
    scope = f"{SCOPE}; {len(drives)} real fields, {ROBOTS} robots from one gate; " + (
        ", ".join(one.instance.name for one in drives)
    )
    yield _ratio("whole peers on fields, mean", fmean(ratios), 1.15, BOUND, scope)
    yield _ratio("whole peers on fields, worst", max(ratios), 1.35, BOUND, scope)


def with_trouble(
    instance: Instance, seed: int, done: list[FleetRun], quick: bool
) -> Iterator[Figure]:
    """A death, a split, joins and a noisy bus (the last two not when quick), on one map."""
    plain = drive(instance, seed)
    half_s = plain.outcome.makespan_s / 2
    robots = len(instance.starts)
    slots = list(range(robots))
    victim = (seed * 7 + 3) % robots
    dead = drive(instance, seed, [Crash(at_s=half_s, kind="crash", robot=victim)])
    halves = [slots[: robots // 2], slots[robots // 2 :]]
    cut = drive(instance, seed, [
        Partition(at_s=half_s / 2, kind="partition", islands=halves),
        Heal(at_s=half_s / 2 + SPLIT_S, kind="heal"),
    ])  # fmt: skip
    done += [plain, dead, cut]
    name, least = f"{instance.name}, seed {seed}", plain.outcome.makespan_s
    against = "the same run without trouble"
    scope = f"{SCOPE}; {name}"
    share = dead.outcome.makespan_s / least
    yield _ratio(f"whole peers, a death at half time, {name}", share, 1.2, against, scope)
    again = dead.outcome.replanned + dead.outcome.redone
    yield Figure(
        f"whole peers, cells of a dead robot planned again, {name}", again, "cells", "0",
        again == 0, "", f"{scope}; besides {dead.outcome.untold} that it told nobody of",
    )  # fmt: skip
    again = cut.outcome.replanned + cut.outcome.redone + cut.outcome.uncovered
    text = f"{scope}; cut in two halves for {SPLIT_S:.0f} s; also nothing left uncovered"
    yield Figure(
        f"whole peers, cells planned again after a heal, {name}", again, "cells", "0",
        again == 0, "", text,
    )  # fmt: skip
    share = cut.outcome.makespan_s / least
    yield _ratio(f"whole peers, a split of 60 s, {name}", share, None, against, text)
    if quick:
        return
    late = [Join(at_s=half_s, kind="join", robot=slot) for slot in slots[robots // 2 :]]
    joined = drive(instance, seed, late)
    noise = Loss(at_s=0.0, kind="loss", rate=0.05)
    noisy = drive(instance, seed, [noise])
    dead_in_noise = drive(instance, seed, [noise, Crash(at_s=half_s, kind="crash", robot=victim)])
    done += [joined, noisy, dead_in_noise]
    share = (joined.outcome.makespan_s - half_s) / (joined.outcome.bound_s - half_s)
    text = (
        f"{scope}; half of them start, as many join at half time: their rest over the others' own"
    )
    yield _ratio(f"whole peers, joins, {name}", share, None, "half of them alone, bound", text)
    share = noisy.outcome.makespan_s / least
    yield _ratio(f"whole peers, 5 % of all frames lost, {name}", share, None, against, scope)
    share = dead_in_noise.outcome.makespan_s / least
    name = f"whole peers, a death at half time and 5 % of all frames lost, {name}"
    yield _ratio(name, share, 1.2, against, scope)


def figures(
    quick: bool, seed: int, maps: Sequence[Instance], fields: Sequence[Instance]
) -> Iterator[Figure]:
    """`maps`, `fields`: with targets; when quick only the smallest map is driven."""
    done: list[FleetRun] = []
    small = sorted(maps, key=lambda instance: instance.walls.size)
    yield from on_maps(small[:1] if quick else small, seed, done)
    if not quick:
        yield from on_fields(fields, seed, done)
    for instance in [scattered(20, ROBOTS, seed)] if quick else troubled(seed):
        for number in range(1 if quick else 2):
            yield from with_trouble(instance, seed + number, done, quick)
    yield from _faults(done)


def _faults(done: Sequence[FleetRun]) -> Iterator[Figure]:
    outcomes = [one.outcome for one in done]
    faults = sum(o.contacts + o.through_walls + o.uncovered for o in outcomes)
    yield Figure(
        "whole peers: contacts, wall entries, uncovered", faults, "faults", "0", faults == 0, "",
        f"{len(outcomes)} runs, by the world; discs of 0.8 m in cells of 4 m",
    )  # fmt: skip
    ends = sum(o.finished and o.replicas_equal for o in outcomes)
    yield Figure(
        "whole peers: runs that end complete with equal replicas", ends, "runs",
        f"{len(outcomes)}", ends == len(outcomes), "", "registers and progress, byte for byte",
    )  # fmt: skip
