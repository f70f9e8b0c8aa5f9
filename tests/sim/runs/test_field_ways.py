"""Ways through fields keep what avoidance demands, and fleets in fields with inner corners finish."""

import itertools
import random
from math import cos, pi, sin
from pathlib import Path

import pytest
from shapely.geometry import LineString, Point, box

from agent.motion.holonomic_motion import FENCE_M
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tests.sim.drawn_fields import SHAPES, rectangle, scenario

WEDGE = [(24.0, 31.0), (66.4, 33.9), (45.0, 38.0)]
NARROW = {
    "a strip 5 cm wider than the implement": rectangle(60.0, 4.05),
    "a tip of 3 degrees": [(0.0, 0.0), (120.0, -3.14), (120.0, 3.14)],
    "a tip of 19 degrees": [(0.0, 0.0), (60.0, -10.0), (60.0, 10.0)],
    "a blunt tip": [(0.0, -2.02), (80.0, -6.0), (80.0, 6.0), (0.0, 2.02)],
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_a11_a_way_keeps_the_clearance_that_avoidance_demands(
    shape: object, seed: int, tmp_path: Path
) -> None:
    draw = random.Random(seed)
    setting = FieldSetup(scenario(tmp_path, shape(draw), 1, seed))  # type: ignore[operator]
    kept_m = setting.scenario.fleet.radius_m + FENCE_M
    fences = setting.field.polygon.boundary
    ends = [end for section in setting.field.sections for end in section.ends]
    for start, goal in itertools.combinations(draw.sample(ends, min(len(ends), 12)), 2):
        way = setting.plan.route.path(start, goal)
        assert LineString(way).distance(fences) >= kept_m - 1e-6, (seed, start, goal, way)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_a11_a_fleet_finishes_a_field_with_inner_corners(
    shape: object, seed: int, tmp_path: Path
) -> None:
    draw = random.Random(seed)
    outcome = FieldRun(FieldSetup(scenario(tmp_path, shape(draw), 3, seed))).run()  # type: ignore[operator]
    assert outcome.success, outcome


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a11_a_fleet_finishes_round_the_corner_of_a_hole(seed: int, tmp_path: Path) -> None:
    made = scenario(tmp_path, rectangle(90.0, 60.0), 3, seed, hole=WEDGE)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome


def test_a_way_round_a_body_keeps_its_reach_at_any_grid(tmp_path: Path) -> None:
    route = FieldSetup(scenario(tmp_path, rectangle(60.0, 60.0), 1, 1)).plan.route
    body, reach_m = (0.13, 0.21), 2.0
    for end in ((-20.0, 1.0), (-20.0, -20.0), (3.0, -20.0)):
        way = LineString(route.round([body], reach_m).path(end, (-end[0], -end[1])))
        assert way.distance(Point(body)) >= reach_m - 1e-6


@pytest.mark.parametrize("seed", (1, 2))
@pytest.mark.parametrize("side_m", (6.0, 8.0))
@pytest.mark.parametrize("robots", (1, 2))
def test_m3_a_field_of_a_few_metres_is_finished(
    side_m: float, robots: int, seed: int, tmp_path: Path
) -> None:
    made = scenario(tmp_path, rectangle(side_m, side_m), robots, seed, time_limit_s=400.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome


@pytest.mark.sampled(3)
@pytest.mark.parametrize("robots", (1, 2))
@pytest.mark.parametrize("name", NARROW)
def test_robots_cover_tips_and_parts_hardly_wider_than_the_implement(
    name: str, robots: int, tmp_path: Path
) -> None:
    # Robots that reverse where the ring turns back leave 5 % of the strip.
    outcome = FieldRun(FieldSetup(scenario(tmp_path, NARROW[name], robots, 1))).run()
    assert outcome.success and outcome.reached == 1.0, outcome


@pytest.mark.sampled(1)
@pytest.mark.parametrize("robots", (2, 4, 6))
def test_m26_six_robots_in_a_small_field_get_on(robots: int, tmp_path: Path) -> None:
    # Implements that keep off each other make six slower than two: 90 to 210 s where two need 54.
    made = scenario(tmp_path, rectangle(20.0, 20.0), robots, 1, time_limit_s=300.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome


@pytest.mark.slow
@pytest.mark.parametrize("seed", (1, 2))
def test_m26_three_tractors_finish_a_strip_in_which_they_cannot_pass(
    seed: int, tmp_path: Path
) -> None:
    made = scenario(tmp_path, rectangle(100.0, 9.0), 3, seed, drive="ackermann", time_limit_s=700.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.finished and outcome.replicas_equal, outcome
    assert outcome.reached > 0.9998, outcome  # two cells at most, in corners


@pytest.mark.slow
def test_m26_a_tractor_is_not_made_to_plan_again_in_its_turns(tmp_path: Path) -> None:
    made = scenario(tmp_path, rectangle(100.0, 9.0), 1, 1, drive="ackermann", time_limit_s=700.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success and outcome.makespan_s < 250.0, outcome


@pytest.mark.slow
def test_i26_a_tractor_that_backs_out_of_a_crowd_meets_no_fence() -> None:
    """It backed out with its wheels still turned the other way, 0.3 m beside its arc."""
    made = load("small").changed(robots=6, seed=3, drive="ackermann", time_limit_s=12.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.contacts == 0, outcome.first_contact


def test_m4_a_field_hardly_wider_than_the_implement_is_finished(tmp_path: Path) -> None:
    made = scenario(tmp_path, rectangle(60.0, 60.0), 3, 1, implement_width_m=59.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome


@pytest.mark.slow
@pytest.mark.parametrize(("robots", "seed"), [(12, 3), (24, 1)])
def test_robots_brake_before_a_round_fence_of_short_edges(
    robots: int, seed: int, tmp_path: Path
) -> None:
    """Braking before each edge undid that before the others, and robots touched the fence."""
    count, radius_m = 720, 20.0
    outline = [
        (radius_m * cos(2 * pi * k / count), radius_m * sin(2 * pi * k / count))
        for k in range(count)
    ]
    outcome = FieldRun(FieldSetup(scenario(tmp_path, outline, robots, seed))).run()
    assert outcome.success and outcome.contacts == 0, outcome


@pytest.mark.slow
def test_a_ring_whose_tip_has_short_sides_is_finished(tmp_path: Path) -> None:
    """Each pass over that tip counted as a bar that had swung wrongly, and the run never ended."""
    outline = Path(__file__).with_name("short_sides.geojson")
    file = tmp_path / "field.toml"
    file.write_text(
        f'name = "short sides"\n[field]\nfile = "{outline}"\nsection_length_m = 60.0\n'
        '[fleet]\nrobots = 1\nsilence = "continue"\n[run]\nseed = 1\n'
    )
    outcome = FieldRun(FieldSetup(load(str(file)))).run()
    assert outcome.success, outcome


@pytest.mark.parametrize(("width_m", "more_m", "chords"), [(4.0, 0.12, 16), (3.0, 0.18, 3)])
def test_a_lane_with_a_round_end_hardly_wider_than_the_implement_is_finished(
    width_m: float, more_m: float, chords: int, tmp_path: Path
) -> None:
    """It was all worked, and the last unit never counted: the ring turned back in a bend of centimetres.

    `more_m`: how much wider the lane is. `chords`: in a quarter of its end.
    """
    lane = LineString([(0, 0), (25, 0)]).buffer((width_m + more_m) / 2, quad_segs=chords)
    ring = list(lane.union(box(20, -8, 40, 8)).exterior.coords)[:-1]
    made = scenario(tmp_path, ring, 1, 1, implement_width_m=width_m, time_limit_s=250.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome
