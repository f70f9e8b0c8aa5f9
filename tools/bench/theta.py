"""The default planner: CPU time against our own plain Theta*, and lengths against the optimum."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from statistics import median
from time import process_time

import numba
import numpy as np
from scipy.ndimage import label

from agent.interface.geometry import GridPoint
from agent.paths.any_angle_planner import Planner, Waypoints, length
from tools.bench.figure import Figure
from tools.bench.map_kinds import Grid, city, maps, small_maps
from tools.bench.optimum import Judge

SEED = 20
AGAINST = f"own plain Theta*, numba {numba.__version__}, same run"
SCOPE = "one core, start and goal to waypoints, all of the Python on both sides"
Query = tuple[tuple[int, int], tuple[int, int]]


def queries(blocked: Grid, count: int, rng: np.random.Generator) -> list[Query]:
    """Free cells of a grid `blocked` (rows, columns), as pairs that 4-connected free cells join."""
    regions, _ = label(~blocked)
    free = np.argwhere(~blocked).tolist()
    found: list[Query] = []
    while len(found) < count:
        (a, b), (c, d) = free[rng.integers(len(free))], free[rng.integers(len(free))]
        if regions[a, b] == regions[c, d] and (a, b) != (c, d):
            found.append(((a, b), (c, d)))
    return found


def each(work: Callable[[GridPoint, GridPoint], Waypoints | None], asked: list[Query]) -> float:
    """CPU seconds of all queries."""
    start = process_time()
    for a, b in asked:
        work(a, b)
    return process_time() - start


def each_fresh(planner: Planner, asked: list[Query]) -> float:
    """CPU seconds of all queries with no edge known at the start of each; forgetting is not timed."""
    spent = 0.0
    for a, b in asked:
        planner.forget()
        start = process_time()
        planner.plan(a, b)
        spent += process_time() - start
    return spent


def against_plain(planner: Planner, asked: list[Query], rounds: int) -> tuple[float, float, float]:
    """Plain Theta* in seconds a query, and medians of the ratios: edges cached, edges fresh."""
    for a, b in asked:  # compiles, and fills the cache
        planner.plan(a, b)
    planner.plan_plain(*asked[0])
    plain, cached, fresh = [], [], []
    for _ in range(rounds):
        plain.append(each(planner.plan_plain, asked))
        fresh.append(each_fresh(planner, asked))
        each(planner.plan, asked)  # fills the cache again
        cached.append(each(planner.plan, asked))
    return (
        median(plain) / len(asked),
        median(c / p for c, p in zip(cached, plain, strict=True)),
        median(f / p for f, p in zip(fresh, plain, strict=True)),
    )


def geometric(ratios: list[float]) -> float:
    """The geometric mean of ratios."""
    return float(np.exp(np.mean(np.log(ratios))))


def figures(quick: bool) -> Iterator[Figure]:
    """Times over kinds of maps and in a large city, lengths of paths, and planning again after
    changes."""
    yield from kinds(30 if quick else 100, 3 if quick else 5)
    yield from big_city(10 if quick else 40, 3)
    yield from lengths(24 if quick else 40, 20 if quick else 60)
    yield from replans(40 if quick else 200)


def kinds(count: int, rounds: int) -> Iterator[Figure]:
    """Times against plain Theta* with edges cached and fresh, over so many queries on each kind of
    map."""
    cached, fresh, solved, through, total = [], [], 0, 0, 0
    for number, (kind, name, blocked) in enumerate(maps(SEED)):
        asked = queries(blocked, count, np.random.default_rng((SEED, number)))
        planner = Planner(blocked)
        plain_s, known, unknown = against_plain(planner, asked, rounds)
        cached.append(known)
        fresh.append(unknown)
        paths = [path for path in (planner.plan(a, b) for a, b in asked) if path is not None]
        segments = np.array([leg for path in paths for leg in pairwise(path)], dtype=np.float64)
        solved, total = solved + len(paths), total + count
        through += int(Judge(blocked).through(segments).sum())
        scope = f"{name}, {blocked.shape[0]} x {blocked.shape[1]}, {count} queries"
        yield Figure(f"plan, {kind}, edges cached", known, "ratio", "", None,
                     f"{AGAINST}: {plain_s * 1e6:.0f} us", scope)  # fmt: skip
        yield Figure(f"plan, {kind}, edges fresh", unknown, "ratio", "", None,
                     f"{AGAINST}: {plain_s * 1e6:.0f} us", scope)  # fmt: skip
    scope = f"{SCOPE}; geometric mean of {len(cached)} kinds of {count} queries"
    for name, ratios, most in (("cached", cached, 0.10), ("fresh", fresh, 0.25)):
        mean = geometric(ratios)
        yield Figure(f"plan, edges {name}", mean, "ratio", f"<= {most:.2f}", mean <= most,
                     AGAINST, scope)  # fmt: skip
    yield Figure("solvable queries solved", solved / total, "share", "= 1", solved == total,
                 "regions of scipy.ndimage.label", f"{total} queries")  # fmt: skip
    yield Figure("legs through a blocked cell", through, "", "= 0", through == 0,
                 "shapely (GEOS)", f"paths of {total} queries, also in corner gaps")  # fmt: skip


def big_city(count: int, rounds: int) -> Iterator[Figure]:
    """The time of a query on 1024 x 1024 cells with edges cached."""
    blocked = city(np.random.default_rng(SEED), 1024, 1024)
    asked = queries(blocked, count, np.random.default_rng(SEED))
    planner = Planner(blocked)
    plain_s, known, unknown = against_plain(planner, asked, rounds)
    against = f"{AGAINST}: {plain_s * 1e3:.1f} ms"
    scope = f"generated, 1024 x 1024, {count} queries; {SCOPE}"
    yield Figure("one query in a large city, edges cached", known, "ratio", "<= 0.05",
                 known <= 0.05, against, scope)  # fmt: skip
    yield Figure(
        "one query in a large city, edges fresh", unknown, "ratio", "", None, against, scope
    )


def lengths(side: int, count: int) -> Iterator[Figure]:
    """Lengths of paths as factors of the optimum, on maps of `side` by `side` cells."""
    ratios: list[float] = []
    unlike = 0
    for number, (_, _, blocked) in enumerate(small_maps(SEED, side)):
        asked = queries(blocked, count, np.random.default_rng((SEED, number)))
        planner = Planner(blocked)
        optima = Judge(blocked).lengths(np.array(asked, dtype=np.float64))
        for (a, b), optimum in zip(asked, optima.tolist(), strict=True):
            path = planner.plan(a, b)
            if path is None or not np.isfinite(optimum):
                unlike += 1
            else:
                ratios.append(length(path) / optimum)
    scope = f"nine kinds of {side} x {side}, {len(ratios)} paths, {unlike} without an answer"
    against = "visibility graph of all pairs by shapely (GEOS), Dijkstra of scipy"
    mean, worst = float(np.mean(ratios)), max(ratios)
    yield Figure("path length, mean", mean, "ratio", "<= 1.001",
                 mean <= 1.001 and not unlike, against, scope)  # fmt: skip
    yield Figure("path length, worst", worst, "ratio", "<= 1.025",
                 worst <= 1.025 and not unlike, against, scope)  # fmt: skip


def replans(turns: int) -> Iterator[Figure]:
    """Six boxes of 3 x 3 move about near the robot before each plan."""
    for kind, name, blocked in maps(SEED):
        if kind not in ("rooms", "warehouse", "city", "cave", "large rooms"):
            continue
        rng = np.random.default_rng(SEED)
        asked = queries(blocked, turns, rng)
        planner = Planner(blocked)
        ours, plain, boxes = 0.0, 0.0, set[tuple[int, int]]()
        for turn, (a, b) in enumerate(asked):
            before, boxes = boxes, moved(blocked, a, b, rng)
            changes = [(r, c, 0) for r, c in before - boxes] + [
                (r, c, 1) for r, c in boxes - before
            ]
            cells = np.array(changes)
            start = process_time()
            planner.update(cells)
            planner.plan(a, b)
            middle = process_time()
            planner.plan_plain(a, b)
            if turn:  # the first one compiles
                ours, plain = ours + middle - start, plain + process_time() - middle
        yield Figure(f"plan after a change, {kind}", ours / plain, "ratio", "", None,
                     AGAINST, f"{name}, six boxes of 3 x 3 move, an array of cells; {SCOPE}")  # fmt: skip


def moved(
    blocked: Grid, a: tuple[int, int], b: tuple[int, int], rng: np.random.Generator
) -> set[tuple[int, int]]:
    """Free cells of a grid `blocked` (rows, columns) under six boxes within twelve cells of the
    start, start and goal left free."""
    rows, columns = blocked.shape
    cells = set()
    for _ in range(6):
        r, c = a[0] + int(rng.integers(-12, 13)), a[1] + int(rng.integers(-12, 13))
        cells |= {(i, j) for i in range(r - 1, r + 2) for j in range(c - 1, c + 2)}
    return {
        (i, j)
        for i, j in cells - {a, b}
        if 0 <= i < rows and 0 <= j < columns and not blocked[i, j]
    }
