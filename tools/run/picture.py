"""Pictures of a finished run: the field, its sections, and where each robot drove."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

from agent.field.field_map import Field
from sim.files.palette import colour_of

Track = Sequence[tuple[float, float, bool]]  # x, y in metres, implement down


def draw_field(field: Field, tracks: Mapping[int, Track], title: str, out: Path) -> None:
    """One PNG: boundary, holes, tracks with the implement down in the robot's colour."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.collections import LineCollection

    figure, axes = pyplot.subplots(figsize=(10, 10), dpi=110)
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
    axes.plot([field.gate[0]], [field.gate[1]], "k^", markersize=10, label="gate")
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_title(title)
    axes.legend(loc="upper right", fontsize=8)
    figure.tight_layout()
    figure.savefig(out)
    pyplot.close(figure)
