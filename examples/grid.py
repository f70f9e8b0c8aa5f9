"""Three robots cover a grid, once in peace and once with a robot that dies."""

from pathlib import Path

import headland as hl

Path("floor.map").write_text(
    "type octile\nheight 4\nwidth 8\nmap\n........\n..@@....\n..@@....\n........\n"
)
crash = {"kind": "crash", "at_s": 10, "robot": 2}
for name, faults in (("peace", []), ("a crash", [crash])):
    run = hl.play("floor.map", robots=3, faults=faults)
    print(f"{name}: {run.makespan_s:.1f} s, {run.uncovered} cells are left")
