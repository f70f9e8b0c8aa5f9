"""The pictures of a report, one chart each, from what `timeline` and `tracking_error` found."""

from base64 import b64decode
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from crdt import Phase
from sim.files import palette
from sim.record.scene import Scene
from tools.report.svg_chart import (
    FAR_PX,
    GAP_PX,
    LEGEND_ROW_PX,
    SMALL_PX,
    WIDTH_PX,
    Axes,
    AxisSpan,
    PlotBox,
    document,
    legend,
    legend_width,
    row_span,
    text,
    width_of,
)
from tools.report.timeline import SILENT, BusAddress, Stop, TimelineEvent, TimelineSpan

if TYPE_CHECKING:
    from tools.report.tracking_error import Following

LABELS_MAX = 12  # robots in a legend
KINDS_MAX = 7  # of frames with a colour of their own
BINS = 1200  # most points of the bus load: about as many as there are pixels
ROWS_MAX = 400  # most sections in the Gantt chart; more cannot be read
EVENT_ROWS_MAX = 16  # kinds of events
WORDS_SHARE, WORDS_MAX = 0.2, 36  # of the width for the words of an event, and their characters
LABEL_SHARE = 0.02  # of the width between the labels of two lines
FULL = 0.7  # share of the bus for which CAN is commonly planned
PLACE_MAX_M = 1e7  # a place farther away is nonsense: the Earth is not as large
CELLS_MAX = 4_000_000  # of a grid that is drawn
LEFT_PX, TOP_PX, BELOW_PX = 64.0, 12.0, 46.0  # margins for ticks and names of axes
MARKS_PX = 64.0  # above a chart with labelled lines
MAP_PX = 700.0  # most height of a map
STATES = {
    State.DISCONNECTED.name: "#d9d9d9", State.IDLE.name: "#9ecae1",
    State.SYNCHRONIZING.name: "#fdd0a2", State.WORKING.name: "#31a354",
    State.EMERGENCY_STOP.name: "#de2d26", SILENT: "#636363",
}  # fmt: skip
PHASES = {Phase.CLAIMED.name: 0.35, Phase.STARTED.name: 1.0, Phase.DONE.name: 0.12}
FAULT, OTHER = 'class="hl-fault-line"', 'stroke="#8a8a8a"'


class Drawn(NamedTuple):
    """A finished picture, in light or dark as the browser is set."""

    svg: bytes


def colour_of(slot: int | None) -> str:
    """Of a robot, the same as on the map; grey for None."""
    return "#777777" if slot is None else palette.colour_of(slot)


# -------------------------------------------------------------------- maps


class _Map:
    """A ground at one scale in both directions, with what lies on it."""

    def __init__(
        self, scene: Scene | None, lines: Iterable[Iterable[Point]], slots: Sequence[int]
    ) -> None:
        """`lines`: what has to be seen beside the scene. Nonsense in a scene raises TypeError,
        ValueError, KeyError, IndexError or OverflowError."""
        scene = scene or {}
        self.rings = [_xy([*ring, ring[0]]) for ring in scene.get("rings", [])]
        self.grid = _grid_of(scene.get("grid"))
        self.entries = (
            [(colour_of(slot), f"robot {slot}") for slot in slots]
            if len(slots) <= LABELS_MAX
            else []
        )
        corners = [] if self.grid is None else [self.grid.origin, self.grid.end]
        x, y = _bounds([*self.rings, *lines, corners])
        right = legend_width(name for _, name in self.entries)
        wide = WIDTH_PX - LEFT_PX - right
        scale = min(wide / (x.end - x.begin), MAP_PX / (y.end - y.begin))
        width, height = (x.end - x.begin) * scale, (y.end - y.begin) * scale
        # A narrow ground is not stretched; a flat one keeps room for the legend.
        grown = max(height, LEGEND_ROW_PX * len(self.entries), 60.0)
        more_m = (grown - height) / scale / 2
        y = AxisSpan(y.begin - more_m, y.end + more_m)
        self.axes = Axes(PlotBox(LEFT_PX, TOP_PX, width, grown), x, y)
        self.width_px = max(LEFT_PX + width + right, WIDTH_PX / 2)

    def picture(self, title: str, parts: Iterable[str]) -> Drawn:
        axes = self.axes
        ground = [] if self.grid is None else [self.grid.walls(axes)]
        fences = axes.lines(self.rings, "", 1.2, ' class="hl-edge"')
        key = legend(axes.box.left + axes.box.width + GAP_PX * 2, TOP_PX, self.entries)
        edges = [axes.x_ticks("east, m"), axes.y_ticks("north, m"), axes.frame(), key]
        height_px = TOP_PX + axes.box.height + BELOW_PX
        return Drawn(document(height_px, title, [*ground, *parts, fences, *edges], self.width_px))


