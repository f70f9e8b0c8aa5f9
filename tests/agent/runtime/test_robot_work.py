"""What a robot file can declare as work: the missions of simulated fleets, and errors of one line."""

import asyncio
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from agent.coverage.coverage_mission import GridWork
from agent.exploration.exploration_mission import ExplorationMission
from agent.navigation.navigation_mission import NavigationMission
from agent.runtime.robot_file import RobotError, RobotFile
from agent.runtime.robot_process import run_robot
from agent.runtime.robot_work import Work, work_of
from tests.agent.runtime.robots_without_simulator import PointBody
from tools.build.warmup import warm

MAP = "\n".join(["@" * 8, *["@......@"] * 4, "@" * 8])  # a cell of the drawing is a metre
SMALL = {"robots": 2, "radius_m": 0.3, "speed_m_s": 1.0}
GOALS = [[[2.5, 2.5]], [[5.5, 3.5], [2.5, 3.5]]]
NAVIGATION: dict[str, Any] = {"navigation": {"map": MAP, "goals": GOALS}}
EXPLORATION: dict[str, Any] = {"exploration": {"width_m": 8.0, "height_m": 6.0}}
COVERAGE: dict[str, Any] = {"coverage": {"map": MAP, "cell_m": 2.0}}


def work(document: dict[str, Any], slot: int = 1, **fleet: Any) -> Work:
    known = {"name": "n", "robot": {"slot": slot}, "fleet": {**SMALL, **fleet}}
    return work_of(RobotFile.of({**known, **document}, "r.toml", Path()), 0, {})


def test_goals_in_a_building() -> None:
    found = work(NAVIGATION)
    assert isinstance(found.parts.mission, NavigationMission) and found.parts.chart is not None
    assert found.sections == 3
    assert found.field_hash == work(NAVIGATION, slot=0).field_hash


def test_exploration_of_a_place_without_a_map() -> None:
    orders = [{"kind": "patrol", "points": [[0.0, 1.0], [1.0, 1.0]]}]
    table = {**EXPLORATION["exploration"], "order": orders}
    found = work({"exploration": table})
    assert isinstance(found.parts.mission, ExplorationMission) and found.parts.chart is not None
    assert found.field_hash == work(EXPLORATION, slot=0).field_hash


def test_coverage_of_a_grid() -> None:
    found = work(COVERAGE)
    assert isinstance(found.parts.mission, GridWork)
    assert found.sections == 1 and found.field_hash == work(COVERAGE, slot=0).field_hash


@pytest.mark.parametrize(
    ("document", "fleet", "says"),
    [
        (NAVIGATION, {"robots": 3}, "navigation.goals: goals of 2 robots for 3"),
        (NAVIGATION, {"drive": "ackermann"}, "drives in any direction"),
        (NAVIGATION, {"radius_m": 3.0}, "navigation.map: no place for a body of 3.0 m radius"),
        (
            {"navigation": {"map": MAP, "goals": [[], [[0.5, 0.5]]]}},
            {},
            "navigation.goals: no robot can stand at 0.5, 0.5",
        ),
        (
            {"navigation": {"map": MAP, "goals": [[], [[0.5, -1e308]]]}},
            {},
            "navigation.goals: no robot can stand at 0.5, -1e+308",
        ),
        ({"navigation": {"map": "none.map", "goals": GOALS}}, {}, "navigation.map: "),
        (EXPLORATION, {"robots": 99}, "exploration.robots_max: Fleet is full"),
        (
            {
                "exploration": {
                    "width_m": 2.0,
                    "height_m": 2.0,
                    "order": [{"kind": "navigate_to", "points": [[5.0, 0.0]]}],
                }
            },
            {},
            "exploration.order.0.points: outside",
        ),
        (
            {"exploration": {"width_m": 8.0, "height_m": 96.0, "cell_m": 0.05}},
            {},
            "exploration.cell_m: 1920 cells from side to side, a map has at most 960",
        ),
        (
            {"exploration": {"width_m": 8.0, "height_m": 6.0, "cell_m": 0.5}},
            {},
            "exploration.range_m: 1.5 m is too short for cells of 0.5 m, which need 1.62 m",
        ),
        (COVERAGE, {"radius_m": 0.8}, "coverage.cell_m: 2 m is too small"),
        ({**COVERAGE, **NAVIGATION}, {}, "a robot has one work"),
    ],
)
def test_wrong_work_is_one_line(document: dict[str, Any], fleet: dict[str, Any], says: str) -> None:
    with pytest.raises(RobotError) as problem:
        work(document, **fleet)
    assert says in str(problem.value) and "\n" not in str(problem.value)


LIMIT_S, LOOK_S, AT_M = 60.0, 0.1, 0.3
STARTS_M = ((2.5, 4.0), (5.5, 1.5))
bodies: dict[int, PointBody] = {}


def body(slot: int) -> PointBody:
    """What the robot files below name as the factory of their bodies."""
    return bodies.setdefault(slot, PointBody(slot, *STARTS_M[slot]))


@pytest.mark.slow
def test_two_robot_files_with_goals_drive_there_on_a_bus(tmp_path: Path) -> None:
    """Judged by their bodies. They need to pass each other in two metres."""
    warm(False)
    end = asyncio.Event()

    def there() -> bool:
        places = [(bodies[slot].x_m, bodies[slot].y_m) for slot in sorted(bodies)]
        return len(places) == 2 and all(
            hypot(x_m - goals[-1][0], y_m - goals[-1][1]) <= AT_M
            for (x_m, y_m), goals in zip(places, GOALS, strict=True)
        )

    async def run() -> None:
        loop = asyncio.get_running_loop()

        def look() -> None:
            if there():
                end.set()
            else:
                loop.call_later(LOOK_S, look)

        look()
        files = [
            RobotFile.of(
                {
                    "name": "n",
                    "robot": {"slot": slot},
                    "fleet": SMALL,
                    "bus": {"interface": "virtual", "channel": "errands"},
                    "body": {"factory": f"{__name__}:body"},
                    **NAVIGATION,
                },
                "r.toml",
                tmp_path,
            )
            for slot in range(2)
        ]
        async with asyncio.timeout(LIMIT_S):
            await asyncio.gather(*(run_robot(file, end, first_boot=True) for file in files))

    asyncio.run(run())
    assert there()
