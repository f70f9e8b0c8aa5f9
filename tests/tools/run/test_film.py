"""A film of a run, read back by Pillow."""

import errno
from pathlib import Path

import pytest

pytest.importorskip("PIL", reason="Pillow is not installed")

from PIL import Image
from typer.testing import CliRunner

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.work_frames import TaskClaim, WorkProgress
from sim.files.palette import ROBOTS
from sim.record.recording import Recording
from tools.cli.headland import app
from tools.run.film import DENSE, HIGH, WIDE, FilmError, View, write_film

SCENE = {
    "name": "strip", "kind": "field", "radius_m": 0.8, "width_m": 4.0, "gate": [0.0, 0.0],
    "rings": [[[0, 0], [100, 0], [100, 40], [0, 40]]], "grid": None, "cells": None,
    "sections": [{"id": 0, "swaths": [[[10, 20], [90, 20]]], "units": [8]}],
}  # fmt: skip


def recording(scene: dict[str, object] | None) -> Recording:
    """Robot 3 drives from west to east, claims section 0 and works its first half, then is silent."""
    made = Recording(scene)
    made.write(0, encode(Member(3, 1, 0), 0x83))
    for step in range(40):
        now_us = step * 100_000
        made.write(now_us, encode(Heartbeat(3, 1, False, False, True, False, 1.0, 0, 0), 0x83))
        made.write(now_us + 1, encode(Pose(10.0 + step, 20.0, 0.0, 1.0, 1, False, 255), 0x83))
    made.write(4_000_000, encode(TaskClaim(0, 1, 2, 9, 1, 3), 0x83))
    made.write(4_100_000, encode(WorkProgress(0, 0, 0b1111), 0x83))
    made.write(9_000_000, encode(Heartbeat(1, 1, False, False, True, False, 1.0, 0, 0), 0x81))
    made.close()
    return made


def view_of(scene: dict[str, object]) -> View:
    from tools.run.film import _Film

    return _Film(recording(scene), 1.0).view


def pixel(picture: Image.Image, x: float, y: float) -> tuple[int, int, int]:
    found = picture.convert("RGB").getpixel((round(x / DENSE), round(y / DENSE)))
    assert isinstance(found, tuple)
    return found[0], found[1], found[2]


def near(found: tuple[int, int, int], colour: str) -> bool:
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return max(abs(a - b) for a, b in zip(found, wanted, strict=True)) < 24


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_full_disk_leaves_the_film_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    def save(picture: Image.Image, place: Path, **words: object) -> None:
        place.write_bytes(b"half of")
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / f"film{suffix}"
    out.write_bytes(b"an earlier film")
    monkeypatch.setattr(Image.Image, "save", save)
    with pytest.raises(OSError, match="No space") as told:
        write_film(recording(SCENE), out, 0.2)
    assert told.value.filename == str(out)
    assert list(tmp_path.iterdir()) == [out] and out.read_bytes() == b"an earlier film"


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_film_shows_the_robot_where_it_was_and_what_it_worked(
    tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"film{suffix}"
    drawn: list[int] = []
    assert write_film(recording(SCENE), out, 2.0, lambda done, count: drawn.append(done)) == 20
    assert drawn == list(range(1, 21))
    with Image.open(out) as film:
        assert film.size == (WIDE, HIGH) and film.n_frames == 20  # type: ignore[attr-defined]
        view = view_of(SCENE)
        film.seek(4)
        x, y = view.at(10.0 + 22, 20.0)
        assert near(pixel(film, x, y - 12), ROBOTS[3]), "after a quarter of nine seconds"
        film.seek(19)
        east, south = view.at(49.0, 20.0)
        assert near(pixel(film, east, south - 14), "#5b666c"), "silent: grey"
        worked, bare = view.at(25.0, 20.5), view.at(75.0, 21.5)
        assert pixel(film, *worked) != pixel(film, *bare)


def test_what_cannot_be_filmed_is_one_line(tmp_path: Path) -> None:
    nothing = [
        (recording(SCENE), "film.mp4"), (recording(None), "film.gif"),
        (Recording(SCENE), "film.gif"), (recording({"rings": []}), "film.gif"),
    ]  # fmt: skip
    for made, name in nothing:
        with pytest.raises(FilmError) as told:
            write_film(made, tmp_path / name, 1.0)
        assert "\n" not in str(told.value)


def test_the_film_of_the_readme_is_small_and_twenty_seconds() -> None:
    path = Path(__file__).parents[3] / "docs" / "use" / "film.gif"
    with Image.open(path) as film:
        frames = film.n_frames  # type: ignore[attr-defined]
        assert frames * film.info["duration"] == pytest.approx(20_000, abs=500)
    assert path.stat().st_size < 3_000_000


@pytest.mark.slow
@pytest.mark.parametrize("words", ["yard --robots 2", "visitor", "warehouse --limit 20"])
def test_any_run_is_filmed_by_the_same_word(words: str, tmp_path: Path) -> None:
    """`--film` was refused for all but explorations."""
    line = f"run {words} --film --json --out {tmp_path}"
    done = CliRunner().invoke(app, line.split(), prog_name="headland")
    assert done.exit_code in (0, 1), done.output
    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == (WIDE, HIGH)
