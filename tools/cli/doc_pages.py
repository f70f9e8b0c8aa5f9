"""What the documents print from the code: frames with their layouts, states with their edges, and the
programming interface.

    python -m tools.cli.doc_pages docs       # writes how/frames.md, how/states.*, use/api.md

A test compares the files with what is printed here, so that they cannot be older than the code.
"""

import sys
from inspect import getdoc
from pathlib import Path

from protocol.frames.messages import GROUPS
from tools.cli.api_page import api
from tools.cli.state_pages import MACHINES, diagram, states

NOTE = "<!-- printed by python -m tools.cli.doc_pages docs; do not edit -->"


def pages() -> dict[str, str]:
    """Paths below the folder of the documents, and what is in each file."""
    return {
        "how/frames.md": frames(), "how/states.md": f"{NOTE}\n{states()}",
        **{f"how/{machine.picture}": diagram(machine) for machine in MACHINES},
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


def main(words: list[str]) -> int:
    """Write every printed page into the folder that is named. The exit code is 2 where there is
    none."""
    if len(words) != 1 or not Path(words[0]).is_dir():
        print("headland: name the folder of the documents: python -m tools.cli.doc_pages docs",
              file=sys.stderr)  # fmt: skip
        return 2
    for name, text in pages().items():
        (Path(words[0]) / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
