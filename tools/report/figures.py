"""The pictures of a report, one figure each, from what `history` and `followed` found."""

import io
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from math import isfinite
from typing import Any

from agent.interface.lifecycle import State
from crdt import Phase
from sim.files import palette
from sim.record.scene import Scene
from tools.report.timeline import SILENT, BusAddress, Stop, TimelineEvent, TimelineSpan
from tools.report.tracking_error import Following

Figure = Any  # matplotlib has no types
DPI = 110
LABELS_MAX = 12  # robots in a legend
KINDS_MAX = 7  # of frames with a colour of their own
BINS = 1200  # most points of the bus load: about as many as there are pixels
ROWS_MAX = 400  # most sections in the Gantt chart; more cannot be read
EVENT_ROWS_MAX = 16  # kinds of events
WORDS_SHARE, WORDS_MAX = 0.2, 36  # of the width for the words of an event, and their characters
LABEL_SHARE = 0.02  # of the width between the labels of two lines
FULL = 0.7  # share of the bus for which CAN is commonly planned
FAULT_COLOUR = "#b00020"
STATES = {
    State.DISCONNECTED.name: "#d9d9d9", State.IDLE.name: "#9ecae1",
    State.SYNCHRONIZING.name: "#fdd0a2", State.WORKING.name: "#31a354",
    State.EMERGENCY_STOP.name: "#de2d26", SILENT: "#636363",
}  # fmt: skip
# Ground, text and plain lines of a picture where the browser is set to dark; robots keep their colours.
DARK = b"""<style>@media (prefers-color-scheme: dark) {
[style*="fill: #ffffff"] { fill: #12181b !important } g[id^="text_"] { fill: #e6edf0 }
[style*="stroke: #000000"], [style*="stroke: #4c4c4c"] { stroke: #a5b4bc !important }
[style*="stroke: #d9d9d9"] { stroke: #38474f !important } }</style>"""
PHASES = {Phase.CLAIMED.name: 0.35, Phase.STARTED.name: 1.0, Phase.DONE.name: 0.12}


