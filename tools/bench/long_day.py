"""A day of ten robots in simulated time: what their memory, their journals and their open files grow by.

The fleet works all day: its units take as long as 24 hours need. Each robot writes a journal on the
disk. Memory is the anonymous memory of this process, so the simulator's own is part of it.
"""

import gc
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from tools.bench.figure import Figure
from tools.common.gc_collector import patient

if TYPE_CHECKING:
    from sim.fleet.scheduler import Script

ROBOTS: Final = 10
DAY_S, QUICK_S = 86_400.0, 600.0
SAMPLES: Final = 24  # in the whole time; the first quarter is left out, as everything is made then
SETTLED: Final = SAMPLES // 4
# In a day. A season may cost a robot 100 MB; one file a day that is never closed is too many.
MEMORY_MB, JOURNAL_MB, FILES = 1.0 * ROBOTS, 1.0 * ROBOTS, 0


class DaySample(NamedTuple):
    """What is held at one time."""

    at_s: float  # simulated
    memory_bytes: int
    journal_bytes: int
    files: int  # that are open, sockets included
    done: int  # sections


def samples(folder: Path, seconds: float, seed: int) -> list[DaySample]:
    """Simulate a fleet for that long. `folder`: for its journals."""
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

    swarm, setting = EventLoop(), LongWork(drill(ROBOTS, seed))
    cluster = Cluster(setting, f"day {seed}", EffectObserver(ROBOTS), swarm)
    journals = [SqliteJournal.opened(folder / f"robot{slot}.sqlite")[0] for slot in range(ROBOTS)]
    cluster.journals.update(enumerate(journals))
    checker = setting.parade.checker()
    found: list[DaySample] = []

    def main() -> "Script[None]":
        cluster.boot_all()
        for k in range(1, SAMPLES + 1):
            yield round(seconds * 1e6 * k / SAMPLES)
            gc.collect()
            found.append(_sample(seconds * k / SAMPLES, folder, len(setting.parade.worked)))

    try:
        with patient():
            swarm.run(main())
            cluster.end()
    finally:
        for journal in journals:
            journal.close()
    assert not checker.violations, checker.violations
    return found


def _sample(at_s: float, folder: Path, done: int) -> DaySample:
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    journal_bytes = sum(path.stat().st_size for path in folder.iterdir())
    open_files = sum(1 for _ in Path("/proc/self/fd").iterdir())
    return DaySample(at_s, int(line.split()[1]) * 1024, journal_bytes, open_files, done)


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """What has grown from the end of the first quarter to the end of the day."""
    seconds = QUICK_S if quick else DAY_S
    with tempfile.TemporaryDirectory() as folder:
        all_samples = samples(Path(folder), seconds, seed)
    first, last = all_samples[SETTLED - 1], all_samples[-1]
    days = (last.at_s - first.at_s) / DAY_S
    scope = (
        f"{ROBOTS} robots, {seconds / 3600:.2g} h simulated, the first quarter left out; {last.done} "
        f"units worked; seed {seed}"
    )
    rows = (
        ("memory", "MB", last.memory_bytes, first.memory_bytes, 1e6, MEMORY_MB),
        ("journals", "MB", last.journal_bytes, first.journal_bytes, 1e6, JOURNAL_MB),
        ("open files", "", last.files, first.files, 1, FILES),
    )
    for name, unit, end, begin, scale, most in rows:
        grown = (end - begin) / scale / (1.0 if scale == 1 else days)
        judged = not quick  # a shorter run says too little about a day
        yield Figure(
            f"growth of {name} in a simulated day", grown, unit, f"<= {most:g}" if judged else "",
            grown <= most if judged else None, "",
            f"{begin / scale:g} before, {end / scale:g} at the end; {scope}",
        )  # fmt: skip
