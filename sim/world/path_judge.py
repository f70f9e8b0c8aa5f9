"""Judges a file of MAPF paths by the rules of the problem, from the text of the file and of the map.

It is written against the published format and shares no code with what plans, drives or writes.

The rules: every agent begins at its start; each step is to the same cell or to one of its four free
neighbours; no two agents are in one cell at a time (vertex conflict) and no two change places between
two times (swapping conflict); an agent that is not excused ends at its goal.
"""

import re
from collections.abc import Collection
from typing import NamedTuple

PLACE = re.compile(r"\((\d+),(\d+)\)")
FREE = ".GS"


class PathVerdict(NamedTuple):
    """What is wrong with the paths, and what they cost."""

    faults: list[str]  # the first of each kind and time; empty: none
    arrived: int  # agents that end at their goals
    sum_of_costs: int  # of those, the time from which on each stays there
    makespan: int


def judge_paths(paths: str, drawing: str, excused: Collection[int] = ()) -> PathVerdict:
    """`paths`: the file. `drawing`: the `.map`. `excused`: agents that need not arrive.

    Raises ValueError for text that is no such file.
    """
    rows = drawing.split("map\n", 1)[-1].splitlines()
    free = {(x, y) for y, row in enumerate(rows) for x, mark in enumerate(row) if mark in FREE}
    head, found, body = paths.partition("solution=\n")
    fields = dict(line.split("=", 1) for line in head.splitlines() if "=" in line)
    if not found or not {"starts", "goals"} <= fields.keys():
        raise ValueError("no starts, goals and solution")
    starts, goals = _places(fields["starts"]), _places(fields["goals"])
    steps = [_places(line.split(":", 1)[1]) for line in body.splitlines() if ":" in line]
    if not steps or any(len(step) != len(starts) for step in steps):
        raise ValueError("not one place for each agent at each time")
    faults = [] if steps[0] == starts else ["the first places are not the starts"]
    for t, step in enumerate(steps):
        faults += _faults_at(t, steps[t - 1] if t else step, step, free)
    costs = []
    for agent, goal in enumerate(goals):
        if steps[-1][agent] == goal:
            away = [t for t, step in enumerate(steps) if step[agent] != goal]
            costs.append(away[-1] + 1 if away else 0)
        elif agent not in excused:
            faults.append(f"agent {agent} does not end at its goal")
    return PathVerdict(faults, len(costs), sum(costs), max(costs, default=0))


def _faults_at(
    t: int, before: list[tuple[int, int]], now: list[tuple[int, int]], free: set[tuple[int, int]]
) -> list[str]:
    faults = []
    where: dict[tuple[int, int], int] = {}
    came = {place: agent for agent, place in enumerate(before)}
    for agent, (x, y) in enumerate(now):
        if (x, y) not in free:
            faults.append(f"{t}: agent {agent} is in a wall")
        if abs(x - before[agent][0]) + abs(y - before[agent][1]) > 1:
            faults.append(f"{t}: agent {agent} jumps")
        if (x, y) in where:
            faults.append(f"{t}: agents {where[x, y]} and {agent} are in one cell")
        where[x, y] = agent
        other = came.get((x, y), agent)
        if other < agent and now[other] == before[agent]:
            faults.append(f"{t}: agents {other} and {agent} change places")
    return faults


def _places(text: str) -> list[tuple[int, int]]:
    return [(int(x), int(y)) for x, y in PLACE.findall(text)]
