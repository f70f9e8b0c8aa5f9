"""How long does each robot take to stand after a person has pressed stop?"""

import headland as hl

press = {"kind": "estop", "at_s": 20, "robot": 0, "reason": "PERSON_IN_FIELD"}
release = {"kind": "reset", "at_s": 25}
run = hl.play("small", robots=4, seed=1, faults=[press, release])
stops = run.frame("stops")
print(stops.to_string(index=False))
print(f"moved after they had to stand: {run.moved_after_stop}")
