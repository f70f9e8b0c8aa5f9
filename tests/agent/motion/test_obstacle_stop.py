"""The question about an obstacle, state by state; how a robot behaves is in tests/chaos/test_pause.py."""

from agent.motion.obstacle_stop import QUESTION_TABLE, REPORT, QuestionEvent, QuestionState
from tests.state_tables import check_table


def test_every_state_and_event() -> None:
    none, asking, waiting, going_round = QuestionState
    blocked, told_to_wait, told_to_pass, way_free, passed = QuestionEvent
    check_table(QUESTION_TABLE, none, {
        (none, blocked, asking), (going_round, blocked, asking),
        (asking, told_to_wait, waiting),
        (asking, told_to_pass, going_round), (waiting, told_to_pass, going_round),
        (asking, way_free, none), (waiting, way_free, none),
        (going_round, passed, none),
    })  # fmt: skip


def test_people_are_told_what_the_robot_then_does() -> None:
    """A report has the name of the state that its event leads to; GONE leads to no question."""
    for (source, event), target in QUESTION_TABLE.items():
        if event in REPORT and source is not target:
            gone = event is QuestionEvent.WAY_FREE
            assert REPORT[event].name == ("GONE" if gone else target.name)
