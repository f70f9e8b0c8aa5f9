"""A clock that jumps under a robot that drives: it drives on by itself, from where it really is."""

import pytest

from agent.interface.config import S
from agent.interface.effects import Effect, Trace
from sim.fleet.simulated_fleet import Cluster
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ClockJump, load

JUMPS_AT_S, SEEN_AT_S, ENDS_AT_S = 12.0, 17.0, 24.0
ROBOT = 2


@pytest.mark.parametrize("by_s", [-1.0, -0.4, 0.4, 5.0])
def test_i24_a_robot_whose_clock_jumps_drives_on(by_s: float) -> None:
    jump = ClockJump(at_s=JUMPS_AT_S, kind="clock_jump", robot=ROBOT, by_s=by_s)
    yard = load("yard").changed(3, 1, time_limit_s=ENDS_AT_S).model_copy(update={"fault": [jump]})
    places: dict[str, tuple[float, float]] = {}
    why: list[str] = []

    def record(slot: int, _: int, effect: Effect) -> None:
        if slot == ROBOT and isinstance(effect, Trace) and effect.event.startswith("PLACE_"):
            why.append(f"{effect.event}: {effect.why}")

    def attach(cluster: Cluster) -> None:
        cluster.record = record
        for when, at_s in (("jump", JUMPS_AT_S), ("seen", SEEN_AT_S), ("end", ENDS_AT_S - 0.1)):

            def note(when: str = when) -> None:
                cluster.world.advance(cluster.host.now_us())
                places[when] = cluster.world.robots[ROBOT].position

            cluster.host.at(round(at_s * S), note)  # type: ignore[attr-defined]

    FieldRun(FieldSetup(yard.with_engine("contact_free")), attach=attach).run()
    assert not why
    for before, after in (("jump", "seen"), ("seen", "end")):
        (x_m, y_m), (then_x_m, then_y_m) = places[before], places[after]
        assert abs(then_x_m - x_m) + abs(then_y_m - y_m) > 1.0, places
