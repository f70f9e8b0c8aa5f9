"""The opponent of tractors: a plan of the whole fleet, with Dubins turns, made in one place.

It may work the swaths of a field in any order, each from either end, and joins them by the soonest
Dubins word, ahead or backing up. Its turning circle and its speed in arcs are those of the fleet's own
planned paths. Fences, holes and other tractors are not in its way, and it pays no time for turning the
wheels and for changes of direction. So no fleet can drive its plan.
"""

from collections.abc import Sequence
from math import atan2, inf, pi

import numpy as np

from agent.interface.geometry import Point
from agent.motion.tractor_tracker import bend_speed_m_s
from agent.paths.dubins import STRAIGHT_1_M, WORDS, words
from sim.scenarios.field_setup import FieldSetup
from tools.bench.field_opponent import FleetProblem, ticks

Pose = tuple[float, float, float]  # x, y in metres, heading in radians


def dubins_s(start: Pose, goal: Pose, radius_m: float, speed_m_s: float) -> float:
    """Time of the soonest Dubins word between two poses, ahead or backing up, seconds.

    Straight pieces take `speed_m_s`, arcs the lateral acceleration that the fleet's tractors permit.
    """
    bend_m_s = bend_speed_m_s(speed_m_s, radius_m)
    soonest_s = inf
    for a, b in ((start, goal), (_turned(start), _turned(goal))):
        lengths_m, curvatures = np.empty((WORDS, 3)), np.empty((WORDS, 3))
        words(*a, *b, radius_m, lengths_m, curvatures)
        passing_m_s = np.where(np.abs(curvatures) < STRAIGHT_1_M, speed_m_s, bend_m_s)
        soonest_s = min(soonest_s, float((lengths_m / passing_m_s).sum(axis=1).min()))
    return soonest_s


def tractor_problem(setup: FieldSetup) -> FleetProblem:
    """All times of a field and its tractors; a job is one swath."""
    vehicle, radius_m = setup.vehicle, setup.turn_radius_m
    lines = [swath for section in setup.field.sections for swath in section.swaths]
    both = [way for line in lines for way in (line, line[::-1])]
    begins = [_pose(way[:2], 0) for way in both]
    ends = [_pose(way[-2:], 1) for way in both]
    starts = [(x_m, y_m, 0.0) for x_m, y_m in setup.starts]

    def way_s(start: Pose, goal: Pose) -> float:
        return dubins_s(start, goal, radius_m, vehicle.speed_m_s)

    # A tractor does not stop between a swath and a turn.
    work = [_length_m(line) / vehicle.speed_m_s for line in both]
    lead = [[way_s(place, begin) for begin in begins] for place in starts]
    link = [[way_s(end, begin) for begin in begins] for end in ends]
    return FleetProblem(ticks(work), ticks(lead), ticks(link))


def _length_m(line: Sequence[Point]) -> float:
    points = np.array(line)
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _pose(ends: Sequence[Point], at: int) -> Pose:
    (ax, ay), (bx, by) = ends
    return (*ends[at], atan2(by - ay, bx - ax))


def _turned(pose: Pose) -> Pose:
    return pose[0], pose[1], pose[2] + pi
