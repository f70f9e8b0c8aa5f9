"""The ways of a MAPF run as one picture: walls, each robot's way, its start and its goal."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Cell
from sim.files.whole_file import whole_file
from tools.run.plain_text import plain_text

INCHES, DOTS = 8.0, 120


@plain_text()
def draw_ways(
    path: Path, walls: NDArray[np.bool_], steps: Sequence[Sequence[Cell]], goals: Sequence[Cell],
    title: str,
) -> None:  # fmt: skip
    """Write a .png, .svg or .pdf. `walls`: (rows, columns). `steps`: the cells of all robots
    at each time."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    rows, columns = walls.shape
    wide = INCHES * min(2.0, max(1.0, columns / rows))
    figure = Figure((wide, wide * rows / columns + 0.6), dpi=DOTS, layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(walls, cmap="Greys", vmin=0, vmax=2)
    ways = np.array(steps)  # (times, robots, 2)
    for robot, goal in enumerate(goals):
        colour = colormaps["turbo"]((robot + 0.5) / len(goals))
        axes.plot(ways[:, robot, 1], ways[:, robot, 0], color=colour, linewidth=1.2, alpha=0.8)
        axes.plot(*ways[0, robot, ::-1], "o", color=colour, markersize=4)
        axes.plot(goal[1], goal[0], "*", color=colour, markersize=8, markeredgecolor="black",
                  markeredgewidth=0.4)  # fmt: skip
    axes.set_title(title)
    axes.set_axis_off()
    with whole_file(path) as part:
        figure.savefig(part)
