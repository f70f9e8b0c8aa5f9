"""One robot's errands, where a joint plan takes it elsewhere."""

from math import hypot

import pytest

from agent.interface.config import S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Observation
from agent.mapf.agreement_phase import AgreementPhase
from agent.mapf.lacam import JointPlan
from agent.mapping.building import Floor
from agent.navigation.navigation_mission import FOLLOWED_MAX, NavigationMission
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.agreement_frames import SilentPosition
from sim.scenarios.building_generator import CORRIDOR

FLOOR = Floor.drawn(CORRIDOR, 1.0, 0.35)
PERIOD_US = 50_000


def driven(errands: NavigationMission, at: tuple[float, float]) -> tuple[list[float], list[float]]:
    """Where a body that does as it is told was when its errand was done and in the end, and how fast
    it was on the way."""
    allocation = FieldAllocationCRDT(0)
    allocation.claim(0, 0)
    allocation.start(0, 0)
    (x_m, y_m), speeds_m_s, done_m = at, list[float](), list[float]()
    vx_m_s = vy_m_s = 0.0
    for tick in range(400):
        here = Observation(x_m, y_m, 0.0, vx_m_s, vy_m_s)
        now_us = tick * PERIOD_US
        view = FleetView(0, now_us, here, allocation, Progress({}), frozenset({0}), {}, {})
        wish = errands.work(view) if not done_m else errands.idle(view)
        if wish.finished:
            done_m.append(x_m)
        vx_m_s, vy_m_s = wish.vx_m_s, wish.vy_m_s
        speeds_m_s.append(hypot(vx_m_s, vy_m_s))
        x_m, y_m = x_m + vx_m_s * 0.05, y_m + vy_m_s * 0.05
    return [*done_m, x_m], speeds_m_s


@pytest.mark.parametrize("over", [True, False])
def test_who_is_driven_over_its_goal_has_been_there(over: bool) -> None:
    """It brakes for it; then it makes way as the plan says."""
    lattice = FLOOR.lattice
    route = tuple(lattice.nearest((column + 0.5, 2.5)) for column in range(2, 12))
    goal = lattice.point(route[4]) if over else (13.5, 0.5)
    errands = NavigationMission(0, {0: [goal]}, FLOOR, 1.0, 1.0)
    agreement = errands.agreement
    agreement.machine.state, agreement.order = AgreementPhase.GO, (0,)
    agreement.plan = JointPlan((route,), ((None,) * len(route),))
    agreement.reach(0, 0)
    places_m, speeds_m_s = driven(errands, lattice.point(route[0]))
    assert abs(places_m[0] - goal[0]) < 0.1
    if over:
        assert abs(places_m[-1] - lattice.point(route[-1])[0]) < 0.1, "it drove the plan to its end"
        assert min(speeds_m_s[10:80]) < 0.6, "it braked for its goal"
    else:
        assert min(speeds_m_s[10:80]) > 0.9


def test_m16_what_holds_a_lone_robot_up_and_no_ray_sees_is_driven_round() -> None:
    """A body that cannot get on, nobody near and nothing in sight: it stood for good."""
    floor = Floor.drawn("\n".join(["." * 16] * 5), 1.0, 0.35)
    goal, (x_m, y_m), (stop_x_m, stop_y_m) = (13.5, 2.5), (2.5, 2.5), (7.5, 2.5)
    errands = NavigationMission(0, {0: [goal]}, floor, 1.0, 1.0)
    allocation = FieldAllocationCRDT(0)
    allocation.claim(0, 0)
    allocation.start(0, 0)
    for tick in range(2400):
        here = Observation(x_m, y_m, 0.0, 0.0, 0.0)
        view = FleetView(
            0, tick * PERIOD_US, here, allocation, Progress({}), frozenset({0}), {}, {}
        )
        wish = errands.work(view)
        if wish.finished:
            break
        next_x_m, next_y_m = x_m + wish.vx_m_s * 0.05, y_m + wish.vy_m_s * 0.05
        if hypot(next_x_m - stop_x_m, next_y_m - stop_y_m) > 0.7:
            x_m, y_m = next_x_m, next_y_m
    assert hypot(x_m - goal[0], y_m - goal[1]) < 0.1, (x_m, y_m)
    assert "stalled" in [followed.why for followed in errands.followed]


def test_f_lines_that_were_followed_are_forgotten_when_there_are_many() -> None:
    """A robot that is sent on its way again and again does not fill its memory."""
    errands = NavigationMission(0, {0: [(13.5, 0.5)]}, FLOOR, 1.0, 1.0)
    for number in range(FOLLOWED_MAX + 10):
        errands._set_out(((1.0, 0.5), (2.0, 0.5)), "lost", number)
    assert len(errands.followed) == FOLLOWED_MAX and errands.followed[0].t_us == 10


@pytest.mark.parametrize("place", [(100.0, 2.0), (-3.0, 2.0)])
def test_a_silent_member_beside_the_building_is_no_body(place: tuple[float, float]) -> None:
    """A frame of anybody about a member made all robots look for parcels and plan beside the floor."""
    errands = NavigationMission(0, {0: [(13.5, 0.5)]}, FLOOR, 1.0, 1.0)
    errands.on_message(1, SilentPosition(*place, 2, 5), 0)
    errands.on_control_period(standing((4.0,) * 8), State.IDLE)
    assert errands.bodies.dead == {} and errands.bodies.refused == 1


def test_rays_from_a_place_that_is_not_believed_are_no_obstacles() -> None:
    """The echoes of walls would be obstacles in free space, for the whole fleet."""
    near = standing((0.6,) * 8)
    errands = NavigationMission(0, {0: [(13.5, 0.5)]}, FLOOR, 1.0, 1.0)
    errands.on_control_period(near._replace(placed=False), State.IDLE)
    assert errands.hazards.map is None and not errands.hazards.hits
    errands.on_control_period(near, State.IDLE)
    assert errands.hazards.hits


def standing(ranges_m: tuple[float, ...]) -> FleetView:
    """A robot in the corridor that has been a member for a minute and senses these ranges."""
    here = Observation(7.5, 2.5, 0.0, 0.0, 0.0, ranges_m)
    live = frozenset({0})
    return FleetView(0, 60 * S, here, FieldAllocationCRDT(0), Progress({}), live, {}, {})
