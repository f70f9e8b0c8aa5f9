"""What a body and its implement can work of a field, and runs that are judged by it."""

from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon, box

from sim.fleet.outcome import COVERAGE_MIN
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.world.coverage_truth import coverage, sample_points
from sim.world.reachable_ground import WorkingBody, reachable_ground
from tests.sim.drawn_fields import Ring, rectangle, scenario
from tools.run.run_field import told_reach

LETTER_U: Ring = [(0, 0), (42, 0), (42, 34), (28, 34), (28, 14), (14, 14), (14, 34), (0, 34)]
ISLAND: Ring = [(18, 15), (26, 15), (26, 23), (18, 23)]
FIELDS: dict[str, tuple[Ring, Ring]] = {
    "square": (rectangle(36.0, 36.0), ()),
    "letter U": (LETTER_U, ()),
    "island": (rectangle(44.0, 38.0), ISLAND),
}
TRACTOR = WorkingBody(width_m=4.0, overlap_m=0.2, radius_m=0.8, turn_radius_m=1.72)
PIVOT = TRACTOR._replace(turn_radius_m=0.6)
SIDEWAYS = TRACTOR._replace(turn_radius_m=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", (1, 2))
@pytest.mark.parametrize("drive", ("ackermann", "differential"))
@pytest.mark.parametrize("name", FIELDS)
def test_m5_bodies_that_steer_finish_without_a_flaw(
    name: str, drive: str, seed: int, tmp_path: Path
) -> None:
    ring, hole = FIELDS[name]
    made = scenario(tmp_path, ring, 2, seed, hole=hole, drive=drive)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome
    assert outcome.reached >= COVERAGE_MIN and outcome.reachable >= 0.999, outcome


def _passes(polygon: Polygon, without: tuple[float, float] | None = None) -> np.ndarray:
    """A track of passes along x over all of the box; none with its bar over `without` (y, y)."""
    west, south, east, north = polygon.bounds
    rows: list[tuple[float, float, float, float]] = []
    for y in np.arange(south + 2.0, north - 1.99, 0.25):
        if without is not None and y + 2.0 > without[0] and y - 2.0 < without[1]:
            continue
        rows += [
            (len(rows) * 1e6, west, float(y), 1.0),
            ((len(rows) + 1) * 1e6, east, float(y), 0.0),
        ]
    return np.array(rows)


@pytest.mark.parametrize("body", (TRACTOR, PIVOT, SIDEWAYS), ids=("tractor", "pivot", "sideways"))
@pytest.mark.parametrize("strip", ((20.0, 20.5), (0.0, 0.4), (39.5, 40.0)))
def test_m5_a_strip_that_can_be_reached_and_is_left_is_a_flaw(
    body: WorkingBody, strip: tuple[float, float]
) -> None:
    field = box(0, 0, 60, 40)
    raster = sample_points(field, body.width_m, body.overlap_m)
    ground = reachable_ground(field, raster, body, [(5.0, 5.0)])
    assert ground.share > 0.999
    whole = coverage(raster, {0: _passes(field)}, body.width_m, ground.cells)
    assert whole.reached >= COVERAGE_MIN and len(whole.missed) == 0
    left = coverage(raster, {0: _passes(field, strip)}, body.width_m, ground.cells)
    assert left.reached < COVERAGE_MIN and len(left.missed) > 100


def test_m5_a_turning_circle_leaves_an_acute_corner_and_says_so() -> None:
    wedge = Polygon([(0, 0), (90, 0), (90, 24)])
    raster = sample_points(wedge, TRACTOR.width_m, TRACTOR.overlap_m)
    ground = reachable_ground(wedge, raster, TRACTOR, [(60.0, 5.0)])
    assert 0.98 < ground.share < 1.0
    assert any("turning circle" in part.why and part.area_m2 > 0.0 for part in ground.unreached)
    missing = raster.centres(raster.cells & ~ground.cells)
    corners = np.array([(0.0, 0.0), (90.0, 0.0), (90.0, 24.0)])
    gaps_m = np.hypot(*(missing[:, None, :] - corners).transpose(2, 0, 1)).min(axis=1)
    assert gaps_m.max() < 20.0, "only near corners"
    assert reachable_ground(wedge, raster, SIDEWAYS, [(60.0, 5.0)]).share == 1.0


def test_a_bar_that_would_cross_the_fences_with_its_ends_does_not_reach_into_a_corner() -> None:
    """Where the fences are 4 m apart, a bar of 4 m ends; the area asked for goes on for 1.4 m."""
    body = TRACTOR._replace(overlap_m=1.0)
    wedge = Polygon([(0, 0), (60, -6), (60, 6)])
    raster = sample_points(wedge, body.width_m, body.overlap_m)
    ground = reachable_ground(wedge, raster, body, [(40.0, 0.0)])
    corners = [part.area_m2 for part in ground.unreached if "turning circle" in part.why]
    assert corners and corners[0] > 3.0, ground.unreached
    reached_m = raster.centres(ground.cells)[:, 0].min()
    assert 19.0 < reached_m < 20.5, "the fences are 4 m apart at 20 m"


def test_m4_ground_behind_a_passage_too_narrow_for_the_body_is_named() -> None:
    field = box(0, 0, 30, 30).union(box(30, 14.5, 34, 15.5)).union(box(34, 0, 64, 30))
    raster = sample_points(field, SIDEWAYS.width_m, SIDEWAYS.overlap_m)
    ground = reachable_ground(field, raster, SIDEWAYS, [(5.0, 5.0)])
    assert 0.45 < ground.share < 0.55
    assert any("too narrow" in part.why and part.area_m2 > 800.0 for part in ground.unreached)
    assert reachable_ground(field, raster, SIDEWAYS, [(5.0, 5.0), (50.0, 5.0)]).share == 1.0


@pytest.mark.parametrize("seed", (1, 2))
def test_m4_a_field_hardly_wider_than_the_implement_says_what_stays_and_why(
    seed: int, tmp_path: Path
) -> None:
    made = scenario(tmp_path, rectangle(60.0, 60.0), 3, seed, implement_width_m=59.0)
    outcome = FieldRun(FieldSetup(made)).run()
    assert outcome.success, outcome
    (corners,) = outcome.unreached
    assert corners.area_m2 > 500.0 and "bar would cross" in corners.why
    assert f"{corners.area_m2:.1f} m2 {corners.why}" in told_reach(outcome)
    assert outcome.to_dict()["unreached"] == [corners._asdict()]
