"""Anti-entropy between real `Sync` objects, everything over the real wire model."""

from random import Random

import pytest

from crdt import Phase
from sim.rigs.sync_rig import SyncFleet

S = 1_000_000


def cut(size: int, seed: int, entries: int = 20, news: int = 20) -> SyncFleet:
    """A fleet that agreed on some sections, was cut in halves, and worked on more in each."""
    fleet = SyncFleet(size, seed)
    for section in range(entries):
        fleet.write(section % size, section)
    fleet.run(2 * S)
    half = size // 2
    fleet.cut(set(range(half)), set(range(half, size)))
    for k in range(news // 2):
        fleet.write(k % half, 1000 + k)
        fleet.write(half + k % (size - half), 2000 + k)
        fleet.run(10_000)
    fleet.run(2 * S)
    fleet.count_from_here()
    return fleet


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("size", [2, 6, 20, 50])
def test_two_halves_become_equal(size: int, seed: int) -> None:
    fleet = cut(size, seed)
    assert len(fleet.states) == 2, f"seed {seed}"
    fleet.heal()
    assert fleet.run(3 * S, until_equal=True), f"seed {seed}"
    fleet.run(3 * S)
    assert len(fleet.states) == 1, f"seed {seed}"
    assert not any(m.sync.synchronizing for m in fleet.members.values())
    assert fleet.frames <= 40 + 4, f"{fleet.frames} frames for 40 entries; seed {seed}"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_hundred_operations_cost_little_more_than_a_hundred_frames(seed: int) -> None:
    fleet = SyncFleet(50, seed)
    fleet.part(100, left=20, period_us=10_000)
    fleet.count_from_here()
    fleet.heal()
    assert fleet.run(2 * S, until_equal=True), f"seed {seed}"
    fleet.run(2 * S)
    assert fleet.frames <= 130, f"{fleet.sent}; seed {seed}"


@pytest.mark.parametrize("seed", range(5))
def test_lossy_halves_become_equal_too(seed: int) -> None:
    fleet = cut(6, seed)
    fleet.wire.faults.loss = 0.2
    fleet.heal()
    assert fleet.run(60 * S, until_equal=True), f"seed {seed}"
    fleet.run(5 * S)
    assert len(fleet.states) == 1, f"seed {seed}"


def test_a_fresh_join_is_told_everything_once() -> None:
    fleet = SyncFleet(5, 1)
    for section in range(200):
        fleet.write(section % 5, section)
        fleet.run(3_000)
    fleet.run(2 * S)
    fleet.count_from_here()
    newcomer = fleet.boot(5)
    fleet.see()
    newcomer.sync.joined(fleet.now_us, fleet.heartbeat_period_us)
    assert not newcomer.sync.ready(fleet.now_us)
    assert fleet.run(3 * S, until_equal=True)
    fleet.run(2 * S)
    assert fleet.frames <= 400 + 2, "400 entries, and the asking"
    assert newcomer.allocation.phase_of(199) is Phase.CLAIMED
    assert newcomer.sync.ready(fleet.now_us)


def test_peers_in_step_say_nothing() -> None:
    fleet = SyncFleet(6, 1)
    for section in range(50):
        fleet.write(section % 6, section)
    fleet.run(20 * S)
    assert fleet.frames == 0 and all(m.sync.in_step for m in fleet.members.values())


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(8))
def test_islands_joins_and_loss_in_any_order_end_equal(seed: int) -> None:
    rng = Random(f"{seed}/islands")
    fleet = SyncFleet(rng.choice([3, 5, 8, 20]), seed)
    for _ in range(2):
        slots = list(fleet.members)
        rng.shuffle(slots)
        at = sorted(rng.sample(range(1, len(slots)), 2))
        fleet.wire.faults.loss = rng.choice([0, 0.05, 0.2])
        fleet.cut(set(slots[: at[0]]), set(slots[at[0] : at[1]]), set(slots[at[1] :]))
        for _ in range(rng.choice([3, 30])):
            fleet.write(rng.choice(slots), rng.randrange(300), rng.randrange(40))
            fleet.run(rng.choice([1_000, 50_000]))
        fleet.heal()
        newcomer = fleet.boot(len(slots))
        fleet.see()
        newcomer.sync.joined(fleet.now_us, fleet.heartbeat_period_us)
    assert fleet.run(60 * S, until_equal=True), f"seed {seed}"
    fleet.run(10 * S)
    assert len(fleet.states) == 1, f"seed {seed}"
    assert not any(m.sync.synchronizing for m in fleet.members.values()), f"seed {seed}"
