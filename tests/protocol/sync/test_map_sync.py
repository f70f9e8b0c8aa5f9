"""Maps over the wire: equal bit for bit after 2 s of quiet, whatever was lost, cut or joined."""

from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crdt.occupancy import Geometry
from crdt.sighting import MergeOrder
from protocol.frames.map_frames import CODES, MAP_DIGESTS, MAP_PATCH, NODES, MapDigests, MapPatch
from protocol.sync.map_sync import decode_cells, encode_cells
from tests.protocol.sync.map_fleet import MapFleet

S = 1_000_000
ARENA = Geometry(50, 50, (-2.5, -2.5), 0.1)


@given(st.integers(0, 0xFFFF), st.integers(0, 8191), st.integers(0, 15), st.integers(0, 31),
       st.integers(0, CODES - 1))  # fmt: skip
def test_a_patch_comes_back(patch: int, time: int, level: int, observer: int, cells: int) -> None:
    message = MapPatch(patch, time, level, observer, cells)
    assert MAP_PATCH.unpack(MAP_PATCH.pack(message)) == message
    assert encode_cells(decode_cells(cells)) == cells


@given(st.integers(0, NODES - 1), st.integers(0, 7), st.tuples(*[st.integers(0, 7)] * 16))
def test_digests_come_back(node: int, salt: int, digests: tuple[int, ...]) -> None:
    message = MapDigests(node, salt, digests)
    assert MAP_DIGESTS.unpack(MAP_DIGESTS.pack(message)) == message


def test_what_is_out_of_range_is_not_read() -> None:
    with pytest.raises(ValueError):
        MAP_PATCH.unpack(b"\xff" * 8)
    with pytest.raises(ValueError):
        MAP_DIGESTS.unpack(b"\xff" * 8)


def test_news_reach_everybody_without_repair() -> None:
    fleet = MapFleet(4, ARENA, MergeOrder.DECAYED, 1)
    for _ in range(200):
        fleet.look(fleet.rng.randrange(4))
        fleet.run(20_000)
    fleet.run(2 * S)
    assert fleet.equal and len(fleet.members[0].chart.serialize()) > 5000
    patches = sum(m.counts["patches"] for m in fleet.members.values())
    news = sum(m.counts["news"] for m in fleet.members.values())
    assert patches < 1.1 * news, "nothing was lost"


@pytest.mark.sampled(7)
@pytest.mark.parametrize("seed", range(12))
def test_loss_splits_and_joins_end_equal_after_two_seconds_of_quiet(seed: int) -> None:
    rng = Random(f"{seed}/maps")
    size = rng.choice([2, 3, 5, 8])
    fleet = MapFleet(size, ARENA, rng.choice(list(MergeOrder)), seed)
    fleet.wire.faults.loss = rng.choice([0.0, 0.05, 0.2])
    for _ in range(3):
        slots = list(fleet.members)
        rng.shuffle(slots)
        at = rng.randrange(1, len(slots))
        fleet.cut(set(slots[:at]), set(slots[at:]))
        for _ in range(rng.choice([10, 60])):
            fleet.look(rng.choice(slots))
            fleet.run(rng.choice([1_000, 40_000]))
        fleet.heal()
        fleet.boot(rng.choice([len(slots), slots[0]]))
    while any(m.pending for m in fleet.members.values()):
        fleet.run(100_000)
    fleet.run(2 * S)
    assert fleet.equal, f"seed {seed}"


@pytest.mark.slow
def test_the_share_of_the_bus_is_kept_and_shared_out() -> None:
    fleet = MapFleet(8, Geometry(200, 200, (0.0, 0.0), 0.1), MergeOrder.DECAYED, 3)
    for _ in range(300):
        for slot in range(8):
            fleet.look(slot)
    fleet.run(5 * S)
    assert fleet.wire.worst_for_us < 0.15 * 5 * S
    told = np.array([m.counts["news"] for m in fleet.members.values()])
    assert told.min() > 0.8 * told.max(), "all of them come to speak"
