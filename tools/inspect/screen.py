"""`headland inspect` in a terminal: the fleet, one robot's state machine, sections, frames, bus load.

The screen shows what an `Inspector` has heard and knows nothing of where the frames come from: a feed
gives them, from a live bus or from a log. Needs textual, of the extra `operator`.
"""

import asyncio
import re
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Footer, Sparkline, Static

from sim.files.whole_file import write_whole
from tools.inspect.inspector import NO_KEYS, Inspector, Seen, latched_words
from tools.inspect.lifecycle_picture import LIT, picture
from tools.inspect.table_widget import Cell, Rows

LOOKS_A_SECOND = 4  # people do not read faster, and the fleet shares this machine
TRANSITIONS_SHOWN = 12
FLEET = ("robot", "state", "at", "m/s", "works", "peers", "digest")
SECTIONS = ("section", "phase", "owner", "units")
FRAMES = ("frame", "all", "chosen")
FONT_FACE = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
Feed = Callable[["InspectScreen"], Awaitable[None]]
BOTH_ROWS = 36  # of a terminal in which the states and an answer of six lines fit


class InspectScreen(App[None]):
    """Arrow keys choose a robot; `w` asks why a section has its owner."""

    TITLE = "headland inspect"
    CSS = """
    #top { height: 3fr; } #bottom { height: 2fr; }
    #left { width: 3fr; } #right { width: 4fr; }
    Rows { height: 1fr; border: round $primary; background: $background; }
    Rows:focus { border: round $accent; }
    #machine, #path, #why { border: round $primary; height: auto; padding: 0 1; }
    #path, #why { height: 1fr; overflow-y: auto; }
    #loadbox { width: 2fr; border: round $primary; }
    #stops, #keys { height: auto; background: red; color: white; text-style: bold; display: none; }
    #load { height: 1fr; } #status { height: 1; color: $text-muted; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "quit", "Quit"), Binding("space", "pause", "Pause"),
        Binding("w", "why", "Why this section"), Binding("plus", "faster", "Faster"),
        Binding("minus", "slower", "Slower"),
    ]  # fmt: skip

    def __init__(self, inspector: Inspector, title: str, feed: Feed, speed: float = 1.0) -> None:
        super().__init__()
        self.inspector, self.sub_title, self.feed = inspector, title, feed
        self.speed = speed  # of a log; times real time
        self.running = asyncio.Event()  # a paused log gives no frames
        self.running.set()
        self.shown: dict[str, str] = {}  # texts, as they were last drawn
        self.why_of: int | None = None
        self.load_drawn: int | None = None  # second of the newest bin that is whole
        self.drawn = ("", "")  # state of the machine's picture, and the one before
        self.fed = False  # the log is at its end
        self.run_when_ready: Callable[[], Awaitable[None]] | None = None

    def compose(self) -> ComposeResult:
        """The parts of the screen (textual calls it)."""
        yield Static(id="stops", markup=False)
        yield Static(id="keys", markup=False)
        with Horizontal(id="top"):
            with Vertical(id="left"):
                yield Rows(FLEET, id="fleet")
            with Vertical(id="right"):
                yield Static(id="machine", markup=False)
                yield Static(id="path", markup=False)
        with Horizontal(id="bottom"):
            yield Rows(SECTIONS, id="sections")
            yield Rows(FRAMES, id="frames")
            with Vertical(id="loadbox"):
                yield Static(id="share", markup=False)
                yield Sparkline(id="load", summary_function=max)
        yield Static(id="status", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to read frames, and look at the inspector several times a second (textual calls
        it)."""
        self.query_one("#loadbox").border_title = "bus load, worst-case stuffing"
        self.query_one("#fleet").focus()
        self.run_worker(self._fed())
        if self.run_when_ready is not None:
            self.run_worker(self.run_when_ready())
        self.set_interval(1 / LOOKS_A_SECOND, self.look)

    async def _fed(self) -> None:
        await self.feed(self)
        self.fed = True
        self.look()

    # ---------------------------------------------------------------- what is shown

    @property
    def chosen(self) -> Seen | None:
        """The robot under the cursor."""
        slot = self._chosen("fleet")
        return None if slot is None else self.inspector.robots.get(int(slot))

    def _chosen(self, name: str) -> str | None:
        return self.query_one(f"#{name}", Rows).chosen

    def look(self) -> None:
        """Bring the screen up to what was heard. Only cells that differ are touched."""
        if not self.is_running:
            return
        seen = self.inspector.to_dict()
        with self.batch_update():
            self._rows("fleet", [_fleet_row(robot) for robot in seen["robots"]])
            self._rows("sections", [_section_row(n, s) for n, s in seen["sections"].items()])
            chosen = self.chosen
            own: Counter[str] = Counter() if chosen is None else chosen.frames
            self._rows(
                "frames", [(k, str(n), str(own[k] or "")) for k, n in seen["frames"].items()]
            )
            self._robot(chosen)
            self._load(seen)
            stops = self.query_one("#stops", Static)
            stops.display = bool(latched_words(seen))
            self.query_one("#keys", Static).display = seen["keyed"] is False
            self._text("keys", f" {NO_KEYS}")
            self._text("stops", f" EMERGENCY STOP latched: {latched_words(seen)}")

    def _rows(self, name: str, rows: list[tuple[str, ...]]) -> None:
        self.query_one(f"#{name}", Rows).show(sorted(rows, key=lambda row: _in_order(row[0])))

    def _text(self, name: str, text: str | Text) -> None:
        """Draws only what differs, and repeats the layout only for another number of lines."""
        plain = text if isinstance(text, str) else text.plain
        before = self.shown.get(name)
        if text == before and isinstance(text, str):
            return
        lines = -1 if before is None else before.count("\n")
        self.shown[name] = plain
        self.query_one(f"#{name}", Static).update(text, layout=lines != plain.count("\n"))

    def _robot(self, robot: Seen | None) -> None:
        machine, path = self.query_one("#machine", Static), self.query_one("#path", Static)
        if robot is None:
            self._text("machine", "no robot is heard yet")
            return
        machine.border_title = f"robot {robot.slot}"
        # On a low screen the picture of the states leaves no row for an answer, which was asked for.
        machine.display = self.why_of is None or self.size.height >= BOTH_ROWS
        state = (robot.state, robot.transitions[-1].source if robot.transitions else "")
        if state != self.drawn:
            self.drawn = state
            self._text("machine", picture(*state))
        if self.why_of is not None:
            path.border_title = f"why S{self.why_of}"
            self._text("path", self._why_text(self.why_of))
            return
        path.border_title = "transitions, newest first"
        newest = list(robot.transitions)[: -TRANSITIONS_SHOWN - 1 : -1]
        self._text(
            "path",
            f"health {robot.health:.0%}\n"
            + "".join(f"stands: {why}\n" for why in self.inspector.stands(robot))
            + "\n".join(
                f"{t.t_s:10.3f} s  {t.source} → {t.target}  by {t.heard_by}" for t in newest
            ),
        )

    def _why_text(self, section: int) -> Text:
        text = Text()
        for step in self.inspector.causality.chain(section):
            text.append(f"{step.heard.t_s:.3f} s  {step.heard.text}\n", style="bold")
            for cause in step.because:
                text.append(f"   because {cause.text} ({cause.t_s:.3f} s, {cause.kind})\n")
            for rival in step.rivals:
                text.append(f"   against {rival.text}\n", style="dim")
        return text

    def _load(self, seen: dict[str, Any]) -> None:
        load = self.inspector.load
        self._text(
            "share",
            f"{load.newest:.1%} now, {seen['bus_load_worst_case']:.1%} on average, "
            f"{max(load.shares):.1%} at most",
        )
        if load.whole != self.load_drawn:
            self.load_drawn = load.whole
            self.query_one("#load", Sparkline).data = load.shares
        paused = "  PAUSED" if not self.running.is_set() else ""
        end = "  end of the log" if self.fed else ""
        malformed = f"  malformed {sum(seen['malformed'].values())}" if seen["malformed"] else ""
        self._text(
            "status",
            f"{self.sub_title}  {self.inspector.now_s:.1f} s{paused}{end}{malformed}",
        )

    # ---------------------------------------------------------------- keys

    def on_rows_moved(self) -> None:
        """The cursor is on another robot or section, so the screen shows that one."""
        if self.focused is not None and self.focused.id == "fleet":
            self.why_of = None
        self.look()

    def action_pause(self) -> None:
        """Stop or continue to read a log."""
        if self.running.is_set():
            self.running.clear()
        else:
            self.running.set()
        self.look()

    def action_faster(self) -> None:
        """Read a log twice as fast."""
        self.speed *= 2

    def action_slower(self) -> None:
        """Read a log half as fast."""
        self.speed /= 2

    def action_why(self) -> None:
        """Of the section under the cursor; again: back to the transitions."""
        section = self._chosen("sections")
        self.why_of = None if self.why_of is not None or section is None else int(section[1:])
        self._robot(self.chosen)


