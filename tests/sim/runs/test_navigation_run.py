"""Whole fleets on errands: through each other in corridors, on the real wire, in virtual time."""

from math import isfinite
from pathlib import Path
from random import Random
from typing import cast

import numpy as np
import pytest

from agent.interface.effects import HALT
from agent.interface.mission import STILL
from agent.interface.observation import Observation
from agent.mapping.building import Floor, FloorError
from sim.runs.delivery_run import DeliveryRun
from sim.runs.navigation_run import NavigationRun, to_polyline_m
from sim.scenarios.building_generator import CORRIDOR, office, rooms
from sim.scenarios.delivery_scenario import DeliveryScenario
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.navigation_setup import NavigationSetup, scattered
from tools.bench.corridor import trial


@pytest.mark.sampled(2)
@pytest.mark.parametrize("layout", ["swap 3:3", "T-junction", "dead end"])
def test_everybody_gets_through_whatever_is_lost(layout: str) -> None:
    seed = 11
    loss = 0.3
    result = trial(layout, loss, True, seed)
    print("seed", seed, result)
    assert result.finished and result.contacts == 0


@pytest.mark.slow
def test_who_drives_behind_a_robot_that_halts_for_a_round_does_not_touch_it() -> None:
    """Here a follower that expected it to go on was once seen to touch it by 2 mm."""
    result = trial("swap 3:3", 0.3, True, 1)
    assert result.finished and result.contacts == 0


def test_orca_by_itself_does_not() -> None:
    """What the rounds of agreement are for; it touches nobody either."""
    result = trial("swap 1:1", 0.0, False, 3)
    assert not result.finished and result.contacts == 0


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "fault",
    [
        'kind = "blind"\nat_s = 3.0',
        'kind = "blind"\nat_s = 0.0',
        'kind = "frozen"\nat_s = 3.0',
        'kind = "jumped"\nat_s = 3.0\ndx_m = 3.0\ndy_m = 0.0',
    ],
    ids=["blind", "blind from the start", "frozen", "jumped"],
)
def test_a_round_does_not_wait_for_a_robot_that_does_not_know_its_place(
    fault: str, tmp_path: Path
) -> None:
    """A robot with old senses does not stand by what they say, and one that never sensed tells no place.
    Each round waited for that, so the whole fleet stood for good."""
    file = tmp_path / "lost.toml"
    file.write_text(
        f'''
        name = "lost"
        mission = "errands"
        [floor]
        map = """{CORRIDOR}"""
        [errands]
        starts = [[0.5, 0.5], [1.5, 2.5], [13.5, 2.5]]
        goals = [[[3.5, 3.5]], [[12.5, 0.5]], [[2.5, 0.5]]]
        [fleet]
        robots = 3
        radius_m = 0.35
        speed_m_s = 1.0
        silence = "continue"
        [run]
        time_limit_s = 50
        [[fault]]
        robot = 0
        for_s = 500
        {fault}
        '''
    )
    scenario = load_mission(str(file))
    assert isinstance(scenario, NavigationScenario)
    outcome = NavigationRun(setting_of(scenario)).run()
    assert [isfinite(arrived_s) for arrived_s in outcome.arrived_s] == [False, True, True]
    assert outcome.rounds and not outcome.contacts


def hall(seed: int, robots: int) -> NavigationSetup:
    floor = Floor.drawn(rooms(seed, 16), 1.0, 0.35)
    rng = Random(seed)
    starts, goals = (scattered(floor, robots, rng, 1.0) for _ in range(2))
    return NavigationSetup.made("hall", floor, starts, [[goal] for goal in goals], seed=seed)


@pytest.mark.slow
def test_a_hall_of_rooms_and_the_same_again() -> None:
    outcomes = [NavigationRun(hall(2, 6)).run() for _ in range(2)]
    assert outcomes[0].trace_hash == outcomes[1].trace_hash
    assert outcomes[0].finished and not outcomes[0].contacts
    assert all(map(isfinite, outcomes[0].arrived_s))