class _Grid(NamedTuple):
    rows: int
    columns: int
    cell_m: float
    origin: Point
    bits: str

    @property
    def end(self) -> Point:
        west, south = self.origin
        return west + self.columns * self.cell_m, south + self.rows * self.cell_m

    def walls(self, axes: Axes) -> str:
        """One rectangle for each run of walls in a row."""
        found = []
        for row in range(self.rows):
            column = 0
            for wall, cells in groupby(self.bits[row * self.columns : (row + 1) * self.columns]):
                count = len(list(cells))
                if wall == "1":
                    x, y = axes.at(
                        self.origin[0] + column * self.cell_m,
                        self.origin[1] + (row + 1) * self.cell_m,
                    )
                    end_x, end_y = axes.at(
                        self.origin[0] + (column + count) * self.cell_m,
                        self.origin[1] + row * self.cell_m,
                    )
                    found.append(f"M{x:.1f} {y:.1f}H{end_x:.1f}V{end_y:.1f}H{x:.1f}z")
                column += count
        return f'<path d="{"".join(found)}" fill="#8a8a8a"/>\n'


def _grid_of(grid: Any) -> _Grid | None:
    if not grid:
        return None
    rows, columns, cell_m = int(grid["rows"]), int(grid["columns"]), float(grid["cell_m"])
    west, south = grid["origin"]
    data = b64decode(grid["walls"])
    if not (0 < rows * columns <= min(CELLS_MAX, 8 * len(data)) and cell_m > 0.0 and rows > 0):
        raise ValueError("a grid without its cells")
    bits = "".join(f"{byte:08b}" for byte in data)
    return _Grid(rows, columns, cell_m, (float(west), float(south)), bits)


def _xy(points: Iterable[Any]) -> list[Point]:
    return [(float(p[0]), float(p[1])) for p in points]


def _bounds(lines: Iterable[Iterable[Point]]) -> tuple[AxisSpan, AxisSpan]:
    """Around all finite places, with a margin; of a single place, a few metres."""
    west = south = inf
    east = north = -inf
    for line in lines:
        for x, y in line:
            if -PLACE_MAX_M < x < PLACE_MAX_M and -PLACE_MAX_M < y < PLACE_MAX_M:
                west, east = min(west, x), max(east, x)
                south, north = min(south, y), max(north, y)
    if west > east:
        return AxisSpan(0.0, 1.0), AxisSpan(0.0, 1.0)
    margin_m = max(0.03 * max(east - west, north - south), 0.5)
    return AxisSpan(west - margin_m, east + margin_m), AxisSpan(south - margin_m, north + margin_m)


def tracks(scene: Scene | None, places: dict[int, list[BusAddress]]) -> Drawn:
    """The field with its swaths and the positions that each robot reported."""
    ways = {slot: [(p.x_m, p.y_m) for p in track] for slot, track in sorted(places.items())}
    ground = _Map(scene, ways.values(), list(ways))
    axes = ground.axes
    swaths = [_xy(s) for section in (scene or {}).get("sections", []) for s in section["swaths"]]
    parts = [axes.lines(swaths, "", 0.8, ' class="hl-dim"')]
    for slot, way in ways.items():
        parts.append(axes.lines([way], colour_of(slot), 1.2))
    for slot, way in ways.items():
        parts.append(axes.dot(*way[-1], colour_of(slot), 4.5, f"robot {slot}"))
    return ground.picture("Tracks of the robots on their ground", parts)


