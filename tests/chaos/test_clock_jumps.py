"""A clock that jumps under a robot that drives: it drives on by itself, from where it really is."""

from itertools import pairwise
from math import dist

import pytest

from agent.interface.config import S
from agent.interface.effects import Effect, Trace
from sim.fleet.simulated_fleet import Cluster
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ClockJump, load

JUMPS_AT_S, ENDS_AT_S = 12.0, 24.0
SEEN_FOR_S, LOOKED_AT_FOR_S = 5, 12  # from the jump on
ROBOT = 2


@pytest.mark.parametrize("by_s", [-1.0, -0.4, 0.4, 5.0])
def test_i24_a_robot_whose_clock_jumps_drives_on(by_s: float) -> None:
    jump = ClockJump(at_s=JUMPS_AT_S, kind="clock_jump", robot=ROBOT, by_s=by_s)
    yard = load("yard").changed(3, 1, time_limit_s=ENDS_AT_S).model_copy(update={"fault": [jump]})
    places: list[tuple[float, float]] = []  # each half second, from the jump on
    why: list[str] = []

    def record(slot: int, _: int, effect: Effect) -> None:
        if slot == ROBOT and isinstance(effect, Trace) and effect.event.startswith("PLACE_"):
            why.append(f"{effect.event}: {effect.why}")

    def attach(cluster: Cluster) -> None:
        cluster.record = record

        def note() -> None:
            cluster.world.advance(cluster.host.now_us())
            places.append(cluster.world.robots[ROBOT].position)

        for half in range(2 * LOOKED_AT_FOR_S):
            at_us = round((JUMPS_AT_S + half / 2) * S)
            cluster.host.at(at_us, note)  # type: ignore[attr-defined]

    FieldRun(FieldSetup(yard.with_engine("contact_free")), attach=attach).run()
    assert not why
    # It may drive back to what it could not finish, so what counts is the way and not the distance.
    ways_m = [dist(before, after) for before, after in pairwise(places)]
    seen = 2 * SEEN_FOR_S
    assert sum(ways_m[:seen]) > 1.0 and sum(ways_m[seen:]) > 1.0, places
