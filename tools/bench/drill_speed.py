"""How fast a drill is simulated. A process of its own: what is imported compiled stays so.

Example: python -m tools.bench.drill_speed 5 --seed 1 --cpu-s 4
"""

import argparse
import time
from typing import TYPE_CHECKING, NamedTuple

from sim.files.strict_json import dumps
from tools.bench.fresh_process import in_fresh_process
from tools.build.compiled_core import use
from tools.common.gc_collector import patient

if TYPE_CHECKING:
    from sim.fleet.scheduler import Script

SETTLED_S = 8.0  # by then the fleet has joined and works; booting is not measured
WORKS_S = 120.0  # no robot is without work until then: 8 sections of 20 units, a second each
SLICE_US = 1_000_000  # simulated time between two looks at the clock, which cost something too


class Speed(NamedTuple):
    """How fast one drill was simulated."""

    rate: float  # simulated seconds per CPU second
    compiled: bool
    frames: int  # on the wire, with those of joining
    simulated_s: float


def measured(robots: int, seed: int, cpu_s: float, interpreted: bool = False) -> Speed:
    """In a fresh process."""
    words = (f"{robots}", "--seed", f"{seed}", "--cpu-s", f"{cpu_s}")
    return Speed(**in_fresh_process(__spec__.name, *words, interpreted=interpreted))


def speed(robots: int, seed: int, cpu_s: float) -> Speed:
    """Here and now: drills that work, without faults, under their checkers, one after another."""
    compiled = use()
    simulated_s = spent_s = 0.0
    frames = 0
    while spent_s < cpu_s:
        with patient():
            worked = _drill(robots, seed, cpu_s - spent_s)
        simulated_s, spent_s = simulated_s + worked[0], spent_s + worked[1]
        frames, seed = frames + worked[2], seed + 1
    return Speed(simulated_s / spent_s, compiled, frames, simulated_s)


def _drill(robots: int, seed: int, cpu_s: float) -> tuple[float, float, int]:
    """(simulated, CPU) seconds of a fleet at work, and frames from its start to its end."""
    from sim.chaos.effect_observer import EffectObserver
    from sim.fleet.event_loop import EventLoop
    from sim.fleet.simulated_fleet import Cluster
    from sim.scenarios.protocol_setup import ProtocolSetup, drill

    event_loop, setting = EventLoop(), ProtocolSetup(drill(robots, seed))
    witness = EffectObserver(robots)
    cluster = Cluster(setting, f"speed {robots}/{seed}", witness, event_loop)
    checker = setting.parade.checker()
    spent: list[float] = []

    def main() -> "Script[None]":
        cluster.boot_all()
        yield round(SETTLED_S * 1e6)
        begun_s = time.process_time()
        while event_loop.now_us() < WORKS_S * 1e6 and time.process_time() - begun_s < cpu_s:
            yield event_loop.now_us() + SLICE_US
        spent.append(time.process_time() - begun_s)

    event_loop.run(main())
    frames = cluster.segment.wire.frames
    cluster.end()
    assert not checker.violations and not witness.broken
    return event_loop.now_us() / 1e6 - SETTLED_S, spent[0], frames


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cpu-s", type=float, default=4.0)
    given = parser.parse_args()
    print(dumps(speed(given.robots, given.seed, given.cpu_s)._asdict()))