def planned(scene: Scene | None, robots: "Sequence[Following]") -> Drawn:
    """Dotted what was planned, solid what was driven."""
    driven = {r.slot: [[(s.x_m, s.y_m) for s in run] for run in _runs(r)] for r in robots}
    meant = {r.slot: [line.tolist() for line in r.lines] for r in robots}
    seen = [line for lines in (*driven.values(), *meant.values()) for line in lines]
    ground = _Map(scene, seen, list(driven))
    parts = []
    for slot in driven:
        colour = colour_of(slot)
        dotted = ' stroke-dasharray="1.5 2.5" opacity="0.7"'
        parts.append(ground.axes.lines(meant[slot], colour, 2.0, dotted))
        parts.append(ground.axes.lines(driven[slot], colour, 1.0))
    return ground.picture("Planned ways, dotted, and driven ones", parts)


# -------------------------------------------------------------------- charts over time


def errors(robots: "Sequence[Following]") -> Drawn:
    """For each robot its distance to its planned line over time."""
    runs = {r.slot: [[(s.t_s, s.off_m) for s in run] for run in _runs(r)] for r in robots}
    every = [point for lines in runs.values() for line in lines for point in line]
    most = max((m for _, m in every if isfinite(m)), default=1.0)
    end_s = max((t for t, _ in every), default=1.0)
    begin_s = min((t for t, _ in every), default=0.0)
    entries = [(colour_of(r.slot), f"robot {r.slot}") for r in robots]
    box, key = _box(LEFT_PX, TOP_PX, 250.0, entries if len(robots) <= LABELS_MAX else [])
    axes = Axes(
        box, AxisSpan(begin_s, max(end_s, begin_s + 1e-3)), AxisSpan(0.0, (most or 1.0) * 1.05)
    )
    parts = [axes.x_ticks("s", grid=True), axes.y_ticks("off its line, m", grid=True)]
    parts += [axes.lines(lines, colour_of(slot), 0.9) for slot, lines in runs.items()]
    return _picture(axes, "Distance of each robot to its planned line", [*parts, key])


def _runs(robot: "Following") -> list[list[Any]]:
    """Samples without a gap between them: where nothing was measured, no line is drawn."""
    found: list[list[Any]] = []
    for sample in robot.samples:
        if not found or sample.t_s - found[-1][-1].t_s > 1.0:
            found.append([])
        found[-1].append(sample)
    return found


def gantt(held: Sequence[TimelineSpan], until_s: float, events: Sequence[TimelineEvent]) -> Drawn:
    """What happened, a row for each kind, and below it on the same axis a row for each section, in the
    order in which they were first claimed."""
    order = list(dict.fromkeys(span.subject for span in held))[:ROWS_MAX]
    row_of = {section: row for row, section in enumerate(order)}
    kinds = list(dict.fromkeys(event.kind for event in events))[:EVENT_ROWS_MAX]
    owners = sorted({span.owner for span in held if span.owner is not None})
    entries = [(colour_of(owner), f"robot {owner}") for owner in owners]
    names = [f"S{section}" for section in order]
    left = max(width_of(kinds), width_of(names), 40.0) + 2 * GAP_PX
    strip_px = 18.0 * len(kinds)
    rows_px = max(140.0, 12.0 * len(order))
    above = TOP_PX + strip_px + GAP_PX if kinds else TOP_PX
    box, key = _box(left, above, rows_px,
                    entries if len(owners) <= LABELS_MAX else [])  # fmt: skip
    time = AxisSpan(0.0, max(until_s, 1e-3))
    axes = Axes(box, time, row_span(len(order)))
    parts = []
    if kinds:
        strip = Axes(PlotBox(left, TOP_PX, box.width, strip_px), time, row_span(len(kinds)))
        parts.append(_strip(strip, kinds, events, until_s) + strip.frame())
    for s in held:
        if s.subject in row_of:
            owner = "nobody" if s.owner is None else f"robot {s.owner}"
            title = f"S{s.subject} {s.what.lower()}, {owner}, {s.from_s:.1f} to {s.until_s:.1f} s"
            parts.append(axes.bar(s.from_s, s.until_s, row_of[s.subject], colour_of(s.owner),
                                  PHASES.get(s.what, 0.5), title))  # fmt: skip
    parts += [axes.rows(names, SMALL_PX), axes.x_ticks("s"), key]
    parts.append(_marks(axes, [e for e in events if is_mark(e)], labelled=not kinds))
    return _picture(axes, "Events, and sections by the robot that has them", parts)


