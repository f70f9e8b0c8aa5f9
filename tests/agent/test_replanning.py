"""Boxes that come and go in front of a robot: when it looks for another path, and when it does not."""

from functools import partial
from math import inf

from agent.floor import Floor
from sim.errand_setting import ErrandSetting
from sim.outing import Outing, OutingOutcome
from sim.world import World

OPEN = "\n".join(["." * 24] * 7)
HALL = Floor.drawn(OPEN, 1.0, 0.35)
START, GOAL = (1.5, 3.5), (22.5, 3.5)
ALONE = "." * 24


def outing(
    boxes: list[tuple[float, float, float, float]], floor: Floor = HALL
) -> tuple[Outing, OutingOutcome]:
    """One robot from west to east at 1 m/s; boxes of 0.8 m: from, until (seconds), x, y."""
    y_m = START[1] if floor is HALL else 0.5
    setting = ErrandSetting.made(
        "boxes", floor, [(START[0], y_m)], [[(GOAL[0], y_m)]], time_limit_s=120.0
    )

    def put(world: World, until_s: float, x_m: float, box_y_m: float) -> None:
        number = world.add_box(x_m, box_y_m, 0.8)
        if until_s < inf:
            world.at(round(until_s * 1e6), partial(world.remove_box, number))

    class Boxed(ErrandSetting):
        def world(self) -> World:
            world = super().world()
            for from_s, until_s, x_m, box_y_m in boxes:
                world.at(round(from_s * 1e6), partial(put, world, until_s, x_m, box_y_m))
            return world

    boxed = Boxed(setting.scenario, floor, setting.starts, list(setting.goals.values()))
    run = Outing(boxed)
    return run, run.run()


def why(run: Outing) -> list[str]:
    return [path.why for path in run.followed[0]]


def at_s(x_m: float) -> float:
    """About when the robot is there, if nothing holds it up."""
    run, _ = FREE
    track = run.tracks[0]
    return float(track[(track[:, 1] > x_m).argmax(), 0]) / 1e6


FREE = outing([])


def test_nothing_there_one_path() -> None:
    run, outcome = FREE
    assert outcome.finished and why(run) == ["goal"]


def test_a_box_far_away_that_leaves_costs_nothing() -> None:
    run, outcome = outing([(3.0, at_s(12.0), 18.0, 3.5)])
    assert outcome.finished and why(run) == ["goal"] and not outcome.contacts


def test_a_box_that_flickers_costs_nothing() -> None:
    """Two control periods at a time, right inside the horizon."""
    boxes = [(at_s(x) + 0.02, at_s(x) + 0.11, x + 2.0, 3.5) for x in (6.0, 9.0, 12.0, 15.0)]
    run, outcome = outing(boxes)
    assert outcome.finished and why(run) == ["goal"] and not outcome.contacts


def test_a_box_that_stays_costs_one_replanning() -> None:
    run, outcome = outing([(2.0, inf, 12.0, 3.5)])
    assert outcome.finished and not outcome.contacts
    assert why(run).count("blocked") == 1 and "lost" not in why(run)


def test_the_path_is_taken_up_again_when_the_box_has_gone() -> None:
    run, outcome = outing([(at_s(8.0), at_s(8.0) + 0.6, 10.2, 3.5)])
    assert outcome.finished and not outcome.contacts
    assert why(run) == ["goal", "blocked", "restored"]


def test_where_there_is_no_way_round_it_waits() -> None:
    run, outcome = outing([(3.0, 40.0, 12.0, 0.5)], Floor.drawn(ALONE, 1.0, 0.35))
    assert outcome.finished and not outcome.contacts
    assert outcome.simulated_s > 40.0 and why(run) == ["goal"]
