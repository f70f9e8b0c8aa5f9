"""Figures of docs/measured/scale.md: many segments, many hosts, one fleet."""

import gc
import multiprocessing
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from importlib.metadata import version
from pathlib import Path
from random import Random
from socket import socket
from typing import Any, TypeVar

from agent.interface.config import S
from agent.peer.inputs import Press
from protocol.frames.safety_frames import Reason
from sim.rigs.bridged_processes import BridgedSegments, write_area
from sim.rigs.segments_rig import SegmentFleet
from tools.bench.figure import Figure, percentile
from tools.chaos.campaign import workers
from tools.chaos.chaos import campaign_hash, judged

T = TypeVar("T")
PAGE = 4096
PROFILE = "bus"  # of the campaign that is run on a cluster and here
OPERATION_US = 30 * S  # each robot works a section in this time: 2 a minute
LIMIT_US = 30 * S
PRESS_MS, SHARE, HEAL_S, MEMORY, SPEEDUP = 60.0, 0.15, 5.0, 1.5, 1.7


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Presses across segments, traffic, heals, memory and campaigns on Dask workers."""
    yield from presses(30 if quick else 1_000, seed)
    few, many = ((2, 40), (8, 40)) if quick else ((1, 100), (10, 100))
    small, great = _apart(order, *few, seed), _apart(order, *many, seed)
    yield from traffic(great, many)
    yield from heal(20 if quick else 100, seed)
    yield from memory(small, great, few, many)
    if quick:
        yield from cluster(range(seed, seed + 2), warm=False)
    else:
        yield from cluster(range(seed, seed + 48))  # fewer end with one worker idle
        size = 100, 100
        yield from traffic(_apart(order, *size, seed, 0, S), size)  # a quarter of an hour


def _apart(measure: Callable[..., T], *arguments: Any) -> T:
    """In a fresh process, whose memory is this measurement's alone."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        return pool.submit(measure, *arguments).result()


# -------------------------------------------------------------------- stops across segments


def presses(count: int, seed: int) -> Iterator[Figure]:
    """Milliseconds from a press to the zero command in another segment, over real processes."""
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    fleet = BridgedSegments(3, seed)
    try:
        with tempfile.TemporaryDirectory() as folder:
            fleet.start_hosts()
            for number in (1, 2, 3):
                way = ("--listen", endpoint) if number == 1 else ("--zenoh", endpoint)
                fleet.start_gateway(number, *way, area=write_area(Path(folder), number, 3))
            fleet.wait_reached(2, limit_for_s=120.0)
            took_ms = sorted(fleet.press_and_wait(1 + k % 3) for k in range(count))
    finally:
        fleet.close()
    high_ms = percentile(took_ms, 0.999)
    against = f"eclipse-zenoh {version('eclipse-zenoh')}, hubs and gateways as processes, loopback"
    scope = "from the press to the zero command of the last robot of three segments, six robots"
    yield Figure(
        f"press to zero command in another segment, p99.9 of {count}", high_ms, "ms",
        f"<= {PRESS_MS:.0f}", high_ms <= PRESS_MS, against, scope,
    )  # fmt: skip
    yield Figure(
        f"press to zero command in another segment, median of {count}",
        statistics.median(took_ms), "ms", "", None, against, scope,
    )  # fmt: skip
    yield Figure(f"press to zero command in another segment, longest of {count}", took_ms[-1], "ms",
                 "", None, against, scope)  # fmt: skip


# -------------------------------------------------------------------- orders of magnitude


