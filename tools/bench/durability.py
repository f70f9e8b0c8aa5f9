"""Acknowledged records lost: over real SIGKILLs of a process that writes, and over simulated power cuts.

A kill proves less than it looks, because the page cache outlives a process; the power cuts take that
away. Planted bugs, journals that forget to sync, show that the campaigns would see a loss.
"""

import sqlite3
from collections.abc import Iterator
from random import Random

from sim.chaos import power_cuts
from sim.chaos.durability_rules import Tape, record
from sim.chaos.sqlite_vfs_recorder import available
from tools.bench.figure import Figure

KILLS, STATES = 1_000, 100_000
QUICK_KILLS, QUICK_STATES = 20, 2_000
SQLITE = f"sqlite {sqlite3.sqlite_version}"
PLANTED = 500  # states are enough to see a journal that does not sync


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Records lost over kills and over power cuts: each must be 0."""
    tapes = list(record(seed).values())
    kills, states = (QUICK_KILLS, QUICK_STATES) if quick else (KILLS, STATES)
    states += -states % len(tapes)  # the same number from each robot
    rng = Random(f"{seed}/durability")
    lost = sum(1 for _ in power_cuts.kills(tapes[0], kills, rng))
    yield _zero(f"acknowledged records lost, {kills} SIGKILLs", lost,
                "one process that writes one sqlite journal; 0 to 12 writes, then a kill")  # fmt: skip
    yield from _sqlite(tapes, states, rng)
    lost = sum(len(list(power_cuts.log_states(t, states // len(tapes), rng))) for t in tapes)
    yield _zero(f"acknowledged records lost, {states} power cuts of the simulated disk", lost,
                "cut before any write or sync; unsynced writes dropped or torn", "")  # fmt: skip
    found = sum(1 for _ in power_cuts.log_states(tapes[0], PLANTED, rng, synced=False))
    yield _planted("states in which a log without sync lost records", found)


def _sqlite(tapes: list[Tape], states: int, rng: Random) -> Iterator[Figure]:
    if not available():
        return  # this Python carries its own sqlite, which cannot be watched
    share, lost = states // len(tapes), 0
    for tape in tapes:
        steps = power_cuts.record_sqlite(tape)
        lost += sum(1 for _ in power_cuts.sqlite_states(tape, steps, share, rng))
    yield _zero(f"acknowledged records lost, {states} power cuts of sqlite", lost,
                "cut before any write, sync, truncation or deletion of sqlite; unsynced ones dropped, "
                "torn or reordered; WAL, FULL, with checkpoints; opened again by sqlite")  # fmt: skip
    steps = power_cuts.record_sqlite(tapes[0], "NORMAL")
    found = sum(1 for _ in power_cuts.sqlite_states(tapes[0], steps, PLANTED, rng))
    yield _planted("states in which sqlite with synchronous=NORMAL lost records", found)


def _zero(name: str, lost: int, scope: str, against: str = SQLITE) -> Figure:
    return Figure(name, lost, "states", "0", lost == 0, against, scope)


def _planted(name: str, found: int) -> Figure:
    return Figure(
        f"{name} (planted bug)", found, "states", "> 0", found > 0, "", f"{PLANTED} states"
    )