def is_mark(event: TimelineEvent) -> bool:
    """Whether it is a line through every chart: what was done to the fleet, stops and resets."""
    return event.kind.startswith("fault") or event.kind in ("stop", "reset")


def _strip(
    axes: Axes, kinds: Sequence[str], events: Sequence[TimelineEvent], until_s: float
) -> str:
    """A mark for each event, with its words where there is room for them."""
    row_of = {kind: row for row, kind in enumerate(kinds)}
    room_s, free_s = until_s * WORDS_SHARE, dict.fromkeys(kinds, -1.0)
    found = [axes.rows(kinds)]
    for event in events:
        row = row_of.get(event.kind)
        if row is None or not isfinite(event.t_s):
            continue
        words = " ".join(filter(None, (event.who, event.what)))
        found.append(axes.tick(event.t_s, row, FAULT if is_mark(event) else OTHER,
                               f"{event.t_s:.1f} s: {event.kind} {words}"))  # fmt: skip
        if event.t_s >= free_s[event.kind] and event.t_s + room_s <= until_s:
            x_px, y_px = axes.at(event.t_s + until_s * 0.005, row)
            found.append(text(x_px, y_px + SMALL_PX / 3, words[:WORDS_MAX], SMALL_PX))
            free_s[event.kind] = event.t_s + room_s
    return "".join(found)


def states(spans: Sequence[TimelineSpan], until_s: float, marks: Sequence[TimelineEvent]) -> Drawn:
    """For each robot a bar of its states over time, with lines for stops and resets."""
    robots = sorted({span.subject for span in spans})
    row_of = {slot: row for row, slot in enumerate(robots)}
    seen = {span.what for span in spans}
    entries = [(colour, name.lower()) for name, colour in STATES.items() if name in seen]
    rows_px = max(20.0 * len(robots), LEGEND_ROW_PX * len(entries), 60.0)
    box, key = _box(LEFT_PX, _above(marks), rows_px, entries)
    axes = Axes(box, AxisSpan(0.0, max(until_s, 1e-3)), row_span(len(robots)))
    parts = [
        axes.bar(s.from_s, s.until_s, row_of[s.subject], STATES.get(s.what, "#777777"), 1.0,
                 f"robot {s.subject} {s.what.lower()}, {s.from_s:.1f} to {s.until_s:.1f} s")
        for s in spans
    ]  # fmt: skip
    parts += [axes.rows([f"robot {slot}" for slot in robots]), axes.x_ticks("s"), key]
    return _picture(axes, "States of each robot", [*parts, _marks(axes, marks)])


def load(
    width_s: int,
    bins: Sequence[tuple[int, Counter[str]]],
    bitrate: int,
    marks: Sequence[TimelineEvent],
) -> Drawn:
    """Stacked by kind, the most frequent at the bottom."""
    total: Counter[str] = sum((bits for _, bits in bins), Counter())
    kinds = [kind for kind, _ in total.most_common(KINDS_MAX)]
    named, whole = set(kinds), width_s * bitrate
    names = [*kinds, "others"] if len(total) > len(kinds) else kinds
    entries = [(colour_of(k), name) for k, name in enumerate(names)]
    end_s = bins[-1][0] + width_s  # the last step has an end, too
    shares = [bits.total() / whole for _, bits in bins]
    most = max(shares, default=0.0)
    full = most > FULL / 2  # or its line would make all else small
    top = max(most, FULL if full else 0.0) * 1.05 or 1.0
    box, key = _box(LEFT_PX, _above(marks), 240.0, entries)
    axes = Axes(box, AxisSpan(0.0, max(end_s, 1e-3)), AxisSpan(0.0, top))
    parts = [axes.x_ticks("s", grid=True), axes.y_ticks("share of the bus", True, percent=True)]
    below = [0.0] * len(bins)
    for k, name in enumerate(names):
        above = [
            low + (bits[name] if name in named else
                   sum(n for kind, n in bits.items() if kind not in named)) / whole
            for low, (_, bits) in zip(below, bins, strict=True)
        ]  # fmt: skip
        edge = [*_steps(bins, above, end_s), *reversed(list(_steps(bins, below, end_s)))]
        parts.append(f'<path d="{axes.path([edge])}z" fill="{colour_of(k)}"/>\n')
        below = above
    if full:
        line = [(0.0, FULL), (end_s, FULL)]
        parts.append(axes.lines([line], "", 1.2, ' class="hl-edge" stroke-dasharray="2 3"'))
    return _picture(axes, "Load of the bus by kind of frame", [*parts, key, _marks(axes, marks)])


