"""A robot's own planner: what cannot wait goes before what is planned ahead."""

from agent.interface.geometry import Point
from agent.navigation.path_requests import KEPT, PathRequests

A, B, C = (0.0, 0.0), (5.0, 0.0), (9.0, 0.0)


class Log:
    def __init__(self) -> None:
        self.asked: list[tuple[Point, Point]] = []

    def __call__(self, start: Point, goal: Point) -> tuple[Point, ...]:
        self.asked.append((start, goal))
        return (start, goal)


def test_one_path_ahead_a_period_in_the_order_of_asking_and_each_once() -> None:
    log = Log()
    paths = PathRequests(log)
    for start, goal in ((A, B), (B, C), (A, B)):
        paths.ask(start, goal)
    paths.work()
    assert log.asked == [(A, B)]
    paths.work()
    paths.work()
    assert log.asked == [(A, B), (B, C)]
    paths.ask(B, C)  # it is there already
    paths.work()
    assert paths.planned == 2


def test_who_is_blocked_goes_first_and_what_is_ahead_waits_for_a_quiet_period() -> None:
    log = Log()
    paths = PathRequests(log)
    paths.ask(B, C)
    assert paths.urgent(log, A, B) == (A, B)  # in the same control period
    paths.work()
    assert log.asked == [(A, B)]
    paths.work()
    assert log.asked == [(A, B), (B, C)]
    assert (paths.at_once, paths.planned) == (1, 1)


def test_a_path_ahead_is_used_where_the_robot_has_come_to_its_beginning() -> None:
    log = Log()
    paths = PathRequests(log)
    for near, used in (((5.1, 0.0), 1), ((6.0, 0.0), 1)):
        paths.ask(B, C)
        paths.work()
        assert paths.take(near, C) == (near, C)
        assert paths.used == used
    assert log.asked == [(B, C), (B, C), ((6.0, 0.0), C)]


def test_paths_that_nobody_fetches_are_not_kept_for_ever() -> None:
    log = Log()
    paths = PathRequests(log)
    for k in range(3 * KEPT):
        paths.ask(A, (float(k), 1.0))
        paths.work()
    asked = len(log.asked)
    for k in range(3 * KEPT):
        paths.take(A, (float(k), 1.0))
    assert len(log.asked) == asked + 2 * KEPT
