"""Each checker finds what breaks its rule, and finds nothing where the rule holds."""

import pytest

from agent.interface.effects import Drive
from sim.world.checkers import (
    ExclusiveWorkChecker,
    MotionAfterStopChecker,
)
from sim.world.drive_trains import Chassis
from sim.world.ground_truth import Track
from sim.world.world import World

BOUND_US = 50_000


def moving(seconds: float, stop_s: float, again_s: float = 1e9) -> MotionAfterStopChecker:
    """Two robots; slot 1 obeys a stop pressed at `stop_s`, and starts again at `again_s`."""
    world = World([], 1)
    for slot in range(2):
        world.add_robot(slot, (0.0, 5.0 * slot), 0.5, Chassis())
    checker = MotionAfterStopChecker(world)
    for t_us in range(0, round(seconds * 1e6), 50_000):
        t_s = t_us / 1e6
        if t_s == stop_s:
            checker.press(t_us, BOUND_US, {1})
        world.body(0).drive(Drive(2.0, 0.0), t_us)
        obeys = stop_s <= t_s < again_s
        world.body(1).drive(Drive(0.0 if obeys else 2.0, 0.0), t_us)
    world.advance(round(seconds * 1e6))
    return checker


def test_a_robot_that_stops_in_time_is_in_order() -> None:
    assert moving(6.0, 2.0).violations == []


def test_a_robot_that_moves_again_without_release_is_found() -> None:
    found = moving(6.0, 2.0, again_s=5.0).violations
    assert {v.what for v in found} == {"told to move after a stop", "moves after a stop"}
    assert {v.slots for v in found} == {(1,)}
    assert 5_000_000 <= min(v.t_us for v in found) <= 5_020_000


def test_a_robot_that_never_heard_is_found_at_the_bound() -> None:
    found = moving(6.0, 2.0, again_s=2.0).violations
    told = [v.t_us for v in found if v.what.startswith("told")]
    assert told[0] == 2_000_000 + BOUND_US + 10_000
    moved = [v.t_us for v in found if v.what.startswith("moves")]
    braking_us = round(Chassis().stopping_for_s * 1e6)
    assert told[0] < moved[0] <= 2_000_000 + BOUND_US + braking_us + 10_000


def test_a_released_robot_may_move() -> None:
    world = World([], 1)
    for slot in range(2):
        world.add_robot(slot, (0.0, 5.0 * slot), 0.5, Chassis())
    checker = MotionAfterStopChecker(world)
    number = checker.press(0, BOUND_US, {0, 1})
    world.advance(3_000_000)
    checker.release(number, {0})
    for t_us in range(3_000_000, 4_000_000, 50_000):
        world.body(0).drive(Drive(1.0, 0.0), t_us)
    assert checker.violations == []
    world.body(1).drive(Drive(1.0, 0.0), 4_000_000)
    world.advance(4_200_000)
    assert {v.slots for v in checker.violations} == {(1,)}


def test_two_robots_in_one_section_at_once_are_found() -> None:
    sections = {7: [[(5.0, 2.0), (25.0, 2.0)]], 8: [[(5.0, 6.0), (25.0, 6.0)]]}
    for other_y, expected in ((2.0, {(0, 1)}), (6.0, set())):
        world = World([], 1)
        for slot, (x, y) in enumerate(((4.0, 2.0), (8.0, other_y))):
            world.add_robot(slot, (x, y), 0.5, Chassis())
        for t_us in range(0, 5_000_000, 50_000):
            for slot in range(2):
                world.body(slot).drive(Drive(1.0, 0.0, 0.0, True), t_us)
        world.advance(5_000_000)
        tracks = {slot: robot.track for slot, robot in world.robots.items()}
        found = ExclusiveWorkChecker(sections, 0.2).violations(tracks)
        assert {v.slots for v in found} == expected
        assert all("section 7" in v.what for v in found)


@pytest.mark.parametrize(("early_m", "found"), [(0.3, False), (0.65, False), (1.5, True)])
def test_an_implement_lowered_a_little_early_in_line_with_a_neighbour_is_no_work_there(
    early_m: float, found: bool
) -> None:
    """`headland chaos`, profile all, seed 1500183: three samples of 0.25 m passed for 0.8 m."""
    sections = {0: [[(5.0, 2.0), (25.0, 2.0)]], 1: [[(25.0, 2.0), (45.0, 2.0)]]}
    tracks = {0: Track(), 1: Track()}
    for k in range(40):
        tracks[0].add(k * 100_000, 25.0 - early_m + 0.1 * k, 2.0, True)
        tracks[1].add(k * 100_000, 5.0 + 0.2 * k, 2.0, True)
    violations = ExclusiveWorkChecker(sections, 0.2, least_m=0.8).violations(tracks)
    assert bool(violations) is found