def figure_of(width: float, height: float) -> tuple[Figure, Any]:
    """A figure of this width and height, in inches of `DPI` pixels, and its axes. Without pyplot:
    nothing is kept, and no screen is looked for."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from tools.report.laid_out_figure import LaidOutFigure

    figure = LaidOutFigure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


class Drawn:
    """A finished picture, as SVG for the page and as PNG for Python. What another process gets of it is
    the SVG."""

    def __init__(self, figure: Figure) -> None:
        self._figure = figure

    def __getstate__(self) -> dict[str, bytes]:
        return {"svg": self.svg}

    @cached_property
    def svg(self) -> bytes:
        """In light or dark, as the browser is set. Figures that are alike give the same bytes."""
        from matplotlib import rc_context

        buffer = io.BytesIO()
        with rc_context({"svg.hashsalt": "headland"}):
            self._figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        head, end, rest = buffer.getvalue().partition(b"<defs>")
        return head + DARK + end + rest

    @cached_property
    def png(self) -> bytes:
        """In light colours."""
        buffer = io.BytesIO()
        self._figure.savefig(buffer, format="png")
        return buffer.getvalue()


def colour_of(slot: int | None) -> Any:
    """Of a robot, the same as on the map; grey for None."""
    return "#777777" if slot is None else palette.colour_of(slot)


def _legend(axes: Any, robots: int) -> None:
    if robots <= LABELS_MAX:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)


def _ground(axes: Any, scene: Scene | None) -> None:
    """Fences, rows and walls, if the run has recorded them."""
    scene = scene or {}
    for ring in scene.get("rings", []):
        axes.plot([p[0] for p in (*ring, ring[0])], [p[1] for p in (*ring, ring[0])],
                  color="0.3", linewidth=1.0)  # fmt: skip
    grid = scene.get("grid")
    if grid:
        from base64 import b64decode

        import numpy as np

        rows, columns = int(grid["rows"]), int(grid["columns"])
        bits = np.unpackbits(np.frombuffer(b64decode(grid["walls"]), np.uint8))
        west, south = grid["origin"]
        box = (west, west + columns * grid["cell_m"], south, south + rows * grid["cell_m"])
        axes.imshow(bits[: rows * columns].reshape(rows, columns), origin="lower", extent=box,
                    cmap="Greys", vmax=2.0)  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")


def tracks(scene: Scene | None, places: dict[int, list[BusAddress]]) -> Figure:
    """The field with its swaths and the positions that each robot reported."""
    figure, axes = figure_of(10, 8)
    for section in (scene or {}).get("sections", []):
        for swath in section["swaths"]:
            axes.plot([p[0] for p in swath], [p[1] for p in swath], color="0.85", linewidth=0.6)
    _ground(axes, scene)
    for slot, track in sorted(places.items()):
        axes.plot([p.x_m for p in track], [p.y_m for p in track], color=colour_of(slot),
                  linewidth=0.9, label=f"robot {slot}")  # fmt: skip
        axes.plot([track[-1].x_m], [track[-1].y_m], "o", color=colour_of(slot), markersize=5)
    _legend(axes, len(places))
    return figure


def planned(scene: Scene | None, robots: Sequence[Following]) -> Figure:
    """Dotted what was planned, solid what was driven."""
    figure, axes = figure_of(10, 8)
    _ground(axes, scene)
    for robot in robots:
        colour, told = colour_of(robot.slot), False
        for line in robot.lines:
            axes.plot(line[:, 0], line[:, 1], ":", color=colour, linewidth=1.6, alpha=0.6)
        for run in _runs(robot):
            axes.plot([s.x_m for s in run], [s.y_m for s in run], color=colour, linewidth=0.8,
                      label=None if told else f"robot {robot.slot}")  # fmt: skip
            told = True
    _legend(axes, len(robots))
    return figure


def errors(robots: Sequence[Following]) -> Figure:
    """For each robot its distance to its planned line over time."""
    figure, axes = figure_of(10, 3.2)
    for robot in robots:
        for k, run in enumerate(_runs(robot)):
            axes.plot([s.t_s for s in run], [s.off_m for s in run], color=colour_of(robot.slot),
                      linewidth=0.7, label=None if k else f"robot {robot.slot}")  # fmt: skip
    axes.set_xlabel("s")
    axes.set_ylabel("off its line, m")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    _legend(axes, len(robots))
    return figure


def _runs(robot: Following) -> list[list[Any]]:
    """Samples without a gap between them: where nothing was measured, no line is drawn."""
    found: list[list[Any]] = []
    for sample in robot.samples:
        if not found or sample.t_s - found[-1][-1].t_s > 1.0:
            found.append([])
        found[-1].append(sample)
    return found


def gantt(held: Sequence[TimelineSpan], until_s: float, events: Sequence[TimelineEvent]) -> Figure:
    """What happened, a row for each kind, and below it on the same axis a row for each section, in the
    order in which they were first claimed."""
    from matplotlib.patches import Patch

    order = list(dict.fromkeys(span.who for span in held))[:ROWS_MAX]
    row_of = {section: row for row, section in enumerate(order)}
    kinds = list(dict.fromkeys(event.kind for event in events))[:EVENT_ROWS_MAX]
    heights = (0.22 * len(kinds) + 0.1, min(max(2.0, 0.16 * len(order)), 40))
    figure, axes = figure_of(10, sum(heights) + 0.9)
    if kinds:
        axes.remove()
        strip, axes = figure.subplots(2, 1, sharex=True, height_ratios=heights)
        _strip(strip, kinds, events, until_s)
    groups: dict[tuple[int | None, str], list[TimelineSpan]] = {}
    for span in held:
        if span.who in row_of:
            groups.setdefault((span.owner, span.what), []).append(span)
    for (owner, what), spans in groups.items():
        axes.barh([row_of[s.who] for s in spans], [s.until_s - s.from_s for s in spans],
                  left=[s.from_s for s in spans], height=0.8, color=colour_of(owner),
                  alpha=PHASES.get(what, 0.5))  # fmt: skip
    owners = sorted({span.owner for span in held if span.owner is not None})
    patches = [Patch(color=colour_of(owner), label=f"robot {owner}") for owner in owners]
    if len(owners) <= LABELS_MAX:
        axes.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8,
                    frameon=False)  # fmt: skip
    axes.set_yticks(range(len(order)), [f"S{section}" for section in order], fontsize=6)
    axes.set_ylim(len(order) - 0.4, -0.6)
    _time(axes, until_s, [e for e in events if is_mark(e)], labelled=not kinds)
    return figure


def is_mark(event: TimelineEvent) -> bool:
    """Whether it is a line through every chart: what was done to the fleet, stops and resets."""
    return event.kind.startswith("fault") or event.kind in ("stop", "reset")


def _strip(
    axes: Any, kinds: Sequence[str], events: Sequence[TimelineEvent], until_s: float
) -> None:
    """A mark for each event, with its words where there is room for them."""
    row_of = {kind: row for row, kind in enumerate(kinds)}
    room_s, free_s = until_s * WORDS_SHARE, dict.fromkeys(kinds, -1.0)
    for event in events:
        row = row_of.get(event.kind)
        if row is None or not isfinite(event.t_s):
            continue
        axes.plot([event.t_s], [row], "|", color=FAULT_COLOUR if is_mark(event) else "#777777")
        if event.t_s >= free_s[event.kind] and event.t_s + room_s <= until_s:
            words = " ".join(filter(None, (event.who, event.what)))[:WORDS_MAX]
            axes.text(event.t_s + until_s * 0.005, row, words, fontsize=6, va="center")
            free_s[event.kind] = event.t_s + room_s
    axes.set_yticks(range(len(kinds)), kinds, fontsize=7)
    axes.set_ylim(len(kinds) - 0.4, -0.6)


def states(spans: Sequence[TimelineSpan], until_s: float, marks: Sequence[TimelineEvent]) -> Figure:
    """For each robot a bar of its states over time, with lines for stops and resets."""
    from matplotlib.patches import Patch

    robots = sorted({span.who for span in spans})
    row_of = {slot: row for row, slot in enumerate(robots)}
    figure, axes = figure_of(10, max(2.0, 0.26 * len(robots) + 1.0))
    for name in STATES:
        bars = [span for span in spans if span.what == name]
        axes.barh([row_of[s.who] for s in bars], [s.until_s - s.from_s for s in bars],
                  left=[s.from_s for s in bars], height=0.8, color=STATES[name])  # fmt: skip
    seen = {span.what for span in spans}
    axes.legend(handles=[Patch(color=c, label=name) for name, c in STATES.items() if name in seen],
                loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)  # fmt: skip
    axes.set_yticks(range(len(robots)), [f"robot {slot}" for slot in robots], fontsize=8)
    axes.set_ylim(len(robots) - 0.4, -0.6)
    _time(axes, until_s, marks)
    return figure


def load(
    width_s: int,
    bins: Sequence[tuple[int, Counter[str]]],
    bitrate: int,
    marks: Sequence[TimelineEvent],
) -> Figure:
    """Stacked by kind, the most frequent at the bottom."""
    total: Counter[str] = sum((bits for _, bits in bins), Counter())
    kinds = [kind for kind, _ in total.most_common(KINDS_MAX)]
    figure, axes = figure_of(10, 3.6)
    bins = [*bins, (bins[-1][0] + width_s, bins[-1][1])]  # the last step has an end, too
    t_s = [second for second, _ in bins]
    rows = [[bits[kind] / (width_s * bitrate) for _, bits in bins] for kind in kinds]
    names = list(kinds)
    if len(total) > len(kinds):
        named = set(kinds)
        rows.append(
            [sum(n for kind, n in bits.items() if kind not in named) / (width_s * bitrate)
             for _, bits in bins]
        )  # fmt: skip
        names.append("others")
    axes.stackplot(t_s, rows, labels=names, step="post", colors=[colour_of(k) for k in range(8)])
    if max(map(sum, zip(*rows, strict=True))) > FULL / 2:  # or it would make all else small
        axes.axhline(FULL, color="0.4", linestyle=":", linewidth=1.0)
    axes.set_ylabel("share of the bus")
    axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7, frameon=False)
    _time(axes, bins[-1][0], marks)
    return figure


def latencies(stops: Sequence[Stop]) -> Figure:
    """A row for each press; a mark for each robot that answered it."""
    figure, axes = figure_of(10, min(max(2.2, 0.22 * len(stops) + 1.2), 30))
    for name, mark, colour, of in LATENCIES:
        points = [(ms * 1e3, row) for row, stop in enumerate(stops) for ms in of(stop).values()]
        axes.plot([x for x, _ in points], [y for _, y in points], mark, color=colour,
                  label=name, markersize=5)  # fmt: skip
    axes.set_yticks(range(len(stops)), [f"{s.t_s:.1f} s, {s.by}" for s in stops], fontsize=7)
    axes.set_ylim(len(stops) - 0.4, -0.6)
    axes.set_xlabel("ms after the first frame of the press")
    axes.set_xlim(left=0.0)
    axes.grid(alpha=0.3, axis="x")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    return figure


Latencies = Callable[[Stop], dict[int, float]]
LATENCIES: tuple[tuple[str, str, str, Latencies], ...] = (
    ("says it again", "|", "#0072b2", lambda stop: stop.echo_s),
    ("says it is stopped", ".", "#e69f00", lambda stop: stop.latch_s),
    ("stands", "s", "#009e73", lambda stop: stop.still_s),
)


def _time(axes: Any, until_s: float, marks: Sequence[TimelineEvent], labelled: bool = True) -> None:
    """The axis of seconds, and a line for each mark. Labels that would cover each other are left out."""
    end_s, free_s = max(until_s, 1e-3), -1.0
    for event in sorted(marks, key=lambda event: event.t_s):
        if not isfinite(event.t_s):
            continue
        axes.axvline(event.t_s, color=FAULT_COLOUR, linewidth=0.8, alpha=0.6)
        if labelled and event.t_s >= free_s:
            axes.text(event.t_s, 1.01, event.kind.removeprefix("fault: "), fontsize=6, rotation=60,
                      transform=axes.get_xaxis_transform(), color=FAULT_COLOUR)  # fmt: skip
            free_s = event.t_s + end_s * LABEL_SHARE
    axes.set_xlim(0.0, end_s)
    axes.set_xlabel("s")
