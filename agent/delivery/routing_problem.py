"""The frozen problem that a fleet of carriers solves: which robot takes which tasks in which order.

A task is indivisible: go to its pickup, load, go to its dropoff, unload. A robot carries one
parcel. So a plan is one sequence of tasks for each robot, and the problem consists of what each
task costs after each other one. Costs are whole milliseconds and whole units of energy, so that
every peer computes the same.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Whole = NDArray[np.int64]
Itineraries = list[list[int]]  # of each robot, indices of tasks


class Power(NamedTuple):
    """What batteries and bays add to a workload. Energy is in one unit of free choice, never
    negative.

    `capacity`: of a full battery. `dock_ms`: fixed time of a charge; `ms_per_unit`: time for each
    unit of energy. Every charge is to the full. The last axis of `*_bay` is the bay.
    """

    capacity: int
    dock_ms: int
    ms_per_unit: float
    left: Whole  # (robots,) energy in the battery when the robot is free
    lead: Whole  # (robots, tasks) energy for what `Workload.lead` is the time of
    link: Whole  # (tasks, tasks) energy for what `Workload.link` is the time of
    home: Whole  # (tasks,) energy from a dropoff to the nearest bay; always kept in the battery
    lead_bay_ms: Whole  # (robots, bays) from where the robot is
    lead_bay: Whole
    to_bay_ms: Whole  # (tasks, bays) from a task's dropoff
    to_bay: Whole
    from_bay_ms: Whole  # (bays, tasks) to a task's pickup, and the task itself
    from_bay: Whole


class Workload(NamedTuple):
    """Times of a routing problem in milliseconds, the task itself included.

    `ready` (robots,): when each robot is free. `lead` (robots, tasks): from where it is free
    through its first task. `link` [i, j] (tasks, tasks): from the dropoff of i through j.
    """

    ready: Whole
    lead: Whole
    link: Whole
    power: Power | None = None

    @property
    def robots(self) -> int:
        """Number of robots."""
        return len(self.ready)

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.link)


class PlanCost(NamedTuple):
    """What a plan costs, milliseconds. Compare two with <: makespan first, then the total."""

    makespan_ms: int
    total_ms: int

    @property
    def feasible(self) -> bool:
        """Whether no battery would be empty."""
        return self.makespan_ms < IMPOSSIBLE_MS


IMPOSSIBLE_MS = 1 << 40  # of a route on which a battery would be empty: 35 years
