"""What does a silent robot cost? The same crash, with two policies of the fleet."""

from pathlib import Path

import headland as hl

crash = {"kind": "crash", "at_s": 15, "robot": 1}
for silence in ("slow", "continue"):
    scenario = Path(f"{silence}.toml")
    scenario.write_text(f'''
name = "{silence}"
[field]
file = "small.geojson"
[fleet]
robots = 3
silence = "{silence}"
''')
    run = hl.play(str(scenario), seed=1, faults=[crash], time_limit_s=400)
    print(f"{silence}: {run.coverage:.1%} in {run.simulated_s:.0f} s, {run.contacts} contacts")
