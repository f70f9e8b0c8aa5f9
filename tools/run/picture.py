"""Pictures of a finished run: the field, its sections, and where each robot drove."""

import itertools
from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.field.field_map import Field
from sim.files.palette import colour_of
from sim.files.whole_file import whole_file
from tools.run.plain_text import plain_text

Cells = NDArray[np.float64]
LEFT = "#d62728"  # ground that was not worked
SIDE_IN, LEGEND_IN = (
    9.0,
    1.6,
)  # longest side of the field in the picture, and what is beside it, inches
BESIDE_IN, LEGEND_LINE_IN = 0.9, 0.2  # title and axis of east; a line of the legend, inches
# What can be marked, as matplotlib draws it.
MARKS = {"crash": "x", "box": "s", "stop pressed": "8", "person, vehicle": "D"}


class PlaceMark(NamedTuple):
    """Where something happened: one of MARKS."""

    what: str
    x_m: float
    y_m: float


Track = Sequence[tuple[float, float, bool]]  # x, y in metres, implement down


@plain_text()
def draw_field(
    field: Field, tracks: Mapping[int, Track], title: str, out: Path, missed: Cells | None = None,
    marks: Sequence[PlaceMark] = (),
) -> None:  # fmt: skip
    """One PNG: boundary, holes, tracks with the implement down in the robot's colour.

    `missed`: (n, 2), centres of the cells that could have been worked and were not, metres.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    wide_in, high_in = _size_in(field)
    # Two more than tracks and marks: the gate, and what is not worked.
    lines = len(tracks) + len({what for what, *_ in marks}) + 2
    columns = ceil(lines / max(1, int((high_in - BESIDE_IN) / LEGEND_LINE_IN)))
    figure = Figure(figsize=(wide_in + LEGEND_IN * (columns - 1), high_in), dpi=110)
    axes = figure.subplots()
    if missed is not None and len(missed):
        axes.plot(*missed.T, "s", color=LEFT, markersize=2, alpha=0.5, label="not worked", zorder=0)
    for ring in (field.exterior, *field.holes):
        closed = [*ring, ring[0]]
        axes.plot([p[0] for p in closed], [p[1] for p in closed], color="0.2", linewidth=1.2)
    for hole in field.holes:
        axes.fill([p[0] for p in hole], [p[1] for p in hole], color="0.85")
    for slot, track in sorted(tracks.items()):
        colour = colour_of(slot)
        for tool_on, width, alpha in ((False, 0.6, 0.5), (True, 2.2, 0.75)):
            pieces = [
                ((a[0], a[1]), (b[0], b[1]))
                for a, b in itertools.pairwise(track)
                if (a[2] and b[2]) is tool_on
            ]
            style = "solid" if tool_on else "dotted"
            axes.add_collection(
                LineCollection(
                    pieces, colors=[colour], linewidths=width, alpha=alpha, linestyles=style
                )
            )
        if track:
            axes.plot(
                [track[-1][0]],
                [track[-1][1]],
                "o",
                color=colour,
                markersize=7,
                label=f"robot {slot}",
            )
    named = set()
    for what, x_m, y_m in marks:
        name = what if what not in named else "_"  # once in the legend
        named.add(what)
        axes.plot([x_m], [y_m], MARKS[what], color="k", markersize=11, markeredgewidth=2.2,
                  markerfacecolor="none", label=name)  # fmt: skip
    axes.plot([field.gate[0]], [field.gate[1]], "k^", markersize=10, label="gate")
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_title(title)
    beside = (1.01, 0.5)  # it covers no track
    axes.legend(loc="center left", bbox_to_anchor=beside, fontsize=8, ncols=columns)
    figure.tight_layout()
    with whole_file(out) as part:
        figure.savefig(part)


def _size_in(field: Field) -> tuple[float, float]:
    """Of the picture: as long and as high as the field is, without empty margins."""
    x_m, y_m = zip(*field.exterior, strict=True)
    wide_m, high_m = max(x_m) - min(x_m), max(y_m) - min(y_m)
    scale = SIDE_IN / max(wide_m, high_m, 1e-9)
    return max(wide_m * scale, 3.0) + LEGEND_IN, max(high_m * scale, 3.0) + BESIDE_IN
