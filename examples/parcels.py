"""A small warehouse that is written here: three robots deliver six parcels, and one of them dies."""

from pathlib import Path

import headland as hl

Path("depot.toml").write_text('''
name = "depot"
mission = "delivery"
[warehouse]
map = """
..............
...@@@@.@@@@..
...@@@@.@@@@..
..............
"""
random_tasks = 6
[fleet]
robots = 3
''')
crash = {"kind": "crash", "at_s": 20, "robot": 1}
run = hl.play("depot.toml", seed=1, faults=[crash])
print(f"{run.delivered} of {run.tasks} parcels in {run.makespan_s:.0f} s, flaws: {run.flaws}")
run.plot("sections").figure.savefig("parcels.png")
