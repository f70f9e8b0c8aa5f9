"""What one peer on a grid hears and may do, as a PettingZoo `ParallelEnv`.

    env = MapfEnvironment(instance, loss=0.02, seed=1)
    observations, _ = env.reset()
    observations, rewards, terminations, truncations, infos = env.step(actions)

No robot sees the whole: it knows the map and its own place and goal, sees bodies within `SIGHT`
cells, and hears where others were when their last frame came through. Frames are lost, one by one,
for each receiver. Two robots that would meet both stay, as the guard on a real one makes them
(`agent/coverage/proximity_guard.py`). The bus, its load and the rounds of agreement are not in it:
for these there is `headland mapf`.
"""

from random import Random
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box, Dict, Discrete
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from agent.interface.geometry import Cell
from sim.files.mapf_scenario import MapfInstance

MOVES: tuple[Cell, ...] = (
    (0, 0),
    (-1, 0),
    (1, 0),
    (0, -1),
    (0, 1),
)  # stay, north, south, west, east
SIGHT = 2  # cells, as far as a body on a grid sees others
WALL, BODY = 1.0, 2.0  # in `seen`
UNHEARD = -1
STEPS_MAX = 1000
STEP_REWARD, GOAL_REWARD = -1.0, 0.0  # so the sum of rewards is minus the sum of costs


class MapfEnvironment(ParallelEnv):
    """Robots `robot_0`, `robot_1` and so on, with one action each in every unit of time."""

    metadata: ClassVar[dict[str, Any]] = {"name": "headland_mapf_v0", "render_modes": ["ansi"]}
    render_mode = "ansi"

    def __init__(
        self, instance: MapfInstance, loss: float = 0.0, seed: int = 0, steps_max: int = STEPS_MAX
    ) -> None:
        """`loss`: the odds that a receiver misses a frame, 0 to 1."""
        assert 0.0 <= loss <= 1.0 and steps_max > 0
        self.instance, self.loss, self.seed, self.steps_max = instance, loss, seed, steps_max
        self.possible_agents = [f"robot_{k}" for k in range(len(instance.starts))]
        self.agents: list[str] = []
        self.places: list[Cell] = []
        self.heard: NDArray[np.int32] = np.empty(
            (0, 0, 3), np.int32
        )  # (hearer, of, row column age)
        self.time = 0
        count, side = len(instance.starts), 2 * SIGHT + 1
        most = max(*instance.walls.shape, steps_max)
        self._actions = {agent: Discrete(len(MOVES)) for agent in self.possible_agents}
        self._space = Dict({
            "place": Box(0, most, (2,), np.int32), "goal": Box(0, most, (2,), np.int32),
            "seen": Box(0.0, BODY, (side, side), np.float32),
            "heard": Box(UNHEARD, most, (count, 3), np.int32),
        })  # fmt: skip

    def observation_space(self, agent: str) -> Any:
        """`place`, `goal`: (row, column). `seen`: the cells around, 1 wall, 2 body. `heard`: for
        each robot (row, column, age in steps), -1 if nothing was heard yet."""
        return self._space

    def action_space(self, agent: str) -> Any:
        """An index into `MOVES`."""
        return self._actions[agent]

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        """Robots at their starts; each has heard of those whose first frame came through."""
        self.seed = self.seed if seed is None else seed
        self._rng = Random(f"{self.seed}/environment")
        self.agents, self.time = list(self.possible_agents), 0
        self.places = list(self.instance.starts)
        count = len(self.places)
        self.heard = np.full((count, count, 3), UNHEARD, np.int32)
        self._tell()
        return self._observed(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> tuple[Any, Any, Any, Any, Any]:
        """One unit of time. It is over for all when all are at their goals, or after `steps_max`."""
        wishes = []
        for agent, (row, column) in zip(self.possible_agents, self.places, strict=True):
            down, right = MOVES[int(actions.get(agent, 0))]
            cell = (row + down, column + right)
            wishes.append(cell if self._is_free(cell) else (row, column))
        self.places = _without_conflicts(self.places, wishes)
        self.time += 1
        self._tell()
        there = [a == b for a, b in zip(self.places, self.instance.goals, strict=True)]
        rewards = {
            agent: GOAL_REWARD if at else STEP_REWARD
            for agent, at in zip(self.possible_agents, there, strict=True)
        }
        over, late = all(there), self.time >= self.steps_max
        ends = dict.fromkeys(self.possible_agents, over)
        cut = dict.fromkeys(self.possible_agents, late and not over)
        infos: dict[str, dict[str, Any]] = {agent: {} for agent in self.possible_agents}
        observed = self._observed()
        if over or late:
            self.agents = []
        return observed, rewards, ends, cut, infos

    def render(self) -> str:
        """The map as text: `@` for walls, the last digit of each robot's number."""
        rows = [["@" if wall else "." for wall in row] for row in self.instance.walls.tolist()]
        for number, (row, column) in enumerate(self.places):
            rows[row][column] = str(number % 10)
        return "\n".join(map("".join, rows))

    def _is_free(self, cell: Cell) -> bool:
        row, column = cell
        rows, columns = self.instance.walls.shape
        return 0 <= row < rows and 0 <= column < columns and not self.instance.walls[cell]

    def _tell(self) -> None:
        """Each robot sends its place; each of the others hears it or does not."""
        self.heard[:, :, 2] += self.heard[:, :, 2] >= 0
        for of, place in enumerate(self.places):
            for hearer in range(len(self.places)):
                if hearer == of or self._rng.random() >= self.loss:
                    self.heard[hearer, of] = (*place, 0)

    def _observed(self) -> dict[str, dict[str, NDArray[Any]]]:
        found = {}
        there = set(self.places)
        for number, agent in enumerate(self.possible_agents):
            row, column = self.places[number]
            seen = np.zeros((2 * SIGHT + 1, 2 * SIGHT + 1), np.float32)
            for i in range(-SIGHT, SIGHT + 1):
                for j in range(-SIGHT, SIGHT + 1):
                    cell = (row + i, column + j)
                    if not self._is_free(cell):
                        seen[i + SIGHT, j + SIGHT] = WALL
                    elif cell in there and (i, j) != (0, 0):
                        seen[i + SIGHT, j + SIGHT] = BODY
            found[agent] = {
                "place": np.array((row, column), np.int32),
                "goal": np.array(self.instance.goals[number], np.int32),
                "seen": seen, "heard": self.heard[number].copy(),
            }  # fmt: skip
        return found


def _without_conflicts(places: list[Cell], wishes: list[Cell]) -> list[Cell]:
    """Where robots are after a step: those that would share or exchange cells stay, and so do those
    that would then run into them."""
    came = {place: k for k, place in enumerate(places)}
    after = list(wishes)
    changed = True
    while changed:
        changed = False
        wanted: dict[Cell, list[int]] = {}
        for k, cell in enumerate(after):
            wanted.setdefault(cell, []).append(k)
        for k, cell in enumerate(after):
            if cell == places[k]:
                continue
            other = came.get(cell)
            swap = other is not None and after[other] == places[k]
            if len(wanted[cell]) > 1 or swap:
                after[k], changed = places[k], True
    return after
