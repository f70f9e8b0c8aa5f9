"""The picture of a field's run: what happened is marked, ground that was left is seen."""

import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.run.picture import MARKS, PlaceMark, draw_field
from tools.run.run_field import MARKED, marks_of


def test_faults_are_marked_where_they_were() -> None:
    tracks = {1: [(0, 0.0, 0.0, True), (40_000_000, 5.0, 2.0, True), (90_000_000, 9.0, 2.0, False)]}
    faults = [
        {"t_s": 41.0, "kind": "crash", "robot": 1}, {"t_s": 3.0, "kind": "heal"},
        {"t_s": 5.0, "kind": "box", "x_m": -3.0, "y_m": 4.0},
        {"t_s": 5.0, "kind": "person", "route": [[1.0, 2.0], [3.0, 4.0]]},
        {"t_s": 5.0, "kind": "estop", "robot": 2},
    ]  # fmt: skip
    assert marks_of(faults, tracks) == [
        PlaceMark("crash", 5.0, 2.0), PlaceMark("box", -3.0, 4.0),
        PlaceMark("person, vehicle", 1.0, 2.0),
    ]  # fmt: skip
    assert set(MARKED.values()) == set(MARKS)


def test_the_picture_has_the_form_of_the_field_and_shows_what_was_left(tmp_path: Path) -> None:
    """It was square, two fifths of it white, and neither a crash nor unworked ground was in it."""
    field = FieldSetup(load("small")).field  # 70 by 45 metres
    rows = {0: [(-30.0, 0.0, True), (30.0, 0.0, True)]}
    draw_field(field, rows, "t", tmp_path / "plain.png")
    missed = np.array([(x, 10.0) for x in np.arange(-20.0, 20.0, 0.25)])
    marks = [PlaceMark(what, 0.0, 5.0) for what in MARKS]
    draw_field(field, rows, "t", tmp_path / "marked.png", missed, marks)
    plain, marked = (
        np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB"), dtype=np.int64)
        for name in ("plain", "marked")
    )
    assert plain.shape[1] > 1.3 * plain.shape[0]

    def red(picture: "np.ndarray[tuple[int, ...], np.dtype[np.int64]]") -> int:
        return int(np.count_nonzero((picture[..., 0] > 180) & (picture[..., 1] < 160)
                                    & (picture[..., 2] < 160)))  # fmt: skip

    assert red(marked) > red(plain) + 500


def test_a_legend_of_the_largest_fleet_fits(tmp_path: Path) -> None:
    """matplotlib said on stderr that its layout was not applied."""
    field = FieldSetup(load("small")).field
    rows = {slot: [(-30.0, 0.0, True), (30.0, 0.0, True)] for slot in range(108)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_field(field, rows, "t", tmp_path / "many.png")
