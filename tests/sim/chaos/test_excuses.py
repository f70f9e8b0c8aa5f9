"""S17: what excuses a contact, and for how long."""

import pytest

from agent.interface.config import S
from sim.chaos.scenario_judge import ScenarioJudge
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios import scenario as kinds
from sim.scenarios.scenario import load
from sim.world.ground_truth import Contact

COMES_S, MEETS_S, END_S, LONG_S = 6.0, 7.0, 9.0, 11.5
OLD_X_M, OLD_Y_M = 10.0, 5.0  # a box that is there from the beginning
INTO_M = 0.3  # of one body into what it meets


class Carried(ScenarioJudge):
    """A run in which robot 1 is set into something a second after a person has come into the field."""

    meets = "robot"
    leans_for_s = 0.5

    def _attach(self, cluster: Cluster) -> None:
        super()._attach(cluster)
        self._at(round(MEETS_S * S), self._carry)

    def _carry(self) -> None:
        world = self.cluster.world
        world.advance(round(MEETS_S * S))
        first, second = world.body(0), world.body(1)
        x_m, y_m = first.position
        if self.meets == "leans":
            at_us = round(MEETS_S * S)
            last_at_us = at_us + round(self.leans_for_s * S)
            world.contacts.append(Contact(at_us, 0, 1, 0.001, "robot 1", x_m, y_m, last_at_us))
        elif self.meets == "old box":
            world.place(first, OLD_X_M - 1.0 - first.radius_m + INTO_M, OLD_Y_M, 0.0)
        elif self.meets == "box":
            world.add_box(x_m + first.radius_m + 1.0 - INTO_M, y_m, 2.0)
        else:
            world.place(second, x_m + 2 * first.radius_m - INTO_M, y_m, 0.0)


@pytest.mark.parametrize(
    ("meets", "broken"), [("robot", True), ("box", False), ("leans", True), ("old box", True)]
)
def test_a_person_elsewhere_excuses_no_robot_that_touches_another(meets: str, broken: bool) -> None:
    """S17 was not judged between robots, nor at fences, for 3 s after anything came into the field.
    A robot that leans on another is a millimetre deep in it. That was never judged. Then any box was
    excused, also one that was there long before."""
    person = kinds.Person(
        at_s=COMES_S, kind="person", route=[(-19.0, -13.0), (-18.0, -13.0)], speed_m_s=0.5
    )
    box = kinds.Box(at_s=1.0, kind="box", x_m=OLD_X_M, y_m=OLD_Y_M, size_m=2.0, for_s=60.0)
    scenario = load("yard").changed(2, 1)
    run = scenario.run.model_copy(update={"time_limit_s": END_S})
    faults = [box, person] if meets == "old box" else [person]
    judge = Carried(scenario.model_copy(update={"fault": faults, "run": run}))
    judge.meets = meets
    told = [each for each in judge.run().broken if each.rule == "S17"]
    assert judge.cluster.world.contacts, "nothing was touched"
    assert bool(told) is broken, told


@pytest.mark.parametrize(
    ("for_s", "stands", "broken"), [(1.0, False, False), (4.0, False, True), (4.0, True, False)]
)
def test_a_push_excuses_no_robot_that_presses_on_something_long_after_it(
    for_s: float, stands: bool, broken: bool
) -> None:
    """A contact that began within 3 s after a push was excused, however long it lasted. Then none was
    that lasted longer, not even of a robot that stood at a box that had fallen before it (`body`
    116000005)."""
    push = kinds.Pushed(at_s=COMES_S, kind="pushed", robot=0, dx_m=0.1, dy_m=0.0)
    stop = kinds.Estop(at_s=MEETS_S, kind="estop", robot=0, reason="OPERATOR_INTERVENTION")
    scenario = load("yard").changed(2, 1)
    run = scenario.run.model_copy(update={"time_limit_s": LONG_S})
    faults = [push, stop] if stands else [push]
    judge = Carried(scenario.model_copy(update={"fault": faults, "run": run}))
    judge.meets, judge.leans_for_s = "leans", for_s
    told = [each for each in judge.run().broken if each.rule == "S17"]
    assert judge.cluster.world.contacts, "nothing was touched"
    assert bool(told) is broken, told
