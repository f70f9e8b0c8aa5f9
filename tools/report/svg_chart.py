"""Charts as SVG text: a box with ticks, and lines, bars, dots and words in it.

matplotlib needs 0.6 s to be imported and 0.3 s for each picture of a report, which a person waits for.
For axes with ticks and lines a few kinds of elements are enough. Each function below gives
one element as text; `Axes` turns values into pixels. Words stay words: they can be searched, selected
and read aloud, and the title of a mark is shown where the pointer is.
"""

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from math import ceil, floor, inf, isfinite, log10
from typing import NamedTuple

WIDTH_PX = 960.0
FONT_PX = 12.0
SMALL_PX = 9.0
# Width of a character by the height of its font: of DejaVu Sans, which is wider than most.
CHARACTER, CAPITAL = 0.6, 0.68
SAME_PX = 0.5  # a point of a line that is nearer to the last one in both directions is left out
FAR_PX = 1e6  # what is farther from the picture is not drawn
TICK_PX, GAP_PX = 4.0, 6.0
TICKS_APART_PX = 75.0  # at least, on an axis that runs from left to right
ROW_TICKS_APART_PX = 45.0
LEGEND_ROW_PX, SWATCH_PX = 17.0, 12.0
# The colours of robots are the same in light and dark. Prefixes: a page holds several pictures.
STYLE = """<style>.hl-ground{fill:#fff}.hl-text{fill:#222}.hl-edge{stroke:#4c4c4c}
.hl-dim{stroke:#d9d9d9}.hl-fault{fill:#b00020}.hl-fault-line{stroke:#b00020}
@media (prefers-color-scheme: dark){.hl-ground{fill:#12181b}.hl-text{fill:#e6edf0}
.hl-edge{stroke:#a5b4bc}.hl-dim{stroke:#38474f}.hl-fault{fill:#ff8a94}.hl-fault-line{stroke:#ff8a94}}
</style>"""

Points = Iterable[tuple[float, float]]


class AxisSpan(NamedTuple):
    """The values at the two ends of an axis; they may run down."""

    begin: float
    end: float


class PlotBox(NamedTuple):
    """The place of axes in a picture, pixels."""

    left: float
    top: float
    width: float
    height: float


