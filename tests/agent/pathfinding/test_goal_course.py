"""Goals of robots if some cannot be reached, and rounds of agreement on goals over a lossy wire."""

from random import Random

import numpy as np

from agent.coverage.cell_map import CellMap
from agent.coverage.plan_agreement import FleetSnapshot
from agent.mapf.agreement_phase import AgreementPhase
from agent.pathfinding.goal_agreement import GoalAgreement
from agent.pathfinding.goal_course import GoalInputs, course_to_goals, ends_of, neighbours
from crdt.progress import Progress
from protocol.frames.agreement_frames import AgreementKind, AgreementMessage, AgreementReply


def hall(rows: int = 3, columns: int = 5) -> CellMap:
    return CellMap(np.zeros((rows, columns), dtype=np.bool_), 1.0)


def test_a_closed_off_goal_becomes_the_nearest_cell_that_is_nobodys_goal() -> None:
    ground = hall(1, 6)
    cells = [ground.number((0, column)) for column in range(6)]
    inputs = GoalInputs((4, 7), (cells[1], cells[0]), (cells[5], cells[1]), (cells[3],), 0)
    ends = ends_of(neighbours(ground, inputs.blocked), inputs)
    assert ends == [cells[0], cells[1]] or ends == [cells[2], cells[1]]
    assert course_to_goals(ground, inputs).left_out == {4}


def test_of_two_with_one_goal_the_lower_slot_gets_it() -> None:
    ground = hall()
    a, b, c = (ground.number((row, 0)) for row in range(3))
    course = course_to_goals(ground, GoalInputs((1, 2), (a, b), (c, c), (), 0))
    assert course.ends[0] == c != course.ends[1] and course.left_out == {2}


def test_no_robot_ends_beside_one_that_stands_between_two_cells() -> None:
    ground = hall(1, 6)
    cells = [ground.number((0, column)) for column in range(6)]
    inputs = GoalInputs((0,), (cells[3],), (cells[3],), (cells[4],), 0, (cells[3], cells[5]))
    course = course_to_goals(ground, inputs)
    assert course.ends == [cells[2]] and course.left_out == {0}, "it makes room, and comes back"


def test_two_that_a_wreck_keeps_in_the_wrong_order_do_not_keep_the_others_standing() -> None:
    ground = hall(1, 8)
    cells = [ground.number((0, column)) for column in range(8)]
    course = course_to_goals(
        ground,
        GoalInputs(
            (1, 2, 3), (cells[0], cells[1], cells[4]), (cells[1], cells[0], cells[7]),
            (cells[3],), 0,
        ),
    )  # fmt: skip
    assert course.finish() == 3 and not course.solved
    assert [course.place(robot, 3) for robot in range(3)] == [cells[0], cells[1], cells[7]]


def test_a_robot_on_the_goal_of_another_makes_room_though_each_cell_is_a_goal() -> None:
    ground = hall(2, 5)
    cells = [[ground.number((row, column)) for column in range(5)] for row in range(2)]
    (a, b, wreck, e, f), (c, d, other_wreck, g, _) = cells
    # The last three cannot come to the cells before the wrecks.
    course = course_to_goals(
        ground,
        GoalInputs((0, 1, 2, 3, 4), (b, a, e, f, g), (a, f, b, c, d), (wreck, other_wreck), 0),
    )
    assert course.solved and course.ends[0] == a and course.ends[1] in (b, c, d)


def test_a_plan_for_nobody_is_at_its_end() -> None:
    course = course_to_goals(hall(), GoalInputs((), (), (), (), 0))
    assert course.solved and course.finish() == 0


def test_a_goal_off_the_map_makes_no_plan_and_no_exception() -> None:
    ground = hall()
    one = GoalAgreement(0, ground, 3)
    one.on_message(1, AgreementMessage(1, AgreementKind.PLACE, AgreementReply.GRANT, 2, 999, 0), 0)
    crew = FleetSnapshot(frozenset({0, 1}), {}, Progress({0: 1, 1: 1}))
    one.on_tick(1, AgreementReply.GRANT, True, crew, 10_000)
    assert one.phase is AgreementPhase.GATHER, "the other one has to send a goal that is a cell"


def test_three_agree_though_a_third_of_the_frames_are_lost() -> None:
    ground, rng = hall(4, 6), Random(8)
    goals = [ground.number(cell) for cell in ((3, 5), (0, 0), (2, 2))]
    places = [ground.number(cell) for cell in ((0, 0), (3, 5), (1, 1))]
    peers = [GoalAgreement(slot, ground, goal) for slot, goal in enumerate(goals)]
    crew = FleetSnapshot(frozenset(range(3)), {}, Progress(dict.fromkeys(range(3), 1)))
    for now_us in range(0, 20_000_000, 50_000):
        for peer in peers:
            peer.on_tick(places[peer.slot], AgreementReply.GRANT, True, crew, now_us)
        for peer in peers:
            for word in peer.outgoing(now_us):
                for other in peers:
                    if other is not peer and rng.random() > 0.3:
                        other.on_message(peer.slot, word, now_us)
        if all(peer.going for peer in peers):
            break
    assert all(peer.going for peer in peers), "no agreement in 20 s"
    assert peers[0].course is peers[1].course is peers[2].course, "one plan of equal inputs"
