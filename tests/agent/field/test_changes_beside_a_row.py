"""A robot at work goes on when something comes or goes beside its row.

Found in `small` with six robots: a robot had gone round another one that stood in its way. 30 s later it
forgot that one, planned all its work again from where it was, and drove back to the beginning of the
unit that it had half worked. It took 11 s until it was as far again.
"""

from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.field.field_obstructions import FORGET_US
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView, MotionRequest
from agent.interface.observation import Neighbour, Observation
from agent.motion.implement_clearance import LEAD_M
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.fleet_frames import Pose
from tests.agent.field.test_left_overs import FENCES, ROWS, free_cells

PERIOD_S = CONTROL_PERIOD_US / S
OTHER_ROW, THIS_ROW = (35.0, 40.0), (42.0, 20.0)


class Working:
    """A robot that works both rows, and is in the middle of a unit of the first one."""

    def __init__(self) -> None:
        sections = (Section(0, ROWS, (6, 6)),)
        field = Field("rows", FENCES, (), (0.0, 0.0), ROWS[0][0], 4.0, 0.2, 5.0, sections)
        self.work = FieldMission(field, Route(free_cells(), -5.0, -5.0, 0.25), 0.8, 2.5, 1.5)
        self.allocation, self.progress = FieldAllocationCRDT(), Progress(self.work.section_units)
        self.allocation.claim(0, 0, 0)
        self.allocation.start(0, 0)
        self.now_us = 10 * S
        self.x_m, self.y_m, self.vx_m_s, self.vy_m_s = ROWS[0][0][0] - LEAD_M, 20.0, 0.0, 0.0
        self.neighbours: dict[int, Neighbour] = {}
        self.silent_at_us: dict[int, int] = {}
        self.work.begin(0, self.view())
        while self.x_m < 32.5:
            self.drive()

    def view(self) -> FleetView:
        here = Observation(
            self.x_m, self.y_m, 0.0, self.vx_m_s, self.vy_m_s, sensed_at_us=self.now_us
        )
        return FleetView(
            0, self.now_us, here, self.allocation, self.progress, frozenset({0}),
            self.silent_at_us, self.neighbours,
        )  # fmt: skip

    def drive(self) -> MotionRequest:
        """One control period with the velocity that it wants."""
        wish = self.work.work(self.view())
        for unit in wish.covered:
            self.progress.cover(0, unit)
        self.vx_m_s, self.vy_m_s = wish.vx_m_s, wish.vy_m_s
        self.x_m, self.y_m = self.x_m + wish.vx_m_s * PERIOD_S, self.y_m + wish.vy_m_s * PERIOD_S
        self.now_us += CONTROL_PERIOD_US
        return wish

    def stands(self, at: tuple[float, float]) -> None:
        """Robot 1 stands there, as it says."""
        self.neighbours = {1: Neighbour(Pose(*at, 0.0, 0.0, State.IDLE, False, 0), self.now_us)}

    def fell_silent(self, at: tuple[float, float]) -> None:
        """Robot 1 stood there 10 s ago, and was not heard since."""
        self.stands(at)
        self.silent_at_us = {1: self.now_us}
        self.now_us += 10 * S


def test_a_robot_that_was_in_the_way_long_ago_is_forgotten_on_the_row() -> None:
    robot = Working()
    robot.stands((35.0, 23.0))
    robot.work.blockage.stand_before(robot.view())
    assert robot.work.blockage.standing
    robot.now_us += FORGET_US  # it was seen so long ago
    wish = robot.drive()
    assert not robot.work.blockage.standing
    assert wish.vx_m_s > 1.0 and wish.tool_on, "it is in the middle of a unit"
    assert robot.work.legs, "the other row comes after this one"


def test_a_body_on_the_other_row_changes_what_comes_after_this_one() -> None:
    robot = Working()
    units = [unit for leg in robot.work.legs for unit in leg.units]
    assert units == [6, 7, 8, 9, 10, 11]
    robot.fell_silent(OTHER_ROW)
    wish = robot.drive()
    assert wish.vx_m_s > 1.0 and wish.tool_on
    left = [unit for leg in robot.work.legs for unit in leg.units]
    assert left and set(left) < set(units), "units under the body are left out"


def test_a_body_on_this_row_stops_the_work_on_it() -> None:
    robot = Working()
    robot.fell_silent(THIS_ROW)
    robot.drive()
    assert 4 not in robot.work.leg.units, "the body stands on it"


def test_all_is_worked_once_after_such_a_change() -> None:
    robot, passed = Working(), list[int]()
    robot.stands((35.0, 23.0))
    robot.work.blockage.stand_before(robot.view())
    robot.now_us += FORGET_US
    known = robot.progress.covered(0)
    for _ in range(2000):
        wish = robot.drive()
        passed += wish.covered
        if wish.finished:
            break
    assert len(passed) == len(set(passed)) == 12 - known