@pytest.mark.parametrize(
    ("spans_down", "found"),
    [([], True), ([(0, 1_000_000), (1_000_000, 2_000_000)], False), ([(0, 1_000_000)], True)],
)
def test_an_implement_that_stays_down_against_its_command_does_no_work_of_its_robot(
    spans_down: list[tuple[int, int]], found: bool
) -> None:
    """`headland chaos`, profile implement, seed 20800506: a robot left its section through that of
    another, and its implement had not risen."""
    sections = {0: [[(5.0, 2.0), (45.0, 2.0)]]}
    tracks = {0: Track(), 1: Track()}
    for k in range(20):
        tracks[0].add(k * 100_000, 5.0 + 0.2 * k, 2.0, True)
        tracks[1].add(k * 100_000, 30.0 + 0.2 * k, 2.0, True)
    checker = ExclusiveWorkChecker(sections, 0.2, least_m=0.8)
    assert bool(checker.violations(tracks, {1: spans_down})) is found


@pytest.mark.parametrize(("beside_m", "found"), [(0.15, False), (3.0, True)])
def test_a_robot_beside_a_near_line_of_another_section_does_not_work_in_both(
    beside_m: float, found: bool
) -> None:
    """Lines of two sections in the tip of a drawn field lay 0.2 m apart, and S7 was broken without
    faults."""
    near = [(5.0, 2.0 + beside_m), (15.0, 2.0 + beside_m)]
    sections = {0: [[(5.0, 2.0), (15.0, 2.0)]], 1: [near, [(20.0, 9.0), (40.0, 9.0)]]}
    tracks = {0: Track(), 1: Track()}
    for k in range(40):
        tracks[0].add(k * 100_000, 5.0 + 0.2 * k, 2.0, True)
        tracks[1].add(k * 100_000, 20.0 + 0.2 * k, 9.0, True)
    checker = ExclusiveWorkChecker(sections, 0.2, least_m=0.8)
    assert not checker.violations(tracks)
    for k in range(40):  # a second robot on the same line of section 1
        tracks[0].add(5_000_000 + k * 100_000, 22.0 + 0.2 * k, 9.0, True)
        tracks[1].add(5_000_000 + k * 100_000, near[0][0] + 0.2 * k, near[0][1], True)
    assert bool(checker.violations(tracks)) is found


@pytest.mark.parametrize("speed_m_s", [0.15, 0.6, 2.5])
def test_slow_robots_in_one_section_at_once_are_found(speed_m_s: float) -> None:
    """Only four samples within one second were work, so that no robot below 0.75 m/s could be found."""
    sections = {0: [[(5.0, 2.0), (45.0, 2.0)]]}
    tracks = {0: Track(), 1: Track()}
    for k in range(100):
        tracks[0].add(k * 100_000, 5.0 + 0.1 * speed_m_s * k, 2.0, True)
        tracks[1].add(k * 100_000, 30.0 + 0.1 * speed_m_s * k, 2.0, True)
    (found,) = ExclusiveWorkChecker(sections, 0.2, least_m=0.8).violations(tracks)
    assert found.slots == (0, 1)


def test_a_robot_that_works_a_line_again_beside_another_is_found() -> None:
    """As one that has lost its progress in a restart. Only its first way along a line was judged."""
    sections = {0: [[(5.0, 2.0), (25.0, 2.0)], [(5.0, 6.0), (25.0, 6.0)]]}
    tracks = {0: Track(), 1: Track()}
    for again in range(2):
        for k in range(80):
            tracks[0].add(again * 20_000_000 + k * 100_000, 5.0 + 0.2 * k, 2.0, k < 79)
            if again:
                tracks[1].add(again * 20_000_000 + k * 100_000, 5.0 + 0.2 * k, 6.0, True)
    (found,) = ExclusiveWorkChecker(sections, 0.2, least_m=0.8).violations(tracks)
    assert found.slots == (0, 1) and found.t_us >= 20_000_000


def test_one_robot_after_another_in_a_second_is_in_order() -> None:
    sections = {0: [[(5.0, 2.0), (25.0, 2.0)], [(5.0, 6.0), (25.0, 6.0)]]}
    tracks = {0: Track(), 1: Track()}
    for k in range(6):
        tracks[0].add(k * 100_000, 5.0 + 0.25 * k, 2.0, k < 5)
        tracks[1].add(500_000 + k * 80_000, 5.0 + 0.25 * k, 6.0, k < 5)
    assert not ExclusiveWorkChecker(sections, 0.2, least_m=0.8).violations(tracks)
