"""pymunk moves the bodies of every run; the step of campaigns has the same result."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim.chaos.fault_profiles import draw
from sim.chaos.scenario_judge import ScenarioJudge
from sim.fleet.outcome import FieldOutcome
from sim.runs.delivery_run import DeliveryRun
from sim.runs.exploration_run import ExplorationRun
from sim.runs.field_run import FieldRun
from sim.runs.navigation_run import NavigationRun
from sim.scenarios.delivery_scenario import DeliveryScenario
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.exploration_scenario import load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.scenario import load
from sim.world.drive_trains import STEP_US
from sim.world.step_engine import Engine
from sim.world.world import World
from tests.sim.runs.test_delivery_run import scenario as warehouse
from tools.run.run_field import run

SAME_M = 1e-9  # in runs without contacts both engines do the same operations in the same order
SHORT_S = 20.0


def played(
    engine: Engine, robots: int, seed: int
) -> tuple[FieldOutcome, dict[int, np.ndarray], World]:
    worlds: list[World] = []
    scenario = load("small").changed(robots, seed).with_engine(engine)
    expedition = FieldRun(FieldSetup(scenario), attach=lambda cluster: worlds.append(cluster.world))
    outcome = expedition.run()
    return outcome, {s: np.array(t) for s, t in expedition.tracks.items()}, worlds[0]


@pytest.mark.slow
@pytest.mark.parametrize(("robots", "seed"), [(3, 1), (4, 2), (6, 3)])
def test_m23_both_engines_agree_in_runs_without_contacts(robots: int, seed: int) -> None:
    print("seed", seed)
    (one, tracks, _), (fast, fast_tracks, _) = (
        played("pymunk", robots, seed), played("contact_free", robots, seed),
    )  # fmt: skip
    assert one.success and fast.success
    # A flawless run was moved by pymunk in all its steps, and not in one of them.
    assert one.pymunk_steps == round(one.simulated_s * 1e6) // STEP_US > 0
    assert fast.pymunk_steps == 0
    for slot, track in tracks.items():
        np.testing.assert_allclose(track, fast_tracks[slot], rtol=0.0, atol=SAME_M)
    differ = ("pymunk_steps", "wall_s")
    assert {k: v for k, v in one._asdict().items() if k not in differ} == {
        k: v for k, v in fast._asdict().items() if k not in differ
    }


def test_m23_run_reports_how_many_steps_pymunk_made(tmp_path: Path) -> None:
    run("small", 2, 1, tmp_path, False, limit_s=SHORT_S)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["pymunk_steps"] == round(report["simulated_s"] * 1e6) // STEP_US > 0


@pytest.mark.slow
def test_m23_errands_deliveries_and_explorations_are_moved_by_pymunk() -> None:
    rooms = load_mission("rooms").changed(2, 1, time_limit_s=SHORT_S)
    assert isinstance(rooms, NavigationScenario) and not isinstance(rooms, DeliveryScenario)
    haul = warehouse(2).changed(time_limit_s=SHORT_S)
    assert isinstance(haul, DeliveryScenario)
    arena = load_arena("arena").changed(2, 1, time_limit_s=SHORT_S)
    outing = setting_of(rooms)
    for outcome in (
        NavigationRun(outing).run(),
        DeliveryRun(DeliverySetup(haul)).run(),
        ExplorationRun(arena).run(),
    ):
        assert outcome.pymunk_steps > 500, outcome


def test_m23_launched_worlds_are_moved_by_pymunk_and_campaigns_choose_the_other_engine() -> None:
    world = FieldSetup(load("small")).world()  # as `headland launch` makes it
    world.advance(1_000_000)
    assert world.engine == "pymunk" and world.pymunk_steps == 100
    play = ScenarioJudge(draw(1, "body"))
    assert play.setting.scenario.run.engine == "contact_free"
    assert play.setting.world().engine == "contact_free"
