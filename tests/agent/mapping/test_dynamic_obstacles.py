"""What stands in the way for a while: seen by one, told to all, gone when it is gone or forgotten."""

from itertools import pairwise
from math import hypot

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.mapping.building import Floor
from agent.mapping.dynamic_obstacles import BELIEVED_S, DynamicObstacles
from agent.mapping.ray_evidence import LEAST
from agent.runtime.mission_parts import obstacle_map
from protocol.frames.map_frames import MapPatch
from protocol.sync.map_sync import MapSync
from sim.scenarios.navigation_setup import NavigationSetup
from sim.world.world import World

HALL = Floor.drawn("\n".join(["." * 16] * 5), 1.0, 0.35)
AT, GOAL = (2.5, 2.5), (13.5, 2.5)
BOX = (5.5, 2.5)
FAR_BOX = (10.5, 2.5)  # seen by the other robot


class Two:
    """One robot at each end of a hall, on a wire that loses nothing."""

    def __init__(self, floor: Floor = HALL, places: tuple[tuple[float, float], ...] = (AT, GOAL)):
        setting = NavigationSetup.made("two", floor, places, [[], []])
        self.floor = floor
        self.world: World = setting.world()
        self.syncs: list[MapSync] = []
        for slot in range(2):
            sync = setting.parts(slot).chart
            assert sync is not None
            sync.live(frozenset((0, 1)))
            self.syncs.append(sync)
        self.robots = [DynamicObstacles(floor, sync) for sync in self.syncs]
        self.looks = {0, 1}
        self.now_us = 0

    def age(self, hours: float) -> None:
        """The clock of the robots' map shows that they are on for so long."""
        for sync in self.syncs:
            sync.clock.witness(round(hours * 3600), self.now_us)

    def restart(self, slot: int) -> None:
        """A robot forgets everything, its clock too."""
        sync = obstacle_map(slot, 2, self.floor, self.now_us)
        assert sync is not None
        sync.live(frozenset((0, 1)))
        self.syncs[slot], self.robots[slot] = sync, DynamicObstacles(self.floor, sync)

    def elapse(self, seconds: float) -> None:
        until_us = self.now_us + round(seconds * S)
        while self.now_us < until_us:
            self.now_us += CONTROL_PERIOD_US
            self.world.advance(self.now_us)
            for slot in sorted(self.looks):
                here = self.world.body(slot).sense(self.now_us)
                other = self.world.body(1 - slot).position
                self.robots[slot].observe(here, 3.0, [other], self.now_us)
            for slot in range(2):
                for message in self.syncs[slot].on_tick(self.now_us):
                    self.syncs[1 - slot].on_message(slot, message, self.now_us)

    def gap_m(self, slot: int) -> float:
        """From its way to the goal of the other's place, to the middle of the box."""
        start = self.world.body(slot).position
        path = self.robots[slot].path(start, self.world.body(1 - slot).position)
        assert path is not None
        best = float("inf")
        for (ax, ay), (bx, by) in pairwise(path):
            length = hypot(bx - ax, by - ay)
            t = ((BOX[0] - ax) * (bx - ax) + (BOX[1] - ay) * (by - ay)) / length**2
            t = min(max(t, 0.0), 1.0)
            best = min(best, hypot(ax + t * (bx - ax) - BOX[0], ay + t * (by - ay) - BOX[1]))
        return best


def test_nothing_stands_and_no_grid_is_made() -> None:
    two = Two()
    two.elapse(2.0)
    assert not any(robot.standing or robot.map for robot in two.robots)
    assert two.gap_m(0) < 0.01


def test_who_has_not_seen_it_goes_round_it_too() -> None:
    two = Two()
    two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)
    for slot in range(2):
        assert two.robots[slot].standing
        assert two.gap_m(slot) > 0.3 + HALL.radius_m, "clear of the box"
    far = two.robots[1]
    assert far.reported() and not far.hits
    assert all(hypot(x - BOX[0], y - BOX[1]) < 0.7 for x, y in far.reported())
    assert far.map is not None
    assert {owner for owner, _ in far.map.grid.obstacles} == {0}


def test_when_it_has_gone_nobody_goes_round_it() -> None:
    two = Two()
    box = two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)
    two.world.remove_box(box)
    two.elapse(3.0)
    assert not any(robot.standing for robot in two.robots)
    assert two.gap_m(0) < 0.01 and two.gap_m(1) < 0.01


def test_what_nobody_looks_at_any_more_is_forgotten() -> None:
    two = Two()
    box = two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)
    two.looks = {1}  # the one who saw it falls silent, and then it is taken away
    two.world.remove_box(box)
    two.elapse(BELIEVED_S - 5.0)
    assert two.robots[1].standing
    two.elapse(8.0)
    assert not two.robots[1].standing