class Axes:
    """Values to pixels. `x` runs from the left edge to the right, `y` from the bottom to the top."""

    def __init__(self, box: PlotBox, x: AxisSpan, y: AxisSpan) -> None:
        self.box, self.x, self.y = box, x, y
        self._x_px = box.width / ((x.end - x.begin) or 1.0)
        self._y_px = box.height / ((y.end - y.begin) or 1.0)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """The pixels of a value."""
        box = self.box
        across_px = box.left + (x - self.x.begin) * self._x_px
        return across_px, box.top + box.height - (y - self.y.begin) * self._y_px

    def path(self, lines: Iterable[Points]) -> str:
        """The data of a path through all these lines. Points that cannot be told from the last one are
        left out, and those that are not finite."""
        found: list[str] = []
        left, bottom = self.box.left, self.box.top + self.box.height
        x_px, y_px, x0, y0 = self._x_px, self._y_px, self.x.begin, self.y.begin
        for line in lines:
            last_x = last_y = inf
            x = y = inf
            for of_x, of_y in line:
                x, y = left + (of_x - x0) * x_px, bottom - (of_y - y0) * y_px
                if -SAME_PX < x - last_x < SAME_PX and -SAME_PX < y - last_y < SAME_PX:
                    continue
                if -FAR_PX < x < FAR_PX and -FAR_PX < y < FAR_PX:
                    found.append(f"{'M' if last_x == inf else 'L'}{x:.1f} {y:.1f}")
                    last_x, last_y = x, y
            if (x, y) != (last_x, last_y) and -FAR_PX < x < FAR_PX and -FAR_PX < y < FAR_PX:
                found.append(f"{'M' if last_x == inf else 'L'}{x:.1f} {y:.1f}")
        return "".join(found)

    def lines(
        self, lines: Iterable[Points], colour: str = "", width_px: float = 1.0, more: str = ""
    ) -> str:
        """Lines of one style; without a colour `more` has a class."""
        data = self.path(lines)
        stroke = f' stroke="{colour}"' if colour else ""
        style = f'fill="none" stroke-width="{width_px:g}" stroke-linejoin="round"'
        return f'<path d="{data}" {style}{stroke}{more}/>\n' if data else ""

    def dot(self, x: float, y: float, colour: str, radius_px: float = 4.0, title: str = "") -> str:
        """A disc; nothing where the place is not finite."""
        x_px, y_px = self.at(x, y)
        if not (abs(x_px) < FAR_PX and abs(y_px) < FAR_PX):
            return ""
        shape = f'<circle cx="{x_px:.1f}" cy="{y_px:.1f}" r="{radius_px:g}" fill="{colour}"'
        return _titled(shape, "circle", title)

    def bar(
        self,
        begin: float,
        end: float,
        row: float,
        colour: str,
        opacity: float = 1.0,
        title: str = "",
    ) -> str:
        """From one value of x to another, in the row `row` of axes whose rows are 1 apart."""
        (x, y), (end_x, _) = self.at(begin, row), self.at(end, row)
        if not (abs(x) < FAR_PX and abs(end_x) < FAR_PX):
            return ""
        height = abs(self._y_px) * 0.8
        shape = (
            f'<rect x="{x:.1f}" y="{y - height / 2:.1f}" width="{max(end_x - x, 0.3):.1f}" '
            f'height="{height:.1f}" fill="{colour}"'
        )
        return _titled(shape + (f' opacity="{opacity:g}"' if opacity < 1.0 else ""), "rect", title)

    def tick(self, x: float, row: float, style: str, title: str = "") -> str:
        """A short upright line in a row. `style`: attributes of the line."""
        x_px, y_px = self.at(x, row)
        half = abs(self._y_px) * 0.4
        shape = f'<path d="M{x_px:.1f} {y_px - half:.1f}v{2 * half:.1f}" stroke-width="1.5" {style}'
        return _titled(shape, "path", title) if abs(x_px) < FAR_PX else ""

    def frame(self) -> str:
        """The edges of the box."""
        left, top, width, height = self.box
        return (
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" '
            'fill="none" class="hl-edge"/>\n'
        )

    def x_ticks(self, name: str, grid: bool = False) -> str:
        """Values below the box, the name of the axis, and lines through the box with `grid`."""
        left, top, width, height = self.box
        bottom = top + height
        found = []
        for value, label in ticks(self.x, width / TICKS_APART_PX):
            x, _ = self.at(value, self.y.begin)
            if grid:
                found.append(f'<path d="M{x:.1f} {top:.1f}V{bottom:.1f}" class="hl-dim"/>')
            found.append(f'<path d="M{x:.1f} {bottom:.1f}v{TICK_PX}" class="hl-edge"/>')
            found.append(text(x, bottom + TICK_PX + FONT_PX, label, anchor="middle"))
        found.append(text(left + width / 2, bottom + 2.4 * FONT_PX + GAP_PX, name, anchor="middle"))
        return "".join(found) + "\n"

    def y_ticks(self, name: str, grid: bool = False, percent: bool = False) -> str:
        """As `x_ticks`, left of the box."""
        left, top, width, height = self.box
        found = []
        for value, label in ticks(self.y, height / ROW_TICKS_APART_PX, percent):
            _, y = self.at(self.x.begin, value)
            if grid:
                found.append(f'<path d="M{left:.1f} {y:.1f}h{width:.1f}" class="hl-dim"/>')
            found.append(f'<path d="M{left:.1f} {y:.1f}h{-TICK_PX}" class="hl-edge"/>')
            found.append(text(left - GAP_PX, y + FONT_PX / 3, label, anchor="end"))
        x, y = FONT_PX, top + height / 2
        found.append(text(x, y, name, anchor="middle", turned=-90))
        return "".join(found) + "\n"

    def rows(self, names: Sequence[str], size_px: float = FONT_PX) -> str:
        """The names of rows, left of the box."""
        found = []
        for row, name in enumerate(names):
            _, y = self.at(self.x.begin, row)
            found.append(text(self.box.left - GAP_PX, y + size_px / 3, name, size_px, "end"))
        return "".join(found) + "\n"


