"""Anti-entropy: what a heal and a join cost on the wire, and merging against pycrdt and loro."""

from collections.abc import Callable, Iterator
from random import Random
from statistics import median
from time import process_time

from agent.interface.config import S
from crdt import FieldAllocationCRDT
from sim.rigs.sync_rig import SyncFleet
from tools.bench.figure import Figure

ENTRIES = 1000
FIELD_BYTES = 4  # of a serialized state, once, for the field that its registers belong to


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Heals, joins, and merging against other libraries."""
    runs = 5 if quick else 50
    yield from heals(range(seed, seed + runs))
    yield from joins(range(seed, seed + (2 if quick else 10)))
    yield from merges(5 if quick else 21, seed)


def heals(seeds: range) -> Iterator[Figure]:
    """Frames and seconds for a heal of 100 operations between 50 peers, over seeds."""
    frames, times_s, equal = [], [], True
    for seed in seeds:
        fleet = SyncFleet(50, seed)
        fleet.part(100, left=25, period_us=20_000)
        fleet.count_from_here()
        fleet.heal()
        healed_us = fleet.now_us
        equal &= fleet.run(20 * S, until_equal=True)
        times_s.append((fleet.now_us - healed_us) / S)
        fleet.run(3 * S)
        equal &= len(fleet.states) == 1
        frames.append(fleet.frames)
    scope = f"50 peers, 100 operations on two sides, {len(seeds)} seeds, worst; all equal: {equal}"
    yield Figure("frames to heal", max(frames), "frames", "<= 130", equal and max(frames) <= 130,
                 "", scope)  # fmt: skip
    yield Figure("time to heal", max(times_s), "s", "<= 2", equal and max(times_s) <= 2, "",
                 scope + "; from the heal, the wait for a heartbeat in it, 30 % of the bus")  # fmt: skip


def joins(seeds: range) -> Iterator[Figure]:
    """Frames and seconds until a robot that joins has everything, over seeds."""
    times_s, frames, equal = [], [], True
    for seed in seeds:
        fleet = SyncFleet(20, seed)
        for section in range(ENTRIES):
            fleet.write(section % 20, section, None)
            fleet.run(2_000)
        fleet.run(3 * S)
        fleet.count_from_here()
        newcomer = fleet.boot(20)
        fleet.see()
        newcomer.sync.joined(fleet.now_us, fleet.heartbeat_period_us)
        joined_us = fleet.now_us
        equal &= fleet.run(20 * S, until_equal=True)
        times_s.append((fleet.now_us - joined_us) / S)
        fleet.run(2 * S)
        frames.append(fleet.frames)
    scope = f"20 peers and a newcomer, {len(seeds)} seeds, worst; all equal: {equal}"
    yield Figure("time to join with 1,000 sections", max(times_s), "s", "<= 2.5",
                 equal and max(times_s) <= 2.5, "", scope + "; at 30 % of the bus")  # fmt: skip
    yield Figure("frames to join with 1,000 sections", max(frames), "frames", "", None, "", scope)


def merges(rounds: int, seed: int) -> Iterator[Figure]:
    """Two replicas that wrote 1,000 entries each without hearing of the other, joined."""
    ours = _ours(seed)
    entry_bytes = ours[1] - FIELD_BYTES / ENTRIES
    yield Figure("state an entry", entry_bytes, "B", "<= 8", entry_bytes <= 8, "",
                 "serialized, 1,000 registers without the 4 bytes for their field")  # fmt: skip
    for name, make in (("pycrdt", _pycrdt), ("loro", _loro)):
        try:
            version, merge, size = make(seed)
        except ImportError:
            continue
        ratios = []
        for _ in range(rounds):
            theirs_s = _cpu(merge)
            ours_s = _cpu(ours[0])
            ratios.append(ours_s / theirs_s)
        ratio = median(ratios)
        yield Figure(f"merge of a concurrent 1,000-entry replica, against {name}", ratio, "ratio",
                     "< 1", ratio < 1, f"{name} {version}, {size:.1f} B an entry",
                     "from the other's encoded state to the joined one, CPU time, median")  # fmt: skip


def _cpu(work: Callable[[], Callable[[], object]]) -> float:
    ready = work()  # made fresh outside of the measurement
    begun_s = process_time()
    ready()
    return process_time() - begun_s


def _ours(seed: int) -> tuple[Callable[[], Callable[[], object]], float]:
    def replica(slot: int) -> FieldAllocationCRDT:
        made, rng = FieldAllocationCRDT(), Random(f"{seed}/{slot}")
        for section in range(ENTRIES):
            made.claim(section, slot, rng.randrange(32))
        return made

    other = replica(2).serialize()
    mine = replica(1).serialize()

    def ready() -> Callable[[], object]:
        base = FieldAllocationCRDT.deserialize(mine)
        return lambda: base.merge(FieldAllocationCRDT.deserialize(other))

    return ready, len(mine) / ENTRIES


def _pycrdt(seed: int) -> tuple[str, Callable[[], Callable[[], object]], float]:
    from importlib.metadata import version

    import pycrdt

    def update(slot: int) -> bytes:
        document = pycrdt.Doc()  # type: ignore[var-annotated]
        entries = document.get("claims", type=pycrdt.Map)
        with document.transaction():
            for section in range(ENTRIES):
                entries[str(section)] = slot
        return bytes(document.get_update())

    mine, other = update(1), update(2)

    def ready() -> Callable[[], object]:
        document = pycrdt.Doc()  # type: ignore[var-annotated]
        document.get("claims", type=pycrdt.Map)
        document.apply_update(mine)
        return lambda: document.apply_update(other)

    return version("pycrdt"), ready, len(mine) / ENTRIES


def _loro(seed: int) -> tuple[str, Callable[[], Callable[[], object]], float]:
    from importlib.metadata import version

    import loro

    def update(slot: int) -> bytes:
        document = loro.LoroDoc()  # type: ignore[no-untyped-call]
        document.peer_id = slot
        entries = document.get_map("claims")
        for section in range(ENTRIES):
            entries.insert(str(section), slot)
        document.commit()
        return bytes(document.export(loro.ExportMode.Snapshot()))

    mine, other = update(1), update(2)

    def ready() -> Callable[[], object]:
        document = loro.LoroDoc()  # type: ignore[no-untyped-call]
        document.import_(mine)
        return lambda: document.import_(other)

    return version("loro"), ready, len(mine) / ENTRIES
