"""A day of ten robots in simulated time: what their memory, their journals and their open files grow by.

The fleet works all day: its units take as long as the whole time needs. Each robot writes a journal on
the disk. Memory is the anonymous memory of this process, so the simulator's own is part of it. The judge
keeps what robots have said, which grows by what they say: that is cleared each minute. The write-ahead
logs of the journals have a bound of their own and are told apart.

Growth is the median slope of all pairs of samples after the warm-up. A shorter time than a day can be had
in a process of its own, with the compiled core if there is one:

    python -m tools.bench.long_day --hours 6 --json

It says what the growth was in each hour, and extrapolates to a day only if both halves agree.
"""

import argparse
import gc
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from sim.files.strict_json import dumps
from tools.bench.figure import Figure
from tools.build.compiled_core import use
from tools.common.gc_collector import patient

if TYPE_CHECKING:
    from sim.fleet.scheduler import Script

ROBOTS: Final = 10
DAY_S, QUICK_S, HOUR_S = 86_400.0, 600.0, 3600.0
SAMPLE_S: Final = 900.0
SAMPLES: Final = 12  # at least
FORGETS_S: Final = 60.0  # the judge's record
WARM_UP_S: Final = (
    7200.0  # caches fill, records of units reach all robots; of a shorter time a quarter
)
# In a day. A season may cost a robot 100 MB; one file a day that is never closed is too many.
MEMORY_MB, JOURNAL_MB, FILES = 1.0 * ROBOTS, 1.0 * ROBOTS, 0
WAL: Final = "-wal"
# SQLite writes its log back at 1,000 pages of 4 KiB, and uses it again.
WAL_MAX_MB: Final = 4.2 * ROBOTS
LINEAR: Final = 0.5  # of the larger slope: what those of the two halves may differ by


class DaySample(NamedTuple):
    """What is held at one time."""

    at_s: float  # simulated
    memory_bytes: int
    journal_bytes: int  # without write-ahead logs
    wal_bytes: int
    files: int  # that are open, sockets included
    done: int  # sections


def samples(
    folder: Path, seconds: float, seed: int, tell: Callable[[DaySample], None] = lambda sample: None
) -> list[DaySample]:
    """Simulate a fleet for that long. `folder`: for its journals. `tell` is called with each sample."""
    from agent.runtime.peer_factory import NO_MEMORY, MissionParts
    from agent.runtime.sqlite_journal import SqliteJournal
    from sim.chaos.effect_observer import EffectObserver
    from sim.fleet.event_loop import EventLoop
    from sim.fleet.simulated_fleet import Cluster
    from sim.scenarios.protocol_setup import ProtocolSetup, drill
    from sim.world.protocol_world import PassThroughMotion, TimedMission

    class LongWork(ProtocolSetup):
        """Sections whose units last until the end of the time."""

        def parts(
            self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
        ) -> MissionParts:
            units = sum(self.parade.units.values())
            unit_for_us = round(seconds * 1e6 * ROBOTS / units)
            return MissionParts(
                TimedMission(self.parade, slot, unit_for_us=unit_for_us), PassThroughMotion()
            )

    event_loop, setting = EventLoop(), LongWork(drill(ROBOTS, seed))
    observer = EffectObserver(ROBOTS)
    cluster = Cluster(setting, f"day {seed}", observer, event_loop)
    journals = [SqliteJournal.opened(folder / f"robot{slot}.sqlite")[0] for slot in range(ROBOTS)]
    cluster.journals.update(enumerate(journals))
    checker = setting.parade.checker()
    found: list[DaySample] = []
    each_s = min(SAMPLE_S, seconds / SAMPLES)

    def main() -> "Script[None]":
        cluster.boot_all()
        at_s = 0.0
        while at_s < seconds:
            ends_at_s = min(at_s + each_s, seconds)
            while at_s < ends_at_s:
                at_s = min(at_s + FORGETS_S, ends_at_s)
                yield round(at_s * 1e6)
                observer.told.clear()
            gc.collect()
            found.append(_sample(at_s, folder, len(setting.parade.worked)))
            tell(found[-1])

    try:
        with patient():
            event_loop.run(main())
            cluster.end()
    finally:
        for journal in journals:
            journal.close()
    assert not checker.violations, checker.violations
    return found


