"""MovingAI's `.scen` files: published ones as they are, and one line for what is wrong with one."""

from pathlib import Path

import pytest

from sim.files.grid_map import GridFileError, parse_map, read_map
from sim.files.mapf_scenario import read_scenario
from tools.bench.map_kinds import data_folder

WALLS = parse_map("type octile\nheight 3\nwidth 4\nmap\n....\n.@..\n....\n")
HEAD, ONE, TWO = "version 1", "0\tm.map\t4\t3\t0\t0\t3\t2\t5", "9\tm.map\t4\t3\t3\t0\t0\t2\t5.4"


def read(tmp_path: Path, *lines: str, agents: int = 2, end: str = "\n") -> list[tuple[int, int]]:
    path = tmp_path / "m.scen"
    path.write_bytes("".join(line + end for line in lines).encode())
    return read_scenario(path, WALLS, agents).starts


@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n", " \n"])
def test_ends_and_empty_lines_are_no_matter(tmp_path: Path, end: str) -> None:
    assert read(tmp_path, HEAD, ONE, TWO, end=end) == [(0, 0), (0, 3)]
    assert read(tmp_path, HEAD, ONE, "what is not read may be anything", agents=1, end=end) == [
        (0, 0)
    ]


def test_the_name_of_a_map_may_have_spaces(tmp_path: Path) -> None:
    """The fields of a line are told apart by tabs."""
    spaced = [line.replace("m.map", "my maps/m 1.map") for line in (ONE, TWO)]
    assert read(tmp_path, HEAD, *spaced) == [(0, 0), (0, 3)]
    assert read(tmp_path, HEAD, *(line.replace("\t", " ") for line in (ONE, TWO))) == [
        (0, 0),
        (0, 3),
    ]


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ((ONE, TWO), "not a MovingAI scenario"),
        ((), "not a MovingAI scenario"),
        ((HEAD, ONE), "has 1 agents, not 2"),
        ((HEAD, ONE, ONE), "on robot 0"),
        ((HEAD, ONE, TWO.replace("\t3\t0\t0\t2\t", "\t1\t1\t0\t2\t")), "in a wall"),
        ((HEAD, ONE, TWO.replace("\t3\t0\t0\t2\t", "\t3\t0\t4\t2\t")), "outside of 3 x 4"),
        ((HEAD, ONE, TWO.replace("\t3\t0\t0\t2\t", "\t3\t0\t-1\t2\t")), "outside of 3 x 4"),
        ((HEAD, ONE, TWO.replace("5.4", "nan")), "line 3 is not that of an agent"),
        ((HEAD, ONE, TWO.replace("\t4\t3\t", "\tx\ty\t")), "line 3 is not that of an agent"),
        ((HEAD, ONE, TWO + "\t1"), "line 3 is not that of an agent"),
        # Found: it was driven on this map.
        ((HEAD, ONE, TWO.replace("\t4\t3\t", "\t3\t4\t")), "4 x 3 cells; this map has 3 x 4"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, lines: tuple[str, ...], why: str) -> None:
    with pytest.raises(GridFileError) as told:
        read(tmp_path, *lines)
    assert why in str(told.value) and len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["room-64-64-8", "warehouse-10-20-10-2-1"])
def test_published_scenarios_are_read_as_they_are(name: str) -> None:
    folder = data_folder() / "maps"
    if not (folder / f"{name}-random-1.scen").is_file():
        pytest.skip("the public maps are not here (HEADLAND_DATA)")
    walls = read_map(folder / f"{name}.map")
    found = read_scenario(folder / f"{name}-random-1.scen", walls, 100)
    assert len(set(found.starts)) == len(set(found.goals)) == 100
