"""What the documents print from the code: frames with their layouts, states with their edges, and the
programming interface.

    python -m tools.cli.doc_pages docs       # writes how/frames.md, how/states.*, use/api.md

A test compares the files with what is printed here, so that they cannot be older than the code.
"""

import sys
from html import escape
from inspect import getdoc
from math import cos, hypot, pi, sin
from pathlib import Path

from agent.interface.lifecycle import TABLE, Event, State
from protocol.frames.messages import GROUPS
from tools.cli.api_page import api
from tools.inspect.lifecycle_picture import edges_from

WIDTH, HEIGHT = 860, 620
BOX_W, BOX_H = 156, 40
BEND = 0.16  # of an edge's length to its left, so that there and back are two lines
COLOURS = {
    State.DISCONNECTED: "#e0e0e0", State.IDLE: "#bfe3f2", State.SYNCHRONIZING: "#fbe3b5",
    State.WORKING: "#bfe6c4", State.EMERGENCY_STOP: "#f5b7b1",
}  # fmt: skip
NOTE = "<!-- printed by python -m tools.cli.doc_pages docs; do not edit -->"


def pages() -> dict[str, str]:
    """Paths below the folder of the documents, and what is in each file."""
    return {
        "how/frames.md": frames(), "how/states.md": states(), "how/states.svg": diagram(),
        "use/api.md": f"{NOTE}\n{api()}",
    }  # fmt: skip


def frames() -> str:
    """Every frame: number, priority, length, and the layout that stands beside its type."""
    rows = [
        f"| [{g.name}](#{g.name.lower()}) | {g.pgn:#06x} | {g.priority} | {_first(g.kind)} |"
        for g in GROUPS
    ]
    parts = [
        NOTE, "# Frames", "", "Classic CAN with 29-bit identifiers (ISO 11783-3): priority, parameter "
        "group, source address. Words are little-endian. `headland dbc` writes the same for other tools.",
        "", "| frame | PGN | priority | what it is |", "|---|---|---|---|", *rows, "",
    ]  # fmt: skip
    for group in GROUPS:
        parts += [f"## {group.name}", "", "```text", getdoc(group.kind) or "", "```", ""]
    return "\n".join(parts)


def _first(kind: type) -> str:
    """The first sentence of what stands in the code."""
    return (getdoc(kind) or "").splitlines()[0].split(". ")[0].rstrip(".").replace("|", "\\|")


def states() -> str:
    """The lifecycle as a picture and as its total table."""
    head = "| state | " + " | ".join(event.name for event in Event) + " |"
    rows = []
    for state in State:
        targets = [TABLE[state, event] for event in Event]
        cells = ["" if target is state else target.name for target in targets]
        rows.append(f"| **{state.name}** | " + " | ".join(cells) + " |")
    return "\n".join(
        [NOTE, "# States", "", "What a robot is to its fleet. Events that are not listed for a state are "
         "seen and deliberately ignored; why each edge is there stands in "
         "`agent/interface/lifecycle.py`.", "",
         "![the state machine of a robot](states.svg)", "", head,
         "|---" * (len(Event) + 1) + "|", *rows, ""]
    )  # fmt: skip


def diagram() -> str:
    """An SVG, without anything from elsewhere."""
    centre = {
        state: (WIDTH / 2 - cos(2 * pi * k / len(State)) * (WIDTH / 2 - BOX_W),
                HEIGHT / 2 - sin(2 * pi * k / len(State)) * (HEIGHT / 2 - 2 * BOX_H))
        for k, state in enumerate(State)
    }  # fmt: skip
    lines, labels, boxes = [], [], []
    for state in State:
        for target, events in edges_from(state):
            text = ", ".join(event.name.lower() for event in events)
            line, label = _edge(centre[state], centre[target], text)
            lines.append(line)
            labels.append(label)
        x, y = centre[state]
        boxes.append(
            f'<rect x="{x - BOX_W / 2:.1f}" y="{y - BOX_H / 2:.1f}" width="{BOX_W}" height="{BOX_H}" '
            f'rx="8" fill="{COLOURS[state]}" stroke="#444"/><text x="{x:.1f}" y="{y + 5:.1f}" '
            f'font-weight="bold">{escape(state.name)}</text>'
        )
    return "\n".join(
        [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
         'font-family="sans-serif" font-size="13" text-anchor="middle">',
         "<title>The state machine of a robot</title>",
         '<defs><marker id="end" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" '
         'orient="auto"><path d="M0 0L10 5L0 10z" fill="#444"/></marker></defs>',
         f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>', *lines, *boxes, *labels, "</svg>", ""]
    )  # fmt: skip


def _edge(a: tuple[float, float], b: tuple[float, float], text: str) -> tuple[str, str]:
    """A bent arrow from border to border, and its label at the bend."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = hypot(dx, dy)
    cx = (a[0] + b[0]) / 2 + dy * BEND
    cy = (a[1] + b[1]) / 2 - dx * BEND
    ax, ay = _border(a, (cx, cy))
    bx, by = _border(b, (cx, cy))
    assert length > 0
    line = (
        f'<path d="M{ax:.1f} {ay:.1f}Q{cx:.1f} {cy:.1f} {bx:.1f} {by:.1f}" fill="none" stroke="#444" '
        'stroke-width="1.3" marker-end="url(#end)"/>'
    )
    x, y = 0.25 * ax + 0.5 * cx + 0.25 * bx, 0.25 * ay + 0.5 * cy + 0.25 * by
    wide = 7.0 * len(text) + 6
    label = (
        f'<rect x="{x - wide / 2:.1f}" y="{y - 9:.1f}" width="{wide:.0f}" height="17" fill="#fff" '
        f'opacity="0.85"/><text x="{x:.1f}" y="{y + 4:.1f}">{escape(text)}</text>'
    )
    return line, label


def _border(centre: tuple[float, float], towards: tuple[float, float]) -> tuple[float, float]:
    dx, dy = towards[0] - centre[0], towards[1] - centre[1]
    share = min(BOX_W / 2 / max(abs(dx), 1e-9), BOX_H / 2 / max(abs(dy), 1e-9))
    return centre[0] + dx * share, centre[1] + dy * share


def main(words: list[str]) -> int:
    if len(words) != 1 or not Path(words[0]).is_dir():
        print("headland: name the folder of the documents: python -m tools.cli.doc_pages docs",
              file=sys.stderr)  # fmt: skip
        return 2
    for name, text in pages().items():
        (Path(words[0]) / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