def _sample(at_s: float, folder: Path, done: int) -> DaySample:
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    sizes = [(path.name.endswith(WAL), path.stat().st_size) for path in folder.iterdir()]
    open_files = sum(1 for _ in Path("/proc/self/fd").iterdir())
    return DaySample(
        at_s, int(line.split()[1]) * 1024, sum(size for wal, size in sizes if not wal),
        sum(size for wal, size in sizes if wal), open_files, done,
    )  # fmt: skip


def _slope(points: list[tuple[float, float]]) -> float:
    """Theil and Sen: the median of the slopes between all pairs; 0.0 for fewer than two."""
    slopes = [
        (value - before) / (at_s - was_s)
        for k, (at_s, value) in enumerate(points)
        for was_s, before in points[:k]
    ]
    return statistics.median(slopes) if slopes else 0.0


def figures(quick: bool, seed: int = 1, hours: float | None = None) -> Iterator[Figure]:
    """What grows after the warm-up. `hours`: simulated; none: a day."""
    seconds = QUICK_S if quick else DAY_S if hours is None else hours * HOUR_S
    with tempfile.TemporaryDirectory() as folder:
        all_samples = samples(Path(folder), seconds, seed)
    yield from growth_figures(all_samples, seed)


def growth_figures(all_samples: list[DaySample], seed: int) -> Iterator[Figure]:
    """What has grown in these samples after the warm-up. Judged if they are of four hours or more."""
    seconds, last = all_samples[-1].at_s, all_samples[-1]
    warm_at_s = min(WARM_UP_S, seconds / 4)
    warm = [sample for sample in all_samples if sample.at_s >= warm_at_s]
    judged = seconds >= 2 * WARM_UP_S  # a shorter run says too little about a day
    scope = (
        f"{ROBOTS} robots, {seconds / HOUR_S:.3g} h simulated, the first {warm_at_s / HOUR_S:.2g} h left "
        f"out; {last.done} units worked; seed {seed}"
    )
    columns: tuple[tuple[str, str, float, float, Callable[[DaySample], int]], ...] = (
        ("memory", "MB", 1e6, MEMORY_MB, lambda each: each.memory_bytes),
        ("journals", "MB", 1e6, JOURNAL_MB, lambda each: each.journal_bytes),
        ("open files", "", 1.0, FILES, lambda each: each.files),
    )
    for name, unit, scale, most, of in columns:
        points = [(each.at_s, of(each) / scale) for each in warm]
        half = len(points) // 2
        hourly = [_slope(part) * HOUR_S for part in (points, points[:half], points[half:])]
        day = hourly[0] * DAY_S / HOUR_S
        apart = abs(hourly[1] - hourly[2])
        linear = apart <= max(LINEAR * max(map(abs, hourly)), most * HOUR_S / DAY_S)
        ok = (day <= most and linear) if judged else None
        yield Figure(
            f"growth of {name} in a simulated day", day, unit, f"<= {most:g}" if judged else "", ok, "",
            f"{hourly[0]:.3g} an hour; first half {hourly[1]:.3g}, second {hourly[2]:.3g}"
            f"{'' if linear else ': not linear, so the day is not known'}; {points[0][1]:g} after the "
            f"warm-up, {points[-1][1]:g} at the end; {scope}",
        )  # fmt: skip
    wal_mb = max(each.wal_bytes for each in all_samples) / 1e6
    yield Figure("write-ahead logs of the journals, largest", wal_mb, "MB", f"<= {WAL_MAX_MB:g}",
                 wal_mb <= WAL_MAX_MB, "", scope)  # fmt: skip


def main() -> None:
    """Tells each sample on stderr, a line of JSON each, and the figures at the end."""
    parser = argparse.ArgumentParser(description=figures.__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    words = parser.parse_args()
    use()

    def tell(sample: DaySample) -> None:
        print(dumps(sample._asdict()), file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        all_samples = samples(Path(folder), words.hours * HOUR_S, words.seed, tell)
    for figure in growth_figures(all_samples, words.seed):
        print(
            figure.to_json() if words.json else f"{figure.figure}: {figure.value:.3g} {figure.unit}"
        )


if __name__ == "__main__":
    main()
