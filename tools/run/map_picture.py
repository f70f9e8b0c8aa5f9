"""Pictures of an exploration: the joined map, each robot's own, what each saw, and a film of it."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.files.palette import colour_of, rgb_of
from sim.files.whole_file import whole_file
from sim.runs.exploration_run import ExplorationOutcome, ExplorationRun
from tools.common.counted import counted
from tools.run.plain_text import plain_text

GREYS = np.array([0.75, 1.0, 0.1])  # unknown, free, obstacle
FRAME_MS = 250


def _plain(axes: Any, run: ExplorationRun, values: NDArray[np.int64], title: str) -> None:
    axes.imshow(GREYS[values], origin="lower", extent=_extent(run), cmap="gray", vmin=0, vmax=1)
    _label(axes, title)


def _label(axes: Any, title: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)


def _first_seen_by(axes: Any, run: ExplorationRun, first: NDArray[np.int64], title: str) -> None:
    """Each cell in the colour of the robot that saw it first."""
    picture = np.ones((*first.shape, 3))
    for slot in np.unique(first[first >= 0]).tolist():
        picture[first == slot] = rgb_of(slot)
    picture[first < 0] = 0.85
    picture[run.setting.solid] = 0.1
    axes.imshow(picture, origin="lower", extent=_extent(run))
    _label(axes, title)


def _extent(run: ExplorationRun) -> tuple[float, float, float, float]:
    rows, columns, (west, south), cell_m = run.setting.geometry
    return west, west + columns * cell_m, south, south + rows * cell_m


@plain_text()
def draw_maps(run: ExplorationRun, outcome: ExplorationOutcome, out: Path) -> None:
    """One PNG: the joined map with the paths driven, which robot saw what first, and each robot's map."""
    from matplotlib.figure import Figure

    assert run.joined is not None
    slots = sorted(run.charts)
    columns = min(4, len(slots) + 2)
    rows = -(-(len(slots) + 2) // columns)
    size = (4 * columns, 4 * rows)
    figure = Figure(figsize=size, dpi=100)
    grid = figure.subplots(rows, columns, squeeze=False)
    places = list(grid.flat)
    title = f"joined map, {100 * outcome.explored:.1f} % in {outcome.time_s:.0f} s"
    _plain(places[0], run, run.joined.values(), title)
    for slot, track in run.tracks.items():
        xy = np.array([(x, y) for _, x, y, _ in track])
        places[0].plot(xy[:, 0], xy[:, 1], color=colour_of(slot), linewidth=0.8)
    again = f"{100 * outcome.overlap_end:.0f} % seen again by another"
    _first_seen_by(places[1], run, run.seen.first, f"which robot saw it first; {again}")
    for axes, slot in zip(places[2:], slots, strict=False):
        _plain(axes, run, run.charts[slot], f"what robot {slot} saw itself")
    for axes in places[2 + len(slots) :]:
        axes.set_axis_off()
    figure.suptitle(
        f"{outcome.scenario}: {counted(outcome.robots, '{} robot{s}')}, seed {outcome.seed}",
        fontsize=11,
    )
    figure.tight_layout()
    with whole_file(out) as part:
        figure.savefig(part)


def film(run: ExplorationRun, out: Path) -> None:
    """A GIF of both as they grow: the map of one robot after another, and which robot saw what first."""
    from matplotlib.animation import FuncAnimation, PillowWriter
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), dpi=80)
    (left, right) = figure.subplots(1, 2)

    def draw(number: int) -> None:
        still = run.films[number]
        left.clear()
        right.clear()
        _plain(left, run, still.values, f"{still.now_s:.0f} s, as robot {still.slot} knows it")
        _first_seen_by(right, run, still.first, "which robot saw it first")
        for slot, (x_m, y_m) in still.places.items():
            for axes, edge in ((left, "none"), (right, "black")):
                axes.plot([x_m], [y_m], "o", color=colour_of(slot), markeredgecolor=edge,
                          markersize=5)  # fmt: skip

    movie = FuncAnimation(figure, draw, frames=len(run.films))
    with whole_file(out) as part:
        movie.save(part, writer=PillowWriter(fps=1000 // FRAME_MS))
