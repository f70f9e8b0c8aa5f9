"""A table of the screen: lines that change several times a second, and a cursor.

Textual's own table renders every cell again when one has changed, which at 20 robots takes most of a
core. Here only the lines in view are built, each from its cells.
"""

from collections.abc import Sequence
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.geometry import Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip

GAP = 2  # cells between columns
HEAD, CURSOR, BLURRED = Style(bold=True), Style(reverse=True), Style(underline=True)


class Cell(str):
    """A text with a style of its own."""

    style = ""

    @classmethod
    def styled(cls, text: str, style: str) -> "Cell":
        """Make one with this text, drawn in `style` of rich."""
        cell = cls(text)
        cell.style = style
        return cell


class Rows(ScrollView, can_focus=True):
    """`show` gives it all rows each time; a row is known by its first cell."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", "Up", show=False), Binding("down", "move(1)", "Down", show=False),
        Binding("home", "move(-9999)", "First", show=False),
        Binding("end", "move(9999)", "Last", show=False),
    ]  # fmt: skip

    class Moved(Message):
        """Another row is under the cursor."""

    def __init__(self, columns: Sequence[str], id: str) -> None:
        super().__init__(id=id)
        self.border_title = id
        self.columns = tuple(columns)
        self.rows: list[tuple[str, ...]] = []
        self.cursor = 0
        self._widths: list[int] = []

    @property
    def chosen(self) -> str | None:
        """The first cell of the row under the cursor."""
        return self.rows[self.cursor][0] if self.rows else None

    def show(self, rows: list[tuple[str, ...]]) -> None:
        """Nothing is drawn where nothing has changed. The cursor stays on its row."""
        if rows == self.rows:
            return
        chosen = self.chosen
        self.rows = rows
        names = [row[0] for row in rows]
        self.cursor = names.index(chosen) if chosen in names else 0
        self._widths = [max(map(len, column)) for column in zip(self.columns, *rows, strict=True)]
        size = Size(sum(self._widths) + GAP * len(self._widths), len(rows) + 1)
        if size != self.virtual_size:
            self.virtual_size = size
        self.refresh()

    def action_move(self, rows: int) -> None:
        """Move the cursor by so many rows, and scroll to it."""
        moved = min(max(self.cursor + rows, 0), max(len(self.rows) - 1, 0))
        if moved != self.cursor:
            self.cursor = moved
            self._into_view()
            self.refresh()
            self.post_message(self.Moved())

    def _into_view(self) -> None:
        line, height = self.cursor + 1, self.scrollable_content_region.height
        top = self.scroll_offset.y
        if line < top + 1:
            self.scroll_to(y=line - 1, animate=False)
        elif line >= top + height:
            self.scroll_to(y=line - height + 1, animate=False)

    def render_line(self, y: int) -> Strip:
        """The line `y` of the view, counted from its top. The head stays on the first line."""
        width, row = self.size.width, y + self.scroll_offset.y - 1
        if y == 0:
            return self._strip(self.columns, HEAD, width)
        if not 0 <= row < len(self.rows):
            return Strip.blank(width, self.rich_style)
        style = Style.null()
        if row == self.cursor:
            style = CURSOR if self.has_focus else BLURRED
        return self._strip(self.rows[row], style, width)

    def _strip(self, cells: Sequence[str], style: Style, width: int) -> Strip:
        ground = self.rich_style  # read once, because it costs as much as the rest of a line
        line = ground + style
        segments = []
        for cell, column_width in zip(cells, self._widths or map(len, cells), strict=True):
            own = Style.parse(cell.style) if isinstance(cell, Cell) and cell.style else None
            pad = " " * (column_width - len(cell) + GAP)
            if own is None:
                segments.append(Segment(cell + pad, line))
            else:
                segments += [Segment(cell, ground + own), Segment(pad, line)]
        return Strip(segments).crop_extend(0, width, line)
