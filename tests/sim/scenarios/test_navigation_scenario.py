"""Scenario files of errands: what is wrong with one is said in one line; a shipped one is run."""

from pathlib import Path

import pytest

from agent.interface.lifecycle import State
from sim.runs.navigation_run import NavigationRun
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.navigation_setup import NavigationSetup
from sim.scenarios.scenario import Scenario, ScenarioError

TEXT = """
name = "yard"
mission = "errands"
[floor]
map = "yard.map"
[fleet]
robots = 2
radius_m = 0.35
speed_m_s = 1.0
"""
MAP = "......\n.#.#..\n......\n"


def setting(
    folder: Path, text: str, drawing: str = MAP, robots: int | None = None
) -> NavigationSetup:
    (folder / "yard.map").write_text(drawing)
    (folder / "yard.toml").write_text(text)
    scenario = load_mission(str(folder / "yard.toml")).changed(robots)
    assert isinstance(scenario, NavigationScenario)
    return setting_of(scenario)


@pytest.mark.parametrize(
    ("text", "drawing", "said"),
    [
        (TEXT.replace("yard.map", "none.map"), MAP, "floor.map"),
        (TEXT, "...\n..", "the same length"),
        (TEXT, "###\n###", "no place for a body"),
        (TEXT.replace("robots = 2", "robots = 40"), MAP, "no room for 40 robots"),
        (TEXT + "[errands]\nstarts = [[0.5, 0.5]]\n", MAP, "both starts and goals"),
        (TEXT + "[errands]\nstarts = [[0.5, 0.5]]\ngoals = [[[5.5, 0.5]]]\n", MAP, "1 starts"),
        (
            TEXT + "[errands]\nstarts = [[0.5, 0.5], [1.5, 1.5]]\ngoals = [[], []]\n",
            MAP,
            "can stand at 1.5, 1.5",
        ),
        (TEXT + "[errand]\n", MAP, "errand: unknown key"),
        (TEXT + "[obstacles]\nsize_m = [9.0, 9.0]\n", MAP, "obstacles.size_m"),
        (TEXT + 'keys = "none.toml"\n', MAP, "fleet.keys"),
        (TEXT + 'drive = "ackermann"\n', MAP, "fleet.drive"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    tmp_path: Path, text: str, drawing: str, said: str
) -> None:
    with pytest.raises(ScenarioError, match=said) as problem:
        setting(tmp_path, text, drawing)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("starts", "goals", "said"),
    [
        (
            "[[0.5, 0.5], [0.9, 0.5]]",
            "[[], [[5.5, 0.5]]]",
            "starts: robot 1 at 0.9, 0.5 would touch",
        ),
        (
            "[[0.5, 0.5], [2.5, 0.5]]",
            "[[[5.5, 0.5]], [[5.5, 0.5]]]",
            "goals: robot 1 at 5.5, 0.5 would",
        ),
        ("[[0.5, 0.5], [2.5, 0.5]]", "[[[2.5, 0.5]], []]", "goals: robot 1 at 2.5, 0.5 would"),
        ("[[0.5, 0.5], [2.5, 0.5]]", "[[[0.5, 2.5]], []]", "no way leads robot 0 to 0.5, 2.5"),
    ],
)
def test_i24_robots_without_room_or_way_are_refused(
    tmp_path: Path, starts: str, goals: str, said: str
) -> None:
    """They touched each other before they moved, or the fleet stood until its time was over."""
    apart = "......\n######\n......\n"
    with pytest.raises(ScenarioError, match=said) as problem:
        setting(tmp_path, f"{TEXT}[errands]\nstarts = {starts}\ngoals = {goals}\n", apart)
    assert "\n" not in str(problem.value)


def test_other_missions_are_loaded_as_before() -> None:
    assert type(load_mission("small")) is Scenario


def test_goals_are_drawn_by_the_seed(tmp_path: Path) -> None:
    text = TEXT + "[errands]\neach = 3\n"
    one, two = (setting(tmp_path, text) for _ in range(2))
    assert one.goals == two.goals and {len(own) for own in one.goals.values()} == {3}
    other = setting(tmp_path, text + "[run]\nseed = 7\n")
    assert other.goals != one.goals


def test_a_shipped_building_with_boxes_in_the_way(tmp_path: Path) -> None:
    scenario = load_mission("rooms").changed(robots=4, seed=3)
    assert isinstance(scenario, NavigationScenario)
    made = setting_of(scenario)
    outcome = NavigationRun(made, tmp_path).run()
    print("seed", scenario.run.seed, outcome.legs)
    assert outcome.success and outcome.obstacles > 0
    assert (tmp_path / "can.log").stat().st_size > 0
    assert (
        outcome.to_dict()["success"]
        and State.WORKING.name in (tmp_path / "trace.jsonl").read_text()
    )
