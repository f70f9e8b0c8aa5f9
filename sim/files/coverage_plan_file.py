"""The plan file of a grid coverage run: the action of every robot at every step, for exact replay.

JSON with the keys of the mission's `vacuum_plan.json`: `H`, `W`, `n_agents`, `makespan`,
`per_agent_actions` (0 wait, 1 up, 2 down, 3 left, 4 right), `walls` and `dirt` (H rows of 0 and 1;
a list of [row, column] is read too) and `starts` ([row, column]). Two keys are ours and may be
absent: `joined` and `died`, the step from which on a robot is there, and from which on it is a wreck
that blocks its cell (-1: never).
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agent.interface.geometry import Cell
from agent.runtime.files.given_file import PLAN_BYTES_MAX, GivenFileError, parse_json, read_text
from sim.files.grid_map import CELLS_MAX, GridFileError, Walls, check_starts
from sim.files.whole_file import write_whole

STEPS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))  # row and column of each action


@dataclass
class Plan:
    """A plan with its map: boolean `walls` and `dirt` of shape (rows, columns), and for each robot
    a start cell (row, column), a list of actions, and the steps at which it joins and dies (-1:
    never)."""

    walls: Walls
    starts: list[Cell]
    actions: list[list[int]]  # a list for each robot; robots with shorter lists wait at their end
    dirt: Walls
    joined: list[int] = field(default_factory=list)
    died: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.joined = self.joined or [0] * len(self.starts)
        self.died = self.died or [-1] * len(self.starts)

    @property
    def makespan(self) -> int:
        """Steps until the robot with the longest list of actions is at its end; 0 without robots."""
        return max((len(actions) for actions in self.actions), default=0)

    def to_json(self) -> str:
        """The plan as one line of JSON, with the keys of the mission's `vacuum_plan.json`. `joined`
        and `died` are written only if some robot joins late or dies."""
        rows, columns = self.walls.shape
        document: dict[str, Any] = {
            "H": rows, "W": columns, "n_agents": len(self.starts), "makespan": self.makespan,
            "starts": [list(cell) for cell in self.starts],
            "walls": self.walls.astype(int).tolist(), "dirt": self.dirt.astype(int).tolist(),
            "per_agent_actions": self.actions,
        }  # fmt: skip
        if any(self.joined) or any(step >= 0 for step in self.died):
            document |= {"joined": self.joined, "died": self.died}
        return json.dumps(document, separators=(",", ":"))


def write_plan(path: Path, plan: Plan) -> None:
    """Write the plan as JSON with a line end, and create missing folders. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, plan.to_json() + "\n")


def _integers(value: Any) -> bool:
    return isinstance(value, list) and all(type(item) is int for item in value)


def _mask(value: Any, rows: int, columns: int, what: str) -> Walls:
    if not isinstance(value, list):
        raise GridFileError(f"{what} is not a list")
    if len(value) == rows and all(_integers(row) and len(row) == columns for row in value):
        whole = np.array(value, dtype=np.int64)
        if not (columns == 2 and (whole > 1).any()):  # two columns: rows or pairs? pairs have > 1
            if ((whole != 0) & (whole != 1)).any():
                raise GridFileError(f"{what} holds more than 0 and 1")
            return np.asarray(whole == 1, dtype=np.bool_)
    mask = np.zeros((rows, columns), dtype=np.bool_)
    for pair in value:
        if not (_integers(pair) and len(pair) == 2):
            raise GridFileError(
                f"{what} is neither H rows of W numbers nor a list of [row, column]"
            )
        if not (0 <= pair[0] < rows and 0 <= pair[1] < columns):
            raise GridFileError(f"{what} has {pair}, outside of {rows} x {columns}")
        mask[pair[0], pair[1]] = True
    return mask


def parse_plan(text: str, name: str = "plan") -> Plan:
    """Parse a plan, or raise GridFileError. The judge decides whether the plan is good."""
    try:
        document = parse_json(text)
        if not isinstance(document, dict):
            raise GridFileError("not a plan file (no object of H, W, starts, ...)")
        rows, columns = document["H"], document["W"]
        starts, actions = document["starts"], document["per_agent_actions"]
        sizes = _integers([rows, columns]) and min(rows, columns) > 0
        if not sizes or rows * columns > CELLS_MAX:
            raise GridFileError(f"H and W are not the sizes of a map of up to {CELLS_MAX} cells")
        walls = _mask(document["walls"], rows, columns, "walls")
        dirt = _mask(document["dirt"], rows, columns, "dirt") if "dirt" in document else ~walls
        robots = len(starts)
        if not all(_integers(start) and len(start) == 2 for start in starts):
            raise GridFileError("starts is not a list of [row, column]")
        if len(actions) != robots or not all(_integers(line) for line in actions):
            raise GridFileError("per_agent_actions is not one list of numbers for each start")
        if any(not 0 <= action < len(STEPS) for line in actions for action in line):
            raise GridFileError("an action is not 0, 1, 2, 3 or 4")
        extra = [document.get(key, []) for key in ("joined", "died")]
        if not all(_integers(line) and len(line) in (0, robots) for line in extra):
            raise GridFileError("joined and died need one number a robot")
        cells, joined = [(start[0], start[1]) for start in starts], extra[0] or [0] * robots
        makespan = max(map(len, actions), default=0)
        if not all(0 <= step <= makespan for step in joined):  # its robot would never be there
            raise GridFileError(f"joined holds a step that is not 0 to {makespan}, the plan's end")
        check_starts("starts", walls, [c for c, j in zip(cells, joined, strict=True) if j == 0])
        for robot, cell in enumerate(cells):  # a late one may start where another was before
            check_starts(f"start {robot}", walls, [cell])
        return Plan(walls, cells, actions, dirt, extra[0], extra[1])
    except GridFileError as error:
        raise GridFileError(f"{name}: {error}") from None
    except GivenFileError as problem:
        raise GridFileError(f"{name}: not a plan file ({problem})") from None
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise GridFileError(f"{name}: not a plan file ({type(error).__name__})") from error


def read_plan(path: Path) -> Plan:
    """Read and check a plan. Raises GridFileError, whose message names the path, if the file is
    unreadable, too large or no plan."""
    try:
        return parse_plan(read_text(path, PLAN_BYTES_MAX), str(path))
    except GivenFileError as problem:
        raise GridFileError(f"{path}: {problem}") from None
