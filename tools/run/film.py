"""A short film of a recorded run: the fleet at work, what happened to it, and the work done so far.

The film shows what a listener on the bus knew, as the map does. It is drawn with Pillow: each picture
at twice its size, then made smaller, so that lines are smooth. GIF and WebP play in every browser.
"""

import textwrap
from base64 import b64decode
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console
from rich.progress import Progress

from crdt.progress import BLOCK_UNITS
from sim.files.palette import ROBOTS
from sim.files.whole_file import whole_file
from sim.record.recording import Recording
from tools.common.progress import shows_progress
from tools.inspect.inspector import SILENT_S
from tools.livemap.event_notes import NotedEvent
from tools.livemap.map_state import Watcher
from tools.livemap.playback import Index, Player

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

FILM_S = 20.0  # long enough for four events with 4 s each, short enough for a README
PICTURES_S = 10  # pictures a second: a robot at ten times its speed still moves smoothly
WIDE, HIGH = 880, 480  # pixels; a README on GitHub is 880 wide
SIDE = 250  # pixels of the column with robots and events
DENSE = 2  # drawn that much larger
MARGIN, FOOT = 26, 34  # pixels around the field, and for the line of time
CAPTION_S = 2.6  # of the film: a caption of seven words is read in two
COLOURS = 96  # chosen by area, for smooth edges; the named ones below come beside them
ROBOTS_NAMED = 20  # whose colours are in the palette for certain
SAMPLES = 8  # pictures from which the palette is made
READ_S = 60.0  # budget of one step; a recording in memory is read in far less
EVENTS = 6  # lines that fit under the robots
FORMATS = (".gif", ".webp")
INK, PAPER, PANEL, DIM, GRID = "#e6edf0", "#0e1316", "#151c20", "#9db0ba", "#26323a"
FIELD, HOLE, FENCE, FREE, OPEN, WALL = (
    "#18221d", "#0a0e10", "#7d8f86", "#31423a", "#2c3f4a", "#dfe9ee",
)  # fmt: skip
GROUND = (INK, PAPER, PANEL, DIM, GRID, FIELD, HOLE, FENCE, FREE, OPEN, WALL)
MARKS = {
    "stop": "#f5222d", "split": "#ffb020", "silent": "#ffb020", "takeover": "#ffb020",
    "reset": "#4fd17c", "back": "#4fd17c",
}  # fmt: skip
STOPPED = "#f5222d"


class FilmError(Exception):
    """One line for the person."""


class View(NamedTuple):
    """Where a place of the field is in a picture."""

    scale: float  # pixels for a metre
    left: float
    foot: float

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        """The point in pixels, from the left and from the top."""
        return self.left + x_m * self.scale, self.foot - y_m * self.scale


def write_film(
    recording: Recording, out: Path, film_s: float = FILM_S,
    on_picture: Callable[[int, int], None] | None = None,
) -> int:  # fmt: skip
    """The number of pictures. `recording`: ended, with its scene. `on_picture`: told the pictures drawn
    and all of them. Raises FilmError where there is nothing to show or no format for the name."""
    if out.suffix.lower() not in FORMATS:
        raise FilmError(f"{out}: a film is a .gif or a .webp")
    if not recording.count or recording.scene is None:
        raise FilmError("the recording has no frames or no scene, so there is nothing to show")
    try:
        from PIL import Image
    except ImportError:
        raise FilmError("--film needs Pillow: pip install 'headland[sim]'") from None
    count = max(2, round(film_s * PICTURES_S))
    pictures: list[Image.Image] = []
    for picture in _Film(recording, film_s).pictures(count):
        pictures.append(picture)
        if on_picture is not None:
            on_picture(len(pictures), count)
    duration_ms = round(1000 / PICTURES_S)
    shared: dict[str, Any] = {"save_all": True, "duration": duration_ms, "loop": 0}
    if out.suffix.lower() == ".webp":
        with whole_file(out) as part:
            pictures[0].save(
                part, append_images=pictures[1:], quality=60, method=4, minimize_size=True, **shared
            )
        return count
    small = _palette(pictures)
    plain = [each.quantize(palette=small, dither=Image.Dither.NONE) for each in pictures]
    with whole_file(out) as part:
        plain[0].save(part, append_images=plain[1:], optimize=False, **shared)
    return count


def write_told_film(console: Console, recording: Recording, out: Path) -> int:
    """The same, and tell at a console how far it is."""
    with Progress(console=console, transient=True, disable=not shows_progress(console)) as progress:
        drawing = progress.add_task("drawing the film", total=None)

        def on_picture(done: int, count: int) -> None:
            progress.update(drawing, completed=done, total=count)

        return write_film(recording, out, on_picture=on_picture)


