"""How many robots can be at their goals at once, where the answer is plain."""

from agent.interface.geometry import Cell
from sim.world.joint_arrivals import most_arrived

ROW: set[Cell] = {(0, column) for column in range(6)}
SWAPPED: tuple[list[Cell], list[Cell | None]] = [(0, 0), (0, 1)], [(0, 1), (0, 0)]


def test_two_that_would_have_to_pass_each_other_in_a_row_are_not_both_at_their_goals() -> None:
    assert most_arrived(ROW, *SWAPPED) == 1
    assert most_arrived(ROW | {(1, 3)}, *SWAPPED) == 2, "one lets the other pass"
    assert most_arrived(ROW, [(0, 0), (0, 1)], [(0, 4), (0, 5)]) == 2


def test_a_robot_without_a_goal_there_gives_way_or_is_in_the_way() -> None:
    assert most_arrived(ROW, [(0, 0), (0, 1)], [(0, 5), None]) == 0
    assert most_arrived(ROW, [(0, 0), (0, 1)], [(0, 4), None]) == 1


def test_a_full_ring_and_too_many_configurations_are_not_answered() -> None:
    ring: list[Cell] = [(0, 0), (0, 1), (1, 1), (1, 0)]
    assert most_arrived(set(ring), ring, [*ring[1:], ring[0]]) is None
    wide = {(row, column) for row in range(30) for column in range(30)}
    assert most_arrived(wide, [(0, 0), (0, 1), (0, 2)], [None] * 3) is None
