"""Whole explorations: real peers on the real wire in virtual time."""

from functools import cache

import pytest

from agent.claims.standing_owners import STANDS_US
from agent.exploration.exploration_task import ExplorationOrder, FleetFullError, TaskKind
from agent.interface.config import S
from sim.runs.exploration_fleet import Sharing
from sim.runs.exploration_run import ExplorationOutcome, ExplorationRun
from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.scenario import (
    BusOff,
    ClockJump,
    Crash,
    DeafWheels,
    Fault,
    Freeze,
    Heal,
    Join,
    Loss,
    Partition,
    Reset,
    Restart,
    ScenarioError,
)


def play(robots: int, seed: int, *faults: object, name: str = "arena") -> ExplorationOutcome:
    scenario = load_arena(name).changed(robots, seed).model_copy(update={"fault": list(faults)})
    return ExplorationRun(scenario).run()


@cache
def undisturbed(robots: int, seed: int) -> ExplorationOutcome:
    """Of such a run more than one test judges something."""
    return play(robots, seed)


@pytest.mark.parametrize(("robots", "seed"), [(1, 7), (2, 5), (3, 7)])
def test_the_arena_of_the_mission(robots: int, seed: int) -> None:
    outcome = undisturbed(robots, seed)
    assert outcome.success and outcome.explored >= 0.99 and outcome.right >= 0.99, outcome
    assert outcome.map_load < 0.15 and outcome.malformed == 0


def test_more_eyes_are_faster() -> None:
    one, three = undisturbed(1, 7), undisturbed(3, 7)
    assert three.time_95_s < 0.6 * one.time_95_s, (one.time_95_s, three.time_95_s)


def test_i24_robots_that_wait_for_their_start_tell_what_they_see() -> None:
    """They looked only once they could drive. So each of four chose its first frontier without the maps
    of the others, and took a third longer than robots that share one map."""
    scenario = load_arena("arena").changed(4, 1)
    omniscient = ExplorationRun(scenario, Sharing.AT_ONCE, until=0.95).run()
    fleet = ExplorationRun(scenario, until=0.95).run()
    assert fleet.time_95_s <= omniscient.time_95_s / 0.9, (fleet.time_95_s, omniscient.time_95_s)


@pytest.mark.slow
def test_the_same_seed_is_the_same_run() -> None:
    one, again, other = undisturbed(2, 5), play(2, 5), undisturbed(2, 1)
    assert one.trace_hash == again.trace_hash != other.trace_hash


@pytest.mark.slow
def test_a_robot_that_dies_is_not_missed_for_long() -> None:
    outcome = play(3, 2, Crash(at_s=5.0, kind="crash", robot=1))
    assert outcome.finished and outcome.contacts == 0 and outcome.maps_equal, outcome
    assert outcome.explored >= 0.97, outcome  # its body stands on some of it


@pytest.mark.parametrize("at_s", [0.0, 4.0])
def test_i24_a_fleet_of_which_all_robots_die_has_an_outcome(at_s: float) -> None:
    """The run ended in an IndexError."""
    scenario = load_arena("arena").changed(2, 1)
    faults = [Crash(at_s=at_s, kind="crash", robot=robot) for robot in range(2)]
    short = scenario.run.model_copy(update={"time_limit_s": 10.0})
    outcome = ExplorationRun(scenario.model_copy(update={"fault": faults, "run": short})).run()
    assert not outcome.finished and not outcome.success, outcome
    assert (outcome.explored > 0.2) == (at_s > 0.0), outcome


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 6, 12])
def test_i24_a_robot_that_stands_does_not_keep_its_frontier(seed: int) -> None:
    """Its wheels get no command. Its frontier stayed its own, and the others waited for it for good.

    With these seeds it stands on the last frontier. The others may meet in its nook, so they get as much
    time again.
    """
    outcome = play(3, seed, DeafWheels(at_s=9.0, kind="deaf_wheels", robot=1, for_s=1_000.0))
    assert outcome.finished and outcome.explored > 0.99, outcome
    assert outcome.time_s < 9.0 + 2.0 * STANDS_US / S


def test_i24_a_clock_that_is_set_back_below_zero_ends_no_run() -> None:
    """The run ended in an OverflowError when the robot sent a frame."""
    outcome = play(3, 7, ClockJump(at_s=1.4, kind="clock_jump", robot=0, by_s=-3.0))
    assert outcome.finished and outcome.contacts == 0, outcome


