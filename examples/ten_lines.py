"""A fleet on a field, with a stop and a split of the bus, in ten lines; the same as a notebook beside."""

import headland as hl

press = {"kind": "estop", "at_s": 20, "robot": 2, "reason": "PERSON_IN_FIELD"}
release, heal = {"kind": "reset", "at_s": 25}, {"kind": "heal", "at_s": 60}
split = {"kind": "partition", "at_s": 40, "islands": [[0, 1], [2, 3]]}
run = hl.play("small", robots=4, seed=3, faults=[press, release, split, heal])
print(f"{run.coverage:.2%} in {run.makespan_s:.0f} s, {run.contacts} contacts")
print("off their lines, m:", run.rmse_m)
print("the stop:", *run.table("stops"), sep="\n  ")
run.picture("sections").save("sections.svg")
print(run.report("ten_lines.html"))
