"""When each robot begins and ends each section of a plan, and from which end it works it.

A plan of the fleet (`agent/field/fleet_plan.py`) says the order alone, because a robot plans again
before each section. Here its times are told to people and to other programs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.field.fleet_plan import PlanProblem


class Visit(NamedTuple):
    """One section of a robot's row; times in milliseconds from now."""

    job: int
    entry: int  # the end at which it is entered: 0 or 1
    leaves_at_ms: int  # the way to it begins
    begins_at_ms: int
    ends_at_ms: int


def visits(problem: PlanProblem, robot: int, row: Sequence[int]) -> list[Visit]:
    """The row of one robot, each section from the end with which the row ends soonest.

    `robot`, `row`: indices of the problem. A row has two states, the ends of its newest section, so
    the best ends are found by dynamic programming in one pass.
    """
    if not row:
        return []
    lead, work, link = problem.lead[robot], problem.work, problem.link
    begins = np.zeros((len(row), 2), dtype=np.int64)
    ends, chosen = np.zeros_like(begins), np.zeros_like(begins)
    for k, job in enumerate(row):
        for entry in range(2):
            at = 2 * job + entry
            if k == 0:
                begins[k, entry] = problem.ready[robot] + lead[at]
            else:
                exits = 2 * row[k - 1] + 1 - np.arange(2)
                arrivals = ends[k - 1] + link[exits, at]
                chosen[k, entry] = int(np.argmin(arrivals))
                begins[k, entry] = arrivals.min()
            ends[k, entry] = begins[k, entry] + work[job]
    entry, found = int(np.argmin(ends[-1])), []
    for k in range(len(row) - 1, -1, -1):
        before = int(chosen[k, entry])
        leaves = problem.ready[robot] if k == 0 else ends[k - 1, before]
        found.append(Visit(row[k], entry, int(leaves), int(begins[k, entry]), int(ends[k, entry])))
        entry = before
    return found[::-1]
