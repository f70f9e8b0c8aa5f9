"""What the documents print from the code: frames with their layouts, states with their edges,
the keys of scenarios, the programming interface, sockets with their limits, and the chart of chaos.

    python -m tools.cli.doc_pages docs       # writes how/frames.md, how/states.*, use/api.md ...

A test compares the files with what is printed here, so that they cannot be older than the code.
"""

import sys
from pathlib import Path

from tools.cli.api_page import api
from tools.cli.chart_pages import chart
from tools.cli.frame_pages import frames
from tools.cli.route_pages import routes
from tools.cli.scenario_pages import scenario_page
from tools.cli.socket_limits import sockets_page
from tools.cli.state_pages import MACHINES, diagram, states
from tools.common.exit_codes import wrong

NOTE = "<!-- printed by python -m tools.cli.doc_pages docs; do not edit -->"


def pages() -> dict[str, str]:
    """Paths below the folder of the documents, and what is in each file."""
    return {
        "how/frames.md": f"{NOTE}\n{frames()}", "how/states.md": f"{NOTE}\n{states()}",
        **{f"how/{machine.picture}": diagram(machine) for machine in MACHINES},
        "how/routes.md": f"{NOTE}\n{routes()}",
        "how/sockets.md": f"{NOTE}\n{sockets_page()}",
        "measured/chaos.svg": chart(),
        "use/api.md": f"{NOTE}\n{api()}",
        "use/scenario.md": f"{NOTE}\n{scenario_page()}",
    }  # fmt: skip


def main(words: list[str]) -> int:
    """Write every printed page into the folder that is named. The exit code is 2 where there is
    none."""
    if len(words) != 1 or not Path(words[0]).is_dir():
        return wrong("name the folder of the documents: python -m tools.cli.doc_pages docs")
    for name, text in pages().items():
        (Path(words[0]) / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
