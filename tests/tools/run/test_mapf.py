"""`headland mapf`: what it prints, the file it writes, and one line for what is wrong."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sim.files.grid_map import GridFileError, map_text, random_walls
from sim.files.mapf_scenario import MapfInstance
from sim.world.path_judge import judge_paths
from tools.cli.headland import app
from tools.run import mapf


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.map"
    path.write_text(map_text(random_walls(9, 9, 0.1, 3)))
    return path


@pytest.mark.slow
def test_a_line_for_each_number_of_robots_and_a_file_of_paths(map_file: Path) -> None:
    out = map_file.with_name("paths.txt")
    words = ["mapf", str(map_file), "--robots", "1:4", "--loss", "0.02", "--crash", "1"]
    done = CliRunner().invoke(
        app, [*words, "--json", "--out", str(out), "--picture", str(out) + ".png"]
    )
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.exit_code == 0, done.output
    assert Path(f"{out}.png").read_bytes().startswith(b"\x89PNG")
    assert [report["robots"] for report in reports] == [1, 2, 4]
    assert all(report["success"] and report["collisions"] == 0 for report in reports)
    assert judge_paths(out.read_text(), map_file.read_text(), range(4)).faults == []


def test_the_paths_name_the_file_of_the_map(map_file: Path) -> None:
    """Viewers of such paths open the map that is named there. It was `small-seed-1`, which is no
    file."""
    out = map_file.with_name("paths.txt")
    list(mapf.reports(map_file, None, [1], 1, 0.0, 0, out))
    assert f"map_file={map_file.name}" in out.read_text().splitlines()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--robots", "x"], "--robots x: give 20, 1:100 or 10:100:30"),
        (["--robots", "١٢"], "--robots ١٢: give 20, 1:100 or 10:100:30"),
        (["--robots", "1_0"], "--robots 1_0: give 20, 1:100 or 10:100:30"),
        (["--robots", "1:400"], "--robots 1:400: a bus has addresses for 108 robots"),
        (["--robots", "80"], "connected free cells for 80 agents"),
        (["--loss", "2"], "--loss is 0 to 0.9"),
        (["--robots", "2", "absent.scen"], "absent.scen"),
    ],
)
def test_what_is_wrong_is_one_line(map_file: Path, words: list[str], line: str) -> None:
    options = [word for word in words if word != "absent.scen"]
    files = [str(map_file), *(["absent.scen"] if "absent.scen" in words else [])]
    done = CliRunner().invoke(app, ["mapf", *files, *options])
    assert done.exit_code == 2 and line in done.output, done.output
    assert len(done.output.strip().splitlines()) == 1


def test_crashes_of_a_range_are_told_where_there_are_fewer_robots(
    map_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    crashes: list[int] = []

    def set_up(found: MapfInstance, seed: int, loss: float, count: int) -> None:
        crashes.append(count)
        raise GridFileError("no run is needed")

    monkeypatch.setattr(mapf, "setting_of", set_up)
    for counts in ([2, 9], [4, 9]):
        with pytest.raises(GridFileError):
            next(mapf.reports(map_file, None, counts, 1, 0.0, 3, None))
    assert crashes == [1, 3]
    assert capsys.readouterr().err == "headland: --crash 3: 1 of 2 robots crash\n"
