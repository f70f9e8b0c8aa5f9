"""Solving and replaying coverage plans for people: figures as text or JSON, drawings in the terminal."""

import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from agent.interface.geometry import Cell
from sim.files.coverage_plan_file import Plan, write_plan
from sim.files.grid_map import Instance, Walls
from sim.files.palette import rgb_of
from sim.files.strict_json import dumps
from sim.runs.planned_coverage import Arrival, Death, work
from sim.world.plan_judge import PlanJudge, PlanScore, judge, lower_bound, steps_from
from tools.build.kernel_cache import told_compiling
from tools.common.result_table import fact_table

WALL, DIRT, CLEAN, ROBOT, WRECK = "█", "·", " ", "o", "x"
COLORS = {WRECK: "\x1b[1;31mx\x1b[0m", DIRT: "\x1b[33m·\x1b[0m"}


def solved(
    instance: Instance, turn_cost: float, deaths: Sequence[Death], arrivals: Sequence[Arrival],
    out: Path, as_json: bool, reachable_only: bool = False,
) -> int:  # fmt: skip
    """`reachable_only`: cells that no robot can come to are no fault."""
    begun_s = time.process_time()
    with told_compiling(Console(stderr=True).print):
        plan = work(instance, turn_cost, deaths, arrivals)
    cpu_s = time.process_time() - begun_s
    write_plan(out, plan)
    plan_judge = PlanJudge(plan)
    while not plan_judge.over:
        plan_judge.advance()
    plan_judge.end()
    verdict = plan_judge.verdict()
    # With robots that joined, and without what only dead ones could reach.
    bound = lower_bound(plan.walls, plan.starts, plan.joined, plan_judge.wanted())
    report = figures(plan, verdict, turn_cost) | {
        "lower_bound": bound,
        "ratio": round(verdict.makespan / bound, 4) if bound else 1.0,
        "cpu_s": round(cpu_s, 3),
        "plan": str(out),
    }
    closed = closed_off(report["unreached_cells"], reachable_only)
    report["ok"] = verdict.ok and not closed
    _print(f"coverage of {instance.name}", report, as_json)
    if closed:
        print(closed, file=sys.stderr)
    return 0 if report["ok"] else 1


def closed_off(cells: int, reachable_only: bool) -> str:
    """One line where the plan leaves out free cells; else nothing."""
    if not cells or reachable_only:
        return ""
    return (
        f"headland: {cells} free cells are not connected with any robot's start and stay uncovered; "
        "--reachable-only accepts that"
    )


def unreached(walls: Walls, starts: Sequence[Cell]) -> int:
    """Free cells that are not connected with any start."""
    return int((~walls).sum()) - len(steps_from(walls.tolist(), list(starts)))


def replayed(
    plan: Plan, delay_s: float, stop_on_done: bool, turn_cost: float, as_json: bool
) -> int:
    """Play a plan, drawn step by step at a terminal, and print its score. The exit code is 0 for a
    plan without faults. `turn_cost`: steps a quarter turn."""
    plan_judge = PlanJudge(plan)
    wanted = plan_judge.wanted()
    show = sys.stdout.isatty() and not as_json
    while not plan_judge.over and not (stop_on_done and wanted <= plan_judge.covered.keys()):
        if show:
            print("\x1b[H\x1b[2J" + drawing(plan_judge, wanted, True), flush=True)
            time.sleep(delay_s)
        plan_judge.advance()
        if plan_judge.step in (*plan.died, *plan.joined):
            wanted = plan_judge.wanted()
    if not as_json:
        print(drawing(plan_judge, wanted, show))
    verdict = judge(plan)
    _print("replay", figures(plan, verdict, turn_cost), as_json)
    return 0 if verdict.ok else 1


def figures(plan: Plan, verdict: PlanScore, turn_cost: float) -> dict[str, Any]:
    """The score of a plan as plain values. `turn_cost`: steps a quarter turn."""
    rows, columns = plan.walls.shape
    return {
        "rows": rows, "columns": columns, "cells": verdict.cells, "robots": len(plan.starts),
        "makespan": verdict.makespan, "score": verdict.score(turn_cost),
        "collisions": verdict.collisions, "swaps": verdict.swaps,
        "wall_entries": verdict.wall_entries, "uncovered": verdict.uncovered,
        "unreached_cells": unreached(plan.walls, plan.starts),
        "moves": verdict.moves, "turns_90": verdict.turns_90, "turns_180": verdict.turns_180,
        "repeats": verdict.repeats, "ok": verdict.ok,
    }  # fmt: skip


def drawing(plan_judge: PlanJudge, wanted: set[Cell], screen: bool) -> str:
    """The map as text, with the last digit of each robot's number. On a screen it is in colour, each
    robot in its own, and coarser where it would not fit; cells are square where there is room.

    A coarse mark is what matters most in its block: a wreck, a robot, dirt, clean ground, walls.
    """
    rows, columns = plan_judge.plan.walls.shape
    coarse, wide = 1, False
    if screen:
        room = shutil.get_terminal_size()
        coarse = max(1, -(-columns // room.columns), -(-rows // max(1, room.lines - 2)))
        wide = 2 * -(-columns // coarse) <= room.columns
    robots: dict[Cell, int] = {}  # by block, the lowest number
    marks = [[WALL if wall else DIRT for wall in row] for row in plan_judge.walls]
    for row, column in plan_judge.covered:
        marks[row][column] = CLEAN
    for robot, (row, column) in plan_judge.at.items():
        marks[row][column] = WRECK if robot in plan_judge.wrecks else ROBOT
        if robot not in plan_judge.wrecks:
            block_of = (row // coarse, column // coarse)
            robots[block_of] = min(robot, robots.get(block_of, robot))
    lines = []
    for top in range(0, rows, coarse):
        line = ""
        for left in range(0, columns, coarse):
            block = {m for row in marks[top : top + coarse] for m in row[left : left + coarse]}
            mark = next(m for m in (WRECK, ROBOT, DIRT, CLEAN, WALL) if m in block)
            if mark == ROBOT:
                line += _robot(robots[top // coarse, left // coarse], screen, wide)
            else:
                line += COLORS.get(mark, mark) * (2 if wide else 1) if screen else mark
        lines.append(line)
    left_over = len(wanted - plan_judge.covered.keys())
    return "\n".join(
        [*lines, f"step {plan_judge.step} of {plan_judge.plan.makespan}, {left_over} to cover"]
    )


def _robot(number: int, screen: bool, wide: bool) -> str:
    if not screen:
        return str(number % 10)
    red, green, blue = (round(255 * part) for part in rgb_of(number))
    shown = f"{number % 100:>2}" if wide else str(number % 10)
    return f"\x1b[38;2;{red};{green};{blue}m{shown}\x1b[0m"


def _print(title: str, report: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(dumps(report))
        return
    facts = ((name.replace("_", " "), escape(str(value))) for name, value in report.items())
    Console().print(fact_table(title, facts))
