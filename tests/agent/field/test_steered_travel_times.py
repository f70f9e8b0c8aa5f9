"""Times of bodies that steer: never sooner than Dubins words, and the same both ways."""

from math import cos, pi, sin

import numpy as np
import pytest

from agent.field.field_map import Field, Section
from agent.field.steered_travel_times import SteeredTravelTimes
from agent.field.tractor_mission import TractorMission
from agent.field.travel_times import TravelTimes
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.motion.tractor_tracker import LATERAL_M_S2, SteeringLimits, bend_speed_m_s
from agent.paths.dubins import shortest_m
from agent.paths.route import Route
from agent.paths.tractor_route import TurnRoute
from crdt import FieldAllocationCRDT, Progress

RADIUS_M, SPEED_M_S, BRAKING_M_S2 = 2.0, 2.5, 1.5
LIMITS = SteeringLimits(SPEED_M_S, BRAKING_M_S2, 0.67)
ROUTE = Route(np.zeros((220, 220), dtype=np.bool_), -5.0, -5.0, 0.5)
EAST, WEST = ((10.0, 20.0), (90.0, 20.0)), ((90.0, 24.0), (10.0, 24.0))


def _field() -> Field:
    """Rows of a square of 100 m, two a section: the second one is driven the other way."""
    sections = tuple(
        Section(k, tuple(tuple((x, y + 8.0 * k) for x, y in row) for row in (EAST, WEST)), (16, 16))
        for k in range(6)
    )
    ring = ((0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0))
    return Field("square", ring, (), (0.0, 0.0), (1.0, 1.0), 4.0, 0.2, 5.0, sections)


FIELD = _field()
TIMES = SteeredTravelTimes(FIELD, ROUTE, LIMITS, 1.5, RADIUS_M)
POINT = TravelTimes(FIELD, ROUTE, SPEED_M_S, 1.5, BRAKING_M_S2)


def test_a_way_takes_as_long_as_a_dubins_word_and_a_point_at_least() -> None:
    links = TIMES.link_for_ms
    assert links.shape == (12, 12) and (links >= POINT.link_for_ms).all()
    for a in range(12):
        for b in range(12):
            if a // 2 == b // 2:
                continue
            out, into = _pose(a, outward=True), _pose(b, outward=False)
            assert links[a, b] >= 1000 * shortest_m(out, into, RADIUS_M) / SPEED_M_S - 1, (a, b)


def test_a_section_is_left_as_it_was_driven() -> None:
    """From the end of the second row to the beginning of the next section: a half circle."""
    turn_s = pi * RADIUS_M / bend_speed_m_s(SPEED_M_S, RADIUS_M) + 1 / RADIUS_M / 0.67
    assert TIMES.link_for_ms[1, 2] == round(1000 * turn_s)


def test_a_way_takes_as_long_there_as_back() -> None:
    assert np.abs(TIMES.link_for_ms - TIMES.link_for_ms.T).max() <= 1


def test_work_is_its_rows_at_full_speed_and_the_turns_between_them() -> None:
    bend_m_s = bend_speed_m_s(SPEED_M_S, RADIUS_M)
    assert bend_m_s == pytest.approx((LATERAL_M_S2 * RADIUS_M) ** 0.5)
    turn_s = pi * RADIUS_M / bend_m_s + 1 / RADIUS_M / 0.67  # a half circle: the rows are 4 m apart
    assert TIMES.driven_for_ms([EAST]) == round(1000 * 80.0 / SPEED_M_S)
    assert TIMES.driven_for_ms([EAST, WEST]) == pytest.approx(
        1000 * (160.0 / SPEED_M_S + turn_s), abs=2
    )


def test_who_claims_the_rest_of_a_section_again_does_not_give_it_back_at_once() -> None:
    """A tractor that had worked units of a section before gave it back in each control period."""
    turns = TurnRoute(np.zeros((220, 220), dtype=np.bool_), -5.0, -5.0, 0.5, RADIUS_M)
    work = TractorMission(FIELD, ROUTE, turns, 0.8, LIMITS, TIMES)
    progress = Progress(work.section_units)
    here = Observation(80.0, 90.0, 0.0, 0.0, 0.0)
    view = FleetView(0, 0, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
    work.advanced = True
    work.begin(0, view)
    assert not work.work(view).given_up


def test_i26_a_tractor_stands_where_a_way_ends_that_backs_into_a_row() -> None:
    """It came to the row at 0.6 m/s backwards, and its wheels were turned for the arc before."""
    blocked = np.zeros((220, 220), dtype=np.bool_)
    blocked[:, : int((EAST[0][0] + 5.0) / 0.5) - 1] = True  # up to half a metre from the row
    turns = TurnRoute(blocked, -5.0, -5.0, 0.5, RADIUS_M)
    work = TractorMission(FIELD, ROUTE, turns, 0.8, LIMITS, TIMES)
    here = Observation(20.0, 12.0, pi / 2, 0.0, 0.0)
    progress = Progress(work.section_units)
    view = FleetView(0, 0, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
    work.begin(0, view)
    work.work(view)
    assert work.follow is not None and not work.leg.units
    assert work.follow.way[-1, 4] == -1.0 and work.follow.speeds[-1] == 0.0


def test_i26_a_tractor_without_work_leaves_a_line_that_is_to_be_worked() -> None:
    """It stood in a corner until another one came near, and could not leave then."""
    turns = TurnRoute(np.zeros((220, 220), dtype=np.bool_), -5.0, -5.0, 0.5, RADIUS_M)
    idle = TractorMission(FIELD, ROUTE, turns, 0.8, LIMITS, TIMES)
    open_line = FIELD.sections[0].swaths[0]
    for done, moves in ((FIELD.sections[1:], True), (FIELD.sections, False)):
        progress = Progress(idle.section_units)
        for section in done:
            for unit in range(section.units):
                progress.cover(section.id, unit)
        here = Observation(*open_line[0], 0.0, 0.0, 0.0)
        view = FleetView(0, 0, here, FieldAllocationCRDT(), progress, frozenset({0}), {}, {})
        idle.parking.forget()
        wish = idle.idle(view)
        assert (wish.vx_m_s != 0.0 or wish.vy_m_s != 0.0) is moves
        assert not wish.tool_on


def _pose(end: int, *, outward: bool) -> tuple[float, float, float]:
    section, last = FIELD.sections[end // 2], bool(end % 2)
    line = section.swaths[-1][::-1] if last else section.swaths[0]
    (ax, ay), (bx, by) = line[:2]
    heading = np.arctan2(by - ay, bx - ax) + (pi if outward else 0.0)
    assert abs(cos(heading)) > 0.99 and abs(sin(heading)) < 0.01
    return ax, ay, float(heading)