def test_a_parked_robot_clears_a_corridor_and_returns() -> None:
    """Robot 1 has nowhere to go and stands in the only way."""
    floor = Floor.drawn(CORRIDOR, 1.0, 0.35)
    setting = NavigationSetup.made("parked", floor, [(1.5, 2.5), (7.5, 2.5)], [[(13.5, 2.5)], []])
    outing = NavigationRun(setting)
    outcome = outing.run()
    track = outing.tracks[1]
    assert outcome.finished and not outcome.contacts
    away = [abs(x - 7.5) + abs(y - 2.5) for _, x, y, _ in track.tolist()]
    assert max(away) > 2.0, "it cleared the way"
    assert outcome.rounds >= 1


def test_goals_one_after_the_other() -> None:
    floor = Floor.drawn(office(), 0.2, 0.35)
    goals = [[(7.0, 2.0), (11.0, 9.0), (1.0, 1.0)]]
    outing = NavigationRun(NavigationSetup.made("tour", floor, [(1.0, 1.0)], goals))
    outcome = outing.run()
    assert outcome.finished and not outcome.contacts
    set_out_s = [way.t_us / 1e6 for way in outing.followed[0]]
    assert [way.why for way in outing.followed[0]] == ["goal"] * 3
    for leg, next_s in zip(outcome.legs, set_out_s[1:], strict=False):
        assert next_s - leg.arrived_s <= 0.1, "the next goal was claimed, and the way to it known"
    arrived = [leg.arrived_s for leg in outcome.legs]
    assert arrived == sorted(arrived)
    assert all(leg.rmse_m < 0.06 and not leg.replans for leg in outcome.legs)


def test_a_robot_that_holds_stands() -> None:
    motion = hall(2, 2).parts(0).motion
    assert motion is not None
    drive = motion.drive(Observation(1.5, 1.5, 0.0, 0.3, 0.0), STILL._replace(hold=True), {}, 0)
    assert drive == HALT


def test_maps_that_are_none() -> None:
    for text in ("", "..\n...", "type octile\nheight 1\nwidth 1\nmap\n"):
        with pytest.raises(FloorError):
            Floor.drawn(text, 1.0, 0.35)


def test_distance_to_a_polyline() -> None:
    path = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0))
    assert to_polyline_m((1.0, 0.5), path) == 0.5
    assert to_polyline_m((3.0, 1.0), path) == 1.0
    assert to_polyline_m((-3.0, 4.0), path) == 5.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 5, 9])
def test_m19_robots_stand_before_a_person_indoors_and_ask(seed: int) -> None:
    """One goes on when the way is free, the other by an operator's word; none drives round by itself."""
    given = cast(NavigationScenario, load_mission("visitor"))
    run = NavigationRun(setting_of(given.changed(seed=seed)))
    outcome = run.run()
    assert outcome.finished and not outcome.contacts
    for slot, until_s in ((0, 23.0), (1, 40.0)):
        t_s, x_m, y_m = run.tracks[slot][:, 0] / 1e6, run.tracks[slot][:, 1], run.tracks[slot][:, 2]
        waits = (t_s > 15.0) & (t_s < until_s)
        assert np.ptp(x_m[waits]) < 0.05 and np.ptp(y_m[waits]) < 0.05, slot
        assert 0.6 <= 8.75 - 0.35 - x_m[waits].max() < 1.5, "the stopping margin is left"


def test_m19_deliveries_stand_before_a_person_and_ask(tmp_path: Path) -> None:
    rows = "pickup_x_m,pickup_y_m,dropoff_x_m,dropoff_y_m\n1.5,1.5,10.5,1.5\n"
    (tmp_path / "tasks.csv").write_text(rows)
    given = DeliveryScenario.model_validate({
        "name": "test", "mission": "delivery",
        "fault": [{"kind": "box", "at_s": 2.0, "x_m": 6.0, "y_m": 1.5, "size_m": 0.5, "for_s": 30.0}],
        "warehouse": {"map": "\n".join(["." * 12] * 3), "handle_s": 1.0, "tasks": "tasks.csv"},
        "folder": tmp_path,
        "fleet": {"robots": 1, "radius_m": 0.3, "speed_m_s": 1.0, "acceleration_m_s2": 2.0,
                  "asks": True},
        "run": {"seed": 1, "time_limit_s": 200.0},
    })  # fmt: skip
    outcome = DeliveryRun(DeliverySetup(given)).run()
    assert outcome.finished and outcome.delivered == 1 and outcome.contacts == 0
    assert outcome.simulated_s > 32.0, "it waited until the way was free"
