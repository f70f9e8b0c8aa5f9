"""The plan of a fleet as a solver of the package pymapf, under the name `headland`.

    import headland.pymapf_solver, pymapf
    pymapf.solve(problem, "headland")

It is the plan that peers compute and agree on (`agent/mapf/sum_of_costs.py`), without peers.
"""

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from pymapf import MAPFSolver, Solution, register_solver

from agent.coverage.cell_map import CellMap
from agent.mapf.sum_of_costs import costs, planned
from agent.pathfinding.goal_course import neighbours


@register_solver("headland")
class HeadlandSolver(MAPFSolver):
    """LaCAM, then large-neighbourhood search; grids with four neighbours and one goal for each agent."""

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def solve(self, problem: Any, observer: Any = None) -> Any:
        """A `pymapf.Solution`; None if no plan was found. ValueError: diagonals, or a shared cell."""
        if problem.allow_diagonals:
            raise ValueError("headland moves to four neighbours")
        began_at_s, grid = perf_counter(), problem.grid
        walls = np.array(
            [[not grid.is_free((r, c)) for c in range(grid.width)] for r in range(grid.height)],
            dtype=np.bool_,
        )
        ground = CellMap(walls, 1.0)
        starts = [ground.number(agent.start) for agent in problem.agents]
        goals = [ground.number(agent.goal) for agent in problem.agents]
        if len(set(starts)) < len(starts) or len(set(goals)) < len(goals):
            raise ValueError("two agents share a start or a goal")
        track = planned(neighbours(ground), starts, goals, self.seed)
        if track is None:
            return None
        ends = costs(track, np.array(goals, np.int32)).tolist()
        paths = {
            agent.name: [ground.cell(number) for number in row[: end + 1]]
            for agent, row, end in zip(problem.agents, track.tolist(), ends, strict=True)
        }
        found = Solution(paths=paths, algorithm="headland")
        return replace(found, runtime=perf_counter() - began_at_s)