def draw(screen: InspectScreen, path: Path, size: tuple[int, int] = (150, 42)) -> None:
    """The screen at the end of its feed as an SVG, without a terminal. Raises OSError."""
    drawn: list[str] = []

    async def when_fed() -> None:
        while not screen.fed:
            await asyncio.sleep(1 / LOOKS_A_SECOND)
        screen.look()
        screen.call_after_refresh(finish)

    def finish() -> None:
        drawn.append(screen.export_screenshot(title=screen.TITLE))
        screen.exit()

    screen.run_when_ready = when_fed
    screen.run(headless=True, size=size)
    # Textual handles the errors of what it calls, so the file is written when the screen has ended.
    for svg in drawn:
        write_whole(path, FONT_FACE.sub("", svg))  # nothing from elsewhere


def _in_order(name: str) -> tuple[str, int]:
    """S2 comes before S10."""
    letters = name.rstrip("0123456789")
    return letters, int(name[len(letters) :] or 0)


def _fleet_row(robot: dict[str, Any]) -> tuple[str, ...]:
    state = "silent" if robot["silent"] else "left" if robot["left"] else robot["state"]
    shown = sorted(robot["sections"], key=_in_order)
    place = "" if robot["x_m"] is None else f"{robot['x_m']:.1f}, {robot['y_m']:.1f}"
    return (
        str(robot["slot"]), Cell.styled(state, LIT.get(state, "dim")), place, f"{robot['speed_m_s']:.2f}",
        " ".join(shown), str(len(robot["peers"])), robot["digest"],
    )  # fmt: skip


def _section_row(name: str, section: dict[str, Any]) -> tuple[str, ...]:
    owner = "" if section["owner"] is None else str(section["owner"])
    return name, section["phase"], owner, str(section["units"])