def _palette(pictures: Sequence["Image"]) -> "Image":
    """One palette for all pictures, from some of them: colours do not flicker."""
    from PIL import Image, ImageColor

    chosen = pictures[:: max(1, len(pictures) // SAMPLES)]
    sheet = Image.new("RGB", (WIDE, HIGH * len(chosen)))
    for number, picture in enumerate(chosen):
        sheet.paste(picture, (0, number * HIGH))
    named = [*ROBOTS[:ROBOTS_NAMED], *map(_faded, range(ROBOTS_NAMED)), *GROUND, *MARKS.values()]
    seen = sheet.quantize(colors=COLOURS, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))  # with the small areas that a choice by area would lose
    palette.putpalette(seen[: 3 * COLOURS] + [c for n in named for c in ImageColor.getrgb(n)[:3]])
    return palette


class _Film:
    """The player, the ground with all work so far, and the captions."""

    def __init__(self, recording: Recording, film_s: float) -> None:
        self.scene: dict[str, Any] = dict(recording.scene or {})
        index = Index(recording)
        while not index.complete:
            index.work(READ_S)
        self.events = list(index.events)
        self.player = Player(index, False, 1.0)
        self.begin_s = index.begin_at_us / 1e6
        self.span_s = max(recording.end_at_us / 1e6 - self.begin_s, 1e-3)
        self.rate = self.span_s / film_s  # seconds of the run in one of the film
        self.view = self._fitted()
        self.lines = {
            int(section["id"]): _units(section) for section in self.scene.get("sections", ())
        }
        self.done = 0
        self.ground = self._bare()

    # ------------------------------------------------------------ the ground

    def _fitted(self) -> View:
        points = [tuple(p) for ring in self.scene.get("rings", ()) for p in ring]
        grid = self.scene.get("grid")
        if grid:
            (west, south), cell_m = grid["origin"], grid["cell_m"]
            points += [
                (west, south), (west + grid["columns"] * cell_m, south + grid["rows"] * cell_m),
            ]  # fmt: skip
        if not points:
            raise FilmError("the scene has no outline, so there is nothing to show")
        xs, ys = [p[0] for p in points], [p[1] for p in points]
        room = ((WIDE - SIDE - 2 * MARGIN) * DENSE, (HIGH - FOOT - 2 * MARGIN) * DENSE)
        wide_m, high_m = max(max(xs) - min(xs), 1.0), max(max(ys) - min(ys), 1.0)
        scale = min(room[0] / wide_m, room[1] / high_m)
        left = MARGIN * DENSE + (room[0] - wide_m * scale) / 2 - min(xs) * scale
        foot = MARGIN * DENSE + (room[1] + high_m * scale) / 2 + min(ys) * scale
        return View(scale, left, foot)

    def _bare(self) -> "Image":
        from PIL import Image, ImageDraw

        picture = Image.new("RGB", (WIDE * DENSE, HIGH * DENSE), PAPER)
        pen = ImageDraw.Draw(picture)
        for number, ring in enumerate(self.scene.get("rings", ())):
            places = [self.view.at(*p) for p in ring]
            pen.polygon(places, fill=HOLE if number else FIELD)
            pen.line([*places, places[0]], fill=FENCE, width=3)
        grid = self.scene.get("grid")
        if grid:
            self._walls(pen, grid)
        for section in self.scene.get("sections", ()):
            for swath in section["swaths"]:
                pen.line([self.view.at(*p) for p in swath], fill=FREE, width=2)
        if self.scene.get("gate"):
            x, y = self.view.at(*self.scene["gate"])
            pen.polygon([(x, y - 14), (x + 12, y + 10), (x - 12, y + 10)], fill=INK)
        return picture

    def _walls(self, pen: "ImageDraw", grid: dict[str, Any]) -> None:
        bits, columns, cell_m = b64decode(grid["walls"]), grid["columns"], grid["cell_m"]
        west, south = grid["origin"]
        for k in range(grid["rows"] * columns):
            if bits[k >> 3] & (128 >> (k & 7)):
                x_m, y_m = west + (k % columns) * cell_m, south + (k // columns) * cell_m
                (x0, y1), (x1, y0) = (
                    self.view.at(x_m, y_m), self.view.at(x_m + cell_m, y_m + cell_m),
                )  # fmt: skip
                pen.rectangle((x0, y0, x1, y1), fill="#8fa1aa")

    def _worked(self, watcher: Watcher) -> None:
        """Draw what is new: units of sections in the colour of their owner, cells as they were seen."""
        from PIL import ImageDraw

        pen = ImageDraw.Draw(self.ground)
        wide = max(3, round(float(self.scene.get("width_m") or 0.0) * self.view.scale * 0.9))
        for section, block in sorted(watcher.changed_blocks):
            bits, lines = watcher.progress.bits(section, block), self.lines.get(section, [])
            owner = watcher.allocation.owner_of(section)
            for k in range(BLOCK_UNITS):
                unit = block * BLOCK_UNITS + k
                if bits >> k & 1 and unit < len(lines) and lines[unit]:
                    colour = "#6d7b74" if owner is None else _faded(owner)
                    places = [self.view.at(*p) for p in lines[unit]]
                    pen.line(places, fill=colour, width=wide, joint="curve")
                    lines[unit] = []
                    self.done += 1
        cells = self.scene.get("cells")
        for row, column, *values in watcher.cells(sorted(watcher.changed_patches)):
            for k, value in enumerate(values):
                if value:
                    self._cell(pen, cells, row + (k >> 2), column + k % 4, value == 1)
        watcher.changed_blocks, watcher.changed_patches = set(), set()

    def _cell(self, pen: "ImageDraw", cells: Any, row: int, column: int, is_open: bool) -> None:
        west, south = cells["origin"]
        x_m, y_m = west + column * cells["cell_m"], south + row * cells["cell_m"]
        (x0, y1), (x1, y0) = (
            self.view.at(x_m, y_m), self.view.at(x_m + cells["cell_m"], y_m + cells["cell_m"]),
        )  # fmt: skip
        pen.rectangle((x0, y0, x1, y1), fill=OPEN if is_open else WALL)

    # ------------------------------------------------------------ pictures

    def pictures(self, count: int) -> Iterator["Image"]:
        """So many, from the begin of the recording to its end."""
        from PIL import Image, ImageDraw

        for number in range(count):
            now_s = self.begin_s + self.span_s * (number + 1) / count
            self.player.goal_us, self.player.caught_up = now_s * 1e6, False
            while not self.player.caught_up:
                self.player.advance(0.0, READ_S)
            watcher = self.player.watcher
            self._worked(watcher)
            picture = self.ground.copy()
            pen = ImageDraw.Draw(picture)
            self._things(pen, watcher)
            self._robots(pen, watcher, now_s)
            self._side(pen, watcher, now_s)
            self._foot(pen, now_s)
            yield picture.resize((WIDE, HIGH), Image.Resampling.BOX)

    def _things(self, pen: "ImageDraw", watcher: Watcher) -> None:
        for _, x_m, y_m, half_x, half_y, *_ in watcher.things:
            x, y = self.view.at(x_m, y_m)
            a, b = max(half_x * self.view.scale, 6), max(half_y * self.view.scale, 6)
            pen.ellipse((x - a, y - b, x + a, y + b), fill="#ff9d3c")

    def _robots(self, pen: "ImageDraw", watcher: Watcher, now_s: float) -> None:
        radius = max(float(self.scene.get("radius_m", 0.5)) * self.view.scale, 9 * DENSE)
        islands = watcher.islands(now_s)
        part = {slot: k for k, island in enumerate(islands) for slot in island}
        for slot, robot in sorted(watcher.robots.items()):
            if robot.left:
                continue
            x, y = self.view.at(robot.x_m, robot.y_m)
            silent = now_s - robot.last_s > SILENT_S
            intent = watcher.intent(slot, now_s)
            if intent and intent["path"] and not silent:
                places = [self.view.at(*p) for p in ((robot.x_m, robot.y_m), *intent["path"])]
                pen.line(places, fill=ROBOTS[slot % len(ROBOTS)], width=2)
            if len(islands) > 1 and slot in part:
                halo = radius + 5 * DENSE
                tint = ("#ffb020", "#6ad1ff", "#d08bff", "#8dff9a")[part[slot] % 4]
                pen.ellipse((x - halo, y - halo, x + halo, y + halo), outline=tint, width=4)
            fill = "#5b666c" if silent else ROBOTS[slot % len(ROBOTS)]
            edge = STOPPED if robot.stopped else "#0a0f12"
            pen.ellipse(
                (x - radius, y - radius, x + radius, y + radius), fill=fill, outline=edge,
                width=7 if robot.stopped else 3,
            )  # fmt: skip
            ink = "#ffffff" if silent else "#081014"
            pen.text((x, y), str(slot), fill=ink, font=_font(11), anchor="mm")

    def _side(self, pen: "ImageDraw", watcher: Watcher, now_s: float) -> None:
        left = (WIDE - SIDE) * DENSE
        pen.rectangle((left, 0, WIDE * DENSE, HIGH * DENSE), fill=PANEL)
        x, y = left + 16 * DENSE, 14 * DENSE
        pen.text((x, y), str(self.scene.get("name", "")), fill=INK, font=_font(15))
        y += 26 * DENSE
        for slot, robot in sorted(watcher.robots.items()):
            silent = now_s - robot.last_s > SILENT_S and not robot.left
            word = "silent" if silent else "left" if robot.left else robot.state
            colour = ROBOTS[slot % len(ROBOTS)]
            pen.ellipse((x, y + 4, x + 20, y + 24), fill="#5b666c" if silent else colour)
            ink = STOPPED if robot.stopped else "#ffd884" if silent else INK
            text = f"{slot}   {word.lower().replace('_', ' ')}"
            pen.text((x + 32, y), text, fill=ink, font=_font(12))
            y += 20 * DENSE
        y += 10 * DENSE
        past = [event for event in self.events if event.at_s <= now_s][-EVENTS:]
        for event in past:
            pen.text((x, y), _clock(event.at_s - self.begin_s), fill=DIM, font=_font(11))
            for line in _wrapped(event.text, 25):
                ink = MARKS.get(event.kind, INK) if event is past[-1] else DIM
                pen.text((x + 42 * DENSE, y), line, fill=ink, font=_font(11))
                y += 15 * DENSE
            y += 3 * DENSE
        self._caption(pen, now_s)

    def _caption(self, pen: "ImageDraw", now_s: float) -> None:
        """The newest event, large, over the field."""
        event = next((e for e in reversed(self.events) if self._speaks(e, now_s)), None)
        if event is None:
            return
        font = _font(20)
        middle = (WIDE - SIDE) * DENSE / 2
        wide = pen.textlength(event.text, font=font) + 36 * DENSE
        box = (middle - wide / 2, 8 * DENSE, middle + wide / 2, 42 * DENSE)
        colour = MARKS.get(event.kind, INK)
        pen.rounded_rectangle(box, 10 * DENSE, fill=PANEL, outline=colour, width=4)
        pen.text((middle, 25 * DENSE), event.text, fill=colour, font=font, anchor="mm")

    def _speaks(self, event: NotedEvent, now_s: float) -> bool:
        return event.kind in MARKS and 0 <= now_s - event.at_s <= CAPTION_S * self.rate

    def _foot(self, pen: "ImageDraw", now_s: float) -> None:
        top, wide = (HIGH - FOOT) * DENSE, (WIDE - SIDE) * DENSE
        pen.rectangle((0, top, wide, HIGH * DENSE), fill=PANEL)
        left, right = 16 * DENSE, wide - 190 * DENSE
        line, share = top + 17 * DENSE, (now_s - self.begin_s) / self.span_s
        pen.line((left, line, right, line), fill=GRID, width=8)
        pen.line((left, line, left + (right - left) * share, line), fill="#4cc2ff", width=8)
        for event in self.events:
            if event.kind in MARKS:
                x = left + (right - left) * (event.at_s - self.begin_s) / self.span_s
                pen.polygon([(x, line - 4), (x - 9, line - 20), (x + 9, line - 20)],
                            fill=MARKS[event.kind])  # fmt: skip
        units = sum(map(len, self.lines.values()))
        text = _clock(now_s - self.begin_s) + (
            f"   {100 * self.done / units:.0f} %" if units else ""
        )
        pen.text((wide - 16 * DENSE, line), f"{text}   {self.rate:.0f}x", fill=INK, font=_font(12),
                 anchor="rm")  # fmt: skip


def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size * DENSE)


def _faded(slot: int) -> str:
    """The colour of a robot on the colour of the field, for ground that it has worked."""
    mixed = (
        round(int(own, 16) * 0.45 + int(under, 16) * 0.55)
        for own, under in zip(_pairs(ROBOTS[slot % len(ROBOTS)]), _pairs(FIELD), strict=True)
    )
    return "#" + "".join(f"{each:02x}" for each in mixed)


def _pairs(colour: str) -> list[str]:
    return [colour[k : k + 2] for k in (1, 3, 5)]


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _wrapped(text: str, most: int) -> list[str]:
    return textwrap.wrap(text, most) or [""]


def _units(section: dict[str, Any]) -> list[Any]:
    """The units of progress of a section, each a line; as `cut` in the page of the map."""
    lines: list[Any] = []
    for swath, count in zip(section["swaths"], section["units"], strict=True):
        lines += _cut(swath, count)
    return lines


def _cut(line: Sequence[Sequence[float]], count: int) -> list[list[tuple[float, float]]]:
    ends = [0.0]
    for here, there in pairwise(line):
        ends.append(ends[-1] + dist(here, there))

    def along(at_m: float) -> tuple[int, tuple[float, float]]:
        k = next((k for k in range(1, len(line)) if ends[k] >= at_m), len(line) - 1)
        share = (at_m - ends[k - 1]) / max(ends[k] - ends[k - 1], 1e-9)
        (x0, y0), (x1, y1) = line[k - 1], line[k]
        return k, (x0 + (x1 - x0) * share, y0 + (y1 - y0) * share)

    pieces, first, start = [], 1, (line[0][0], line[0][1])
    for unit in range(1, count + 1):
        k, end = along(ends[-1] * unit / count)
        pieces.append([start, *((p[0], p[1]) for p in line[first:k]), end])
        first, start = k, end
    return pieces
