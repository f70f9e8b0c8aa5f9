"""The judge sees every kind of fault in a plan, and the plan file comes back as it was."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.geometry import Cell
from sim.files.coverage_plan_file import Plan, parse_plan
from sim.files.grid_map import GridFileError
from sim.world.plan_judge import judge, lower_bound

UP, DOWN, LEFT, RIGHT = 1, 2, 3, 4


def plan(rows: list[str], starts: list[Cell], actions: list[list[int]]) -> Plan:
    walls = np.array([[mark == "@" for mark in row] for row in rows])
    return Plan(walls, starts, actions, ~walls)


def test_a_good_plan() -> None:
    verdict = judge(plan(["...", ".@."], [(1, 0), (1, 2)], [[UP, RIGHT], [UP, 0]]))
    assert verdict.ok and verdict.makespan == 2 and verdict.cells == 5
    assert verdict.moves == 3 and verdict.turns_90 == 1 and verdict.repeats == 0
    assert verdict.score(0.5) == 2.5


def test_the_makespan_is_when_the_last_cell_is_covered() -> None:
    verdict = judge(plan(["..."], [(0, 1)], [[LEFT, RIGHT, RIGHT, LEFT, 0, 0]]))
    assert verdict.makespan == 3 and verdict.turns_180 == 2 and verdict.repeats == 2
    assert verdict.score(0.5) == 3 + 0.5 * 2, "turns after the last new cell do not count"


def test_faults_are_counted() -> None:
    assert judge(plan([".."], [(0, 0), (0, 1)], [[RIGHT], [LEFT]])).swaps == 1
    assert judge(plan(["..."], [(0, 0), (0, 2)], [[RIGHT], [LEFT]])).collisions == 1
    assert judge(plan([".."], [(0, 0), (0, 1)], [[RIGHT], [0]])).collisions == 1
    assert judge(plan([".@"], [(0, 0)], [[RIGHT]])).wall_entries == 1
    assert judge(plan(["."], [(0, 0)], [[UP]])).wall_entries == 1
    assert judge(plan(["..@."], [(0, 0)], [[0]])).uncovered == 1, "behind the wall nobody can go"


def test_following_and_turning_in_a_ring_are_allowed() -> None:
    ring = plan(["..", ".."], [(0, 0), (0, 1), (1, 1), (1, 0)], [[RIGHT], [DOWN], [LEFT], [UP]])
    verdict = judge(ring)
    assert verdict.ok and verdict.makespan == 0


def test_a_wreck_blocks_and_frees_of_what_only_it_reached() -> None:
    line = plan(["...."], [(0, 0), (0, 1)], [[0, 0], [0, 0]])
    line.died = [-1, 1]
    assert judge(line).ok, "nobody living can pass the wreck"
    line.actions = [[0, RIGHT], [0, 0]]
    assert judge(line).wall_entries == 1


def test_a_robot_that_dies_after_the_last_step_covers_nothing_more() -> None:
    line = plan(["...."], [(0, 0)], [[RIGHT]])
    assert judge(line).uncovered == 2
    line.died = [1]
    assert judge(line).uncovered == 0, "no robot is left that could reach a cell"


def test_a_robot_that_joins_is_not_there_before() -> None:
    late = plan(["..."], [(0, 0), (0, 2)], [[0, RIGHT, 0], [0, 0, 0]])
    late.joined = [0, 2]
    assert judge(late).makespan == 2 and judge(late).ok
    late.actions[0] = [RIGHT, RIGHT, 0]
    assert judge(late).collisions == 2, "at its arrival, and in the step after it"


def test_no_plan_is_better_than_the_bound_with_a_robot_that_joins() -> None:
    for begun in range(7):
        late = plan(["." * 9], [(0, 0), (0, 8)], [[RIGHT] * 8, [0] * begun + [LEFT] * 8])
        late.joined = [0, begun]
        assert judge(late).makespan == lower_bound(late.walls, late.starts, late.joined), begun


def test_the_bound_is_that_of_the_cells_that_count() -> None:
    walls = np.zeros((1, 9), dtype=bool)
    assert lower_bound(walls, [(0, 0)], [], {(0, 1), (0, 2)}) == 2
    assert lower_bound(walls, [(0, 0)]) == 8


@given(st.integers(1, 6), st.integers(1, 6), st.data())
def test_a_plan_file_comes_back(rows: int, columns: int, data: st.DataObject) -> None:
    walls = np.array(data.draw(st.lists(
        st.lists(st.booleans(), min_size=columns, max_size=columns), min_size=rows, max_size=rows
    )))  # fmt: skip
    free = [(int(r), int(c)) for r, c in np.argwhere(~walls)]
    starts = data.draw(st.lists(st.sampled_from(free), unique=True)) if free else []
    actions = [data.draw(st.lists(st.integers(0, 4), max_size=9)) for _ in starts]
    whole = Plan(walls, starts, actions, ~walls)
    text = whole.to_json()
    found = parse_plan(text)
    assert (found.walls == walls).all() and (found.dirt == ~walls).all()
    assert (found.starts, found.actions, found.died) == (starts, actions, whole.died)
    assert judge(found) == judge(whole)
    pairs = json.loads(text) | {"walls": np.argwhere(walls).tolist()}
    if len(pairs["walls"]) != rows or columns != 2:
        assert (parse_plan(json.dumps(pairs)).walls == walls).all()


GOOD = {"H": 1, "W": 2, "starts": [[0, 0]], "walls": [[0, 0]], "per_agent_actions": [[4]]}


@pytest.mark.parametrize("change", [
    {"H": "1"}, {"W": 3}, {"starts": [[0, 5]]}, {"starts": [[0]]}, {"starts": 7}, {"walls": [[1, 0]]},
    {"per_agent_actions": [[5]]}, {"per_agent_actions": []}, {"died": [1, 2]}, {"walls": [[0, 2]]},
    {"per_agent_actions": [[True]]}, {"H": 10**9}, {"dirt": 1},
])  # fmt: skip
def test_a_bad_plan_is_one_line(change: dict[str, object]) -> None:
    assert parse_plan(json.dumps(GOOD)).makespan == 1
    with pytest.raises(GridFileError) as caught:
        parse_plan(json.dumps(GOOD | change))
    assert "\n" not in str(caught.value)


def late_plan(**told: object) -> Plan:
    plain = {
        "H": 1, "W": 3, "walls": [[0, 0, 0]], "starts": [[0, 0], [0, 1]],
        "per_agent_actions": [[0, 0, 0], [RIGHT]],
    }  # fmt: skip
    return parse_plan(json.dumps({**plain, **told}))


@pytest.mark.parametrize("joined", [[0, 4], [0, 99], [0, -5], [0, 10**30]])
def test_a_plan_whose_robot_never_arrives_is_refused(joined: list[int]) -> None:
    """It was judged as a good plan: a robot that is not there can reach nothing."""
    with pytest.raises(GridFileError, match="not 0 to 3"):
        late_plan(joined=joined)
    assert late_plan(joined=[0, 3]).joined == [0, 3], "with the last step"


@pytest.mark.parametrize("start", [[5, 99], [-1, -1]])
def test_a_late_robot_that_starts_outside_of_the_map_is_refused(start: list[int]) -> None:
    """The judge ended with an IndexError."""
    with pytest.raises(GridFileError, match="outside of 1 x 3"):
        late_plan(joined=[0, 1], starts=[[0, 0], start])
    assert late_plan(joined=[0, 1], starts=[[0, 0], [0, 0]]), "where another one was before"


def test_a_wall_with_a_number_beyond_64_bits_is_no_plan() -> None:
    with pytest.raises(GridFileError, match="not a plan file"):
        late_plan(walls=[[0, 0, 10**30]])
