"""Each robot of a grid goes from its start to a goal of its own: one-shot MAPF without a centre.

`goal_course` makes a plan for all, `goal_agreement` adopts one, `pathfinding_mission` drives it.
"""