def order(
    segments: int, robots: int, seed: int, settle_us: int = S, span_us: int = 3 * S
) -> dict[str, float]:
    """One fleet in virtual time: bus share, memory, convergence. In a process of its own."""
    gc.collect()
    before, begun_s = _resident(), time.process_time()
    fleet = SegmentFleet(segments, robots, seed)
    assert fleet.run(LIMIT_US, lambda: fleet.joined), "segments that never met"
    booted_us = fleet.event_loop.now_us()
    fleet.run(settle_us)
    fleet.count_from_here()
    _load(fleet, Random(f"{seed}/load"), span_us)
    shares = list(fleet.share.values())
    fleet.halted_at_us.clear()
    presser = fleet.runners[1, 0]
    pressed_us = fleet.event_loop.now_us()
    presser.operate(Press(Reason.PERSON_IN_FIELD))
    everybody = len(fleet.runners)
    heard = fleet.run(S, lambda: len(fleet.halted_at_us) == everybody)
    stopped_us = max(fleet.halted_at_us.values()) - pressed_us if heard else S
    gc.collect()
    grown = _resident() - before
    found = {
        "peers": everybody, "bus": max(a for a, _ in shares),
        "bridged": max(b for _, b in shares), "memory_kb": grown / everybody / 1024,
        "joined_s": booted_us / S, "stopped_ms": stopped_us / 1e3,
        "backbone_kb_s": fleet.backbone.bytes / segments / (fleet.event_loop.now_us() / S) / 1024,
        "cpu_s": time.process_time() - begun_s,
    }  # fmt: skip
    fleet.end()
    return found


def _load(fleet: SegmentFleet, rng: Random, span_us: int) -> None:
    """Every robot works a section now and then, of those of its area, borders included."""
    end_us = fleet.event_loop.now_us() + span_us
    free = {k: list(range(fleet.areas[k].home)) for k in fleet.segments}
    step_us = OPERATION_US // fleet.robots
    while fleet.event_loop.now_us() < end_us:
        for number in fleet.segments:
            if free[number]:
                section = free[number].pop(rng.randrange(len(free[number])))
                fleet.finish(number, rng.randrange(fleet.robots), section)
        fleet.run(min(step_us, end_us - fleet.event_loop.now_us()))


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def traffic(found: dict[str, float], size: tuple[int, int]) -> Iterator[Figure]:
    """Share of the fullest bus that is bridged, from the shares in `found`, for a fleet of `size`
    (segments, robots in each)."""
    where = f"{size[0] * size[1]:,} peers in {size[0]} segments"
    scope = "virtual time, whole peers on whole wires, two operations a minute and peer"
    yield Figure(
        f"bridged traffic on the fullest segment, {where}", 100 * found["bridged"], "% of bus",
        f"<= {100 * SHARE:.0f}", found["bridged"] <= SHARE, "", scope,
    )  # fmt: skip
    yield Figure(f"all traffic on it, {where}", 100 * found["bus"], "% of bus", "", None, "", scope)
    yield Figure(f"press to the last zero command, {where}", found["stopped_ms"], "ms", "", None,
                 "", scope)  # fmt: skip


def memory(
    small: dict[str, float], great: dict[str, float], few: tuple[int, int], many: tuple[int, int]
) -> Iterator[Figure]:
    """Memory of a peer in a great fleet as a factor of that in a small one; `few` and `many` are
    (segments, robots in each)."""
    ratio = great["memory_kb"] / small["memory_kb"]
    yield Figure(
        f"memory per peer, {many[0] * many[1]:,} against {few[0] * few[1]} in the fleet", ratio, "x",
        f"<= {MEMORY}", ratio <= MEMORY, f"{small['memory_kb']:.0f} kB a peer",
        "resident memory of a fresh process, gateways and wires included, divided by peers",
    )  # fmt: skip


# -------------------------------------------------------------------- heal