def test_what_still_stands_is_not_forgotten() -> None:
    two = Two()
    two.world.add_box(*BOX, 0.6)
    two.elapse(BELIEVED_S + 5.0)
    assert two.robots[1].standing


@pytest.mark.parametrize("hours", [0.0, 2.27, 3.0, 4.55, 40.0])
def test_after_hours_what_comes_and_goes_is_known_to_all(hours: float) -> None:
    """Found: after 2 h 17 min no time was later than another. What had gone stood for ever for robots
    far off, and they never heard of what stood there again."""
    two = Two()
    two.age(hours)
    for _ in range(2):
        box = two.world.add_box(*BOX, 0.6)
        two.elapse(3.0)
        assert two.robots[0].standing and two.robots[1].standing and two.gap_m(1) > 0.6
        two.world.remove_box(box)
        two.elapse(3.0)
        assert not two.robots[0].standing and not two.robots[1].standing
    two.world.add_box(*BOX, 0.6)
    two.elapse(BELIEVED_S + 5.0)
    assert two.robots[1].standing, "it is told again while it stands"
    assert two.syncs[0].chart.digest == two.syncs[1].chart.digest


def test_a_robot_that_restarts_after_hours_learns_what_stands_and_is_heard() -> None:
    two = Two()
    two.age(10.3)
    two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)
    two.restart(1)
    two.elapse(3.0)
    assert two.robots[1].standing and two.gap_m(1) > 0.6
    two.world.add_box(*FAR_BOX, 0.6)
    two.elapse(3.0)
    assert any(hypot(x - FAR_BOX[0], y - FAR_BOX[1]) < 0.7 for x, y in two.robots[0].reported())
    assert two.syncs[0].chart.digest == two.syncs[1].chart.digest


def test_what_a_restarted_robot_says_before_it_hears_others_does_not_move_their_clock() -> None:
    two = Two()
    two.age(10.3)
    two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)
    before = two.syncs[0].clock.read(two.now_us)
    two.restart(1)
    two.syncs[0].on_message(1, MapPatch(0, 5, 13, 1, 1), two.now_us)
    assert two.syncs[0].clock.read(two.now_us) == before


def test_a_robot_that_is_heard_later_is_no_box() -> None:
    """Seen before it was heard: its place is not an obstacle from then on."""
    two = Two(places=(AT, (4.5, 2.5)))
    here = two.world.body(0).sense(0)
    for k in range(10):
        two.robots[0].observe(here, 3.0, [], k * CONTROL_PERIOD_US)
    assert two.robots[0].standing
    two.robots[0].observe(here, 3.0, [two.world.body(1).position], 10 * CONTROL_PERIOD_US)
    assert not two.robots[0].standing


@pytest.mark.parametrize("width", [1, 5])
def test_a_closed_way_is_none(width: int) -> None:
    floor = Floor.drawn("\n".join(["." * 16] * width), 1.0, 0.35)
    y_m = width / 2
    two = Two(floor, ((2.5, y_m), (13.5, y_m)))
    for k in range(width):
        two.world.add_box(BOX[0], k + 0.5, 0.96)
    two.elapse(3.0)
    assert two.robots[0].path((2.5, y_m), (13.5, y_m)) is None


def test_what_was_free_when_we_passed_may_stand_there_now() -> None:
    """What a robot saw free long ago is no better than what another tells now."""
    two = Two(places=(AT, (8.5, 2.5)))
    first = two.world.add_box(10.5, 1.0, 0.5)  # and so both have a grid
    two.elapse(2.0)
    far = two.robots[1]
    assert far.map is not None
    row, column = far.map.geometry.cell((BOX[0] + 0.2, BOX[1]))
    assert far.map.grid.evidence[row, column] == LEAST
    two.world.body(1).teleport(*GOAL)
    two.world.remove_box(first)
    two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)
    assert two.gap_m(1) > 0.3 + HALL.radius_m, "clear of the box"


@pytest.mark.parametrize("place", [(100.0, 2.0), (-0.5, 2.0), (5.0, 1e5), (-1e5, -1e5)])
def test_a_silent_member_beside_the_map_is_in_nobodys_way(place: tuple[float, float]) -> None:
    """A beat of anybody, in the name of a robot that has just died, ended all other robots."""
    two = Two()
    robot = two.robots[0]
    two.world.add_box(*BOX, 0.6)
    two.elapse(3.0)  # now it has a map of obstacles
    assert robot.map is not None
    robot.map.stand({1: place}, two.now_us)
    two.elapse(1.0)
    assert robot.path(AT, GOAL) is not None
