"""How much of an unknown place do one, two and three robots see in the same time?"""

import headland as hl

for robots in (1, 2, 3):
    run = hl.play("arena", robots=robots, seed=1, time_limit_s=20)
    print(f"{robots} robots: {run.explored:.0%} seen after {run.time_s:.0f} s")
