"""Registers of a whole allocation from its bytes, as columns: a restart reads 65,536 in milliseconds."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crdt.claim_register import BID_MAX, LAMPORT_MAX, OWNER_MAX, Phase

ROWS = np.dtype([("section", "<u2"), ("epoch", "u1"), ("mixed", "u1"), ("low", "<u2"), ("high", "u1"),
                 ("owner", "u1")])  # fmt: skip
assert ROWS.itemsize == 8
PHASES = np.isin(np.arange(8), [int(phase) for phase in Phase])  # the valid values of a phase
Column = NDArray[Any]  # (n,): one field of n registers


def read_rows(data: bytes, offset: int) -> tuple[Iterable[tuple[int, int]], int]:
    """Pairs of section and key, of which the last of a section counts, and the greatest Lamport time.

    `data`: as `FieldAllocationCRDT.serialize` writes it, with its rows from `offset` on. Raises
    ValueError for a phase that there is not.
    """
    rows = np.frombuffer(data, ROWS, offset=offset)
    phase, bid = rows["mixed"] & 7, rows["mixed"] >> 3
    if not PHASES[phase].all():
        raise ValueError("an allocation has no such phase")
    lamport = rows["low"] | rows["high"].astype(np.uint32) << 16
    keys = pack_all(rows["epoch"], phase, bid, lamport, rows["owner"])
    sections = rows["section"]
    if (sections[1:] <= sections[:-1]).any():  # our own output is strictly sorted
        # If a section was written twice, the greater key is kept.
        order = np.argsort(keys, kind="stable")
        sections, keys = sections[order], keys[order]
    pairs = zip(sections.tolist(), keys.tolist(), strict=True)
    return pairs, int(lamport.max(initial=0))


def pack_all(
    epoch: Column, phase: Column, bid: Column, lamport: Column, owner: Column
) -> NDArray[np.int64]:
    """`claim_register.pack` of n registers: five columns of integers, each (n,), give the keys, (n,)."""
    phase = phase.astype(np.int64)
    keys: NDArray[np.int64] = (
        (phase == Phase.DONE).astype(np.int64) << 48 | epoch.astype(np.int64) << 40 | phase << 37
        | (BID_MAX - bid.astype(np.int64)) << 32 | (LAMPORT_MAX - lamport.astype(np.int64)) << 8
        | (OWNER_MAX - owner.astype(np.int64))
    )  # fmt: skip
    return keys
