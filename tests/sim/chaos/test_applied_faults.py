"""Which faults count as injected: those that found what they are about."""

from sim.chaos.scenario_judge import ScenarioJudge
from sim.runs.protocol_run import ProtocolRun
from sim.scenarios import scenario as kinds
from sim.scenarios.protocol_setup import ProtocolSetup, drill
from sim.scenarios.scenario import Scenario


def played(faults: list[kinds.Fault]) -> Scenario:
    scenario = drill(2, 1, "sprint")
    run = scenario.run.model_copy(update={"time_limit_s": 12.0})
    return scenario.model_copy(update={"fault": faults, "run": run})


def test_a_fault_of_a_robot_that_is_off_is_not_counted() -> None:
    """A campaign counted every fault that was drawn, and a report listed it as applied."""
    scenario = played([
        kinds.Estop(at_s=2.0, kind="estop", robot=1),  # not there yet
        kinds.Freeze(at_s=2.5, kind="freeze", robot=1, for_s=1.0),
        kinds.Join(at_s=4.0, kind="join", robot=1),
        kinds.Crash(at_s=6.0, kind="crash", robot=0),
        kinds.BusOff(at_s=6.5, kind="bus_off", robot=0, for_s=1.0),
        kinds.Crash(at_s=7.0, kind="crash", robot=0),
        kinds.Estop(at_s=8.0, kind="estop", robot=1),
        kinds.Crash(at_s=20.0, kind="crash", robot=1),  # the run is over
    ])  # fmt: skip
    assert ScenarioJudge(scenario).run().faults == {"join": 1, "crash": 1, "estop": 1}
    run = ProtocolRun(ProtocolSetup(scenario))
    run.run()
    told = [(fault["t_s"], fault["kind"], fault["robot"]) for fault in run.told_faults]
    assert told == [(4.0, "join", 1), (6.0, "crash", 0), (8.0, "estop", 1)]
