"""Robots of two rooms want into the other one, through a corridor of one robot's width."""

import headland as hl

run = hl.play("corridor", robots=4, seed=2)
print(f"all arrived: {run.finished}, {run.contacts} contacts, {run.simulated_s:.0f} s")
for robot in run.robots:
    print(f"robot {robot.slot}: {robot.driven_m:.1f} m, {robot.rmse_m:.2f} m off its lines")
run.plot().figure.savefig("errands.png")