@pytest.mark.parametrize("disk", ["kept", "lost"])
def test_a_robot_that_comes_back_knows_the_map(disk: str) -> None:
    """A robot without its memory stands until a person has looked (agent/peer/durable_records.py)."""
    faults = (
        Restart(at_s=6.0, kind="restart", robot=2, disk=disk),  # type: ignore[arg-type]
        Join(at_s=8.0, kind="join", robot=1),
        Reset(at_s=10.0, kind="reset"),
    )
    outcome = play(3, 3, *faults)
    assert outcome.finished and outcome.maps_equal and outcome.contacts == 0, outcome


def test_i24_what_a_dead_robot_saw_is_on_the_map_of_one_that_is_switched_on_again() -> None:
    """It kept what it had seen itself only, and explored the rest of the arena once more."""
    scenario = load_arena("arena").changed(2, 1)
    seen = []
    for faults, end_s in (
        ([], 11.0),
        (
            [
                Crash(at_s=11.0, kind="crash", robot=1),
                Restart(at_s=14.0, kind="restart", robot=0, disk="kept"),
            ],
            15.0,
        ),
    ):
        run = scenario.run.model_copy(update={"time_limit_s": end_s})
        told = scenario.model_copy(update={"fault": faults, "run": run})
        seen.append(ExplorationRun(told).run().explored)
    assert seen[1] >= seen[0] > 0.7, seen


@pytest.mark.parametrize("fault", [
    BusOff(at_s=14.0, kind="bus_off", robot=1, for_s=40.0),
    Freeze(at_s=31.0, kind="freeze", robot=1, for_s=20.0),
])  # fmt: skip
def test_i24_a_run_does_not_end_before_a_robot_is_in_the_fleet_again(fault: Fault) -> None:
    """The others were done, so the run ended. It told that the maps differ."""
    outcome = play(2, 2, fault)
    assert outcome.success and outcome.time_s > 50.0, outcome


@pytest.mark.slow
def test_both_sides_of_a_split_explore_and_their_maps_merge() -> None:
    faults = (
        Partition(at_s=3.0, kind="partition", islands=[[0], [1, 2]]),
        Heal(at_s=14.0, kind="heal"),
    )
    outcome = play(3, 4, *faults)
    assert outcome.success and outcome.explored >= 0.99, outcome


def test_a_split_that_heals_after_both_sides_are_done_ends_well() -> None:
    """The maps joined while the run settled. A robot began a frontier then, and the run counted as not
    finished."""
    scenario = load_arena("arena").changed(3, 74)
    place = {
        "width_m": 3.0, "height_m": 5.0, "solid": [], "range_m": 4.0, "merge_strategy": "latest_update",
        "starts": [(-0.83, 1.64), (-0.74, -1.75), (0.78, 0.11)],
    }  # fmt: skip
    faults = [
        Partition(at_s=2.0, kind="partition", islands=[[0], [1, 2]]),
        Heal(at_s=21.741512924926518, kind="heal"),
    ]
    arena = scenario.arena.model_copy(update=place)
    outcome = ExplorationRun(
        scenario.model_copy(update={"arena": arena, "fault": faults, "order": []})
    ).run()
    assert outcome.success, outcome


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_fifth_of_all_frames_lost_and_one_robot_killed(seed: int) -> None:
    faults = (Loss(at_s=0.5, kind="loss", rate=0.2), Crash(at_s=6.0, kind="crash", robot=0))
    outcome = play(3, seed, *faults)
    assert outcome.finished and outcome.maps_equal and outcome.contacts == 0, outcome
    assert outcome.explored >= 0.97, outcome


def test_orders_are_carried_out_by_somebody() -> None:
    orders = [
        ExplorationOrder(TaskKind.NAVIGATE_TO, ((2.0, -2.0),)),
        ExplorationOrder(TaskKind.PATROL, ((-2.0, -2.0), (-2.0, 2.0), (2.0, 2.0))),
    ]
    survey = ExplorationRun(load_arena("arena").changed(2, 1), orders=orders)
    outcome = survey.run()
    assert outcome.success, outcome
    ends = [(x, y) for track in survey.tracks.values() for _, x, y, _ in track]
    for order in orders:
        for x, y in order.points:
            assert min((a - x) ** 2 + (b - y) ** 2 for a, b in ends) < 0.2**2