def _steps(
    bins: Sequence[tuple[int, Counter[str]]], values: Sequence[float], end_s: float
) -> Iterable[Point]:
    for k, ((second, _), value) in enumerate(zip(bins, values, strict=True)):
        yield second, value
        yield bins[k + 1][0] if k + 1 < len(bins) else end_s, value


def latencies(stops: Sequence[Stop]) -> Drawn:
    """A row for each press; a mark for each robot that answered it."""
    names = [f"{s.t_s:.1f} s, {s.by}" for s in stops]
    entries = [(colour, name) for name, colour, _, _ in LATENCIES]
    rows_px = min(max(20.0 * len(stops), LEGEND_ROW_PX * len(entries), 60.0), 3000.0)
    box, key = _box(width_of(names) + 2 * GAP_PX, TOP_PX, rows_px, entries)
    ms = [value * 1e3 for s in stops for *_, of in LATENCIES for value in of(s).values()]
    axes = Axes(box, AxisSpan(0.0, max(ms, default=0.0) * 1.05 or 1.0), row_span(len(stops)))
    parts = [axes.x_ticks("ms after the first frame of the press", grid=True), axes.rows(names)]
    for name, colour, radius_px, of in LATENCIES:
        parts += [
            axes.dot(after_s * 1e3, row, colour, radius_px,
                     f"robot {slot} {name}: {after_s * 1e3:.1f} ms")
            for row, stop in enumerate(stops) for slot, after_s in of(stop).items()
        ]  # fmt: skip
    return _picture(axes, "From each press until every robot stood", [*parts, key])


Latencies = Callable[[Stop], dict[int, float]]
LATENCIES: tuple[tuple[str, str, float, Latencies], ...] = (
    ("says it again", "#0072b2", 4.5, lambda stop: stop.echo_s),
    ("says it is stopped", "#e69f00", 4.0, lambda stop: stop.latch_s),
    ("stands", "#009e73", 3.0, lambda stop: stop.still_s),
)


# -------------------------------------------------------------------- what charts share


def _box(
    left_px: float, top_px: float, height_px: float, entries: Sequence[tuple[str, str]]
) -> tuple[PlotBox, str]:
    """The place of a chart beside its legend, and that legend."""
    right = legend_width(name for _, name in entries)
    box = PlotBox(left_px, top_px, WIDTH_PX - left_px - right, height_px)
    return box, legend(WIDTH_PX - right + 2 * GAP_PX, top_px, entries)


def _picture(axes: Axes, title: str, parts: Iterable[str]) -> Drawn:
    height_px = axes.box.top + axes.box.height + BELOW_PX
    return Drawn(document(height_px, title, [*parts, axes.frame()]))


def _above(marks: Sequence[TimelineEvent]) -> float:
    return MARKS_PX if marks else TOP_PX


def _marks(axes: Axes, marks: Sequence[TimelineEvent], labelled: bool = True) -> str:
    """A line for each mark. Labels that would cover each other are left out."""
    found, free_s = [], -1.0
    _, top, _, height = axes.box
    for event in sorted(marks, key=lambda event: event.t_s):
        x_px, _ = axes.at(event.t_s, axes.y.begin)
        if not abs(x_px) < FAR_PX:
            continue
        found.append(f'<path d="M{x_px:.1f} {top:.1f}v{height:.1f}" opacity="0.7" {FAULT}/>')
        if labelled and event.t_s >= free_s:
            name = event.kind.removeprefix("fault: ")
            found.append(
                text(x_px, top - 3.0, name, SMALL_PX, style='class="hl-fault"', turned=-60)
            )
            free_s = event.t_s + axes.x.end * LABEL_SHARE
    return "".join(found) + "\n"
