"""The frozen problem that a fleet of carriers solves: which robot takes which tasks in which order.

A task is an atom: go to its pickup, load, go to its dropoff, unload; a robot carries one parcel. So a
plan is one sequence of tasks a robot, and all that is to be known is what each costs after what. Costs
are whole milliseconds and energy whole units, so that every peer computes the same.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Whole = NDArray[np.int64]
Itineraries = list[list[int]]  # of each robot, indices of tasks


class Power(NamedTuple):
    """What batteries and bays add. Energy in units of the capacity's choice, never negative.

    `capacity`: of a full battery; `dock_ms`: of a charge whatever it takes, and `ms_per_unit` for each
    unit of it; charges are always to the full. The last axis of `*_bay` is the bay.
    """

    capacity: int
    dock_ms: int
    ms_per_unit: float
    left: Whole  # (robots,) in the battery now
    lead: Whole  # (robots, tasks) energy as `Workload.lead` is time
    link: Whole  # (tasks, tasks)
    home: Whole  # (tasks,) from a dropoff to the nearest bay: never to be without it
    lead_bay_ms: Whole  # (robots, bays) from where the robot is
    lead_bay: Whole
    to_bay_ms: Whole  # (tasks, bays) from a task's dropoff
    to_bay: Whole
    from_bay_ms: Whole  # (bays, tasks) to a task's pickup, and the task itself
    from_bay: Whole


class Workload(NamedTuple):
    """ready (robots,): when each is free; lead (robots, tasks): its first task; link (tasks, tasks):
    the next task after a dropoff. Milliseconds, the task itself included."""

    ready: Whole
    lead: Whole
    link: Whole
    power: Power | None = None

    @property
    def robots(self) -> int:
        return len(self.ready)

    @property
    def tasks(self) -> int:
        return len(self.link)


class PlanCost(NamedTuple):
    """What a plan costs; the less of two is the better, makespan first."""

    makespan_ms: int
    total_ms: int

    @property
    def feasible(self) -> bool:
        return self.makespan_ms < IMPOSSIBLE_MS


IMPOSSIBLE_MS = 1 << 40  # of a route on which a battery would be empty: 35 years
