"""A team covers every reachable cell of any map, never collides, never locks; also after deaths."""

from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.coverage.team import Team
from agent.interface.geometry import Cell
from tests.examples import examples

Walls = NDArray[np.bool_]


def neighbours(cell: Cell) -> list[Cell]:
    row, column = cell
    return [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]


def reachable(walls: Walls, sources: list[Cell]) -> set[Cell]:
    free = {(int(r), int(c)) for r, c in np.argwhere(~walls)}
    seen, stack = set(sources), list(sources)
    while stack:
        for near in neighbours(stack.pop()):
            if near in free and near not in seen:
                seen.add(near)
                stack.append(near)
    return seen


def follow(team: Team, walls: Walls, covered: set[Cell], until: int | None = None) -> int:
    """Advance to the end (or `until`), checking each step; the steps it took."""
    steps = 0
    places = {r: team.cell(p) for r, p in enumerate(team.robots.place.tolist()) if p >= 0}
    covered |= set(places.values())
    limit = 40 * walls.size + 100
    while team.remaining() and steps != until:
        after = {r: team.cell(p) for r, p in enumerate(team.advance()) if p >= 0}
        assert after.keys() == places.keys()
        assert len(set(after.values())) == len(after), "two robots in one cell"
        moved = {(places[r], after[r]) for r in after if places[r] != after[r]}
        assert not any((b, a) in moved for a, b in moved), "two robots changed places"
        for a, b in moved:
            assert b in neighbours(a) and not walls[b]
        covered |= set(after.values())
        places = after
        steps += 1
        assert steps < limit, "locked"
    return steps


def scene(
    rows: int, columns: int, share: float, robots: int, seed: int
) -> tuple[Walls, list[Cell]]:
    rng = Random(f"{seed}/scene")
    walls = np.array([[rng.random() < share for _ in range(columns)] for _ in range(rows)])
    free = [(int(r), int(c)) for r, c in np.argwhere(~walls)]
    return walls, rng.sample(free, min(robots, len(free)))


@settings(max_examples=examples(150), deadline=None)
@given(st.integers(1, 14), st.integers(1, 14), st.sampled_from([0.0, 0.1, 0.25, 0.45]),
       st.integers(0, 30), st.integers(0, 10**6), st.sampled_from([0.0, 0.5]))  # fmt: skip
def test_every_map_is_covered(
    rows: int, columns: int, share: float, robots: int, seed: int, turn: float
) -> None:
    walls, starts = scene(rows, columns, share, robots, seed)
    covered: set[Cell] = set()
    follow(Team(walls, starts, turn), walls, covered)
    assert covered == reachable(walls, starts)


@settings(max_examples=examples(80), deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(0, 25), st.booleans())
def test_deaths_and_joins(seed: int, robots: int, when: int, crowded: bool) -> None:
    walls, starts = scene(9, 11, 0.4 if crowded else 0.15, robots, seed)
    team, covered, rng = Team(walls, starts), set[Cell](), Random(f"{seed}/fate")
    follow(team, walls, covered, when)
    victim = rng.randrange(len(starts))
    walls[team.cell(int(team.robots.place[victim]))] = True
    team.die(victim)
    follow(team, walls, covered, when)
    taken = {team.cell(p) for p in team.robots.place.tolist() if p >= 0}
    empty = sorted({(int(r), int(c)) for r, c in np.argwhere(~walls)} - taken)
    if empty:
        assert team.join(rng.choice(empty)) == len(starts)
    follow(team, walls, covered)
    live = [team.cell(p) for p in team.robots.place.tolist() if p >= 0]
    assert covered >= reachable(walls, live)


@pytest.mark.parametrize("walls", [
    np.zeros((1, 1), bool), np.zeros((1, 30), bool), np.zeros((30, 1), bool), np.zeros((7, 7), bool),
])  # fmt: skip
def test_robots_everywhere_and_one_robot(walls: Walls) -> None:
    cells = [(int(r), int(c)) for r, c in np.argwhere(~walls)]
    assert Team(walls, cells).remaining() == 0, "all are covered at once"
    for starts in ([cells[0]], cells[1:]):
        covered: set[Cell] = set(starts)
        follow(Team(walls, starts), walls, covered)
        assert covered >= (set(cells) if starts else set())


