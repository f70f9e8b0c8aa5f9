"""The plain event loop and asyncio's on a virtual clock: the same run, to the last effect."""

import pytest

from sim.fleet.event_loop import EventLoop, SimulatedRunner
from sim.fleet.outcome import FieldOutcome
from sim.fleet.scheduler import Script
from sim.fleet.virtual_clock import run_virtual
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import (
    BusOff,
    Crash,
    Duplicate,
    Errors,
    Estop,
    Fault,
    Freeze,
    Loss,
    Reset,
    Restart,
    load,
)

TROUBLE: list[Fault] = [
    Loss(at_s=10.0, kind="loss", rate=0.05),
    Errors(at_s=12.0, kind="errors", rate=0.02),
    Duplicate(at_s=13.0, kind="duplicate", rate=0.01),
    Freeze(at_s=15.0, kind="freeze", robot=1, for_s=0.7),
    Crash(at_s=20.0, kind="crash", robot=2),
    Estop(at_s=30.0, kind="estop", robot=1),
    Restart(at_s=33.0, kind="restart", robot=2),
    Reset(at_s=45.0, kind="reset"),
    BusOff(at_s=60.0, kind="bus_off", robot=0, for_s=1.0),
    Loss(at_s=64.0, kind="loss", rate=0.0),
]


LIMIT_S = 68.0


def play(robots: int, seed: int, faults: list[Fault], event_loop: bool) -> FieldOutcome:
    """Until all that goes wrong has gone wrong, and is over for a while."""
    plain = load("small").changed(robots, seed)
    run = plain.run.model_copy(update={"time_limit_s": LIMIT_S})
    scenario = plain.model_copy(update={"fault": faults, "run": run})
    expedition = FieldRun(FieldSetup(scenario))
    return expedition.run() if event_loop else run_virtual(expedition.live())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robots", "seed", "faults"), [(3, 1, []), (4, 2, TROUBLE), (3, 3, TROUBLE)]
)
def test_both_loops_give_the_same_trace_hash(robots: int, seed: int, faults: list[Fault]) -> None:
    ours, theirs = play(robots, seed, faults, True), play(robots, seed, faults, False)
    assert ours.trace_hash == theirs.trace_hash, f"{robots} robots, seed {seed}"
    assert ours.makespan_s == theirs.makespan_s and ours.frames == theirs.frames


def test_timers_of_one_instant_fire_in_the_order_they_were_set() -> None:
    event_loop, seen = EventLoop(), list[str]()

    def main() -> Script[int]:
        event_loop.at(5, lambda: seen.append("first"))
        event_loop.at(5, lambda: seen.append("second"))
        cancelled = event_loop.at(4, lambda: seen.append("never"))
        cancelled.cancel()
        event_loop.at(3, lambda: event_loop.soon(lambda: seen.append("soon")))
        yield 10
        return event_loop.now_us()

    assert event_loop.run(main()) == 10
    assert seen == ["soon", "first", "second"]


def test_a_clock_that_runs_fast_reaches_every_deadline() -> None:
    """Found by `headland chaos`, profile protocol, seed 1130: by a last bit, time stood still."""
    runner = SimulatedRunner.__new__(SimulatedRunner)
    runner._base_at_us = runner._rate_set_at_us = 117_798_000
    for ppm in (5_000.0, -5_000.0, 37.0):
        runner._rate = 1.0 + ppm * 1e-6
        for due_at_us in (153_066_666, *range(153_000_000, 153_100_000, 7)):
            assert runner._shown_at(runner._at(due_at_us)) >= due_at_us, (ppm, due_at_us)


def test_a_run_in_which_time_stands_still_ends() -> None:
    """Who asks to be woken and does not do what it was woken for."""
    event_loop = EventLoop()

    def again() -> None:
        event_loop.at(event_loop.now_us(), again)

    def main() -> Script[None]:
        event_loop.at(5, again)
        yield 10

    with pytest.raises(AssertionError, match="time stands still at 5 us"):
        event_loop.run(main())
