"""Reading maps and instances: what is written can be read, what is wrong is one line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.files.grid_map import (
    GridFileError,
    Instance,
    Walls,
    gate_starts,
    largest_room,
    map_text,
    mcpp_text,
    parse_map,
    parse_roots,
    rack_walls,
    random_starts,
    random_walls,
    read_instance,
    room_walls,
    write_instance,
)
from sim.files.mapf_scenario import drawn_scenario
from tests.examples import examples

HEAD = "type octile\nheight 2\nwidth 3\nmap\n"


@given(st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.integers(0, 99))
def test_a_map_comes_back(rows: int, columns: int, share: float, seed: int) -> None:
    walls = random_walls(rows, columns, share, seed)
    assert (parse_map(map_text(walls)) == walls).all()


@pytest.mark.parametrize(
    "text",
    ["", "type octile\nheight 2\n", HEAD + "...\n", HEAD + "...\n....\n", HEAD.replace("2", "0"),
     HEAD.replace("2", "99999999"), HEAD.replace("2", "-2"), HEAD.replace("map", "mop") + "...\n...\n"],
)  # fmt: skip
def test_a_bad_map_is_one_line(text: str) -> None:
    with pytest.raises(GridFileError) as caught:
        parse_map(text)
    assert "\n" not in str(caught.value)


@settings(max_examples=examples(300))
@given(st.text(st.sampled_from("map: root[]0123456789,\n-e."), max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    for read in (parse_map, lambda text: parse_roots(text, 5)):
        try:
            read(text)
        except GridFileError as error:
            assert "\n" not in str(error)


def test_roots_as_numbers_and_over_lines() -> None:
    assert parse_roots("root: [[7, 1],\n       [2,\n 3]]\nmap: a b\n", 9) == (
        "a b",
        [(1, 7), (3, 2)],
    )
    assert parse_roots("map: m\nroot: [0, 11]\n", rows=10)[1] == [(0, 0), (1, 1)]


def test_an_instance_comes_back_with_its_map(tmp_path: Path) -> None:
    walls = random_walls(9, 13, 0.2, 4)
    instance = Instance("x", walls, random_starts(walls, 5, 4))
    write_instance(tmp_path / "x.mcpp", instance)
    found = read_instance(tmp_path / "x.mcpp")
    assert found.starts == instance.starts and (found.walls == walls).all()


@pytest.mark.parametrize("starts, words", [
    ([(0, 0), (0, 0)], "on robot 0"), ([(1, 1)], "in a wall"), ([(0, 9)], "outside"),
])  # fmt: skip
def test_bad_starts_are_named(tmp_path: Path, starts: list[tuple[int, int]], words: str) -> None:
    walls = np.zeros((3, 3), dtype=np.bool_)
    walls[1, 1] = True
    (tmp_path / "m.map").write_text(map_text(walls))
    (tmp_path / "m.mcpp").write_text(mcpp_text("m", starts))
    with pytest.raises(GridFileError, match=words):
        read_instance(tmp_path / "m.mcpp")


def test_random_maps_are_the_same_for_a_seed() -> None:
    assert (random_walls(20, 30, 0.2, 7) == random_walls(20, 30, 0.2, 7)).all()
    assert (random_walls(20, 30, 0.2, 7) != random_walls(20, 30, 0.2, 8)).any()
    walls = random_walls(20, 30, 0.2, 7)
    room = set(largest_room(walls))
    for starts in (random_starts(walls, 40, 1), gate_starts(walls, 40)):
        assert len(set(starts)) == 40 and set(starts) <= room
    with pytest.raises(ValueError, match="do not fit"):
        random_starts(walls, 601, 1)


def test_the_gate_is_one_place() -> None:
    starts = gate_starts(np.zeros((30, 30), dtype=np.bool_), 6)
    assert max(row + column for row, column in starts) <= 2


@pytest.mark.parametrize(
    "walls", [room_walls(31, 31, 7, 3), room_walls(20, 33, 5, 1), rack_walls(32, 32)]
)
def test_buildings_are_one_room_with_walls(walls: Walls) -> None:
    """Every door is open on both sides, and aisles are joined."""
    free = int((~walls).sum())
    assert len(largest_room(walls)) == free < walls.size


@pytest.mark.parametrize("side", range(2, 12))
def test_of_rooms_of_one_size_the_first_one_is_the_largest(side: int) -> None:
    """It was the one that a set gave first, and the twin of this function for drawn agents, which had a
    rule, looked for the first cell among all that are left: minutes for a large map."""
    walls = np.zeros((2 * side + 1, 2 * side + 1), dtype=np.bool_)
    walls[side] = walls[:, side] = True
    assert largest_room(walls) == [(row, column) for row in range(side) for column in range(side)]
    walls[0, 0] = True
    assert largest_room(walls)[0] == (0, side + 1)
    many = random_walls(32, 32, 0.45, side)
    room = drawn_scenario("many", many, 20, 1).starts
    assert set(room) <= set(largest_room(many))