def test_nobody_waits_for_ever_in_a_corridor() -> None:
    """A comb of dead ends one cell wide with robots deep in them: the map on which PIBT alone locks."""
    walls = np.ones((8, 21), dtype=np.bool_)
    walls[0, :] = False
    walls[:, ::2] = False
    starts = [(7, column) for column in range(0, 21, 2)] + [
        (6, column) for column in range(0, 21, 2)
    ]
    covered: set[Cell] = set()
    follow(Team(walls, starts), walls, covered)
    assert covered == reachable(walls, starts)


@pytest.mark.parametrize("seed", range(20))
def test_the_maps_on_which_priority_by_step_never_ended(seed: int) -> None:
    """32 x 32, 20 robots, 20 % walls: with priority renewed at each step some of these locked."""
    walls, starts = scene(32, 32, 0.2, 20, seed)
    covered: set[Cell] = set()
    steps = follow(Team(walls, starts), walls, covered)
    assert covered == reachable(walls, starts), seed
    assert steps < 4 * len(covered) / len(starts) + 100, seed


def test_peers_agree_without_a_word() -> None:
    walls, starts = scene(40, 40, 0.1, 12, 3)
    one, other = Team(walls, starts), Team(walls.copy(), list(starts))
    while one.remaining():
        assert one.advance() == other.advance()
        assert (one.robots.goal == other.robots.goal).all()


def test_the_cut_is_balanced_and_kept() -> None:
    """An open hall: within a tenth of an equal share each, from one corner within a quarter."""
    walls = np.zeros((60, 60), dtype=np.bool_)
    rng = Random(5)
    spread = rng.sample([(r, c) for r in range(60) for c in range(60)], 10)
    corner = [(r, c) for r in range(2) for c in range(5)]
    for starts, factor in ((spread, 1.1), (corner, 1.25)):
        team = Team(walls, starts)
        assert team.bound <= factor * 3600 / 10
        assert follow(team, walls, set()) <= team.bound * 1.02 + 2


def test_a_death_costs_no_more_than_its_share() -> None:
    walls, starts = scene(50, 50, 0.05, 10, 8)
    whole = follow(Team(walls, starts), walls, set())
    team, covered = Team(walls, starts), set[Cell]()
    follow(team, walls, covered, whole // 2)
    before = set(covered)
    walls[team.cell(int(team.robots.place[4]))] = True
    team.die(4)
    todo = {team.cell(int(n)) for n in team.walked.order}
    assert not todo & before, "what was covered stays covered"
    rest = follow(team, walls, covered)
    assert whole // 2 + rest <= 1.2 * whole


def test_turns_are_worth_avoiding() -> None:
    """With a cost of turning the cut promises its bound with turns in it."""
    walls = np.zeros((24, 24), dtype=np.bool_)
    plain, turning = (Team(walls, [(0, 0), (23, 23)], cost) for cost in (0.0, 0.5))
    assert turning.bound > plain.bound >= 24 * 24 / 2 - 1


def in_order(columns: int, at: list[int]) -> int:
    """The least steps in which robots on one row of cells cover it, none passing another."""
    for steps in range(2 * columns):
        first = 0  # what is left begins here
        for own in sorted(at):
            back = max(0, own - first)
            if back > steps:
                break
            ahead = max(steps - 2 * back, (steps - back) // 2)
            first = max(first, own + ahead + 1)
        if first >= columns:
            return steps
    raise AssertionError("one robot needs fewer")


def test_neighbours_in_a_corridor_do_not_push_each_other_to_and_fro() -> None:
    walls = np.zeros((1, 200), dtype=bool)
    starts = [105, 104, 43, 42]
    covered: set[Cell] = set()
    steps = follow(Team(walls, [(0, column) for column in starts]), walls, covered)
    assert steps == in_order(200, starts) == 94


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 10**6))
def test_a_corridor_takes_hardly_longer_than_robots_in_their_order(seed: int) -> None:
    rng = Random(f"{seed}/corridor")
    columns = rng.randint(40, 120)
    pairs = {at + k for at in rng.sample(range(columns - 1), rng.randint(1, 4)) for k in (0, 1)}
    starts = rng.sample(sorted(pairs), len(pairs))
    walls = np.zeros((1, columns), dtype=bool)
    steps = follow(Team(walls, [(0, column) for column in starts]), walls, set())
    assert steps <= 1.3 * in_order(columns, starts) + 4
