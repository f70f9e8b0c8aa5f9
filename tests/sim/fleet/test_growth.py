"""What a robot keeps in memory has bounds: nothing in it grows with time alone."""

import tracemalloc
from collections import Counter, deque
from collections.abc import Iterator
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
import pytest

from agent.field import travel_times
from agent.peer import pgn_responder as letters
from agent.peer.peer import Peer
from crdt import digest
from protocol.sync import replica
from sim.fleet.simulated_fleet import Cluster
from sim.runs.field_run import FieldRun
from sim.runs.run import RunProgress
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

WARM_UP_S, END_S = 200.0, 500.0  # of virtual time
SLACK = 96  # elements of what comes and goes: the rest of a way, the legs of a turn
CHANGES = 20_000  # four hours of ten robots
CACHES_BYTES_MAX = 150_000  # 107 kB in a new process, 75 kB in one that has objects to use again
POOL = "._corners."  # arrays of a path planner, doubled when too small: `corner_cache.POOL_MAX`
ATOMS = (
    int,
    float,
    str,
    bytes,
    bool,
    type(None),
    type,
    ModuleType,
    FunctionType,
    BuiltinFunctionType,
)
HELD = (dict, list, set, frozenset, deque, bytearray)


def _sizes(root: object) -> Counter[str]:
    """Elements of all containers that are reachable, by their path from the root."""
    sizes: Counter[str] = Counter()
    seen: set[int] = set()
    todo: list[tuple[str, Any]] = [("peer", root)]
    while todo:
        path, at = todo.pop()
        if id(at) in seen or isinstance(at, ATOMS):
            continue
        seen.add(id(at))
        if isinstance(at, np.ndarray):
            sizes[path] += at.size
        else:
            sizes[path] += len(at) if isinstance(at, HELD) else 0
            todo += [(path + step, each) for step, each in _inside(at)]
    return sizes


def _inside(at: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(at, dict):
        for key, value in at.items():
            yield from (("{}", key), ("[]", value))
    elif isinstance(at, (*HELD, tuple)):
        yield from (("[]", each) for each in at)
    elif isinstance(at, MethodType):
        yield "", at.__self__
    else:
        yield from ((f".{name}", value) for name, value in getattr(at, "__dict__", {}).items())
        for kind in type(at).__mro__:
            for name in getattr(kind, "__slots__", ()):
                if hasattr(at, name):
                    yield f".{name}", getattr(at, name)


def _peers(cluster: Cluster) -> list[Peer]:
    return [robot.peer for robot in cluster.robots.values()]


@pytest.mark.slow
def test_f_nothing_in_a_peer_grows_with_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replica, "HISTORY_MAX", 32)  # memories of the newest are full early
    monkeypatch.setattr(letters, "LINES_MAX", 8)
    monkeypatch.setattr(travel_times, "LEADS_KEPT", 1)
    clusters: list[Cluster] = []
    found: list[tuple[list[Counter[str]], int]] = []

    class EndError(Exception):
        pass

    def look(moment: RunProgress) -> None:
        if moment.simulated_s >= (END_S if found else WARM_UP_S):
            (cluster,) = clusters
            work = sum(1 for _ in cluster.robots[0].peer.sync.replica.entries())
            found.append(([_sizes(peer) for peer in _peers(cluster)], work))
            if len(found) == 2:
                raise EndError

    setting = FieldSetup(load("oxted").changed(2, 1, None))
    with pytest.raises(EndError):
        FieldRun(setting, told=look, attach=clusters.append).run()
    (before, entries), (after, entries_after) = found
    allowed = entries_after - entries + SLACK  # each entry of the work is once in a container
    for was, now in zip(before, after, strict=True):
        grown = {
            path: n - was[path]
            for path, n in now.items()
            if n - was[path] > allowed and POOL not in path
        }
        assert not grown, f"seed 1, {allowed} are allowed: {grown}"


def test_f_remembered_hashes_fill_no_memory() -> None:
    """On commit 24747e2 four hours of changes filled 9 MB of each process; later on half an hour of
    ten robots filled 0.2 MB of each, most of what a robot grew by."""
    caches = digest.place, digest.entry_hash, digest.change_of
    for cache in caches:
        cache.cache_clear()
    tracemalloc.start()
    try:
        begin, _ = tracemalloc.get_traced_memory()
        for number in range(CHANGES):
            digest.change_of(1, number % 500, number or None, number + 1)
        end, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert end - begin < CACHES_BYTES_MAX
    assert all(cache.cache_info().currsize <= digest.HASHES_MAX for cache in caches)
