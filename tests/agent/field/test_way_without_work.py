"""On a way without work, a robot that was pushed off its line heads for the next corner of the way.

24 robots left one gate: those that others pushed aside went back to their lines, across everybody, and
stood in the crowd for 20 s. Six of them gave their sections back.
"""

from math import atan2, degrees, hypot

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.interface.mission import FleetView, MotionRequest
from agent.interface.observation import Observation
from agent.motion.implement_clearance import LEAD_M
from agent.paths.route import Route
from crdt import FieldAllocationCRDT, Progress

CELL_M, ORIGIN_M = 0.25, -1.0
START, BEGIN, END = (2.0, 10.0), (40.0, 10.0), (48.0, 10.0)
CORNER = (BEGIN[0] - LEAD_M, BEGIN[1])


def _wish(blocked: NDArray[np.bool_], pushed_to: tuple[float, float]) -> MotionRequest:
    """What a robot wants that was on its way from `START` to its section, and is elsewhere now."""
    section = Section(0, ((BEGIN, END),), (2,))
    fences = ((0.0, 0.0), (50.0, 0.0), (50.0, 20.0), (0.0, 20.0))
    field = Field("line", fences, (), (0.0, 0.0), START, 4.0, 0.2, 4.0, (section,))
    work = FieldMission(field, Route(blocked, ORIGIN_M, ORIGIN_M, CELL_M), 0.8, 2.5, 1.5)
    progress = Progress(work.section_units)
    wish = MotionRequest(0.0, 0.0)
    for k, (x_m, y_m) in enumerate((START, pushed_to)):
        here = Observation(x_m, y_m, 0.0, 0.0, 0.0)
        view = FleetView(0, k, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
        if work.section is None:
            work.begin(0, view)
        wish = work.work(view)
    return wish


@pytest.mark.parametrize("aside_m", [-3.5, -0.5, -0.2, 0.2, 0.5, 2.5])
def test_a_robot_beside_its_way_goes_on_at_full_speed(aside_m: float) -> None:
    pushed_to = (12.0, 10.0 + aside_m)
    wish = _wish(np.zeros((100, 240), dtype=np.bool_), pushed_to)
    assert hypot(wish.vx_m_s, wish.vy_m_s) == pytest.approx(2.5)
    turn_rad = atan2(wish.vy_m_s, wish.vx_m_s)
    wanted_rad = atan2(CORNER[1] - pushed_to[1], CORNER[0] - pushed_to[0])
    assert degrees(turn_rad) == pytest.approx(degrees(wanted_rad), abs=0.5)


def test_a_robot_behind_a_hole_goes_back_to_its_way() -> None:
    blocked = np.zeros((100, 240), dtype=np.bool_)
    south, north = (round((y_m - ORIGIN_M) / CELL_M) for y_m in (12.0, 18.0))
    west, east = (round((x_m - ORIGIN_M) / CELL_M) for x_m in (14.0, 20.0))
    blocked[south:north, west:east] = True
    wish = _wish(blocked, (12.0, 13.5))
    assert wish.vy_m_s < -1.0, "the hole is between the robot and the corner"


def test_a_robot_near_the_corner_goes_back_to_its_line_first() -> None:
    """Turns between rows took seconds longer when robots headed for the corner there too."""
    wish = _wish(np.zeros((100, 240), dtype=np.bool_), (CORNER[0] - 4.0, CORNER[1] + 0.4))
    assert wish.vy_m_s < -0.5 and wish.vx_m_s < 0.1