def heal(operations: int, seed: int) -> Iterator[Figure]:
    """A backbone cut, so many sections done on each side of the border, and together again."""
    fleet = SegmentFleet(2, 10, seed, home=operations + 20, shared=operations)
    assert fleet.run(LIMIT_US, lambda: fleet.joined)
    fleet.backbone.cut({1}, {2})
    fleet.run(3 * S)
    for k in range(operations):
        for number in (1, 2):  # both borders of a ring of two are with the same neighbour
            fleet.finish(number, k % fleet.robots, k)
        fleet.run(S // fleet.robots)
    fleet.run(3 * S)
    done = {k: _done(fleet, k) for k in (1, 2)}
    fleet.backbone.heal()
    healed_us = fleet.event_loop.now_us()
    fleet.run(LIMIT_US, lambda: fleet.borders_equal)
    took_s = (fleet.event_loop.now_us() - healed_us) / S
    fleet.run(S)
    lost = sum(len(done[k] - _done(fleet, k)) for k in (1, 2))
    there = sum(
        place.section in done[place.segment] and peer.allocation.phase_of(section) == 7
        for number in (1, 2) for section, place in fleet.areas[number].borrowed.items()
        for peer in fleet.peers(number)
    )  # fmt: skip
    due = fleet.robots * sum(
        place.section in done[place.segment]
        for number in (1, 2) for place in fleet.areas[number].borrowed.values()
    )  # fmt: skip
    twice = sum(peer.redone for number in (1, 2) for peer in fleet.peers(number))
    fleet.end()
    scope = f"{len(done[1])} and {len(done[2])} sections done while cut; ten robots on each side"
    yield Figure(
        "heal of a backbone cut", took_s, "s", f"<= {HEAL_S:.0f}", took_s <= HEAL_S, "", scope
    )
    yield Figure("of what was done, lost by anybody or not told to the other side",
                 lost + due - there, "", "0", lost + due - there == 0, "", scope)  # fmt: skip
    yield Figure("units done twice", twice, "", "0", twice == 0, "", scope)


def _done(fleet: SegmentFleet, number: int) -> set[int]:
    peers = fleet.peers(number)
    home = range(fleet.areas[number].home)
    return {s for s in home if all(peer.allocation.phase_of(s) == 7 for peer in peers)}


# -------------------------------------------------------------------- campaigns on a cluster


def cluster(seeds: range, warm: bool = True) -> Iterator[Figure]:
    """Two workers against one process. Their times are compared only if `warm`: with a run before."""
    from dask import config
    from distributed import LocalCluster

    make: Any = LocalCluster  # untyped
    with (
        config.set({"distributed.worker.profile.enabled": False}),  # it takes 6 % of a worker
        make(n_workers=2, threads_per_worker=1, dashboard_address=None, processes=True) as two,
        workers(cluster=two.scheduler_address) as far,
        workers(1) as here,
        workers(2) as both,
    ):  # fmt: skip
        for pool in (far, both, here) if warm else ():
            list(pool.map(judged, (0, 0), (PROFILE, PROFILE)))
        order = [("far", far), ("both", both), ("here", here)][:: 1 if warm else 2]
        times: dict[str, list[float]] = {name: [] for name, _ in order}
        hashes = set()
        half = len(seeds) // 2
        for part in (seeds[:half], seeds[half:]):  # ABBA: others use this machine, too
            for name, pool in order[:: 1 if part[0] == seeds[0] else -1]:
                took_s, told = _campaign(pool, part)
                times[name].append(took_s)
                hashes.add((part, told))
    ratio = sum(times["here"]) / sum(times["far"])
    against = f"distributed {version('distributed')}, one process of this machine"
    scope = f"{len(seeds)} seeds of headland chaos --profile {PROFILE}, wall time"
    if warm:
        yield Figure("campaign on two Dask workers against one process", ratio, "x",
                     f">= {SPEEDUP}", ratio >= SPEEDUP, against, scope)  # fmt: skip
        yield Figure("the same in two processes without Dask: what this machine gives at the time",
                     sum(times["here"]) / sum(times["both"]), "x", "", None, against, scope)  # fmt: skip
    yield Figure("parts of it whose hash depends on where they ran", len(hashes) - 2, "", "0",
                 len(hashes) == 2, against, scope)  # fmt: skip


def _campaign(pool: Executor, seeds: range) -> tuple[float, str]:
    begun_s = time.monotonic()
    verdicts = list(pool.map(judged, seeds, [PROFILE] * len(seeds)))
    return time.monotonic() - begun_s, campaign_hash(verdicts)
