"""What the setups of all missions have alike."""

from pathlib import Path

import pytest

from agent.interface.identity import SilencePolicy
from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.protocol_setup import ProtocolSetup, drill
from sim.scenarios.scenario import ScenarioError, load


def setups() -> list[FleetSetup]:
    return [
        FieldSetup(load("small").changed(robots=3)),
        ProtocolSetup(drill(3, 1)),
        ExplorationSetup(load_arena("arena").changed(3)),
    ]


@pytest.mark.parametrize("setup", setups(), ids=lambda setup: type(setup).__name__)
def test_every_setup_makes_a_world_with_its_robots_and_knows_their_vehicle(
    setup: FleetSetup,
) -> None:
    world = setup.world()
    assert sorted(world.robots) == [0, 1, 2]
    assert setup.vehicle.radius_m == setup.scenario.fleet.radius_m
    assert setup.chassis.speed_m_s == setup.scenario.fleet.speed_m_s
    assert setup.silence is SilencePolicy[setup.scenario.fleet.silence.upper()]
    assert setup.keyring(1) is None  # without keys


def test_places_for_bodies_are_asked_of_the_ground_where_there_is_one() -> None:
    field, protocol, arena = setups()
    inside = field.free_space(0.8)
    assert inside is not None and inside(*field.starts[0]) and not inside(1e6, 0.0)
    assert protocol.free_space(0.8) is None and arena.free_space(0.8) is None


def test_a_missing_key_file_is_said_of_every_mission(tmp_path: Path) -> None:
    none = tmp_path / "none.toml"
    with pytest.raises(ScenarioError, match=r"fleet\.keys"):
        FieldSetup(load("small").changed(keys=none))
    with pytest.raises(ScenarioError, match=r"fleet\.keys"):
        ProtocolSetup(drill(2, 1).changed(keys=none))
    with pytest.raises(ScenarioError, match=r"fleet\.keys"):
        ExplorationSetup(
            load_arena("arena")
            .changed()
            .model_copy(
                update={"fleet": load_arena("arena").fleet.model_copy(update={"keys": str(none)})}
            )
        )
