"""S7 in fields under the policy `continue`: judged where all robots hear each other, and only there."""

import pytest

from agent.interface.config import S
from sim.chaos.scenario_judge import ScenarioJudge
from sim.fleet.outcome import FieldOutcome
from sim.scenarios import scenario as kinds
from sim.scenarios.scenario import Fault, load

BEGIN_S, END_S, CUT_S, HEAL_S = 8, 16, 5.0, 9.0


class Together(ScenarioJudge):
    """A run at whose end the tracks of both robots lead along one line at the same time."""

    def _judge(self, outcome: FieldOutcome) -> None:
        swath = self.setting.field.sections[0].swaths[0]
        (ax_m, ay_m), (bx_m, by_m) = swath[:2]
        for slot in range(2):
            track = self.cluster.world.body(slot).track
            track.add(BEGIN_S * S, ax_m, ay_m, False, carried=True)
            for t_us in range(BEGIN_S * S, END_S * S, S // 10):
                share = (t_us / S - BEGIN_S) / (END_S - BEGIN_S)
                track.add(t_us, ax_m + share * (bx_m - ax_m), ay_m + share * (by_m - ay_m), True)
        super()._judge(outcome)


@pytest.mark.parametrize(
    ("cut", "healed", "at_s"), [(False, False, 8), (True, False, None), (True, True, 13)]
)
def test_two_robots_in_a_section_under_continue(cut: bool, healed: bool, at_s: int | None) -> None:
    """No field under this policy was judged by S7. Later, a robot that began a pass
    apart could end it beside another one, however long all had heard each other again."""
    scenario = load("yard").changed(2, 1)
    fleet = scenario.fleet.model_copy(update={"silence": "continue"})
    run = scenario.run.model_copy(update={"time_limit_s": float(END_S)})
    faults: list[Fault] = []
    if cut:
        faults.append(kinds.Partition(at_s=CUT_S, kind="partition", islands=[[0], [1]]))
    if healed:
        faults.append(kinds.Heal(at_s=HEAL_S, kind="heal"))
    judge = Together(scenario.model_copy(update={"fleet": fleet, "run": run, "fault": faults}))
    found = [int(each.t_s) for each in judge.run().broken if each.rule == "S7"]
    assert found == ([] if at_s is None else [at_s])