def test_a_run_does_not_end_well_before_an_order_is_done() -> None:
    scenario = load_arena("arena").changed(2, 1)
    west, south, east, north = scenario.arena.solid[0]
    inside = ExplorationOrder(TaskKind.NAVIGATE_TO, (((west + east) / 2, (south + north) / 2),))
    run = scenario.run.model_copy(update={"time_limit_s": 60.0})
    outcome = ExplorationRun(scenario.model_copy(update={"run": run}), orders=[inside]).run()
    assert outcome.explored >= 0.98 and not outcome.finished and not outcome.success, outcome


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dropout", "split"])
def test_what_ships_with_troubles_ends_well(name: str) -> None:
    survey = ExplorationRun(load_arena(name))
    outcome = survey.run()
    assert outcome.success, outcome
    ends = [(x, y) for track in survey.tracks.values() for _, x, y, _ in track]
    for order in survey.orders:
        for x, y in order.points:
            assert min((a - x) ** 2 + (b - y) ** 2 for a, b in ends) < 0.2**2


def test_orders_out_of_the_arena_are_refused() -> None:
    scenario = load_arena("split")
    away = scenario.order[0].model_copy(update={"points": [(4.6, 0.0)]})
    with pytest.raises(ScenarioError, match=r"order\.0\.points: outside of the arena"):
        ExplorationRun(scenario.model_copy(update={"order": [away]}))


def test_an_order_where_no_body_has_room_beside_the_wall_is_refused() -> None:
    """The run lasted until its limit: a robot cannot come to such a point."""
    scenario = load_arena("split")
    east_m = scenario.arena.width_m / 2 - scenario.fleet.radius_m + 0.01
    near = scenario.order[0].model_copy(update={"points": [(east_m, 0.0)]})
    with pytest.raises(ScenarioError, match=r"order\.0\.points: no robot can stand at"):
        ExplorationRun(scenario.model_copy(update={"order": [near]}))


def test_an_arena_of_more_cells_than_a_map_has_is_refused() -> None:
    scenario = load_arena("arena")
    fine = scenario.arena.model_copy(update={"width_m": 96.0, "cell_m": 0.05})
    with pytest.raises(ScenarioError, match=r"arena\.cell_m: 1920 cells from side to side"):
        ExplorationRun(scenario.model_copy(update={"arena": fine}))


def test_sensors_that_see_nothing_beyond_a_frontier_are_refused() -> None:
    """The fleet found nothing to explore and ended with a quarter of the place seen."""
    scenario = load_arena("arena")
    coarse = scenario.arena.model_copy(update={"cell_m": 0.5})
    with pytest.raises(
        ScenarioError, match=r"arena\.range_m: 1\.5 m is too short for cells of 0\.5 m"
    ):
        ExplorationRun(scenario.model_copy(update={"arena": coarse}))


def test_stations_are_so_near_that_short_sensors_see_beyond_the_frontier() -> None:
    scenario = load_arena("arena").changed(2, 1)
    short = {"cell_m": 0.2, "range_m": 0.8, "solid": []}
    arena = scenario.arena.model_copy(update=short)
    assert ExplorationRun(scenario.model_copy(update={"arena": arena})).run().explored > 0.9


@pytest.mark.parametrize("start", [(-2.34, -1.5), (-2.34, -2.34)])
def test_what_can_be_seen_is_the_same_from_a_start_beside_a_wall(
    start: tuple[float, float],
) -> None:
    scenario = load_arena("arena").changed(1, 1)
    here = scenario.arena.model_copy(update={"starts": [start]})
    near, away = (
        ExplorationSetup(scenario.model_copy(update={"arena": here})),
        ExplorationSetup(scenario),
    )
    assert (near.reachable == away.reachable).all()


