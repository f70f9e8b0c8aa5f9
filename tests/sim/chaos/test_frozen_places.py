"""S19: how far a robot really drives while its place is frozen."""

from functools import partial
from math import cos, hypot, pi, sin

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import Drive
from sim.chaos.scenario_judge import ScenarioJudge
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios import scenario as kinds
from sim.scenarios.scenario import Fault, load
from sim.world.drive_trains import VX, VY

BEGIN_S, END_S = 10.0, 14.0
STEP_RAD = 0.1
TURN_STEPS = round(2 * pi / STEP_RAD)


class Carried(ScenarioJudge):
    """A run in which robot 0 goes round in a circle of 1 m, once, whatever its wheels are told."""

    def _attach(self, cluster: Cluster) -> None:
        super()._attach(cluster)
        self.middle: tuple[float, float] | None = None
        for k in range(TURN_STEPS):
            self._at(round(BEGIN_S * S) + k * CONTROL_PERIOD_US, partial(self._step, k))

    def _step(self, k: int) -> None:
        world, angle_rad = self.cluster.world, STEP_RAD * k
        world.advance(self.cluster.host.now_us())
        body = world.body(0)
        if self.middle is None:
            self.middle = body.position[0] - 1.0, body.position[1]
        x_m, y_m = self.middle[0] + cos(angle_rad), self.middle[1] + sin(angle_rad)
        world.place(body, x_m, y_m, body.heading_rad)


@pytest.mark.parametrize(
    "spans_s",
    [[(9.5, 14.0)], [(6.0, 9.8), (9.5, 14.0)], [(6.0, 14.0), (7.0, 8.0)]],
    ids=["one", "overlapping", "one within the other"],
)
@pytest.mark.parametrize("ordered", [None, 0, 1])
def test_a_robot_that_goes_round_with_a_frozen_place_is_found(
    spans_s: list[tuple[float, float]],
    ordered: int | None,
) -> None:
    """It ended where it began, and only the distance between both was judged. Of two faults that
    overlap, nothing was judged after the end of the first. An order to any robot ended it for all."""
    scenario = load("yard").changed(2, 1)
    faults: list[Fault] = [
        kinds.Frozen(at_s=begin_s, kind="frozen", robot=0, for_s=end_s - begin_s)
        for begin_s, end_s in spans_s
    ]
    if ordered is not None:
        faults.append(kinds.Order(at_s=11.0, kind="order", robot=ordered, order="start"))
    run = scenario.run.model_copy(update={"time_limit_s": END_S + 1.0})
    judge = Carried(scenario.model_copy(update={"fault": faults, "run": run}))
    found = [each.what for each in judge.run().broken if each.rule == "S19"]
    assert len(found) == 1 and "while its place is frozen" in found[0]


class TurnedBack(ScenarioJudge):
    """A run in which robot 0 is told to drive at full speed, on or back, at `BEGIN_S`."""

    forth = -1.0
    speed_m_s = brakes_m = 0.0

    def _attach(self, cluster: Cluster) -> None:
        super()._attach(cluster)
        self._at(round(BEGIN_S * S), self._turn)

    def _turn(self) -> None:
        now_us, world = self.cluster.host.now_us(), self.cluster.world
        world.advance(now_us)
        body = world.robots[0]
        vx_m_s, vy_m_s = world.motion[body.index, VX : VY + 1].tolist()
        self.speed_m_s = hypot(vx_m_s, vy_m_s)
        body.drive(Drive(self.forth * vx_m_s, self.forth * vy_m_s), now_us)
        self.brakes_m = self._brakes_m(0, now_us)


@pytest.mark.parametrize("forth", [1.0, -1.0])
def test_a_robot_that_turns_back_when_its_place_freezes_brakes_first(forth: float) -> None:
    """One that was told to turn back at full speed drove 1 m more than S19 allows (fixes 116420116)."""
    scenario = load("yard").changed(2, 1)
    run = scenario.run.model_copy(update={"time_limit_s": BEGIN_S + 1.0})
    judge = TurnedBack(scenario.model_copy(update={"fault": [], "run": run}))
    judge.forth = forth
    judge.run()
    braking_m = judge.speed_m_s**2 / (2 * scenario.fleet.acceleration_m_s2)
    assert judge.speed_m_s > 0.5
    assert judge.brakes_m == (pytest.approx(braking_m) if forth < 0.0 else 0.0)