def row_span(count: int) -> AxisSpan:
    """Of the y axis, for rows 0 to `count` - 1 from top to bottom."""
    return AxisSpan(count - 0.4, -0.6)


def text(
    x_px: float, y_px: float, words: str, size_px: float = FONT_PX, anchor: str = "start",
    style: str = 'class="hl-text"', turned: float = 0.0,
) -> str:  # fmt: skip
    """Words at their baseline, turned clockwise by degrees."""
    turn = f' transform="rotate({turned:g} {x_px:.1f} {y_px:.1f})"' if turned else ""
    place = "" if anchor == "start" else f' text-anchor="{anchor}"'
    size = "" if size_px == FONT_PX else f' font-size="{size_px:g}"'
    return f'<text x="{x_px:.1f}" y="{y_px:.1f}" {style}{place}{size}{turn}>{escape(words)}</text>'


def width_of(words: Iterable[str], size_px: float = FONT_PX) -> float:
    """Of the widest of them, in pixels, as an estimate."""
    widths = (sum(CAPITAL if c.isupper() else CHARACTER for c in word) for word in words)
    return size_px * max(widths, default=0.0)


def legend(left_px: float, top_px: float, entries: Iterable[tuple[str, str]]) -> str:
    """A swatch and a name for each (colour, name), below each other."""
    found = []
    for row, (colour, name) in enumerate(entries):
        y = top_px + row * LEGEND_ROW_PX
        found.append(
            f'<rect x="{left_px:.1f}" y="{y:.1f}" width="{SWATCH_PX:g}" height="{SWATCH_PX:g}" '
            f'rx="2" fill="{colour}"/>'
        )
        found.append(text(left_px + SWATCH_PX + GAP_PX, y + SWATCH_PX - 2.0, name))
    return "".join(found) + "\n"


def legend_width(names: Iterable[str]) -> float:
    """Room that a legend needs, in pixels."""
    width = width_of(names)
    return GAP_PX * 3 + SWATCH_PX + width if width else GAP_PX * 2


def document(
    height_px: float, title: str, parts: Iterable[str], width_px: float = WIDTH_PX
) -> bytes:
    """A whole file; equal parts give equal bytes."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px:.0f}" height="{height_px:.0f}" '
        f'viewBox="0 0 {width_px:.0f} {height_px:.0f}" role="img" aria-label="{escape(title)}" '
        f'font-family="system-ui, sans-serif" font-size="{FONT_PX:g}">{STYLE}\n'
        f'<rect width="100%" height="100%" class="hl-ground"/>\n{"".join(parts)}</svg>\n'
    ).encode()


def ticks(span: AxisSpan, most: float, percent: bool = False) -> Iterator[tuple[float, str]]:
    """Round values between the ends, 1, 2 or 5 times a power of ten apart, with their labels."""
    least, end = min(span), max(span)
    width = end - least
    if not (isfinite(width) and width > 0.0):
        return
    rough = width / max(most, 1.0)
    power = floor(log10(rough))
    step = next(k for k in (1, 2, 5, 10) if k * 10.0**power >= rough * (1 - 1e-9)) * 10.0**power
    digits = max(0, -floor(log10(step) + 1e-9) - (2 if percent else 0))
    for k in range(ceil(least / step - 1e-9), floor(end / step + 1e-9) + 1):
        value = k * step
        shown = value * 100 if percent else value
        yield value, f"{shown + 0.0:.{digits}f}" + ("%" if percent else "")


def _titled(shape: str, name: str, title: str) -> str:
    return f"{shape}><title>{escape(title)}</title></{name}>\n" if title else f"{shape}/>\n"