@pytest.mark.parametrize(("wide_m", "open_to_robots"), [(0.5, False), (0.8, True)])
def test_a_passage_in_which_no_robot_drives_is_not_missed(
    wide_m: float, open_to_robots: bool
) -> None:
    """A body fits in 0.5 m. Robots keep a margin, so no one drove there and the run counted as failed."""
    scenario = load_arena("arena").changed(2, 3)
    place = {
        "width_m": 8.0, "height_m": 1.0, "starts": [(-3.6, 0.0), (3.6, 0.0)],
        "solid": [(-3.0, -0.5, 3.0, -wide_m / 2), (-3.0, wide_m / 2, 3.0, 0.5)],
    }  # fmt: skip
    arena = scenario.arena.model_copy(update=place)
    scenario = scenario.model_copy(update={"arena": arena})
    setting = ExplorationSetup(scenario)
    assert setting.reachable[setting.geometry.cell((0.0, 0.0))] == open_to_robots
    assert all(setting.reachable[setting.geometry.cell(start)] for start in setting.starts)
    assert ExplorationRun(scenario).run().success


def test_i24_robots_in_a_closed_room_without_their_margin_are_judged_by_that_room() -> None:
    """They were judged by what can be seen from the other room. So nothing was left to see, and the run
    ended in a ZeroDivisionError."""
    scenario = load_arena("arena").changed(1, 1)
    place = {
        "width_m": 4.0, "height_m": 3.0, "starts": [(-1.0, 1.3)], "solid": [(-2.0, 0.9, 2.0, 1.1)],
    }  # fmt: skip
    arena = scenario.arena.model_copy(update=place)
    scenario = scenario.model_copy(update={"arena": arena, "order": []})
    setting = ExplorationSetup(scenario)
    assert setting.reachable[setting.geometry.cell((-1.0, 1.3))]
    assert not setting.reachable[setting.geometry.cell((0.0, 0.0))]
    assert ExplorationRun(scenario).run().explored == 1.0


def test_i24_cells_too_coarse_for_the_room_of_a_start_are_refused() -> None:
    scenario = load_arena("arena").changed(1, 1)
    place = {
        "width_m": 7.0, "height_m": 3.0, "cell_m": 1.0, "range_m": 4.0, "starts": [(-3.3, 0.0)],
        "solid": [(-3.1, -1.5, 1.0, 1.5)],
    }  # fmt: skip
    arena = scenario.arena.model_copy(update=place)
    with pytest.raises(ScenarioError, match="none at the start of a robot is free"):
        ExplorationSetup(scenario.model_copy(update={"arena": arena, "order": []}))


@pytest.mark.parametrize("side_m", [1.4, 4.04, 4.06])
def test_cells_that_do_not_divide_an_arena_cover_all_of_it(side_m: float) -> None:
    scenario = load_arena("arena").changed(1, 1)
    corner = side_m / 2 - 0.16
    sides = {
        "width_m": side_m,
        "height_m": side_m,
        "cell_m": 1.0 if side_m < 2.0 else 0.1,
        "range_m": 4.0,
    }
    arena = scenario.arena.model_copy(update={**sides, "solid": [], "starts": [(corner, corner)]})
    assert arena.geometry.holds((side_m / 2 - 1e-6, side_m / 2 - 1e-6))
    outcome = ExplorationRun(scenario.model_copy(update={"arena": arena})).run()
    assert outcome.success, outcome


@pytest.mark.slow
def test_without_sharing_everybody_sees_everything() -> None:
    scenario = load_arena("arena").changed(2, 1)
    alone, shared = ExplorationRun(scenario, Sharing.NONE).run(), undisturbed(2, 1)
    assert alone.overlap_end > 0.9 > shared.overlap_end


def test_a_fleet_has_a_limit() -> None:
    scenario = load_arena("arena").changed(3, 1)
    small = scenario.arena.model_copy(update={"robots_max": 2})
    with pytest.raises(FleetFullError, match=r"Fleet is full \(max 2 robots\)"):
        ExplorationRun(scenario.model_copy(update={"arena": small})).run()
    with pytest.raises(ScenarioError, match=r"arena\.starts"):
        ExplorationRun(load_arena("arena").changed(9, 1))


def test_i24_a_room_in_which_only_another_robot_starts_counts_as_well() -> None:
    place = {"starts": [(-2.0, 0.0), (1.0, 0.0)], "solid": [(-1.1, -2.5, -0.9, 2.5)]}
    both, alone = (
        ExplorationSetup(
            scenario.model_copy(update={"arena": scenario.arena.model_copy(update=place)})
        )
        for scenario in (load_arena("arena").changed(robots, 1) for robots in (2, 1))
    )
    assert all(both.reachable[both.geometry.cell(start)] for start in both.starts)
    assert not alone.reachable[alone.geometry.cell((1.0, 0.0))], "no robot comes there"
