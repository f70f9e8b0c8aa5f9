"""A ground numbers every free cell; a course driven in its order, at any pace, never locks."""

from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.coverage.cell_map import NONE, CellMap
from agent.coverage.joint_course import TOLD_STEPS_MAX, CourseInputs, JointCourse, course_of
from tests.examples import examples


def scene(seed: int, rows: int, columns: int, robots: int) -> tuple[CellMap, list[int]]:
    rng = Random(f"{seed}/course")
    walls = np.array([[rng.random() < 0.3 for _ in range(columns)] for _ in range(rows)])
    ground = CellMap(walls, 4.0)
    return ground, rng.sample(range(len(ground)), min(robots, len(ground)))


def course(ground: CellMap, places: list[int], covered: NDArray[np.bool_]) -> JointCourse:
    return JointCourse(ground, range(len(places)), places, covered, (), 0.0)


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 12))
def test_every_free_cell_has_one_number(seed: int, rows: int, columns: int) -> None:
    ground, _ = scene(seed, rows, columns, 1)
    cells = [ground.cell(n) for n in range(len(ground))]
    assert sorted(cells) == [(int(r), int(c)) for r, c in np.argwhere(~ground.walls)]
    for number, cell in enumerate(cells):
        assert ground.number(cell) == number == ground.at(*ground.centre(number))
    assert ground.number((-1, 0)) == ground.number((rows, 0)) == NONE
    assert sum(ground.section_units.values()) == len(ground)


def test_a_map_that_does_not_fit_the_wire_is_refused() -> None:
    with pytest.raises(ValueError, match="65536"):
        CellMap(np.zeros((257, 256), dtype=np.bool_), 4.0)


def movers(plan: JointCourse, at: list[int], willing: set[int]) -> set[int]:
    """Of those that want to go, who gets there: nobody enters a cell that is not being left."""
    moving = set(willing)
    while True:
        cells = {plan.place(other, at[other]): other for other in range(len(at))}
        held = {
            robot for robot in moving
            if cells.get(plan.place(robot, at[robot] + 1), robot) not in moving | {robot}
        }  # fmt: skip
        if not held:
            return moving
        moving -= held


@pytest.mark.slow
@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 12))
def test_driven_at_any_pace_nobody_meets_and_all_arrive(seed: int, robots: int) -> None:
    """Robots set out at random, when they may: the plan's order is enough, and never locks."""
    ground, places = scene(seed, 9, 9, robots)
    plan = course(ground, places, np.zeros(len(ground), dtype=np.bool_))
    last, rng = plan.finish(), Random(seed)
    at, covered = [0] * len(places), set(places)
    while any(step < last for step in at):
        ready = set()
        for robot, step in enumerate(at):
            if step < last:
                wait = plan.wait(robot, step + 1)
                if wait.robot == NONE or at[wait.robot] >= wait.step:
                    ready.add(robot)
        assert movers(plan, at, ready), (seed, "locked")
        for robot in movers(plan, at, {r for r in ready if rng.random() < 0.7}):
            at[robot] += 1
        inside = [plan.place(robot, step) for robot, step in enumerate(at)]
        assert len(set(inside)) == len(inside), (seed, "two in one cell")
        covered |= set(inside)
    assert covered >= set(plan.todo.tolist()), seed


def test_what_is_covered_or_blocked_is_left_out() -> None:
    ground = CellMap(np.zeros((6, 6), dtype=np.bool_), 4.0)
    covered = np.zeros(36, dtype=np.bool_)
    covered[:12] = True
    plan = JointCourse(
        ground, (3, 5), (ground.number((5, 5)), ground.number((4, 5))), covered, (20,), 0.0
    )
    assert not set(plan.todo.tolist()) & {*range(12), 20}
    plan.finish()
    assert all(plan.place(r, s) != 20 for r in range(2) for s in range(plan.finish() + 1))
    owned = {n for n in range(36) if plan.owner[n] != NONE}
    assert owned >= set(plan.todo.tolist())


def test_equal_terms_are_one_course() -> None:
    ground, places = scene(4, 8, 8, 3)
    bits = np.packbits(np.zeros(len(ground), dtype=np.bool_)).tobytes()
    one = CourseInputs((0, 1, 2), tuple(places), bits, (), 0.0)
    assert course_of(ground, one) is course_of(ground, CourseInputs(*one))
    assert one.digest(ground) != one._replace(blocked=(5,)).digest(ground)


def test_a_told_step_is_computed_in_small_parts() -> None:
    ground = CellMap(np.zeros((40, 40), dtype=np.bool_), 4.0)
    covered = np.zeros(len(ground), dtype=np.bool_)
    last = course(ground, [0], covered).finish()
    assert last > TOLD_STEPS_MAX
    plan = course(ground, [0], covered)
    assert plan.told_step(last) == 0
    assert len(plan._steps) == TOLD_STEPS_MAX + 1
    told = [plan.told_step(last) for _ in range(last // TOLD_STEPS_MAX)]
    assert told[-1] == last
    assert plan.told_step(last + 1) == plan.told_step(0xFFFF) == 0
