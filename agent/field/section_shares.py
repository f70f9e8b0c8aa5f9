"""Deterministic split of the free sections among live robots; needs no messages.

The free sections, in their spatial order, are cut into as many runs of equal work as there are live
members. The runs are assigned so that the total travel distance is shortest. Every peer computes
the same cut from the same state. If views differ for a moment, claims decide.

Sections that were in a member's run when it fell silent stay reserved for it. Others take them only
when nothing else is left and its lease is over, beginning at the end that it would have reached
last. If it is alive behind a network cut, it works them from the other end.
"""

from collections.abc import Mapping, Sequence
from math import hypot, inf
from typing import NamedTuple

import numpy as np

from agent.interface.geometry import Point
from agent.mapf.linear_assignment import NOBODY, assigned


class SectionJob(NamedTuple):
    """A section as the partition sees it; ends are (x, y) metres."""

    section: int
    work_for_s: float  # time to do what is left of it
    ends: tuple[Point, ...]  # where it can be entered


def cut(jobs: Sequence[SectionJob], parts: int) -> list[list[SectionJob]]:
    """Cut jobs, in their order, into at most `parts` runs of nearly equal work."""
    runs: list[list[SectionJob]] = []
    rest_for_s, left = sum(job.work_for_s for job in jobs), parts
    run: list[SectionJob] = []
    run_for_s = 0.0
    for job in jobs:
        if run and left > 1 and run_for_s + job.work_for_s / 2 > rest_for_s / left:
            runs.append(run)
            rest_for_s, left = rest_for_s - run_for_s, left - 1
            run, run_for_s = [], 0.0
        run.append(job)
        run_for_s += job.work_for_s
    if run:
        runs.append(run)
    return runs


def shares(
    jobs: Sequence[SectionJob], robots: Mapping[int, Point], speed_m_s: float
) -> dict[int, list[SectionJob]]:
    """The run of each robot, by slot, with the end nearest to it first.

    `robots`: where each live robot will be free, (x, y) metres by slot. Robots beyond the number of
    runs get an empty one.
    """
    order = sorted(robots)
    runs = cut(jobs, len(order))
    result: dict[int, list[SectionJob]] = {slot: [] for slot in order}
    if not runs:
        return result
    way_m = np.array([[_way(robots[slot], run) for run in runs] for slot in order])
    # Whole millimetres are equal on every machine; the last bit of a square root may not be.
    for slot, column in zip(order, assigned(np.rint(way_m * 1000.0)), strict=True):
        if column == NOBODY:
            continue
        run, here = runs[column], robots[slot]
        if _near(here, run[-1]) < _near(here, run[0]):
            run = run[::-1]
        result[slot] = run
    return result


def _near(here: Point, job: SectionJob) -> float:
    near_m = inf
    for x, y in job.ends:
        near_m = min(near_m, hypot(x - here[0], y - here[1]))
    return near_m


def _way(here: Point, run: Sequence[SectionJob]) -> float:
    return min(_near(here, run[0]), _near(here, run[-1]))
